"""What plans know of an avatar before any skin is found: how far its parts reach, and how far they move.

From bones and boxes alone; `crop` makes the part of an image of it that hands can touch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.correctives import CorrectiveChange, LinearCorrectives
from jghand_engine.avatar.learned import ShadowLook, SkinResponse
from jghand_engine.avatar.skin_task import BLEND_DET_MIN, SIGMA_STRETCH_MAX
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native import library
from jghand_engine.render.camera import Camera
from jghand_engine.render.gate import ShadowGate

# offsets of the correctives are stretched by at most this beyond their bones' maps: where bones that are folded share
# the skin, their mean map keeps its length along the axis of the fold, and is divided by the third root of its volume
OFFSET_STRETCH = BLEND_DET_MIN ** (-1 / 3)
# numbers that native/view.cpp finds
FOUND = 14
# of a ball around a hand without size, as a divisor
RADIUS_MIN_M = 1e-6
PRINTED_NOTE = "the avatar was trained with the shadow of the paper, which is not drawn: JGHand's own is another one"


@dataclass(frozen=True)
class Ball:
    """middle_m: (3,) in the frame of the joints · radius_m: above 0"""

    middle_m: np.ndarray
    radius_m: float


class HandFacts:
    """What plans need to know of an avatar, found once.

    avatar:            as it is drawn, see `strip_disabled`
    count:             of its Gaussians
    joints_m:          (21, 3) of the canonical hand, root-relative
    gate:              of its shadow
    look:              of its shadow; None where it was learned without one
    gated:             whether its colors were learned under that gate
    notes:             what is said of it beside every image
    keeps_correctives: whether it is worth while to use those of the last pose again
    sigma_m:           of its median Gaussian
    corrective_change: bounds how far its correctives differ between two poses
    detail_power:      of the ratios of its detail in the light that it is drawn in
    """

    def __init__(self, avatar: HandAvatar, detail_power: float = 1.0) -> None:
        self.avatar, self.count, self.learned, self.detail_power = avatar, len(avatar), avatar.learned, detail_power
        self.joints_m = avatar.canonical_joints_m - avatar.canonical_joints_m[0]
        self.gate = ShadowGate(avatar.canonical_joints_m)
        self.look = ShadowLook() if self.learned is None else self.learned.shadow
        printed = self.look is not None and self.look.printed
        self.gated, self.notes = self.learned is not None and not printed, [PRINTED_NOTE] if printed else []
        net = None if self.learned is None else self.learned.correctives
        # a linear tier is found as fast as it is read
        self.keeps_correctives = net is not None and not isinstance(net, LinearCorrectives)
        self.corrective_change = CorrectiveChange(net)
        self.sigma_m = float(np.median(avatar.sigma_m)) if len(avatar) else 0.0
        # the longest offset of the correctives
        self._offset_m = 0.0 if net is None else OFFSET_STRETCH * net.longest_offset_m()
        self._moving, self._corners_m = _corners(avatar, avatar.position_m, avatar.bone_weights)
        # along these a bone is stretched
        self._frames = np.ascontiguousarray(avatar.skeleton().canonical.frames)
        self._call = library.load().call.jg_view
        constant = (self._moving, self._corners_m, self._frames)
        self._constant = len(self._moving), *(array.ctypes.data for array in constant)
        # of the last pose that was asked for
        # the largest standard deviation that a pose of scale 1 gives a Gaussian. The blended map stretches ellipsoids
        # like the corners; twice is more than it does to the skin of a hand
        self._sigma_max_m = float(avatar.sigma_m.max(initial=0.0)) * SIGMA_STRETCH_MAX
        if self.learned is not None and self.learned.ellipsoid is not None:
            longest_m = avatar.sigma_m * np.exp(self.learned.ellipsoid.log_stretch.max(1, initial=-np.inf))
            self._sigma_max_m = 2 * float(longest_m.max(initial=0.0))

    @property
    def response(self) -> SkinResponse | None:
        """What answers the light of a scene; None for a hand that shines with its own colors."""
        return None if self.learned is None else self.learned.response

    def before(self, camera: Camera, joints_m: np.ndarray, bones: Bones) -> list[float]:
        """Where a pose is before a camera, as native/view.cpp has it: 14 numbers. joints_m: (21, 3) float64, world"""
        maps, joints = np.ascontiguousarray(bones.linear_offset, np.float32), np.ascontiguousarray(joints_m, np.float64)
        given = (array.ctypes.data for array in (maps, joints, camera.camera_from_world))
        found = np.empty(FOUND)
        self._call(*self._constant, *given, camera.orthographic, found.ctypes.data)
        return found.tolist()

    def reach_m(self, scale: float, stretch: float, alpha_min: float) -> tuple[float, float]:
        """How far a Gaussian reaches from its center in an image with this cut-off, and how far its center may be from
        its skinned place. scale: of the hand · stretch: of its bones along their frames, at most: one that is longer
        than the scale says stretches the offsets along it."""
        seen_m = math.sqrt(2 * math.log(1 / alpha_min)) * self._sigma_max_m
        return seen_m * max(scale, 1.0), self._offset_m * max(stretch, 1.0)

    @cached_property
    def _surface(self) -> tuple[np.ndarray, np.ndarray] | None:
        """`_corners` of the surface that ends the hand; None without one."""
        detail = self.avatar.detail
        if detail is None or not detail.ends_hand:
            return None
        drawn = np.unique(detail.faces)
        return _corners(self.avatar, detail.position_m[drawn], detail.bone_weights[drawn])

    def ball(self, bones: Bones) -> Ball | None:
        """Around the surface that ends the hand, correctives aside; None without one."""
        if self._surface is None:
            return None
        moving, corners_m = self._surface
        posed_m = (bones.maps[moving].astype(np.float64) @ corners_m).swapaxes(0, 1).reshape(3, -1)
        middle_m = (posed_m.min(1) + posed_m.max(1)) / 2
        radius_m = math.sqrt(np.square(posed_m - middle_m[:, None]).sum(0).max())
        return Ball(middle_m + bones.root_m, max(radius_m, RADIUS_MIN_M))

    def skin_change_m(self, new: Bones, old: Bones) -> float:
        """How far a point of the skin is from where another pose has it, at most, correctives that change apart: a
        skinned point is a mean of what its bones make of it, so that it moves less than some corner of a bone's box."""
        change = new.maps.astype(np.float64) - old.maps
        moved_m = math.sqrt(np.square(change[self._moving] @ self._corners_m).sum(1).max(initial=0.0))
        # offsets turn with the hand, by no more than twice what their bones' maps change
        turned = 2 * math.sqrt(np.square(change[:, :, :3]).sum((1, 2)).max())
        return moved_m + turned * self._offset_m + float(np.linalg.norm(new.root_m - old.root_m))


def _corners(avatar: HandAvatar, position_m: np.ndarray, bone_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the maps that move any of some canonical places (N, 3); (maps, 4, 8) corners of the boxes around it,
    canonical, root-relative, and ones.

    A skinned point is a mean of the places where its bones would carry it, each inside its bone's box: all of them lie
    in the hull of the boxes.
    """
    relative = position_m.astype(np.float64) - avatar.canonical_joints_m[0]
    moves = (avatar.map_weights(position_m, bone_weights) != 0).T
    moving = np.asarray(moves.any(1))
    ends = [np.stack([relative[rows].min(0), relative[rows].max(0)], 1) for rows in moves[moving]]
    corners = [np.stack(np.meshgrid(*pair, [1.0], indexing="ij")).reshape(4, 8) for pair in ends]
    return np.flatnonzero(moving).astype(np.int32), np.array(corners).reshape(-1, 4, 8)
