"""From what is being learnt to an avatar of plain numbers."""

from __future__ import annotations

import copy
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.avatar.model import LearnedHand
from jghand_engine.hand.joints import LEVEL_NAMES
from jghand_engine.hand.transform import JointTransform

Record = TypeVar("Record")


def bake(
    hand: LearnedHand, info: AvatarInfo, transform: JointTransform, joints_m: Tensor, with_shadow: bool
) -> HandAvatar:
    """The hand as it is now, without gradients, apart from what goes on learning.

    joints_m: (P, 21, 3) float64 poses that were learnt from; their joint angles become the avatar's ranges.
    """
    with torch.no_grad():
        avatar = hand.avatar(
            replace(info, pose_statistics=angle_ranges(transform, joints_m)), handedness=transform.handedness
        )
        if avatar.learnt is not None:
            learnt = _detached(avatar.learnt)
            net = copy.deepcopy(hand.pose_net).requires_grad_(False)
            shadow = learnt.shadow if with_shadow else None
            avatar = replace(_detached(avatar), learnt=replace(learnt, correctives=net, shadow=shadow))
        return avatar


def angle_ranges(transform: JointTransform, joints_m: Tensor) -> dict[str, tuple[float, float]]:
    """Least and greatest flexion and abduction of every joint that bends, radians, by "joint flexion"."""
    angles = transform.bones(joints_m).frames.angles
    low, high = angles.amin(0), angles.amax(0)
    return {
        f"{LEVEL_NAMES[bone - 5]} {name}": (float(low[bone - 6, k]), float(high[bone - 6, k]))
        for bone in range(6, 21)
        for k, name in enumerate(("flexion", "abduction"))
    }


def _detached(record: Record) -> Record:
    """A frozen dataclass whose tensors are copies without history, in nested records too."""
    values: dict[str, Any] = {}
    for f in fields(record):  # type: ignore[arg-type]
        value = getattr(record, f.name)
        if isinstance(value, Tensor):
            values[f.name] = value.detach().clone()
        elif is_dataclass(value) and not isinstance(value, type):
            values[f.name] = _detached(value)
    return replace(record, **values)  # type: ignore[type-var]
