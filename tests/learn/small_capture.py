"""A tiny capture in the InterHand2.6M layout, painted with our own renderer from the built-in avatar."""

from pathlib import Path

import numpy as np
import torch

from jghand_engine.avatar.builtin import load_painted
from jghand_engine.captures.interhand_writer import RecordedHand, write_interhand
from jghand_engine.export.pictures import write_png
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import MotionOptions, pose_sequence_of_names
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset

SIDES = {"400001": (1.0, 0.2, 0.3), "400002": (-1.0, 0.1, 0.3), "400003": (0.2, 1.0, 0.2), "400004": (0.6, -0.6, 0.5)}

# how far the cameras are away, and what they show of the space there
DISTANCE_M, HAND_M = 0.5, 0.24


def write_small_capture(folder: Path, *, poses: int = 6, size_px: tuple[int, int] = (64, 48)) -> Path:
    """`poses` poses between open and fist, seen by four cameras; every fifth pose is for the test, by the rule."""
    avatar = load_painted(handedness=Handedness.RIGHT)
    motion = pose_sequence_of_names(
        ["open", "fist"], avatar.canonical_joints_m, handedness=Handedness.RIGHT,
        options=MotionOptions(hold_s=0.0),
    )  # fmt: skip
    chosen = np.linspace(0, len(motion) - 1, poses).round().astype(int)
    joints_m = {10 * index: motion.joints_m[frame] for index, frame in enumerate(chosen)}
    middle_m = np.mean(list(joints_m.values()), axis=(0, 1))
    middle_m, up = torch.from_numpy(middle_m), torch.tensor([0.1, 0.9, 0.4])
    width, height = size_px
    cameras = {}
    for name, side in SIDES.items():
        eye_m = middle_m + DISTANCE_M * torch.nn.functional.normalize(torch.tensor(side, dtype=torch.float64), dim=0)
        focal_px = min(size_px) / HAND_M * DISTANCE_M
        cameras[name] = Camera.looking_at(eye_m, middle_m, up, width=width, height=height, focal_px=focal_px)
    renderer = HandRenderer(avatar, preset("final"))
    boxes = {}
    pictures = {}
    for frame, pose_m in joints_m.items():
        for name, camera in cameras.items():
            pictures[frame, name] = renderer.render(pose_m, camera).rgba
            rows, columns = np.nonzero(pictures[frame, name][..., 3] > 0.5)
            left, top = int(columns.min()), int(rows.min())
            boxes[frame, name] = (left, top, int(columns.max()) - left + 1, int(rows.max()) - top + 1)
    hand = RecordedHand(cameras, joints_m, boxes)
    write_interhand(folder, hand)
    for (frame, name), rgba in pictures.items():
        write_png(hand.image(folder, frame, name), rgba)
    return folder
