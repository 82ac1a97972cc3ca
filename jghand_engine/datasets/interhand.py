"""InterHand2.6M, and our own captures, which are stored the same way. Layout: DATA 5.

    images/{train,val,test}/Capture{N}/{sequence}/cam{serial}/image{frame}.jpg
    annotations/{split}/InterHand2.6M_{split}_{data,camera,joint_3d}.json      (older: annotations/{all,…}/)
    masks_removeblack/{split}/…png                                             masks that others made, where there are

Its millimetres become metres, its tip-first joints level order, and x_camera = R (X - campos) our camera_from_world.
The hand that a picture does not show is filled with ones there; only `joint_valid` tells. A principal point is taken
as measured from the picture's corner, as in our own captures; the data set does not say whether it counts from there
or from the middle of the first pixel, which would be half a pixel.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import numpy as np

from jghand_engine.datasets.cameras import calibrated_camera
from jghand_engine.datasets.captures import Capture, CaptureChoice, Layout
from jghand_engine.datasets.interhand_files import InterHandFiles, find_files
from jghand_engine.datasets.json_files import read_object
from jghand_engine.datasets.pictures_in import probe_picture
from jghand_engine.datasets.plausibility import check_joints
from jghand_engine.datasets.sample import MaskSource, Sample
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import METRES_PER_UNIT, JointOrder, to_level
from jghand_engine.splat.camera import Camera

_FIRST_JOINT = {Handedness.RIGHT: 0, Handedness.LEFT: JOINT_COUNT}
_INTERACTING = "interacting"
_UNIT = "mm"
_REMEDY = "Download and unpack the annotations again."
Value = TypeVar("Value")


@dataclass(frozen=True)
class InterHandPicture:
    """A picture as the annotations list it. bbox_px: x, y, width, height of the hand · joint_valid: (42,) bool"""

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


# decides from a picture's annotation, its file and its mask file why a protocol leaves it out; None: it stays
DropRule = Callable[[InterHandPicture, Path, Path | None], str | None]


def read_interhand(
    folder: Path | str, choice: CaptureChoice | None = None, drop_rule: DropRule | None = None
) -> Capture:
    """The pictures of one hand in a folder of the InterHand2.6M layout.

    The head of every picture is read: InputError names the first that is missing, cut off or of another size than
    annotated. InputError too for damaged annotations, when the choice leaves more than one person or hand, and for
    joints that are no hand. Pictures without all 21 joints are left out unless the choice takes them.
    """
    choice = choice or CaptureChoice()
    files = find_files(Path(folder), choice.split)
    return _Reader(files, choice, drop_rule).capture()


class _Reader:
    """One reading of one split; counts what it leaves out."""

    def __init__(self, files: InterHandFiles, choice: CaptureChoice, drop_rule: DropRule | None) -> None:
        self.files, self.choice, self.drop_rule = files, choice, drop_rule
        self.capture_wanted = choice.capture or files.capture
        self.sequences_wanted = choice.sequences or ((files.sequence,) if files.sequence else None)
        self.dropped: Counter[str] = Counter()
        self.cameras: dict[tuple[str, int, int], Camera] = {}

    def capture(self) -> Capture:
        pictures = self._chosen(list(_pictures(self.files)))
        handedness = self._handedness(pictures)
        capture = pictures[0].capture
        camera_table = _of_capture(self.files.camera, capture)
        joint_table = _of_capture(self.files.joint_3d, capture)
        fits = read_object(self.files.mano, _REMEDY).get(capture, {}) if self.drop_rule and self.files.mano else None
        samples: list[Sample] = []
        for picture in pictures:
            if fits is not None and not (fits.get(str(picture.frame)) or {}).get(handedness.value):
                self.dropped["no MANO fit"] += 1
                continue
            sample = self._sample(picture, handedness, camera_table, joint_table)
            if sample is not None:
                samples.append(sample)
        name = f"{self.files.root.name} {self.files.split}/Capture{capture}"
        made = Capture(
            name=name,
            folder=self.files.root,
            layout=Layout.INTERHAND,
            samples=tuple(sorted(samples, key=lambda s: (s.sequence, s.frame, s.camera_name))),
            handedness=handedness,
            dropped=tuple(sorted(self.dropped.items())),
            notes=_notes(samples),
        )
        check_joints(made.joints_m(), JointOrder.INTERHAND, _UNIT, str(self.files.joint_3d))
        return made

    def _chosen(self, pictures: list[InterHandPicture]) -> list[InterHandPicture]:
        """The pictures of the wanted person and sequences. InputError when there are none, or several persons."""
        captures = sorted({picture.capture for picture in pictures})
        wanted = None if self.capture_wanted is None else self.capture_wanted.removeprefix("Capture")
        if wanted is None and len(captures) > 1:
            raise InputError(
                f"data set {self.files.images}",
                wanted="the pictures of one person",
                came=f"{len(captures)} captures: {', '.join(f'Capture{name}' for name in captures)}",
                remedy="Name the capture, or a protocol.",
            )
        of_person = [picture for picture in pictures if wanted in (None, picture.capture)]
        if not of_person:
            _missing("capture", f"Capture{wanted}", [f"Capture{name}" for name in captures], self.files.data)
        sequences = sorted({picture.sequence for picture in of_person})
        for name in self.sequences_wanted or ():
            if name not in sequences:
                _missing("sequence", name, sequences, self.files.data)
        kept = [picture for picture in of_person if picture.sequence in (self.sequences_wanted or sequences)]
        unsure = sum(not picture.hand_type_valid for picture in kept)
        if unsure:
            self.dropped["not sure which hand it is"] += unsure
        return [picture for picture in kept if picture.hand_type_valid] or kept

    def _handedness(self, pictures: list[InterHandPicture]) -> Handedness:
        if self.choice.handedness is not None:
            return self.choice.handedness
        hands = sorted({picture.hand_type for picture in pictures} - {_INTERACTING})
        if len(hands) == 1:
            return Handedness(hands[0])
        raise InputError(
            f"hand of {self.files.images}",
            wanted="one hand",
            came=f"pictures of {' and '.join(hands)} hands" if hands else "only pictures with both hands",
            remedy="Say which hand, or choose sequences of one hand.",
        )

    def _sample(
        self, picture: InterHandPicture, handedness: Handedness, camera_table: dict, joint_table: dict
    ) -> Sample | None:
        """The picture as a sample, or None when it is left out (and counted)."""
        if picture.hand_type != handedness and not (picture.hand_type == _INTERACTING and self.choice.interacting):
            self.dropped[f"shows {picture.hand_type}"] += 1
            return None
        joints_m, valid = self._joints(picture, handedness, joint_table)
        if not valid.all() and not self.choice.partial:
            self.dropped["not all 21 joints known"] += 1
            return None
        file, mask = self._file(picture), self._mask_file(picture)
        reason = self.drop_rule(picture, file, mask) if self.drop_rule else None
        if reason is not None:
            self.dropped[reason] += 1
            return None
        return Sample(
            picture=file,
            camera=self._camera(picture, camera_table),
            joints_m=joints_m,
            valid=valid,
            handedness=handedness,
            capture=f"{self.files.split}/Capture{picture.capture}",
            sequence=picture.sequence,
            frame=picture.frame,
            camera_name=picture.camera,
            mask_source=self._mask_source(picture, file, mask),
            mask=mask,
        )

    def _joints(
        self, picture: InterHandPicture, handedness: Handedness, joint_table: dict
    ) -> tuple[np.ndarray, np.ndarray]:
        """(21, 3) level order, world, metres, NaN where not known; (21,) bool."""
        where = f"{self.files.joint_3d}, frame {picture.frame}"
        entry = _entry(joint_table, str(picture.frame), where)
        first = _FIRST_JOINT[handedness]
        hand = slice(first, first + JOINT_COUNT)
        coordinates = _numbers(_entry(entry, "world_coord", where), (2 * JOINT_COUNT, 3), f"world_coord in {where}")
        known = picture.joint_valid & _flags(entry.get("joint_valid", picture.joint_valid), f"joint_valid in {where}")
        valid = to_level(np.repeat(known[hand, None], 3, axis=1), JointOrder.INTERHAND)[:, 0]
        joints_m = to_level(coordinates[hand], JointOrder.INTERHAND) * METRES_PER_UNIT[_UNIT]
        valid &= np.isfinite(joints_m).all(axis=1)
        joints_m[~valid] = np.nan
        return joints_m, valid

    def _camera(self, picture: InterHandPicture, table: dict) -> Camera:
        key = (picture.camera, picture.width, picture.height)
        if key not in self.cameras:
            what = f"camera {picture.camera} in {self.files.camera}"
            parts = [_entry(_entry(table, name, what), picture.camera, what) for name in _CAMERA_FIELDS]
            rotation = _numbers(parts[0], (3, 3), f"camrot of {what}")
            position_m = _numbers(parts[1], (3,), f"campos of {what}") * METRES_PER_UNIT[_UNIT]
            focal, centre = (_numbers(part, (2,), f"focal and princpt of {what}") for part in parts[2:])
            intrinsics = [[focal[0], 0, centre[0]], [0, focal[1], centre[1]], [0, 0, 1]]
            size = (picture.width, picture.height)
            self.cameras[key] = calibrated_camera(what, size, intrinsics, rotation, -rotation @ position_m)
        return self.cameras[key]

    def _file(self, picture: InterHandPicture) -> Path:
        """The picture's file, whose head fits its annotation."""
        file = self.files.images / picture.file_name
        facts = probe_picture(file)
        if (facts.width, facts.height) != (picture.width, picture.height):
            raise InputError(
                f"size of {file}",
                wanted=f"{picture.width} x {picture.height} pixels, as {self.files.data.name} says",
                came=f"{facts.width} x {facts.height}",
                remedy="Pictures that were resized or turned do not fit their cameras: take the originals.",
            )
        return file

    def _mask_file(self, picture: InterHandPicture) -> Path | None:
        if self.files.masks is None:
            return None
        named = self.files.masks / picture.file_name
        return next((file for file in (named.with_suffix(".png"), named) if file.is_file()), None)

    def _mask_source(self, picture: InterHandPicture, file: Path, mask: Path | None) -> MaskSource:
        if mask is not None:
            return MaskSource.FILE
        # alpha would hold both hands
        if picture.hand_type != _INTERACTING and probe_picture(file).has_alpha:
            return MaskSource.ALPHA
        return MaskSource.TEMPLATE


_CAMERA_FIELDS = ("camrot", "campos", "focal", "princpt")


def _notes(samples: list[Sample]) -> tuple[str, ...]:
    projected = sum(sample.mask_source is MaskSource.TEMPLATE for sample in samples)
    if not projected:
        return ()
    return (
        f"{projected} of {len(samples)} pictures have no mask: the projected template stands in for it, so figures are "
        "not comparable with those of papers.",
    )


# ---- the annotation files -------------------------------------------------------------------------------------------


def _pictures(files: InterHandFiles) -> Iterator[InterHandPicture]:
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


def _picture(image: dict[str, Any], annotation: dict[str, Any], where: str) -> InterHandPicture:
    name = PurePosixPath(str(image["file_name"]).replace("\\", "/"))
    if name.is_absolute() or ".." in name.parts:
        raise ValueError(f"file_name {str(name)!r} leads out of the data set")
    hand_type = str(annotation["hand_type"])
    if hand_type not in (*Handedness, _INTERACTING):
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
    )


def _list(content: dict[str, Any], name: str, file: Path) -> list[Any]:
    if not isinstance(content.get(name), list) or not content[name]:
        raise InputError(f"{file}", wanted=f"a list '{name}'", came="none, or an empty one", remedy=_REMEDY)
    return content[name]


def _of_capture(file: Path, capture: str) -> dict[str, Any]:
    return _entry(read_object(file, _REMEDY), capture, f"Capture{capture} in {file}")


def _entry(table: Any, key: str, where: str) -> Any:
    if not isinstance(table, dict) or key not in table:
        raise InputError(where, wanted=f"an entry '{key}'", came="none", remedy=_REMEDY)
    return table[key]


def _numbers(values: Any, shape: tuple[int, ...], what: str) -> np.ndarray:
    try:
        return np.array(values, dtype=np.float64).reshape(shape)
    except (TypeError, ValueError) as error:
        raise InputError(what, wanted=f"numbers of shape {shape}", came=str(error)[:200], remedy=_REMEDY) from error


def _flags(values: Any, what: str) -> np.ndarray:
    """42 flags, listed flat or as 42 x 1 -> (42,) bool."""
    return _numbers(values, (2 * JOINT_COUNT,), what) > 0


def _missing(kind: str, name: str, present: list[str], file: Path) -> None:
    came = ", ".join(present[:20]) + (" …" if len(present) > 20 else "")
    raise InputError(
        f"{kind} '{name}'", wanted=f"one of those in {file}", came=came or "none", remedy="Check its name."
    )
