"""The files of an InterHand2.6M download: where they lie, in any of the arrangements in which people have it, and the
annotations in them, read entry by entry so that a damaged one is named. Layout: DATA 5."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from jghand_engine.captures.reading import calibrated_camera, find_roots, one_root, subfolders
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import METERS_PER_UNIT, JointOrder, to_level
from jghand_engine.json_files import JsonObject, numbers
from jghand_engine.render.camera import Camera

SPLITS = ("train", "val", "test")
# where a split's annotations are: version 1.0, and then the older drops, the most complete one first
_DROPS = ("{split}", "all", "machine_annot", "human_annot", ".")
_BATCH = "InterHand2.6M_*fps_batch*"
_DATA_FILE = re.compile(r"InterHand2\.6M_(train|val|test)_(data|camera|joint_3d)\.json")
# of the numbers in its files
UNIT = "mm"
INTERACTING = "interacting"
_FIRST_JOINT = {Handedness.RIGHT: 0, Handedness.LEFT: JOINT_COUNT}
_DOWNLOAD = "Download InterHand2.6M's annotations again, and unpack them as annotations/<split>/."


@dataclass(frozen=True)
class InterHandFiles:
    """The files of one split.

    root:     the folder that holds `annotations`
    images:   the folder of the split's Capture folders
    masks:    the same for `masks_removeblack`, or None
    mano:     the annotations of MANO fits, or None
    capture, sequence: what the folder that the user named stands for, when it is inside the data set; else None
    """

    root: Path
    split: str
    images: Path
    masks: Path | None
    data: Path
    camera: Path
    joint_3d: Path
    mano: Path | None
    capture: str | None = None
    sequence: str | None = None


def is_interhand(folder: Path) -> bool:
    """Whether `folder` holds annotations named as InterHand2.6M names them, whole or not."""
    annotations = folder / "annotations"
    return annotations.is_dir() and any(
        _DATA_FILE.fullmatch(entry.name)
        for place in [annotations, *subfolders(annotations)]
        for entry in place.iterdir()
    )


def find_files(folder: Path, split: str | None = None) -> InterHandFiles:
    """The files that belong to `folder`: the data set itself, the folder around it, or one inside it.

    split: which one; None: the only one, or the one that `folder` lies in. InputError says what is missing.
    """
    root = one_root(folder, find_roots(folder, is_interhand))
    named_split, capture, sequence = _named(root, folder.resolve())
    present = {name: place for name in SPLITS if (place := _annotations(root, name))}
    stored = {name: place for name in present if (place := _images(root, name))}
    split = _split(list(present), list(stored), split or named_split, root)
    if split not in stored:
        remedy = "Put the folder images beside the folder annotations."
        raise InputError(f"images of {root}", wanted=f"a folder images/{split}", came="none", remedy=remedy)
    masks = stored[split].parent.with_name("masks_removeblack") / split
    data, camera, joint_3d, mano = (
        present[split] / f"InterHand2.6M_{split}_{kind}.json"
        for kind in ("data", "camera", "joint_3d", "MANO_NeuralAnnot")
    )
    return InterHandFiles(
        root=root,
        split=split,
        images=stored[split],
        masks=masks if masks.is_dir() else None,
        data=data,
        camera=camera,
        joint_3d=joint_3d,
        mano=mano if mano.is_file() else None,
        capture=capture,
        sequence=sequence,
    )


def _named(root: Path, folder: Path) -> tuple[str | None, str | None, str | None]:
    """(split, capture, sequence) that a folder inside the data set stands for, such as images/test/Capture0."""
    if not folder.is_relative_to(root):
        return None, None, None
    parts = [part for part in folder.relative_to(root).parts if not Path(part).match(_BATCH)][1:4]
    return tuple(parts[k] if k < len(parts) and (k or parts[k] in SPLITS) else None for k in range(3))  # type: ignore[return-value]


def _split(present: list[str], with_images: list[str], wanted: str | None, root: Path) -> str:
    """The wanted one, or the only one."""
    if wanted in present:
        return wanted
    if wanted is None and len(with_images) == 1:
        return with_images[0]
    if wanted is None and len(present) == 1:
        return present[0]
    raise InputError(
        f"split '{wanted}' of {root}" if wanted else f"data set {root}",
        wanted=f"one of {', '.join(present)}" if present else "annotations of a split, …_data.json",
        came=f"annotations of {', '.join(present)}" if present else "none",
        remedy="Name the folder of one of them, such as images/test, or a protocol." if present else _DOWNLOAD,
    )


def _annotations(root: Path, split: str) -> Path | None:
    places = [root / "annotations" / drop.format(split=split) for drop in _DROPS]
    return next((place for place in places if (place / f"InterHand2.6M_{split}_data.json").is_file()), None)


def _images(root: Path, split: str) -> Path | None:
    places = [root / "images" / split, *sorted(root.glob(f"{_BATCH}/images/{split}"))]
    return next((place for place in places if place.is_dir()), None)


# ---- what is in them -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class InterHandImage:
    """An image as the annotations list it.

    hand_type: 'right', 'left' or 'interacting' · joint_valid: (42,) bool, right hand first · bbox_px: x, y, width,
    height of the hand, or nothing · where: names the entry in errors
    """

    file_name: str
    width: int
    height: int
    capture: str
    sequence: str
    camera: str
    frame: int
    hand_type: str
    hand_type_valid: bool
    joint_valid: np.ndarray
    bbox_px: tuple[float, ...]
    where: str


def read_annotations(files: InterHandFiles) -> Iterator[InterHandImage]:
    """Every annotated image of a split. InputError names the first entry that is not as it should be."""
    content = JsonObject.of_file(files.data, _DOWNLOAD)
    images, annotations = content.entries("images"), content.entries("annotations")
    try:
        by_id = {image["id"]: image for image in images}
    except (KeyError, TypeError) as error:
        raise content.wrong("images", "an id each") from error
    for number, annotation in enumerate(annotations):
        where = f"annotation {number} in {files.data}"
        try:
            yield _image(by_id[annotation["image_id"]], annotation, where)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            came = f"{type(error).__name__}: {error}"[:200]
            raise InputError(where, wanted="an entry as InterHand2.6M has it", came=came, remedy=_DOWNLOAD) from error


class CaptureTables:
    """Cameras, joints and MANO fits of one person. Reading them raises InputError as `read_annotations` does."""

    def __init__(self, files: InterHandFiles, capture: str) -> None:
        self._files = files
        self._cameras, self._joints = (
            JsonObject.of_file(file, _DOWNLOAD).needed(capture) for file in (files.camera, files.joint_3d)
        )
        self._fits = JsonObject.of_file(files.mano, _DOWNLOAD).object(capture) if files.mano else None
        self._has_fits = files.mano is not None
        self._made: dict[tuple[str, int, int], Camera] = {}

    def joints(self, image: InterHandImage, handedness: Handedness) -> np.ndarray | None:
        """(21, 3) level order, world, meters; None unless all are known."""
        entry = self._joints.needed(str(image.frame))
        first = _FIRST_JOINT[handedness]
        hand = slice(first, first + JOINT_COUNT)
        coordinates = entry.array("world_coord", (2 * JOINT_COUNT, 3))
        known = image.joint_valid
        if "joint_valid" in entry.fields:
            known = known & (entry.array("joint_valid", (2 * JOINT_COUNT,)) > 0)
        if not known[hand].all():
            return None
        if not np.isfinite(coordinates[hand]).all():
            raise entry.wrong("world_coord", "finite numbers for joints that are marked as valid")
        return to_level(coordinates[hand], JointOrder.INTERHAND) * METERS_PER_UNIT[UNIT]

    def camera(self, image: InterHandImage) -> Camera:
        """The image's camera; the same object for all images of a camera and a size."""
        key = (image.camera, image.width, image.height)
        if key not in self._made:
            self._made[key] = self._camera(image)
        return self._made[key]

    def has_fit(self, image: InterHandImage, handedness: Handedness) -> bool | None:
        """Whether there is a MANO fit of that hand; None where the set has no file of them."""
        if not self._has_fits:
            return None
        hands = None if self._fits is None else self._fits.object(str(image.frame))
        return hands is not None and bool(hands.fields.get(handedness.value))

    def _camera(self, image: InterHandImage) -> Camera:
        what = f"camera {image.camera} in {self._files.camera}"
        rotation, position, focal, center = (
            self._cameras.needed(name).array(image.camera, shape)
            for name, shape in (("camrot", (3, 3)), ("campos", (3,)), ("focal", (2,)), ("princpt", (2,)))
        )
        intrinsics = [[focal[0], 0, center[0]], [0, focal[1], center[1]], [0, 0, 1]]
        # absurd numbers become infinite, and are refused as such
        with np.errstate(over="ignore", invalid="ignore"):
            translation_m = -rotation @ (position * METERS_PER_UNIT[UNIT])
        return calibrated_camera(what, (image.width, image.height), intrinsics, rotation, translation_m)


def _image(image: dict[str, Any], annotation: dict[str, Any], where: str) -> InterHandImage:
    name = PurePosixPath(str(image["file_name"]).replace("\\", "/"))
    if name.is_absolute() or ".." in name.parts or ":" in str(name):
        raise ValueError(f"file_name {str(name)!r} leads out of the data set")
    if len(name.parts) < 4:
        raise ValueError(f"file_name {str(name)!r} is not Capture…/sequence/camera/image")
    hand_type = str(annotation["hand_type"])
    if hand_type not in (*(hand.value for hand in Handedness), INTERACTING):
        raise ValueError(f"hand_type {hand_type!r}")
    return InterHandImage(
        file_name=str(name),
        width=int(image["width"]),
        height=int(image["height"]),
        capture=str(image["capture"]),
        sequence=str(image["seq_name"]),
        camera=str(image["camera"]),
        frame=int(image["frame_idx"]),
        hand_type=hand_type,
        hand_type_valid=bool(annotation.get("hand_type_valid", True)),
        joint_valid=numbers(annotation["joint_valid"], (2 * JOINT_COUNT,), f"joint_valid in {where}", _DOWNLOAD) > 0,
        bbox_px=tuple(float(number) for number in annotation.get("bbox", ())),
        where=where,
    )
