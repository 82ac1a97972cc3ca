"""From what is being learned to an avatar of plain numbers."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.avatar.correctives import PoseNetwork
from jghand_engine.avatar.pose_range import angle_name
from jghand_engine.learn.model import LearnedHand
from jghand_engine.learn.skeleton import JointTransform


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
        ranges = angle_ranges(transform, joints_m)
        avatar = hand.avatar(replace(info, pose_statistics=ranges), handedness=transform.handedness).avatar()
    learned = avatar.learned
    if learned is None or not isinstance(learned.correctives, PoseNetwork):
        return avatar
    if wave_weight is not None:
        learned.correctives.weights["encoding_in.weight"] *= wave_weight.cpu().numpy()
    return avatar if with_shadow else replace(avatar, learned=replace(learned, shadow=None))


def angle_ranges(transform: JointTransform, joints_m: Tensor) -> dict[str, tuple[float, float]]:
    """Least and greatest flexion and abduction of every joint that bends, radians, by "joint flexion"."""
    angles = transform.bones(joints_m).frames.angles
    low, high = angles.amin(0), angles.amax(0)
    return {
        angle_name(bone, kind): (float(low[bone - 6, kind]), float(high[bone - 6, kind]))
        for bone in range(6, 21)
        for kind in (0, 1)
    }
