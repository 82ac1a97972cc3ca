"""Refusing avatars that cannot be rendered: every value of every array is looked at."""

from __future__ import annotations

import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, LEVEL_NAMES, PARENTS
from jghand_engine.limits import (
    AVATAR_MAX_GAUSSIANS,
    AVATAR_REACH_M,
    CANONICAL_BONE_MIN,
    HAND_LENGTH_MAX_M,
    HAND_LENGTH_MIN_M,
    SIGMA_MAX_M,
    SIGMA_MIN_M,
    WEIGHT_SUM_TOLERANCE,
)

REMEDY = "The avatar is damaged or was made by another program: export or download it again."


def check_avatar(avatar: HandAvatar, thing: str) -> None:
    """InputError naming `thing`, the array and the first offending Gaussian if the avatar cannot be rendered."""
    _check_shapes(avatar, thing)
    _check_joints(avatar.canonical_joints_m, thing)
    for name in ("position_m", "sigma_m", "opacity", "rgb", "bone_weights", "uvd"):
        _refuse(thing, name, "finite values", ~torch.isfinite(getattr(avatar, name)), getattr(avatar, name))
    sigma_m = avatar.sigma_m
    # a float16 on disk may lie half a step outside the limits
    outside = (sigma_m < SIGMA_MIN_M * (1 - 1e-3)) | (sigma_m > SIGMA_MAX_M * (1 + 1e-3))
    _refuse(thing, "sigma_m", f"radii of {SIGMA_MIN_M} to {SIGMA_MAX_M} m", outside, sigma_m)
    far = (avatar.position_m - avatar.canonical_joints_m[0].to(avatar.position_m.dtype)).abs() > AVATAR_REACH_M
    _refuse(thing, "position_m", f"points within {AVATAR_REACH_M} m of the wrist", far, avatar.position_m)
    for name in ("opacity", "rgb", "uvd", "bone_weights"):
        values = getattr(avatar, name)
        _refuse(thing, name, "values of 0 to 1", (values < 0) | (values > 1), values)
    total = avatar.bone_weights.to(torch.float64).sum(1)
    off = (total - 1).abs() > WEIGHT_SUM_TOLERANCE
    _refuse(thing, "bone_weights", f"rows that sum to 1 within {WEIGHT_SUM_TOLERANCE}", off, total)


def _check_shapes(avatar: HandAvatar, thing: str) -> None:
    count = avatar.position_m.shape[0] if avatar.position_m.ndim else 0
    if not 1 <= count <= AVATAR_MAX_GAUSSIANS:
        raise InputError(
            f"{thing}: number of Gaussians", wanted=f"1 to {AVATAR_MAX_GAUSSIANS}", came=str(count), remedy=REMEDY
        )
    wanted = {
        "canonical_joints_m": (JOINT_COUNT, 3),
        "position_m": (count, 3),
        "sigma_m": (count,),
        "opacity": (count,),
        "rgb": (count, 3),
        "bone_weights": (count, JOINT_COUNT),
        "uvd": (count, 3),
    }
    for name, shape in wanted.items():
        came = tuple(getattr(avatar, name).shape)
        if came != shape:
            raise InputError(f"{thing}: {name}", wanted=f"shape {shape}", came=f"shape {came}", remedy=REMEDY)


def _check_joints(joints_m: torch.Tensor, thing: str) -> None:
    """A canonical hand: finite, of a hand's size, no bone without a direction (METHOD 2.4)."""
    if not bool(torch.isfinite(joints_m).all()):
        raise InputError(f"{thing}: canonical_joints_m", wanted="finite values", came="NaN or Inf", remedy=REMEDY)
    length_m = float((joints_m[LEVEL_NAMES.index("middle4")] - joints_m[0]).norm())
    if not HAND_LENGTH_MIN_M <= length_m <= HAND_LENGTH_MAX_M:
        raise InputError(
            f"{thing}: canonical hand, wrist to middle tip",
            wanted=f"{HAND_LENGTH_MIN_M} to {HAND_LENGTH_MAX_M} m",
            came=f"{length_m:.4g} m",
            remedy="Joints are in metres; convert them before the avatar is made.",
        )
    bones_m = (joints_m[1:] - joints_m[list(PARENTS[1:])]).norm(dim=-1)
    shortest = int(bones_m.argmin())
    if float(bones_m[shortest]) < CANONICAL_BONE_MIN * float(bones_m.mean()):
        name = LEVEL_NAMES[shortest + 1]
        raise InputError(f"{thing}: canonical bone {name}", wanted="a length", came="coincident joints", remedy=REMEDY)


def _refuse(thing: str, name: str, wanted: str, bad: torch.Tensor, values: torch.Tensor) -> None:
    """InputError about the first Gaussian where `bad` (N,) or (N, C) holds."""
    if not bool(bad.any()):
        return
    first = bad.nonzero()[0]
    raise InputError(
        f"{thing}: {name}",
        wanted=wanted,
        came=f"{float(values[tuple(first)]):.6g} at Gaussian {int(first[0])} ({int(bad.sum())} such values)",
        remedy=REMEDY,
    )
