"""From what is being learned to an avatar of plain numbers."""

from __future__ import annotations

import copy
from dataclasses import replace

import torch
from torch import Tensor

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.avatar.model import LearnedHand
from jghand_engine.avatar.pose_range import angle_name
from jghand_engine.avatar.records import mapped
from jghand_engine.hand.transform import JointTransform


def bake(
    hand: LearnedHand,
    info: AvatarInfo,
    transform: JointTransform,
    joints_m: Tensor,
    with_shadow: bool,
    wave_weight: Tensor | None = None,
) -> HandAvatar:
    """The hand as it is now, on the CPU, without gradients, apart from what goes on learning.

    joints_m: (P, 21, 3) float64 poses that were learned from; their joint angles become the avatar's ranges ·
    wave_weight: how much of each wave of the encoding has been learned with, 0..1; None: all.
    """
    with torch.no_grad():
        avatar = hand.avatar(
            replace(info, pose_statistics=angle_ranges(transform, joints_m)), handedness=transform.handedness
        )
        if avatar.learned is not None:
            learned = mapped(avatar.learned, _plain)
            net = copy.deepcopy(hand.pose_net).requires_grad_(False).cpu()
            if wave_weight is not None:
                net.encoding_in.weight *= wave_weight.cpu()
            shadow = learned.shadow if with_shadow else None
            avatar = replace(mapped(avatar, _plain), learned=replace(learned, correctives=net, shadow=shadow))
        return avatar


def angle_ranges(transform: JointTransform, joints_m: Tensor) -> dict[str, tuple[float, float]]:
    """Least and greatest flexion and abduction of every joint that bends, radians, by "joint flexion"."""
    angles = transform.bones(joints_m).frames.angles
    low, high = angles.amin(0), angles.amax(0)
    return {
        angle_name(bone, kind): (float(low[bone - 6, kind]), float(high[bone - 6, kind]))
        for bone in range(6, 21)
        for kind in (0, 1)
    }


def _plain(tensor: Tensor) -> Tensor:
    """A copy on the CPU without history."""
    return tensor.detach().cpu().clone()
