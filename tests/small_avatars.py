"""Small random avatars for tests: Gaussians near the built-in canonical joints, blended between neighboring bones."""

from dataclasses import replace

import numpy as np
import torch

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.correctives import PoseNetShape
from jghand_engine.avatar.learned import SH_COUNT, Ellipsoid, ShadowLook, bone_flesh, flesh_of, own_flesh
from jghand_engine.avatar.relief import Relief
from jghand_engine.avatar.relighting import estimated
from jghand_engine.hand.joints import JOINT_COUNT, PARENTS, Handedness
from jghand_engine.learn.cast_shadow import CastTensors, place_anchors
from jghand_engine.learn.light import LightTensors
from jghand_engine.learn.pose_net import PoseNet
from jghand_engine.learn.tensors import HandTensors, LearnedTensors
from jghand_engine.template.builtin import load_template, load_template_with_forearm


def small_avatar(count: int = 200, seed: int = 0) -> HandAvatar:
    return small_tensors(count, seed).avatar()


def small_tensors(count: int = 200, seed: int = 0) -> HandTensors:
    """The same for the differentiable form."""
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
    return HandTensors(
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


def on_template(forearm: bool) -> HandAvatar:
    """The painted hand's arrays, its first Gaussians at the vertices of a template."""
    template = load_template_with_forearm() if forearm else load_template()
    painted = load_painted(handedness=Handedness.RIGHT).prefix(len(template.vertices_m))
    info, weights = replace(painted.info, template=template.identifier), template.bone_weights.astype(np.float32)
    whole = np.ones(len(painted), np.float32)
    rest_m = template.vertices_m.astype(np.float32)
    return replace(painted, info=info, position_m=rest_m, opacity=whole, bone_weights=weights)


def trained_avatar(count: int = 200, seed: int = 0, shape: PoseNetShape | None = None) -> HandAvatar:
    """The same with everything that training adds, random but strong enough to be seen."""
    return trained_tensors(count, seed, shape).avatar()


def trained_tensors(count: int = 200, seed: int = 0, shape: PoseNetShape | None = None) -> HandTensors:
    """The same for the differentiable form."""
    avatar, g = small_tensors(count, seed), torch.Generator().manual_seed(1000 + seed)
    shape = shape or PoseNetShape(octaves=(4, 4, 2), angle_channels=8, angle_texels=6, hidden=32)
    net = PoseNet(avatar.bone_weights, avatar.uvd, shape).requires_grad_(False)
    for tensor in net.state_dict().values():
        tensor.copy_(0.25 * torch.randn(tensor.shape, generator=g))
    net.angles.planes.data *= 6
    light = LightTensors(
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
    flesh = bone_flesh(avatar.canonical_joints_m.numpy())
    own = torch.from_numpy(own_flesh(anchors.position_m.numpy(), flesh))
    cast = CastTensors(lamp_rgb, torch.tensor([0.4, 0.3, 0.2]), anchors, torch.from_numpy(flesh), own)
    return replace(avatar, learned=LearnedTensors(normal, torch.rand(count, generator=g), light, net, look, cast=cast))


def known_avatar(count: int = 200, seed: int = 0) -> HandAvatar:
    """A trained one that answers any light, each Gaussian in its own way."""
    avatar, g = estimated(trained_avatar(count, seed)), np.random.default_rng(seed)
    assert avatar.learned is not None
    guess = avatar.learned.response
    assert guess is not None
    response = replace(
        guess,
        spread=g.uniform(0.5, 2, count).astype(np.float32),
        roughness=g.uniform(0.25, 0.65, count).astype(np.float32),
        reflectance=g.uniform(0.01, 0.08, count).astype(np.float32),
        **{name: np.float32(getattr(guess, name)) for name in ("softness", "bounce")},
        shade_gain=float(np.float32(guess.shade_gain)),
        trained_on={"worlds": 3, "sun": 5},
    )
    cast = avatar.learned.cast
    assert cast is not None
    flesh, own = flesh_of(cast.anchors.position_m, avatar.canonical_joints_m, fitted=True)
    cast = replace(cast, flesh=flesh, own=own)
    return replace(avatar, learned=replace(avatar.learned, response=response, cast=cast))


def ellipsoid_avatar(count: int = 200, seed: int = 0) -> HandAvatar:
    """A trained one whose Gaussians are no spheres."""
    avatar, g = trained_avatar(count, seed), torch.Generator().manual_seed(2000 + seed)
    stretch, turn = 0.6 * torch.randn(count, 3, generator=g).clamp(-2, 2), torch.randn(count, 4, generator=g)
    assert avatar.learned is not None
    shape = Ellipsoid(stretch.numpy(), turn.numpy())
    return replace(avatar, learned=replace(avatar.learned, ellipsoid=shape))


def coarse_builtin(count: int = 2000, texels: int = 128) -> HandAvatar:
    """The built-in hand with all that it has, of fewer Gaussians and texels: what is made of 2048 x 2048 takes seconds.
    texels: along a side, a power of two"""
    avatar = load_builtin(handedness=Handedness.RIGHT).prefix(count)
    detail = avatar.detail
    assert detail is not None
    assert detail.relief is not None
    every = detail.size // texels
    relief = Relief(np.ascontiguousarray(detail.relief.height[::every, ::every]))
    coarse = replace(detail, texture=np.ascontiguousarray(detail.texture[::every, ::every]), relief=relief)
    return replace(avatar, detail=coarse)
