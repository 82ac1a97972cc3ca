"""The hand that a fit draws: few Gaussians of the prior, posed in batches, with outlines as large as the whole hand's.

It is `learn.skinning` for many poses at once. What the pose's network adds is not differentiated: it is found once in a
while and kept. Everything is before the camera: x right, y down, z forward, meters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

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
from jghand_engine.render.settings import RenderSettings

# Gaussians that are drawn: a pass forwards and back takes some 30 ms
FIT_GAUSSIANS = 8000
# the factor of the radii is sought between these, as exactly as this: a thousandth is 0.03 % of the area
RADIUS_FACTORS, RADIUS_FACTOR_STEP = (0.1, 1.6), 1e-3
# the whole hand is measured in a picture with so many times the film's pixels along each side
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
        return torch.from_numpy(shape_basis(self._few)).to(self._dtype)

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
    """By which the radii of `surface` have outlines of the size that the whole hand has in a picture that is finer.

    A pixel's low pass widens outlines, by 9 to 11 % of their area at the sizes of a fit, and few Gaussians have grown
    ones: a fit would answer with thin fingers and a hand too far away.

    joints_m: (P, 21, 3) of some poses · views: (P,) of each, as the fit sees it
    """
    whole = FitSurface(prior, 0)
    finer = [view.camera.scaled(FINE * view.factor) for view in views]
    wanted = _area(whole, joints_m, finer)(1.0) / FINE**2
    area = _area(surface, joints_m, [view.camera for view in views])
    low, high = RADIUS_FACTORS
    while high - low > RADIUS_FACTOR_STEP:
        middle = (low + high) / 2
        too_large = area(middle) * views[0].factor ** 2 > wanted
        low, high = (low, middle) if too_large else (middle, high)
    return (low + high) / 2


def _area(surface: FitSurface, joints_m: Tensor, cameras: Sequence[Camera]) -> Callable[[float], float]:
    """How many pixels of all pictures are covered on the hand's side of the wrist, by the factor of the radii."""
    posed = surface.posed(joints_m, None, surface.keep(joints_m))
    sides = [hand_side(camera, joints.numpy()) for camera, joints in zip(cameras, joints_m, strict=True)]

    def area(factor: float) -> float:
        pictures = (surface.draw(posed, row, camera, surface.hand.rgb, factor) for row, camera in enumerate(cameras))
        return sum(float((picture.alpha * side).sum()) for picture, side in zip(pictures, sides, strict=True))

    return area
