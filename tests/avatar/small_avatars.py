"""Small random avatars for tests: Gaussians near the built-in canonical joints, blended between neighbouring bones."""

from __future__ import annotations

import torch

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.hand.joints import JOINT_COUNT, PARENTS, Handedness
from jghand_engine.template.builtin import load_template


def small_avatar(count: int = 200, seed: int = 0) -> HandAvatar:
    g = torch.Generator().manual_seed(seed)
    joints_m = torch.from_numpy(load_template().joints_m.copy())
    bone = torch.randint(1, JOINT_COUNT, (count,), generator=g)
    parent = torch.tensor(PARENTS)[bone]
    along = torch.rand(count, 1, dtype=torch.float64, generator=g)
    spot_m = joints_m[parent] * (1 - along) + joints_m[bone] * along
    weights = torch.zeros(count, JOINT_COUNT, dtype=torch.float64)
    weights[torch.arange(count), bone] += 0.6
    weights[torch.arange(count), parent] += 0.3
    weights += 0.1 * torch.softmax(4 * torch.randn(count, JOINT_COUNT, dtype=torch.float64, generator=g), 1)
    weights /= weights.sum(1, keepdim=True)
    return HandAvatar(
        info=AvatarInfo(name="small", template="test", licence="none", pose_statistics={"index mcp": (-0.1, 1.5)}),
        handedness=Handedness.RIGHT,
        canonical_joints_m=joints_m,
        position_m=(spot_m + 0.008 * torch.randn(count, 3, dtype=torch.float64, generator=g)).float(),
        sigma_m=0.0003 + 0.001 * torch.rand(count, generator=g),
        opacity=torch.rand(count, generator=g),
        rgb=torch.rand(count, 3, generator=g),
        bone_weights=weights.float(),
        uvd=torch.rand(count, 3, generator=g),
    )
