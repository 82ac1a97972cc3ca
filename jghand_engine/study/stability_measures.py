"""What is measured of a hard hand: finite values and gradients, precision, continuity, and the picture.

Two formulations stand side by side: ours, as the renderer uses it (joints relative to the wrist, which is added last),
and the usual one (`stability_usual`). Lengths are given as on a hand of ordinary size, so that units compare.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.avatar import FOREARM_WAY, HandAvatar
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.learned import lamp_directions, own_flesh
from jghand_engine.avatar.posing import Posing
from jghand_engine.avatar.tiers import Tier
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import describe_flags
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.cast_shadow import place_anchors
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.skeleton import BoneTransforms, JointTransform
from jghand_engine.learn.skinning import apply, pose_gaussians
from jghand_engine.learn.tensors import HandTensors
from jghand_engine.native import contract
from jghand_engine.render.camera import Camera
from jghand_engine.study.stability_hands import (
    GRADIENT_MAX,
    JITTERS,
    NUDGE_M,
    HandCase,
    beside,
    template_joints_m,
    template_size_m,
)
from jghand_engine.study.stability_pictures import PictureError, against_reference
from jghand_engine.study.stability_usual import UsualTransform
from jghand_engine.template.builtin import load_template

# hands at each of the distances of JITTERS
BESIDE = 20
# nudges tried for every hand, in random directions
NUDGES = 64
# hands beside where a network has to be asked for each of them
FEW = 15
# points of the skin that are watched, of the template's 1610
SKIN_POINTS = 400
# what a nudge may move any of them by, meters (METHOD 2.11); of a forearm see `levers_of`
SKIN_MAX_M = 2e-3
# the same with the worst of all signs: three times as far as each joint is off, sqrt(3) NUDGE_M. Joints that are off by
# e at both ends of a bone of length l turn it by 2 e / l, which moves skin r beside its axis by e (1 + 2 r / l): 8 mm
# beside a finger's end of 19 mm by 1.8 e, and by 2.7 e where it is half as long. Twist and blending make 2.2 e of 1.8;
# 3 e is left for bones of other lengths, and fingers that stand aside
SIGNS_MAX_M = 3 * 3**0.5 * NUDGE_M
# of a nudge, by which it is found how each joint moves the skin: small enough for first order, large beside rounding
FIRST_ORDER = 0.02
# directions, of half of all, in which ways of skin are sought: 15 degrees apart, and 8 degrees off one lose a hundredth
DIRECTIONS = 100
# places of the skin whose worst signs are tried, both ways round
WORST = 32
# float32 against float64, meters on a hand of ordinary size (METHOD 2.11, of the joints)
PRECISION_MAX_M = 5e-7
# Gaussians of the hand, and side of the picture, in which it is compared with the reference
GAUSSIANS = 1500
PICTURE_PX = 64
# anchors of its cast shadow: at all 2,048 the gradients of one row's hands took 6 GB
ANCHORS = 128


@dataclass(frozen=True)
class Skin:
    """A formulation's answer for hands (N, 21, 3). skin: (N, V, 3) relative to the wrist · loss: a sum of everything
    that it computes, for gradients"""

    skin: Tensor
    loss: Tensor


# float64 joints (N, 21, 3) and a precision -> the answer in that precision
Formulation = Callable[[Tensor, torch.dtype], Skin]


@dataclass(frozen=True)
class Measured:
    """Of one formulation on one hand and the hands beside it.

    finite: values and gradients, float32 and float64 · gradient: largest |gradient| times hand size, float32
    precision_mm: skin of float32 against float64 · nudged_mm: how far a nudge of 0.5 mm of every joint moves the skin
    signs_mm: the same for exactly +-0.5 mm on every axis, with the worst of all signs
    """

    finite: bool
    gradient: float
    precision_mm: float
    nudged_mm: float
    signs_mm: float


@dataclass(frozen=True)
class HandRow:
    """One row of the table. flags: what the transform says of the hand · usual: None where it was not asked"""

    name: str
    flags: list[str]
    ours: Measured
    usual: Measured | None
    picture: PictureError
    missed: list[str] = field(default_factory=list)


@cache
def _watched() -> tuple[Tensor, Tensor]:
    """Points of the template's skin, (V, 3) and weights (V, 21), float64."""
    template = load_template()
    every = max(1, len(template.vertices_m) // SKIN_POINTS)
    return torch.from_numpy(template.vertices_m[::every].copy()), torch.from_numpy(
        template.bone_weights[::every].copy()
    )


@cache
def transform_for(handedness: Handedness) -> JointTransform:
    return JointTransform(template_joints_m().numpy(), handedness=handedness)


def _blended(linear: Tensor, offset_m: Tensor, points_m: Tensor, weights: Tensor) -> Tensor:
    """(N, V, 3) by linear blend skinning."""
    maps = torch.cat([linear, offset_m.unsqueeze(-1)], -1)
    blended = (weights.to(maps.dtype) @ maps.flatten(-2)).unflatten(-1, (3, 4))
    return apply(blended[..., :3], points_m.to(maps.dtype)) + blended[..., 3]


def ours(joints_m: Tensor, dtype: torch.dtype, *, handedness: Handedness) -> Skin:
    """See Formulation: as the renderer does it, whose camera moves to the hand."""
    points_m, weights = _watched()
    bones = transform_for(handedness).bones((joints_m - joints_m[:, :1]).to(dtype))
    frames = bones.frames
    angles = frames.angles.sum() + frames.palm_p.sum() + frames.palm_n.sum()
    loss = _sum_of_turns(bones.linear, bones.scale) + angles
    return Skin(_blended(bones.linear, bones.offset_m, points_m - bones.canonical_root_m, weights), loss)


def _sum_of_turns(linear: Tensor, scale: Tensor) -> Tensor:
    """Sum of the linear parts (N, 21, 3, 3) without the unit of length; a hand without size has scale 0."""
    size = torch.where(scale > 0, scale, 1.0).detach()
    return (linear / size[:, None, None, None]).sum()


@cache
def _usual_transform(handedness: Handedness) -> UsualTransform:
    return UsualTransform(template_joints_m(), handedness=handedness)


def usual(joints_m: Tensor, dtype: torch.dtype, *, handedness: Handedness) -> Skin:
    """See Formulation: absolute coordinates all the way."""
    points_m, weights = _watched()
    bones = _usual_transform(handedness).bones(joints_m.to(dtype))
    skin = _blended(bones.linear, bones.offset_m, points_m, weights)
    return Skin(skin - joints_m[:, :1].to(dtype), _sum_of_turns(bones.linear, bones.scale) + bones.angles.sum())


# ---- one number each ------------------------------------------------------------------------------------------------


def measure(
    formulation: Formulation,
    case: HandCase,
    *,
    hands_beside: int = BESIDE,
    shown: Formulation | None = None,
    levers: Tensor | None = None,
) -> Measured:
    """All numbers of a formulation on a case. hands_beside: at each of the distances · shown: whose skin is nudged ·
    levers: see `moved_mm`"""
    to_mm = 1e3 * template_size_m() / case.size_m
    single, double = (
        _differentiated(formulation, beside(case, hands_beside), dtype) for dtype in (torch.float32, torch.float64)
    )
    nudges = random_nudges(), worst_signs(shown or formulation, case, levers)
    nudged, signs = (moved_mm(shown or formulation, case, nudge, levers) for nudge in nudges)
    exact = formulation(case.joints_m[None], torch.float64).skin
    rounded = formulation(case.joints_m[None], torch.float32).skin
    return Measured(
        finite=single[0] and double[0],
        gradient=single[1],
        precision_mm=float((rounded.double() - exact).norm(dim=-1).max()) * to_mm,
        nudged_mm=nudged,
        signs_mm=signs,
    )


def _differentiated(formulation: Formulation, joints_m: Tensor, dtype: torch.dtype) -> tuple[bool, float]:
    """Whether values and gradients are finite, and the largest gradient times the size of its hand (N, 21, 3)."""
    sizes_m = (joints_m - joints_m[:, :1]).abs().amax((1, 2))
    # where all joints coincide there is no natural unit: meters
    sizes_m = torch.where(sizes_m > 0, sizes_m, 1.0)
    answer = formulation(joints_m.requires_grad_(), dtype)
    skin = (answer.skin.mean(1) / sizes_m[:, None].to(dtype)).sum()
    (gradient,) = torch.autograd.grad(answer.loss + skin, joints_m)
    finite = bool(torch.isfinite(answer.skin).all() & torch.isfinite(gradient).all() & torch.isfinite(answer.loss))
    return finite, float((gradient.abs().amax((1, 2)) * sizes_m).max())


def random_nudges(count: int = NUDGES) -> Tensor:
    """(count, 21, 3) of length 1 for every joint."""
    direction = torch.randn(count, 21, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    return direction / direction.norm(dim=-1, keepdim=True)


def worst_signs(formulation: Formulation, case: HandCase, levers: Tensor | None = None) -> Tensor:
    """(2 WORST, 21, 3) of +1 or -1 along every axis: of all 2^63 such nudges those that move some point of the skin
    farthest, to first order. A nudge n moves a point by J n, and the longest J n is the largest sum of |J^T u| over
    directions u, where n has the signs of J^T u.

    levers: see `moved_mm`"""
    step_m = FIRST_ORDER * NUDGE_M * case.size_m / template_size_m()
    nudges = torch.eye(case.joints_m.numel(), dtype=torch.float64).reshape(-1, *case.joints_m.shape)
    forth, back = (_skin(formulation, case.joints_m + side * step_m * nudges) for side in (1, -1))
    by_joint = forth - back
    best, towards = torch.zeros_like(by_joint[0, :, 0]), torch.zeros_like(by_joint[0])
    # of a direction and its opposite one is enough
    for direction in torch.from_numpy(lamp_directions(2 * DIRECTIONS)[:DIRECTIONS]):
        way = (by_joint @ direction).abs().sum(0)
        farther = way > best
        best, towards[farther] = torch.where(farther, way, best), direction
    points = (best if levers is None else best / levers).topk(WORST).indices
    signs = torch.einsum("kvi,vi->vk", by_joint[:, points], towards[points]).sign().reshape(-1, *case.joints_m.shape)
    return torch.cat([signs, -signs])


def _skin(formulation: Formulation, joints_m: Tensor) -> Tensor:
    """(N, V, 3) in float64. The wrist itself moves, too: its place counts."""
    return formulation(joints_m, torch.float64).skin + joints_m[:, :1]


def levers_of(avatar: HandAvatar) -> Tensor:
    """(N,) how many times as far as the hand's a nudge may move each of its Gaussians: 1, and behind the wrist one more
    for each palm's length of way. A forearm goes on where the palm points, and where that is, is known from joints as
    far apart as the palm is long: what turns the palm moves the forearm as it moves the end of a lever."""
    wrist_m, knuckles_m = avatar.canonical_joints_m[0], avatar.canonical_joints_m[2:6].mean(0)
    behind_m = ((avatar.position_m - wrist_m) @ FOREARM_WAY).clip(0)
    return 1 + torch.from_numpy(behind_m) / float(np.linalg.norm(knuckles_m - wrist_m))


def moved_mm(formulation: Formulation, case: HandCase, nudges: Tensor, levers: Tensor | None = None) -> float:
    """How far nudges of 0.5 mm, on a hand of ordinary size, move any point of the skin, millimeters.

    levers: (V,) what the way of each point is divided by; None: 1"""
    part = case.size_m / template_size_m()
    joints_m = torch.cat([case.joints_m[None], case.joints_m + part * NUDGE_M * nudges])
    skin = _skin(formulation, joints_m)
    way_m = (skin[1:] - skin[0]).norm(dim=-1)
    return 1e3 * float((way_m if levers is None else way_m / levers).max()) / part


# ---- rows -----------------------------------------------------------------------------------------------------------


def hand_row(case: HandCase) -> HandRow:
    """The row of a hard hand."""
    transform = transform_for(case.handedness)
    centered = case.joints_m - case.joints_m[:1]
    flags = describe_flags(int(transform.frames(centered).flags))
    measured = measure(partial(ours, handedness=case.handedness), case)
    compared = measure(partial(usual, handedness=case.handedness), case)
    avatar = load_painted(handedness=case.handedness).prefix(GAUSSIANS)
    picture = hand_picture(avatar, case)
    return HandRow(case.name, flags, measured, compared, picture, misses(measured, picture, flagged=bool(flags)))


def correctives_row(case: HandCase) -> HandRow:
    """The row of a hand far outside what the trained avatar has learned from: what is finite and exact of a part of it,
    with gradients, and how far nudges move all of its Gaussians in the tier that is shown."""
    shipped = load_builtin(handedness=case.handedness)
    avatar = _with_fewer_anchors(HandTensors.of(shipped.prefix(GAUSSIANS)))
    transform = transform_of(avatar)
    flags = describe_flags(int(transform.frames(case.joints_m - case.joints_m[:1]).flags))

    def learned(joints_m: Tensor, dtype: torch.dtype) -> Skin:
        posed = [posed_avatar(avatar, transform, one.to(dtype)) for one in joints_m - joints_m[:, :1]]
        rgb = torch.stack([one.rgb.sum() for one in posed]).sum()
        return Skin(torch.stack([one.position_m for one in posed]), rgb)

    # the network is evaluated hand by hand: fewer of them
    few, shown, levers = FEW // len(JITTERS), as_shown(shipped), levers_of(shipped)
    measured = measure(learned, case, hands_beside=few, shown=shown, levers=levers)
    picture = hand_picture(avatar, case)
    name = f"trained hand, {case.name}"
    return HandRow(name, flags, measured, None, picture, misses(measured, picture, flagged=bool(flags)))


def as_shown(avatar: HandAvatar) -> Formulation:
    """An avatar as the renderer shows it, by the kernels: all Gaussians, all anchors, the tier that `auto` takes."""
    learned = avatar.learned
    posing = Posing(avatar if learned is None else replace(avatar, learned=learned.with_tier(Tier.AUTO)[0]))

    def formulation(joints_m: Tensor, dtype: torch.dtype) -> Skin:
        posed = [torch.from_numpy(posing(one.numpy()).position_m) for one in joints_m - joints_m[:, :1]]
        return Skin(torch.stack(posed).to(dtype), torch.zeros((), dtype=dtype))

    return formulation


def _with_fewer_anchors(avatar: HandTensors) -> HandTensors:
    """Its cast shadow at so few anchors that the gradients of many hands fit into memory together."""
    learned = avatar.learned
    if learned is None or learned.cast is None:
        return avatar
    anchors = place_anchors(avatar.position_m, learned.normal, avatar.bone_weights, ANCHORS)
    own = own_flesh(anchors.position_m.numpy(), learned.cast.flesh.numpy())
    cast = replace(learned.cast, anchors=anchors, own=torch.from_numpy(own))
    return replace(avatar, learned=replace(learned, cast=cast))


def misses(measured: Measured, picture: PictureError, *, flagged: bool) -> list[str]:
    """What is not as it should be, in words. A flagged hand has no certain frame: its skin may jump."""
    nudge, skin, by_signs = 1e3 * NUDGE_M, 1e3 * SKIN_MAX_M, 1e3 * SIGNS_MAX_M
    checks = (
        (measured.finite, "not finite"),
        (measured.gradient <= GRADIENT_MAX, "gradient"),
        (measured.precision_mm <= 1e3 * PRECISION_MAX_M, "float32"),
        (flagged or measured.nudged_mm <= skin, f"a nudge of {nudge:g} mm moves skin over {skin:g} mm"),
        (flagged or measured.signs_mm <= by_signs, f"+-{nudge:g} mm on every axis moves skin over {by_signs:.1f} mm"),
        (picture.good, "picture"),
    )
    return [words for good, words in checks if not good]


def posed_avatar(avatar: HandAvatar | HandTensors, transform: JointTransform, joints_m: Tensor) -> Gaussians:
    """The Gaussians of an avatar for joints (21, 3), with its correctives where it has any."""
    bones: BoneTransforms = transform.bones(joints_m)
    return pose_gaussians(avatar, bones, frames=bones.frames)


def hand_picture(avatar: HandAvatar | HandTensors, case: HandCase) -> PictureError:
    """The hand as the native kernel draws it against the float64 reference."""
    joints_m = case.joints_m - case.joints_m[:1]
    with torch.no_grad():
        gaussians = posed_avatar(avatar, transform_of(avatar), joints_m.float())
    return against_reference(gaussians, camera_before(case))


def camera_before(case: HandCase) -> Camera:
    """A camera that sees a whole hand whose wrist is at the origin, from the palm's side, however large the hand is."""
    distance_m = max(4.0 * case.size_m, 10 * contract.Z_NEAR_M)
    middle = (case.joints_m - case.joints_m[:1]).mean(0).numpy()
    eye = middle + np.array([0.3, 0.1, 0.95]) * distance_m
    focal_px = 0.4 * PICTURE_PX * distance_m / case.size_m
    return Camera.looking_at(eye, middle, (0.0, 1.0, 0.0), width=PICTURE_PX, height=PICTURE_PX, focal_px=focal_px)
