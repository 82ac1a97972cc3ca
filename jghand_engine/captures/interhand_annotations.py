"""The annotation files of InterHand2.6M, read entry by entry so that a damaged one is named. Layout: DATA 5."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from jghand_engine.captures.cameras import calibrated_camera
from jghand_engine.captures.interhand_files import InterHandFiles
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import METERS_PER_UNIT, JointOrder, to_level
from jghand_engine.json_files import numbers, read_object
from jghand_engine.render.camera import Camera

UNIT = "mm"
INTERACTING = "interacting"
_FIRST_JOINT = {Handedness.RIGHT: 0, Handedness.LEFT: JOINT_COUNT}
_REMEDY = "Download and unpack the annotations again."


@dataclass(frozen=True)
class InterHandPicture:
    """A picture as the annotations list it.

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


def read_pictures(files: InterHandFiles) -> Iterator[InterHandPicture]:
    """Every annotated picture of a split. InputError names the first entry that is not as it should be."""
    content = read_object(files.data, _REMEDY)
    images, annotations = (_list(content, name, files.data) for name in ("images", "annotations"))
    try:
        by_id = {image["id"]: image for image in images}
    except (KeyError, TypeError) as error:
        raise InputError(f"images in {files.data}", wanted="an id each", came=repr(error), remedy=_REMEDY) from error
    for number, annotation in enumerate(annotations):
        where = f"annotation {number} in {files.data}"
        try:
            yield _picture(by_id[annotation["image_id"]], annotation, where)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            came = f"{type(error).__name__}: {error}"[:200]
            raise InputError(where, wanted="an entry as InterHand2.6M has it", came=came, remedy=_REMEDY) from error


class CaptureTables:
    """Cameras, joints and MANO fits of one person. Reading them raises InputError as `read_pictures` does."""

    def __init__(self, files: InterHandFiles, capture: str) -> None:
        self._files = files
        self._cameras, self._joints = (
            _entry(read_object(file, _REMEDY), capture, f"Capture{capture} in {file}")
            for file in (files.camera, files.joint_3d)
        )
        self._fits = read_object(files.mano, _REMEDY).get(capture, {}) if files.mano else None
        self._made: dict[tuple[str, int, int], Camera] = {}

    def joints(self, picture: InterHandPicture, handedness: Handedness) -> tuple[np.ndarray, np.ndarray]:
        """(21, 3) level order, world, meters, NaN where not known; (21,) bool, which are known."""
        where = f"{self._files.joint_3d}, frame {picture.frame}"
        entry = _entry(self._joints, str(picture.frame), where)
        first = _FIRST_JOINT[handedness]
        hand = slice(first, first + JOINT_COUNT)
        coordinates = numbers(
            _entry(entry, "world_coord", where), (2 * JOINT_COUNT, 3), f"world_coord in {where}", _REMEDY
        )
        known = picture.joint_valid & _flags(entry.get("joint_valid", picture.joint_valid), f"joint_valid in {where}")
        valid = to_level(np.repeat(known[hand, None], 3, axis=1), JointOrder.INTERHAND)[:, 0]
        joints_m = to_level(coordinates[hand], JointOrder.INTERHAND) * METERS_PER_UNIT[UNIT]
        if not np.isfinite(joints_m[valid]).all():
            raise InputError(
                f"world_coord in {where}", wanted="numbers for joints that are marked as valid",
                came="NaN or infinity", remedy=_REMEDY,
            )  # fmt: skip
        joints_m[~valid] = np.nan
        return joints_m, valid

    def camera(self, picture: InterHandPicture) -> Camera:
        """The picture's camera; the same object for all pictures of a camera and a size."""
        key = (picture.camera, picture.width, picture.height)
        if key not in self._made:
            self._made[key] = self._camera(picture)
        return self._made[key]

    def has_fit(self, picture: InterHandPicture, handedness: Handedness) -> bool | None:
        """Whether there is a MANO fit of that hand; None where the set has no file of them."""
        if self._fits is None:
            return None
        hands = self._fits.get(str(picture.frame)) if isinstance(self._fits, dict) else None
        return bool(isinstance(hands, dict) and hands.get(handedness.value))

    def _camera(self, picture: InterHandPicture) -> Camera:
        what = f"camera {picture.camera} in {self._files.camera}"
        rotation, position, focal, center = (
            numbers(
                _entry(_entry(self._cameras, name, what), picture.camera, what), shape, f"{name} of {what}", _REMEDY
            )
            for name, shape in (("camrot", (3, 3)), ("campos", (3,)), ("focal", (2,)), ("princpt", (2,)))
        )
        intrinsics = [[focal[0], 0, center[0]], [0, focal[1], center[1]], [0, 0, 1]]
        # absurd numbers become infinite, and are refused as such
        with np.errstate(over="ignore", invalid="ignore"):
            translation_m = -rotation @ (position * METERS_PER_UNIT[UNIT])
        return calibrated_camera(what, (picture.width, picture.height), intrinsics, rotation, translation_m)


def _picture(image: dict[str, Any], annotation: dict[str, Any], where: str) -> InterHandPicture:
    name = PurePosixPath(str(image["file_name"]).replace("\\", "/"))
    if name.is_absolute() or ".." in name.parts or ":" in str(name):
        raise ValueError(f"file_name {str(name)!r} leads out of the data set")
    if len(name.parts) < 4:
        raise ValueError(f"file_name {str(name)!r} is not Capture…/sequence/camera/picture")
    hand_type = str(annotation["hand_type"])
    if hand_type not in (*(hand.value for hand in Handedness), INTERACTING):
        raise ValueError(f"hand_type {hand_type!r}")
    return InterHandPicture(
        file_name=str(name),
        width=int(image["width"]),
        height=int(image["height"]),
        capture=str(image["capture"]),
        sequence=str(image["seq_name"]),
        camera=str(image["camera"]),
        frame=int(image["frame_idx"]),
        hand_type=hand_type,
        hand_type_valid=bool(annotation.get("hand_type_valid", True)),
        joint_valid=_flags(annotation["joint_valid"], f"joint_valid in {where}"),
        bbox_px=tuple(float(number) for number in annotation.get("bbox", ())),
        where=where,
    )


def _list(content: dict[str, Any], name: str, file: Path) -> list[Any]:
    entries = content.get(name)
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{file}", wanted=f"a list '{name}'", came="none, or an empty one", remedy=_REMEDY)
    return entries


def _entry(table: Any, key: str, where: str) -> Any:
    if not isinstance(table, dict) or key not in table:
        raise InputError(where, wanted=f"an entry '{key}'", came="none", remedy=_REMEDY)
    return table[key]


def _flags(values: Any, what: str) -> np.ndarray:
    """42 flags, listed flat or as 42 x 1 -> (42,) bool."""
    return numbers(values, (2 * JOINT_COUNT,), what, _REMEDY) > 0
