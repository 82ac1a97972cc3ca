"""One picture of a hand that something can be learnt from: the record that every loader of a data set gives."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from jghand_engine.hand.joints import Handedness
from jghand_engine.splat.camera import Camera


class MaskSource(StrEnum):
    """Where the mask of a picture comes from: a file of its own, the picture's alpha, or the projected template."""

    FILE = "file"
    ALPHA = "alpha"
    TEMPLATE = "template"


@dataclass(frozen=True)
class Sample:
    """A picture on disk and what is known of it; nothing is read until `load_picture`.

    picture:     path of the picture, sRGB
    camera:      OpenCV camera, world -> camera, metres; its size is the picture's
    joints_m:    (21, 3) float64, level order, world, metres; of a left hand not mirrored
    valid:       (21,) bool, which joints are known
    handedness:  which hand
    capture, sequence, frame, camera_name: where it comes from; (sequence, frame) names a pose
    mask_source, mask: how to get the mask; `mask` is the file for MaskSource.FILE
    """

    picture: Path
    camera: Camera
    joints_m: np.ndarray
    valid: np.ndarray
    handedness: Handedness
    capture: str
    sequence: str
    frame: int
    camera_name: str
    mask_source: MaskSource = MaskSource.ALPHA
    mask: Path | None = None

    @property
    def pose(self) -> tuple[str, int]:
        """What names the pose: pictures of several cameras share it."""
        return self.sequence, self.frame


@dataclass(frozen=True)
class TrainingPicture:
    """rgb: (H, W, 3) float32, display-referred sRGB over black, 0..1 · mask: (H, W) float32, 0..1"""

    rgb: np.ndarray
    mask: np.ndarray
