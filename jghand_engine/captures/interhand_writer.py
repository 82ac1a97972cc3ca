"""Writes annotations in the layout of InterHand2.6M v1.0, so that one loader serves its captures and ours. DATA 5.

Millimeters, x_camera = R (X - campos) with OpenCV axes, joints tip first with the right hand in places 0 to 20; the
hand that is not there is filled with ones and marked as not valid.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.files import write_file
from jghand_engine.hand.joints import FINGERS, JOINT_COUNT, Handedness
from jghand_engine.hand.orders import METERS_PER_UNIT, JointOrder, check_joint_shape, from_level
from jghand_engine.render.camera import Camera


@dataclass(frozen=True)
class RecordedHand:
    """One hand in some frames, each seen by some cameras.

    cameras:   name (a number as text, as the data set has serials) -> camera, world in meters
    joints_m:  frame number -> (21, 3) joints, level order, world, meters
    boxes_px:  (frame, camera) of every image -> x, y, width, height of the hand in it, pixels
    capture, sequence, split, subject: where the images are said to come from
    suffix:    of the image files
    """

    cameras: Mapping[str, Camera]
    joints_m: Mapping[int, np.ndarray]
    boxes_px: Mapping[tuple[int, str], tuple[float, float, float, float]]
    handedness: Handedness = Handedness.RIGHT
    capture: int = 0
    sequence: str = "ROM_JGHAND"
    split: str = "train"
    subject: int = 0
    suffix: str = ".png"

    def image_name(self, frame: int, camera: str) -> str:
        """The name of an image in the annotations, relative to images/{split}."""
        return f"Capture{self.capture}/{self.sequence}/cam{camera}/image{frame}{self.suffix}"

    def image(self, folder: Path, frame: int, camera: str) -> Path:
        """Where an image of the capture in `folder` is."""
        return folder / "images" / self.split / self.image_name(frame, camera)


def write_interhand(folder: Path | str, hand: RecordedHand) -> list[Path]:
    """Writes the annotations below `folder`/annotations and returns their files. The images are the caller's.

    InputError for joints that are no (21, 3) finite numbers.
    """
    files = {Path(folder) / name: text for name, text in interhand_texts(hand).items()}
    for file, text in files.items():
        write_file(file, text)
    return list(files)


def interhand_texts(hand: RecordedHand) -> dict[str, str]:
    """What `write_interhand` writes, by the name of the file in its folder. InputError as there."""
    for frame, joints in hand.joints_m.items():
        check_joint_shape(joints)
        if not np.isfinite(joints).all():
            raise InputError(f"joints of frame {frame}", wanted="finite numbers", came="NaN or infinity")
    stem = f"annotations/{hand.split}/InterHand2.6M_{hand.split}"
    contents = {
        f"{stem}_data.json": _data(hand),
        f"{stem}_camera.json": {str(hand.capture): _cameras(hand)},
        f"{stem}_joint_3d.json": {str(hand.capture): _joints(hand)},
    }
    texts = {name: json.dumps(content, allow_nan=False) for name, content in contents.items()}
    return texts | {"annotations/skeleton.txt": _skeleton()}


def _data(hand: RecordedHand) -> dict[str, Any]:
    images, annotations = [], []
    for (frame, name), box in hand.boxes_px.items():
        if frame not in hand.joints_m:
            continue
        camera, number = hand.cameras[name], len(images)
        images.append({
            "id": number, "file_name": hand.image_name(frame, name), "width": camera.width,
            "height": camera.height, "capture": hand.capture, "subject": hand.subject,
            "seq_name": hand.sequence, "camera": name, "frame_idx": frame,
        })  # fmt: skip
        annotations.append({
            "id": number, "image_id": number, "bbox": list(box),
            "joint_valid": _valid(hand, 1, 0), "hand_type": hand.handedness.value, "hand_type_valid": 1,
        })  # fmt: skip
    return {"images": images, "annotations": annotations}


def _cameras(hand: RecordedHand) -> dict[str, dict[str, Any]]:
    result: dict[str, dict[str, Any]] = {"campos": {}, "camrot": {}, "focal": {}, "princpt": {}}
    for name, camera in hand.cameras.items():
        matrix = camera.camera_from_world
        place_m = -matrix[:3, :3].T @ matrix[:3, 3]
        result["campos"][name] = (place_m / METERS_PER_UNIT["mm"]).tolist()
        result["camrot"][name] = matrix[:3, :3].tolist()
        result["focal"][name] = [camera.fx, camera.fy]
        result["princpt"][name] = [camera.cx, camera.cy]
    return result


def _joints(hand: RecordedHand) -> dict[str, Any]:
    absent = np.ones((JOINT_COUNT, 3))
    result = {}
    for frame, joints in hand.joints_m.items():
        present = from_level(np.asarray(joints, dtype=np.float64), JointOrder.INTERHAND) / METERS_PER_UNIT["mm"]
        both = [present, absent] if hand.handedness is Handedness.RIGHT else [absent, present]
        result[str(frame)] = {
            "world_coord": np.concatenate(both).tolist(), "joint_valid": _valid(hand, True, False),
            "hand_type": hand.handedness.value, "hand_type_valid": True,
        }  # fmt: skip
    return result


def _valid(hand: RecordedHand, yes: int | bool, no: int | bool) -> list[list[int | bool]]:
    """42 x 1, as the data set has it."""
    right = hand.handedness is Handedness.RIGHT
    return [[yes if right else no]] * JOINT_COUNT + [[no if right else yes]] * JOINT_COUNT


def _skeleton() -> str:
    """Lines of name, number and parent, as in skeleton.txt of the data set."""
    lines = []
    for side, base in (("r", 0), ("l", JOINT_COUNT)):
        wrist = base + JOINT_COUNT - 1
        for finger, name in enumerate(FINGERS):
            for level in (4, 3, 2, 1):
                number = base + 4 * finger + 4 - level
                lines.append(f"{side}_{name}{level} {number} {wrist if level == 1 else number + 1}")
        lines.append(f"{side}_wrist {wrist} -1")
    return "\n".join(lines) + "\n"
