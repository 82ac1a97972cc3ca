"""An avatar's rows in the arrays of the native picture, filled by the torch functions."""

from __future__ import annotations

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.fast_skinning import spatial_order
from jghand_engine.avatar.torch_posing import TorchPosing
from jghand_engine.native.rasteriser import GaussianArrays
from jghand_engine.splat.painter import Pose, RootRelative, covariance_of


class TorchRows:
    """Rows as in `FastSkinning`: in its order, rounded up to whole blocks; those beyond the avatar stay as they are.

    into: where they are, `padded_rows(len(avatar))` of them
    """

    def __init__(self, avatar: HandAvatar, into: GaussianArrays) -> None:
        self._avatar, self._into = avatar, into
        self._posing = TorchPosing(avatar)
        self._order = torch.from_numpy(spatial_order(avatar.position_m.numpy()))
        if into.covariance_m2 is not None:
            into.covariance_m2[len(avatar) :] = np.nan  # invalid, as a radius of 0 is: never drawn
        into.opacity[: len(avatar)] = avatar.opacity[self._order].numpy()

    def pose(self, pose: Pose) -> None:
        """Centres and radii of the next pose, around the picture's origin."""
        matt = self._posing.pose(RootRelative.of(self._avatar, pose), pose.frames).matt
        self._put(self._into.position_m, matt.position_m)
        self._put(self._into.sigma_m, matt.sigma_m)
        if self._into.covariance_m2 is not None:
            self._put(self._into.covariance_m2, covariance_of(matt))

    def colour(self, eye_m: np.ndarray) -> None:
        """Colours as a camera at `eye_m` (3,), around the picture's origin, sees them."""
        rgb = self._posing.rgb(eye_m)
        if rgb is not None:
            self._put(self._into.rgb, rgb)

    def _put(self, rows: np.ndarray, values: torch.Tensor) -> None:
        torch.index_select(values, 0, self._order, out=torch.from_numpy(rows[: len(values)]))
