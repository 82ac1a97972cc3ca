"""How far a motion from a film is from the truth, in the ways that tell what a film can give from what it cannot.

One camera does not see how large a hand is: lengths are compared at one common scale of the whole film, never at one
for each picture, which would hide errors of depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.rotations import alignment
from jghand_engine.hand.sequence import bone_directions
from jghand_engine.track.track import FINGER_BONES, angles_between_deg

METACARPALS = slice(0, 5)
# of the chain from the wrist to the middle tip, which is a hand's length
_LONGEST = [2, 7, 12, 17]
_MM = 1e-3


@dataclass(frozen=True)
class MotionErrors:
    """Means over joints and pictures in millimeters at one common scale; of angles and pixels the median and the 95th
    percentile.

    aligned_mm: each picture moved, turned and scaled onto the truth · wrist_mm: wrist on wrist, not turned
    place_mm:   before the camera as they are
    camera_deg: of finger bones before the camera · palm_deg: the same, metacarpals laid upon each other
    bones_part: mean error of the 20 bones' lengths (medians over the film), as a part of them
    px:         of the joints in the picture
    """

    aligned_mm: float
    wrist_mm: float
    place_mm: float
    camera_deg: tuple[float, float]
    palm_deg: tuple[float, float]
    bones_part: float
    px: tuple[float, float]

    def __str__(self) -> str:
        def pair(values: tuple[float, float]) -> str:
            return f"{values[0]:.1f} / {values[1]:.0f}"

        return (
            f"aligned {self.aligned_mm:.1f} mm, wrist {self.wrist_mm:.1f} mm, finger bones {pair(self.camera_deg)} deg,"
            f" in the palm {pair(self.palm_deg)} deg, bone lengths {100 * self.bones_part:.1f} %,"
            f" {pair(self.px)} px, place {self.place_mm:.0f} mm"
        )


def motion_errors(joints_m: np.ndarray, focal_px: float, truth_m: np.ndarray, truth_focal_px: float) -> MotionErrors:
    """Joints (F, 21, 3) in level order before the camera (camera axes, meters), each with its own focal length and the
    same principal point."""
    lengths, true_lengths = (np.median(bone_lengths(joints), axis=0) for joints in (joints_m, truth_m))
    scale = true_lengths[_LONGEST].sum() / lengths[_LONGEST].sum()
    scaled = scale * joints_m
    directions, true_directions = bone_directions(joints_m), bone_directions(truth_m)
    turn = alignment(directions[:, METACARPALS], true_directions[:, METACARPALS])
    in_palm = directions @ np.swapaxes(turn, -1, -2)
    px = [f * joints[..., :2] / joints[..., 2:] for f, joints in ((focal_px, joints_m), (truth_focal_px, truth_m))]
    return MotionErrors(
        aligned_mm=_mean_mm(_aligned(joints_m, truth_m) - truth_m),
        wrist_mm=_mean_mm(scaled - scaled[:, :1] - truth_m + truth_m[:, :1]),
        place_mm=_mean_mm(scaled - truth_m),
        camera_deg=_median_and_95(angles_between_deg(directions, true_directions)[:, FINGER_BONES]),
        palm_deg=_median_and_95(angles_between_deg(in_palm, true_directions)[:, FINGER_BONES]),
        bones_part=float(np.abs(scale * lengths / true_lengths - 1).mean()),
        px=_median_and_95(np.linalg.norm(px[0] - px[1], axis=-1)),
    )


def _aligned(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Each picture's joints as near to the truth as moving, turning and scaling brings them (Umeyama 1991)."""
    middle, true_middle = (points.mean(1, keepdims=True) for points in (joints, truth))
    turned = (joints - middle) @ np.swapaxes(alignment(joints - middle, truth - true_middle), -1, -2)
    scale = (turned * (truth - true_middle)).sum((1, 2)) / np.square(turned).sum((1, 2))
    return scale[:, None, None] * turned + true_middle


def _mean_mm(offsets_m: np.ndarray) -> float:
    return float(np.linalg.norm(offsets_m, axis=-1).mean() / _MM)


def _median_and_95(errors: np.ndarray) -> tuple[float, float]:
    return float(np.median(errors)), float(np.percentile(errors, 95))
