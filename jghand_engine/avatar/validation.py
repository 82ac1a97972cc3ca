"""Refusing avatars that cannot be rendered: every value of every array is looked at."""

from __future__ import annotations

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import check_hand_size, check_order
from jghand_engine.hand.transform import JointTransform
from jghand_engine.limits import (
    AVATAR_MAX_GAUSSIANS,
    AVATAR_REACH_M,
    SIGMA_MAX_M,
    SIGMA_MIN_M,
    WEIGHT_SUM_TOLERANCE,
)

REMEDY = "The avatar is damaged or was made by another program: export or download it again."


def check_avatar(avatar: HandAvatar, thing: str) -> None:
    """InputError naming `thing`, the array and the first offending Gaussian if the avatar cannot be rendered."""
    _check_shapes(avatar, thing)
    _check_joints(avatar, thing)
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


def _check_joints(avatar: HandAvatar, thing: str) -> None:
    """A canonical hand that joints can drive: the same checks as of any other hand, and the transform is built once."""
    joints_m = avatar.canonical_joints_m.detach().cpu().to(torch.float64).numpy()
    if not np.isfinite(joints_m).all():
        raise InputError(f"{thing}: canonical_joints_m", wanted="finite values", came="NaN or Inf", remedy=REMEDY)
    try:
        check_hand_size(joints_m)
        JointTransform(
            joints_m, handedness=Handedness.RIGHT, swing=avatar.info.swing, scale_mode=avatar.info.scale_mode
        )
        check_order(joints_m)
    except InputError as error:
        raise InputError(
            f"{thing}: {error.thing}", wanted=error.wanted, came=error.came, remedy=error.remedy or REMEDY
        ) from error


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
