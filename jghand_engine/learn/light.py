"""The light that a hand was learned in: what falls on the skin from every side, and what the skin reflects of it.

A capture stands still in its light while the hand turns in it, so colors alone would learn the light of the poses
they were seen in. Split off, it carries over to every pose: the same finger is darker where it turns from the lamps.
Everything is in the world's frame, that of the joints.

    color = albedo * exp(sum_k Y_k(n) irradiance_k) + shine * gloss(n, eye)

Y_k are real spherical harmonics up to degree 3, without their constants: irradiance of a distant environment is nearly
contained in the first nine (Ramamoorthi and Hanrahan 2001); the exponent keeps it positive, and display-referred
colors multiply like light up to a power. The gloss is a sum of spherical Gaussians around the mirrored direction
(Wang et al. 2009): few smooth lobes, which hold for cameras that were not learned from; free harmonics do not.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from jghand_engine.avatar.learned import LIGHT_EXPONENT_MAX, Light
from jghand_engine.avatar.skin_task import NORMAL_LENGTH2_MIN

# cosines to the eye over which skin that faces away fades out; of native/learned.h
AWAY_FROM, AWAY_WIDTH = -0.1, 0.2


@dataclass(frozen=True)
class LightTensors(Light[Tensor]):
    """The coefficients of the irradiance are in the order of `harmonics`."""

    def to(self, dtype: torch.dtype) -> LightTensors:
        """The same light in another precision."""
        return LightTensors(**{f.name: getattr(self, f.name).to(dtype) for f in fields(self)})


def harmonics(normal: Tensor) -> Tensor:
    """(N, 16) real spherical harmonics, degrees 0 to 3, without constants, of unit vectors (N, 3)."""
    x, y, z = normal.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    return torch.stack(
        [
            torch.ones_like(x), x, y, z,
            x * y, y * z, z * x, xx - yy, 3 * zz - 1,
            y * (3 * xx - yy), x * y * z, y * (5 * zz - 1), z * (5 * zz - 3), x * (5 * zz - 1), z * (xx - yy),
            x * (xx - 3 * yy),
        ]
    ).T  # fmt: skip


def unit(vector: Tensor) -> Tensor:
    """(..., 3) of length 1; a zero vector stays zero and has a finite gradient."""
    return vector * (vector * vector).sum(-1, keepdim=True).clamp_min(NORMAL_LENGTH2_MIN).rsqrt()


def smooth(part: Tensor) -> Tensor:
    """Smoothstep of part, clamped to 0..1."""
    t = part.clamp(0, 1)
    return t * t * (3 - 2 * t)


def seen_from_outside(facing: Tensor) -> Tensor:
    """0..1, the part of skin that is seen, of its cosines to the eye: what faces away shows through gaps only."""
    return smooth((facing - AWAY_FROM) / AWAY_WIDTH)


def lit(albedo: Tensor, normal: Tensor, light: LightTensors, shade: Tensor | None = None) -> Tensor:
    """(N, 3) color of matt skin. albedo: (N, 3) · normal: (N, 3) unit, world · shade: (N, 3) logarithm of what the
    pose adds or takes."""
    exponent = harmonics(normal) @ light.irradiance
    if shade is not None:
        exponent = exponent + shade
    return albedo * exponent.clamp(-LIGHT_EXPONENT_MAX, LIGHT_EXPONENT_MAX).exp()


def gloss(normal: Tensor, to_eye: Tensor, light: LightTensors) -> Tensor:
    """(N, 3) what a surface of shine 1 reflects towards the eye. normal, to_eye: (N, 3) unit, world."""
    facing = (normal * to_eye).sum(-1, keepdim=True)
    mirrored = 2 * facing * normal - to_eye
    cosine = mirrored @ unit(light.lobe_direction).T
    lobes = torch.exp(light.lobe_sharpness * (cosine - 1)) @ light.lobe_rgb
    fresnel = (1 - facing.clamp(0, 1)) ** 5
    return lobes * (1 + light.rim * fresnel)
