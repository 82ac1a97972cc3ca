"""Posing an avatar again and again with the torch functions, those that a trained one was trained with."""

from __future__ import annotations

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.pose_features import PoseAngles
from jghand_engine.avatar.skinning import PosedSkin, PoseTransforms, posed_skin, seen_from
from jghand_engine.errors import InputError


class TorchPosing:
    """One avatar in one pose, as one camera after another sees it."""

    def __init__(self, avatar: HandAvatar) -> None:
        self._avatar = avatar
        self._skin: PosedSkin | None = None
        self._eye_m: np.ndarray | None = None

    def pose(self, bones: PoseTransforms, frames: PoseAngles | None) -> PosedSkin:
        """The next pose. frames: of the same joints; None for an avatar without correctives."""
        with torch.no_grad():
            self._skin = posed_skin(self._avatar, bones, frames)
        self._eye_m = None
        return self._skin

    def rgb(self, eye_m: np.ndarray) -> torch.Tensor | None:
        """(N, 3) what a camera at `eye_m` (3,), in the frame of the joints, sees of the pose. None: what the last one
        saw."""
        if self._skin is None:
            raise InputError("picture", wanted="a pose", came="none")
        if self._eye_m is not None and (np.array_equal(self._eye_m, eye_m) or not reflects(self._avatar)):
            return None
        self._eye_m = eye_m
        with torch.no_grad():
            return seen_from(self._skin, torch.from_numpy(eye_m), self._avatar).rgb


def reflects(avatar: HandAvatar) -> bool:
    """Whether its colors depend on where the camera stands."""
    learned = avatar.learned
    return learned is not None and bool(learned.shine.any()) and bool(learned.light.lobe_rgb.any())
