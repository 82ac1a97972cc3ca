"""Which part of an image hands can touch: outside of it nothing has to be drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.correctives import LinearCorrectives
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.avatar.skin_task import SIGMA_STRETCH_MAX
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native import contract
from jghand_engine.render.camera import Camera
from jghand_engine.render.gate import ShadowGate
from jghand_engine.render.image import Box

# offsets of the correctives are stretched by at most this: where two bones at 112 degrees share the skin, their mean
# map keeps its volume by stretching along the axis by cos(56 degrees)^(-2/3) = 1.47
OFFSET_STRETCH = 1.5
# the box stands at multiples of this, px: tiles stay where they were, and buffers are seldom made anew
CROP_STEP_PX = 64


class HandFacts:
    """What plans need to know of an avatar, found once.

    avatar:            as it is drawn, see `strip_disabled`
    gate:              of its shadow
    look:              of its shadow; None where it was learned without one
    keeps_correctives: whether it is worth while to use those of the last pose again
    sigma_m:           of its median Gaussian
    offset_m:          the longest offset of its correctives along an axis
    """

    def __init__(self, avatar: HandAvatar) -> None:
        self.avatar, self.learned = avatar, avatar.learned
        self.gate = ShadowGate(avatar.canonical_joints_m)
        self.look = ShadowLook() if self.learned is None else self.learned.shadow
        net = None if self.learned is None else self.learned.correctives
        # a linear tier is found as fast as it is read
        self.keeps_correctives = net is not None and not isinstance(net, LinearCorrectives)
        self.sigma_m = float(np.median(avatar.sigma_m)) if len(avatar) else 0.0
        self.offset_m = 0.0 if net is None else net.longest_offset_m()
        self._moving, self._corners_m = _corners(avatar)
        # the largest standard deviation that a pose of scale 1 gives a Gaussian. The blended map stretches ellipsoids
        # like the corners; twice is more than it does to the skin of a hand
        self._sigma_max_m = float(avatar.sigma_m.max(initial=0.0)) * SIGMA_STRETCH_MAX
        if self.learned is not None and self.learned.ellipsoid is not None:
            longest_m = avatar.sigma_m * np.exp(self.learned.ellipsoid.log_stretch.max(1, initial=-np.inf))
            self._sigma_max_m = 2 * float(longest_m.max(initial=0.0))

    def reach_m(self, bones: Bones, alpha_min: float) -> float:
        """How far from its skinned place a Gaussian of that pose may touch an image with this cut-off."""
        seen = math.sqrt(2 * math.log(1 / alpha_min)) * self._sigma_max_m
        return (seen + OFFSET_STRETCH * math.sqrt(3) * self.offset_m) * max(bones.scale, 1.0)

    def corners_m(self, bones: Bones) -> np.ndarray:
        """(K, 3) points relative to the hand's root whose hull holds every skinned place."""
        maps = bones.linear_offset[self._moving]
        moved = np.einsum("ijk,ick->icj", maps[:, :, :3], self._corners_m)
        return (moved + maps[:, None, :, 3]).reshape(-1, 3)


def _corners(avatar: HandAvatar) -> tuple[np.ndarray, np.ndarray]:
    """(21,) bool which bones move anything; (bones, 8, 3) corners of the boxes around it, canonical, root-relative.

    A skinned point is a mean of the places where its bones would carry it, each inside its bone's box: all of them lie
    in the hull of the boxes.
    """
    relative = avatar.position_m.astype(np.float64) - avatar.canonical_joints_m[0]
    moves = (avatar.bone_weights != 0).T
    moving = np.asarray(moves.any(1))
    ends = [(relative[rows].min(0), relative[rows].max(0)) for rows in moves[moving]]
    corners = [np.stack(np.meshgrid(*np.stack(pair, 1), indexing="ij"), -1).reshape(8, 3) for pair in ends]
    return moving, np.array(corners).reshape(-1, 8, 3)


def hand_box(
    joints_m: Sequence[np.ndarray],
    bones: Sequence[Bones],
    hands: Sequence[HandFacts],
    camera: Camera,
    alpha_min: float,
) -> Box | None:
    """The part of the image outside of which nothing of the hands is seen; None when that is not known, as for a
    camera between the fingers. Its edges stand at multiples of CROP_STEP_PX."""
    origin = camera.camera_from_world
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for joints, own, hand in zip(joints_m, bones, hands, strict=True):
        if own.flags:
            return None  # such hands stretch their skin beyond what is known
        corners, reach_m = hand.corners_m(own), hand.reach_m(own, alpha_min)
        if not len(corners):
            continue
        points = (corners + joints[0]) @ origin[:3, :3].T + origin[:3, 3]
        nearest_m = float(points[:, 2].min()) - reach_m
        if not (np.isfinite(points).all() and contract.Z_NEAR_M < nearest_m < math.inf):
            return None
        slope = points[:, :2] if camera.orthographic else points[:, :2] / points[:, 2:]
        focal = np.array([camera.fx, camera.fy])
        pixels = slope * focal + np.array([camera.cx, camera.cy])
        # a ball of radius r at depth z covers r (1 + tan) / (z - r) of the plane at depth 1, and the low pass comes on
        # top: a Gaussian of opacity 1 is cut where its exponent is ln(1 / alpha_min)
        margin = focal * reach_m * (1.0 if camera.orthographic else (1 + np.abs(slope).max(0)) / nearest_m)
        margin += math.sqrt(2 * math.log(1 / alpha_min) * contract.BLUR_PX2) + 1
        low, high = np.minimum(low, pixels.min(0) - margin), np.maximum(high, pixels.max(0) + margin)
    return _on_grid(low, high, camera)


def _on_grid(low: np.ndarray, high: np.ndarray, camera: Camera) -> Box:
    """The rectangle from `low` to `high`, pixels, widened to the grid and cut to the image; at least a step wide."""
    size, step = np.array([camera.width, camera.height]), CROP_STEP_PX
    last = (size - 1) // step * step
    first = np.clip(np.floor(np.clip(low, 0, size) / step) * step, 0, last).astype(int)
    end = np.minimum(np.maximum(np.ceil(np.clip(high, 0, size) / step) * step, first + step), size).astype(int)
    return Box(int(first[0]), int(first[1]), int(end[0] - first[0]), int(end[1] - first[1]))
