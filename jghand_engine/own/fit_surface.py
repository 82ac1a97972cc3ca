"""The hand that a fit draws: few Gaussians of the prior, posed in batches, with outlines as large as pictures show.

It is `learn.skinning` for many poses at once. What the pose's network adds is not differentiated: it is found once in a
while and kept. Everything is before the camera: x right, y down, z forward, meters.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.light import unit
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.reference import Picture
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.skinning import posed_radius_scale
from jghand_engine.learn.tensors import HandTensors
from jghand_engine.own.fit_views import View, hand_side
from jghand_engine.own.shape import shape_basis
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings, preset

# Gaussians that are drawn: a pass forwards and back takes some 30 ms
FIT_GAUSSIANS = 8000
# the factor of the radii is sought between these, as exactly as this: a thousandth is 0.03 % of the area
RADIUS_FACTORS, RADIUS_FACTOR_STEP = (0.1, 1.6), 1e-3
# how large outlines are to be is measured in pictures with so many times the film's pixels along each side
FINE = 2
_SETTINGS = RenderSettings(threads=1)


@dataclass(frozen=True)
class Kept:
    """What poses add that changes slowly with them.

    offset_m: (F, N, 3) canonical, before skinning · shade: (F, N, 3) logarithm of a factor of the color ·
    radius: (F, N) posed over canonical
    """

    offset_m: Tensor
    shade: Tensor
    radius: Tensor

    def of(self, pictures: Tensor) -> Kept:
        """That of some pictures."""
        return Kept(self.offset_m[pictures], self.shade[pictures], self.radius[pictures])


@dataclass(frozen=True)
class PosedBatch:
    """position_m, normal: (F, N, 3) · sigma_m: (F, N)"""

    position_m: Tensor
    normal: Tensor
    sigma_m: Tensor


class FitSurface:
    """The first `count` Gaussians of a right hand's avatar, 0 for all. hand: them, as tensors"""

    def __init__(self, prior: HandAvatar, count: int = FIT_GAUSSIANS, dtype: torch.dtype = torch.float32) -> None:
        few = prior.for_hand(Handedness.RIGHT).prefix(count)
        self.hand = HandTensors.of(few)
        self._few, info = few, prior.info
        self._transform = JointTransform(
            prior.canonical_joints_m, handedness=Handedness.RIGHT, swing=info.swing, scale_mode=info.scale_mode
        )
        self._dtype = dtype

    def __len__(self) -> int:
        return len(self.hand)

    @cached_property
    def basis(self) -> Tensor:
        """(SHAPE_COUNT, N, 3) see shape.shape_basis."""
        return torch.from_numpy(shape_basis(self._few, self._few.position_m)).to(self._dtype)

    @torch.no_grad()
    def keep(self, joints_m: Tensor) -> Kept:
        """Of joints (F, 21, 3)."""
        learned = self.hand.learned
        correctives = None if learned is None else learned.correctives
        offset, shade = torch.zeros(2, len(joints_m), len(self), 3, dtype=self._dtype)
        radius = torch.empty(len(joints_m), len(self), dtype=self._dtype)
        for row, joints in enumerate(joints_m):
            bones = self._transform.bones(joints)
            if correctives is not None:
                correction = correctives(bones.frames)
                offset[row], shade[row] = correction.offset_m, correction.shade
            linear = torch.einsum("nb,bij->nij", self.hand.bone_weights.to(self._dtype), bones.linear)
            radius[row] = posed_radius_scale(linear, bones.scale)
        return Kept(offset, shade, radius)

    def posed(self, joints_m: Tensor, shape: Tensor | None, kept: Kept) -> PosedBatch:
        """Of joints (F, 21, 3), whose gradients it carries, as those of the shape (K,); None is the prior's own."""
        hand, dtype = self.hand, self._dtype
        bones = self._transform.bones(joints_m)
        flat = torch.cat([bones.linear.flatten(-2), bones.offset_m], -1)
        maps = torch.einsum("nb,fbk->fnk", hand.bone_weights.to(dtype), flat)
        linear, moved = maps[..., :9].unflatten(-1, (3, 3)), maps[..., 9:]
        place = hand.position_m.to(dtype)
        if shape is not None:
            place = place + torch.einsum("k,knc->nc", shape, self.basis)
        place = place - bones.canonical_root_m + kept.offset_m
        position_m = (linear @ place[..., None])[..., 0] + moved + bones.root_m[:, None]
        normal = torch.zeros_like(position_m)
        if hand.learned is not None:
            normal = unit((linear @ hand.learned.normal.to(dtype)[..., None])[..., 0])
        return PosedBatch(position_m, normal, hand.sigma_m.to(dtype) * kept.radius)

    def draw(self, posed: PosedBatch, row: int, camera: Camera, rgb: Tensor, factor: float) -> Picture:
        """One of them. rgb: (N, 3) · factor: of the radii, see `outline_factor`"""
        opacity = self.hand.opacity.to(posed.position_m)
        return rasterize(Gaussians(posed.position_m[row], posed.sigma_m[row] * factor, opacity, rgb), camera, _SETTINGS)


@torch.no_grad()
def outline_factor(prior: HandAvatar, surface: FitSurface, joints_m: Tensor, views: Sequence[View]) -> float:
    """By which the radii of `surface` have outlines of the size in which finer pictures show the prior.

    A pixel's low pass widens outlines, by 9 to 11 % of their area at the sizes of a fit, few Gaussians have grown ones,
    and pictures end where the skin's surface does: a fit would answer with thin fingers and a hand too far away.

    joints_m: (P, 21, 3) of some poses · views: (P,) of each, as the fit sees it
    """
    joints = joints_m.double().numpy()
    finer = [view.camera.scaled(FINE * view.factor) for view in views]
    shown = HandRenderer(prior.for_hand(Handedness.RIGHT), replace(preset("final"), threads=1))
    alphas = (shown.render(one, camera).rgba[..., 3] for one, camera in zip(joints, finer, strict=True))
    wanted = _covered(map(torch.from_numpy, alphas), finer, joints) / FINE**2
    cameras, posed = [view.camera for view in views], surface.posed(joints_m, None, surface.keep(joints_m))
    low, high = RADIUS_FACTORS
    while high - low > RADIUS_FACTOR_STEP:
        middle = (low + high) / 2
        pictures = (surface.draw(posed, row, one, surface.hand.rgb, middle) for row, one in enumerate(cameras))
        covered = _covered((picture.alpha for picture in pictures), cameras, joints)
        low, high = (low, middle) if covered * views[0].factor ** 2 > wanted else (middle, high)
    return (low + high) / 2


def _covered(alphas: Iterable[Tensor], cameras: Sequence[Camera], joints_m: np.ndarray) -> float:
    """How many pixels pictures (h, w) cover on the hand's side of the wrist. joints_m: (P, 21, 3) of each"""
    each = zip(alphas, cameras, joints_m, strict=True)
    return sum(float((alpha * hand_side(camera, joints)).sum()) for alpha, camera, joints in each)
