"""Small random avatars for tests: Gaussians near the built-in canonical joints, blended between neighboring bones."""

from __future__ import annotations

from dataclasses import replace

import torch

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.avatar.cast_shadow import CastShadow, own_flesh, place_anchors
from jghand_engine.avatar.correctives import PoseNet, PoseNetShape
from jghand_engine.avatar.learned import Ellipsoid, Learned, ShadowLook
from jghand_engine.avatar.light import SH_COUNT, Light
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
        info=AvatarInfo(name="small", template="test", license="none", pose_statistics={"index mcp": (-0.1, 1.5)}),
        handedness=Handedness.RIGHT,
        canonical_joints_m=joints_m,
        position_m=(spot_m + 0.008 * torch.randn(count, 3, dtype=torch.float64, generator=g)).float(),
        sigma_m=0.0003 + 0.001 * torch.rand(count, generator=g),
        opacity=torch.rand(count, generator=g),
        rgb=torch.rand(count, 3, generator=g),
        bone_weights=weights.float(),
        uvd=torch.rand(count, 3, generator=g),
    )


def trained_avatar(count: int = 200, seed: int = 0, shape: PoseNetShape | None = None) -> HandAvatar:
    """The same with everything that training adds, random but strong enough to be seen."""
    avatar, g = small_avatar(count, seed), torch.Generator().manual_seed(1000 + seed)
    shape = shape or PoseNetShape(octaves=(4, 4, 2), angle_channels=8, angle_texels=6, hidden=32)
    net = PoseNet(avatar.bone_weights, avatar.uvd, shape).requires_grad_(False)
    for tensor in net.state_dict().values():
        tensor.copy_(0.25 * torch.randn(tensor.shape, generator=g))
    net.angles.planes.data *= 6
    light = Light(
        irradiance=0.2 * torch.randn(SH_COUNT, 3, generator=g),
        lobe_direction=torch.randn(5, 3, generator=g),
        lobe_sharpness=2 + 20 * torch.rand(5, generator=g),
        lobe_rgb=0.3 * torch.rand(5, 3, generator=g),
        rim=torch.tensor(0.7),
    )
    normal = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=-1)
    look = ShadowLook(gain=5.0, tint=(0.4, 0.6, 0.7))
    anchors = place_anchors(avatar.position_m, normal, avatar.bone_weights, 60)
    lamp_rgb = torch.rand(20, 3, generator=g) ** 3
    cast = CastShadow(lamp_rgb, torch.tensor([0.4, 0.3, 0.2]), anchors, own_flesh(anchors, avatar.canonical_joints_m))
    return replace(avatar, learned=Learned(normal, torch.rand(count, generator=g), light, net, look, cast=cast))


def ellipsoid_avatar(count: int = 200, seed: int = 0) -> HandAvatar:
    """A trained one whose Gaussians are no spheres."""
    avatar, g = trained_avatar(count, seed), torch.Generator().manual_seed(2000 + seed)
    shape = Ellipsoid(0.6 * torch.randn(count, 3, generator=g).clamp(-2, 2), torch.randn(count, 4, generator=g))
    assert avatar.learned is not None
    return replace(avatar, learned=replace(avatar.learned, ellipsoid=shape))
