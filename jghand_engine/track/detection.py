"""What a detector of hands says about a picture. Everything behind this interface is the same for every detector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness

# one right and one left: those of one person
HANDS_MAX = 2


@dataclass(frozen=True, eq=False)
class SeenHand:
    """One hand in one picture.

    image_px:   (21, 2) landmarks, level order, pixels; (0, 0) is the top left corner of the picture
    space_m:    (21, 3) the detector's idea of the hand in space, level order: x right, y down, z away from the camera,
                about meters, around the hand's middle. Its bones wobble: their directions are what counts
    handedness: which hand it is, the right way round
    score:      how sure the detector is of the handedness, 0..1
    """

    image_px: np.ndarray
    space_m: np.ndarray
    handedness: Handedness
    score: float

    def __post_init__(self) -> None:
        for name, shape in (("image_px", (JOINT_COUNT, 2)), ("space_m", (JOINT_COUNT, 3))):
            array = np.asarray(getattr(self, name), dtype=np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise InputError(f"detected hand: {name}", wanted=f"finite numbers {shape}", came=str(array.shape))
            object.__setattr__(self, name, array)
        object.__setattr__(self, "handedness", Handedness(self.handedness))

    @property
    def middle_px(self) -> np.ndarray:
        """(2,) where the hand is."""
        return self.image_px.mean(0)

    @property
    def size_px(self) -> float:
        """How large it is: twice the landmarks' distance from their middle."""
        return float(2 * np.sqrt(np.square(self.image_px - self.middle_px).sum(-1).mean()))


class HandDetector(Protocol):
    """Finds hands in the pictures of one video, in their order."""

    def detect(self, rgb8: np.ndarray, time_s: float) -> list[SeenHand]:
        """Hands in a picture (H, W, 3) uint8 that was taken `time_s` seconds after the first one."""
        ...

    def close(self) -> None:
        """Gives back what it holds; it is not asked again."""
        ...
