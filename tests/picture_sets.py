"""Small data sets in exactly the layouts of InterHand2.6M and HanCo: colored silhouettes of the template."""

import functools
import json
import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from jghand_engine.captures.interhand_writer import RecordedHand, write_interhand
from jghand_engine.captures.masks import template_mask
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.hand.poses import named_pose
from jghand_engine.render.camera import Camera
from jghand_engine.template.builtin import load_template

RIGHT, LEFT = Handedness.RIGHT, Handedness.LEFT
POSES = ("open", "fist", "point")
SKIN, WALL = (200, 150, 120), (40, 60, 30)
FAR = np.array([0.4, -0.3, 1.2])


@functools.cache
def pose(index: int, handedness: Handedness = RIGHT) -> np.ndarray:
    """(21, 3) level order, meters: a pose by number, somewhere in the room."""
    joints = named_pose(POSES[index % len(POSES)], load_template().joints_m, handedness=handedness) + FAR
    joints.setflags(write=False)
    return joints


def look(azimuth_deg: float, width: int, height: int, handedness: Handedness = RIGHT) -> Camera:
    """A camera 0.8 m from the hand, all of which it sees; the principal point is not the middle."""
    turn = np.radians(azimuth_deg)
    side = -1.0 if handedness is LEFT else 1.0
    target = FAR + np.array([0.0, 0.08, 0.0])
    eye = target + 0.8 * np.array([side * np.sin(turn), 0.2, np.cos(turn)])
    eye, target, up = (torch.as_tensor(vector) for vector in (eye, target, np.array([0.0, 1.0, 0.0])))
    made = Camera.looking_at(eye, target, up, width=width, height=height, focal_px=2.2 * min(width, height))
    return Camera(width, height, made.fx, made.fy * 1.001, made.cx + 3.25, made.cy - 5.5, made.camera_from_world)


def recorded(
    handedness: Handedness = RIGHT,
    *,
    frames: int = 2,
    cameras: int = 2,
    suffix: str = ".png",
    first_frame: int = 2000,
    **named,
) -> RecordedHand:
    """A hand in some poses before some cameras: every other one portrait, 334 x 512, and landscape, 512 x 334.

    Frames are counted through all sequences of a person in the data set: give each another `first_frame`.
    """
    sizes = ((334, 512), (512, 334))
    views = {str(400262 + k): look(-40 + 55 * k, *sizes[k % 2], handedness) for k in range(cameras)}
    joints = {first_frame + 6 * k: pose(k, handedness) for k in range(frames)}
    boxes = {(frame, name): box_px(view, joints[frame]) for frame in joints for name, view in views.items()}
    return RecordedHand(views, joints, boxes, handedness, suffix=suffix, **named)


def box_px(camera: Camera, joints_m: np.ndarray) -> tuple[float, float, float, float]:
    """x, y, width, height around the joints, as InterHand2.6M has it."""
    pixels = camera.project(joints_m)[0]
    low, high = pixels.min(0) - 15, pixels.max(0) + 15
    return low[0], low[1], *(high - low)


_MASKS: dict[tuple, np.ndarray] = {}


def _mask(camera: Camera, frame: int, handedness: Handedness) -> np.ndarray:
    key = (camera.width, camera.height, camera.fx, camera.camera_from_world.tobytes(), frame, handedness)
    if key not in _MASKS:
        _MASKS[key] = template_mask(camera, pose(frame, handedness), handedness)
    return _MASKS[key]


def write_set(folder: Path, *hands: RecordedHand, joint_flags_flat: bool = False) -> Path:
    """Annotations of several recordings of one split in one file, as the data set has them, and their pictures."""
    merged: dict[str, dict] = {}
    for hand in hands:
        for file in write_interhand(folder / "one", hand)[:3]:
            _merge(merged.setdefault(file.name, {}), json.loads(file.read_text()))
        _write_pictures(folder, hand)
    for number, image in enumerate(merged[f"InterHand2.6M_{hands[0].split}_data.json"]["images"]):
        image["id"] = number
    for number, entry in enumerate(merged[f"InterHand2.6M_{hands[0].split}_data.json"]["annotations"]):
        entry["id"] = entry["image_id"] = number
        if joint_flags_flat:
            entry["joint_valid"] = [flag for (flag,) in entry["joint_valid"]]
    shutil.rmtree(folder / "one")
    place = folder / "annotations" / hands[0].split
    place.mkdir(parents=True, exist_ok=True)
    for name, content in merged.items():
        (place / name).write_text(json.dumps(content))
    return folder


def _merge(into: dict, more: dict) -> None:
    for key, value in more.items():
        if isinstance(value, dict) and key in into:
            _merge(into[key], value)
        elif isinstance(value, list) and key in ("images", "annotations"):
            into.setdefault(key, []).extend(value)
        else:
            into[key] = value


def _write_pictures(folder: Path, hand: RecordedHand) -> None:
    place = {frame: number for number, frame in enumerate(hand.joints_m)}
    for frame, name in hand.boxes_px:
        file = hand.image(folder, frame, name)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_picture(file, _mask(hand.cameras[name], place[frame], hand.handedness))


def write_picture(file: Path, mask: np.ndarray) -> None:
    """A hand of one color: PNG with straight alpha, JPEG before a dark wall."""
    if file.suffix == ".png":
        rgba = np.zeros((*mask.shape, 4), np.uint8)
        rgba[..., :3], rgba[..., 3] = SKIN, np.round(mask * 255)
        Image.fromarray(rgba).save(file, compress_level=1)
    else:
        rgb = mask[..., None] * np.array(SKIN) + (1 - mask[..., None]) * np.array(WALL)
        Image.fromarray(np.round(rgb).astype(np.uint8)).save(file, quality=95)


def write_masks(folder: Path, hand: RecordedHand, suffix: str = ".png") -> None:
    """masks_removeblack/ as the avatar papers' preparation writes it: three equal channels, 0 and 255."""
    for place, frame in enumerate(hand.joints_m):
        for name, camera in hand.cameras.items():
            file = folder / "masks_removeblack" / hand.split / hand.image_name(frame, name)
            file.parent.mkdir(parents=True, exist_ok=True)
            mask = np.where(_mask(camera, place, hand.handedness) >= 0.5, 255, 0).astype(np.uint8)
            Image.fromarray(np.repeat(mask[..., None], 3, axis=2)).save(file.with_suffix(suffix), quality=90)


@contextmanager
def edited(folder: Path, kind: str, split: str = "train"):
    """The content of an annotation file, to be changed and written back: 'data', 'camera' or 'joint_3d'."""
    file = next(folder.rglob(f"InterHand2.6M_{split}_{kind}.json"))
    content = json.loads(file.read_text())
    yield content
    file.write_text(json.dumps(content))


# ---- HanCo ----------------------------------------------------------------------------------------------------------


def write_hanco(
    folder: Path, sequences: tuple[int, ...] = (191,), frames: int = 2, subjects: dict | None = None
) -> Path:
    """HanCo with `frames` valid frames in each of `sequences`, as many that are not valid, and none in the others."""
    views = [look(45.0 * c, 224, 224) for c in range(8)]
    count = max(sequences) + 1
    listed = [2 * frames if sid in sequences else 1 for sid in range(count)]
    meta = {
        "is_train": [[True] * n for n in listed],
        "is_valid": [[k < frames for k in range(n)] if n > 1 else [False] for n in listed],
        "subject_id": [[(subjects or {}).get(sid, 7)] * n for sid, n in enumerate(listed)],
        "object_id": [[None] * n for n in listed],
        "has_fit": [[True] * n for n in listed],
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "meta.json").write_text(json.dumps(meta))
    calib = {"K": [k_of(view).tolist() for view in views], "M": [view.camera_from_world.tolist() for view in views]}
    for sid in sequences:
        for fid in range(frames):
            standard = from_level(pose(fid), JointOrder.STANDARD)
            for part, content in (("calib", calib), ("xyz", standard.tolist())):
                file = folder / part / f"{sid:04d}" / f"{fid:08d}.json"
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(json.dumps(content))
            for c, view in enumerate(views):
                mask = _hanco_mask(c, fid)
                for part in ("rgb", "mask_hand"):
                    file = folder / part / f"{sid:04d}" / f"cam{c}" / f"{fid:08d}.jpg"
                    file.parent.mkdir(parents=True, exist_ok=True)
                    if part == "rgb":
                        write_picture(file, mask)
                    else:
                        Image.fromarray(np.round(255 * mask).astype(np.uint8)).save(file, quality=90)
                assert view.width == 224
    return folder


@functools.cache
def _hanco_mask(camera: int, frame: int) -> np.ndarray:
    return template_mask(look(45.0 * camera, 224, 224), pose(frame), RIGHT)


def k_of(camera: Camera) -> np.ndarray:
    """(3, 3) intrinsics."""
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
