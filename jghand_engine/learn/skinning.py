"""Posing an avatar: linear blend skinning of its Gaussians by the 21 bone transforms (METHOD 2.8, 2.9), and those of a
forearm's slices.

This is the differentiable form, in any floating dtype; the native path of the renderer is tested against it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import torch

from jghand_engine.avatar.avatar import HandAvatar, with_slices
from jghand_engine.avatar.cast_task import Capsules
from jghand_engine.avatar.forearm import hidden_from
from jghand_engine.avatar.learned import Ellipsoid
from jghand_engine.avatar.skin_task import BLEND_DET_MIN, SIGMA_STRETCH_MAX, SIGMA_STRETCH_MIN
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.learn.cast_shadow import CastTensors, LampsSeen, exponent, lamps_seen
from jghand_engine.learn.gaussians import Gaussians, posed_covariance
from jghand_engine.learn.light import gloss, lit, seen_from_outside, unit
from jghand_engine.learn.pose_features import PoseAngles
from jghand_engine.learn.pose_net import Correction
from jghand_engine.learn.tensors import HandTensors


class PoseTransforms(Protocol):
    """What skinning needs of `learn.skeleton.BoneTransforms` of one pose; the study of others' formulas has its own."""

    @property
    def linear(self) -> torch.Tensor: ...
    @property
    def offset_m(self) -> torch.Tensor: ...
    @property
    def root_m(self) -> torch.Tensor: ...
    @property
    def canonical_root_m(self) -> torch.Tensor: ...
    @property
    def scale(self) -> torch.Tensor: ...


def blend(bone_weights: torch.Tensor, bones: PoseTransforms) -> tuple[torch.Tensor, torch.Tensor]:
    """The blended affine map of every point: linear (N, 3, 3) and root-relative offset (N, 3), meters.

    A sum of products, never a matrix product: GEMM loses 0.7 mm under autocast and on TF32 hardware (METHOD 2.10).
    """
    flat = torch.cat([bones.linear.flatten(-2), bones.offset_m], -1)
    weights = bone_weights.to(flat.dtype)
    total = weights[:, :1] * flat[0]
    for bone in range(1, flat.shape[0]):
        total = torch.addcmul(total, weights[:, bone : bone + 1], flat[bone])
    return total[:, :9].unflatten(-1, (3, 3)), total[:, 9:]


def apply(linear: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
    """linear (..., 3, 3) times vector (..., 3) by multiply-add, without GEMM."""
    return (linear * vector.unsqueeze(-2)).sum(-1)


def volume_scale(linear: torch.Tensor, hand_scale: torch.Tensor) -> torch.Tensor:
    """|det L|^(1/3) of linear (N, 3, 3), where |det L| counts as BLEND_DET_MIN * s_g^3 at least.

    There the gradient is zero, never infinite.
    """
    det = (linear[..., 0] * torch.linalg.cross(linear[..., 1], linear[..., 2])).sum(-1).abs()
    return torch.maximum(det, BLEND_DET_MIN * hand_scale.abs() ** 3) ** (1.0 / 3.0)


def posed_radius_scale(linear: torch.Tensor, hand_scale: torch.Tensor) -> torch.Tensor:
    """(N,) posed radius / canonical radius: |det L|^(1/3), clamped to SIGMA_STRETCH_MIN..MAX times s_g (METHOD 2.8)."""
    return torch.clamp(volume_scale(linear, hand_scale), SIGMA_STRETCH_MIN * hand_scale, SIGMA_STRETCH_MAX * hand_scale)


def turning(linear: torch.Tensor, bones: PoseTransforms) -> torch.Tensor:
    """The blended rotation (up to shear) L / |det L|^(1/3), (N, 3, 3); of a blend that has collapsed, less of it.

    It turns what is attached to the skin in canonical axes, such as a learned offset, with the hand (METHOD 2.9).
    0, which loses what is attached, of a hand without any size.
    """
    size = volume_scale(linear, bones.scale)
    return linear / torch.where(size > 0, size, 1.0)[:, None, None]


@dataclass(frozen=True)
class SkinMaps:
    """How the skin of one pose moves: what skinning needs of the bones for every Gaussian, and nothing of the avatar
    that training changes.

    linear:   (N, 3, 3) root-relative blended maps
    offset_m: (N, 3) meters, theirs
    radius:   (N,) posed over canonical radius
    turning:  (N, 3, 3) see `turning`
    """

    linear: torch.Tensor
    offset_m: torch.Tensor
    radius: torch.Tensor
    turning: torch.Tensor


def map_weights(position_m: torch.Tensor, bone_weights: torch.Tensor, bones: PoseTransforms) -> torch.Tensor:
    """(N, J) weights of all maps of `bones`, of canonical places (N, 3) with weights of bones (N, 21): slices of a
    turned forearm take their shares, see `HandAvatar.map_weights`. No gradient goes there."""
    if len(bones.linear) == bone_weights.shape[1]:
        return bone_weights
    numbers = (tensor.detach().cpu().numpy() for tensor in (position_m, bone_weights, bones.canonical_root_m))
    return torch.from_numpy(with_slices(*numbers)).to(bone_weights.device)


def skin_maps(bone_weights: torch.Tensor, bones: PoseTransforms) -> SkinMaps:
    """The maps of Gaussians with `bone_weights` (N, 21), see also `map_weights`, under `bones` of one pose."""
    with torch.autocast(bones.linear.device.type, enabled=False):
        linear, offset_m = blend(bone_weights, bones)
        radius = posed_radius_scale(linear, bones.scale)
        return SkinMaps(linear, offset_m, radius, turning(linear, bones))


@dataclass(frozen=True)
class PosedSkin:
    """One pose of an avatar before anybody looks at it.

    matt:   Gaussians with the color that is the same from everywhere
    normal: (N, 3) unit, world, of a trained avatar
    shine:  (N,) of a trained avatar
    shade:  (N, 3) that the pose adds to an albedo that a scene lights (`known_light`); matt has that albedo then
    """

    matt: Gaussians
    normal: torch.Tensor | None = None
    shine: torch.Tensor | None = None
    shade: torch.Tensor | None = None


def see_lamps(shadow: CastTensors, bones: PoseTransforms, others: Capsules | None = None) -> LampsSeen:
    """What the skin of one pose sees of the lamps, without the pose's correction: it moves skin by less than an edge
    of a shadow is wide. others: the flesh of hands beside this one, relative to its root."""
    with torch.autocast(bones.linear.device.type, enabled=False):
        (position_m, normal), ends_m = posed_anchors(shadow, bones)
        return lamps_seen(shadow, position_m, normal, ends_m, bones.scale, others)


def posed_anchors(shadow: CastTensors, bones: PoseTransforms) -> tuple[tuple[torch.Tensor, torch.Tensor], torch.Tensor]:
    """Places and normals (A, 3) of the anchors, and the ends (2, 20, 3) of the flesh, of one pose, root-relative."""
    anchors, dtype = shadow.anchors, bones.linear.dtype
    maps = skin_maps(map_weights(anchors.position_m, anchors.bone_weights, bones), bones)
    root_m = bones.canonical_root_m.to(dtype)
    position_m = apply(maps.linear, anchors.position_m.to(dtype) - root_m) + maps.offset_m
    normal = unit(apply(maps.turning, anchors.normal.to(dtype)))
    ends_m = torch.stack([shadow.flesh[:, :3], shadow.flesh[:, 3:6]]).to(dtype) - root_m
    return (position_m, normal), apply(bones.linear[1:JOINT_COUNT], ends_m) + bones.offset_m[1:JOINT_COUNT]


def pose_skin(
    avatar: HandTensors,
    bones: PoseTransforms,
    correction: Correction | None = None,
    *,
    maps: SkinMaps | None = None,
    seen: LampsSeen | None = None,
) -> PosedSkin:
    """Canonical Gaussians -> those of one pose, in the frame of the joints that made `bones`.

    bones: transforms of one pose (no batch axis); its dtype is that of the result · correction: of that pose, for a
    trained avatar · maps, seen: as `skin_maps` and `see_lamps` make them, where they are known already

    Position: blend [L | t] root-relative, add the root last (METHOD 2.9): the result stays exact far from the origin.
    Radius: sigma * |det L|^(1/3), clamped to SIGMA_STRETCH_MIN..MAX times s_g * sigma (METHOD 2.8).
    """
    learned = avatar.learned
    with torch.autocast(bones.linear.device.type, enabled=False):
        dtype = bones.linear.dtype
        maps = maps or skin_maps(map_weights(avatar.position_m, avatar.bone_weights, bones), bones)
        relative_m = avatar.position_m.to(dtype) - bones.canonical_root_m.to(dtype)
        position_m = apply(maps.linear, relative_m) + maps.offset_m
        if correction is not None:
            offset_m = correction.offset_m.to(dtype)
            in_world = learned is not None and learned.world_offsets
            position_m = position_m + (
                _of_hand(avatar.handedness, offset_m) if in_world else bones.scale * apply(maps.turning, offset_m)
            )
        rgb, normal, shine, shade = avatar.rgb.to(dtype), None, None, None
        if learned is not None:
            normal = unit(apply(maps.turning, learned.normal.to(dtype)))
            shade = None if correction is None else correction.shade.to(dtype)
        if learned is not None and normal is not None and learned.response is None:
            if learned.cast is not None:
                fallen = exponent(learned.cast, seen or see_lamps(learned.cast, bones))
                shade = fallen if shade is None else shade + fallen
            rgb, shine = lit(rgb, normal, learned.light.to(dtype), shade), learned.shine.to(dtype)
        gaussians = Gaussians(
            position_m=position_m + bones.root_m,
            sigma_m=avatar.sigma_m.to(dtype) * maps.radius,
            opacity=avatar.opacity.to(dtype),
            rgb=rgb,
            covariance_m2=None if learned is None else _covariance(avatar.sigma_m, learned.ellipsoid, maps.linear),
        )
        return PosedSkin(gaussians, normal, shine, shade)


def seen_from(skin: PosedSkin, eye_m: torch.Tensor, avatar: HandTensors) -> Gaussians:
    """The Gaussians with what they reflect towards the eye (3,), in the frame of `skin`.

    Where the skin lies decides which way to the eye is, but it is not pulled about by it: no gradient goes there.
    """
    if avatar.learned is None or skin.normal is None or skin.shine is None:
        return skin.matt
    to_eye = unit(eye_m.to(skin.normal) - skin.matt.position_m.detach())
    reflected = skin.shine[:, None] * gloss(skin.normal, to_eye, avatar.learned.light.to(skin.normal.dtype))
    rgb = skin.matt.rgb + reflected
    if not avatar.learned.in_studio:
        return replace(skin.matt, rgb=rgb)
    facing = (skin.normal * to_eye).sum(-1)
    front = seen_from_outside(facing)
    drawn_from = torch.from_numpy(hidden_from(avatar.position_m.numpy(force=True), avatar.opacity.numpy(force=True)))
    return replace(skin.matt, rgb=front[:, None] * rgb, front=torch.where(facing > drawn_from.to(facing), front, -1))


def posed_skin(
    avatar: HandTensors, bones: PoseTransforms, frames: PoseAngles | None, others: Capsules | None = None
) -> PosedSkin:
    """The skin of a finished avatar: `pose_skin` with the correction that its own correctives give for `frames`, in the
    shadow of `others`, see `see_lamps`.

    InputError when it has correctives and there are no frames.
    """
    learned, seen = avatar.learned, None
    if learned is not None and learned.cast is not None and others is not None:
        seen = see_lamps(learned.cast, bones, others)
    correctives = None if learned is None else learned.correctives
    if correctives is None:
        return pose_skin(avatar, bones, seen=seen)
    if frames is None:
        raise InputError("pose of a trained avatar", wanted="its frames, for the joint angles", came="none")
    return pose_skin(avatar, bones, correctives(frames), seen=seen)


def pose_gaussians(
    avatar: HandAvatar | HandTensors,
    bones: PoseTransforms,
    *,
    frames: PoseAngles | None = None,
    eye_m: torch.Tensor | None = None,
    others: Capsules | None = None,
) -> Gaussians:
    """Canonical Gaussians -> what is drawn of one pose, in the frame of the joints that made `bones`.

    frames: of the same pose; a trained avatar with correctives needs them (InputError) · eye_m: (3,) where the camera
    stands; None leaves out what only that camera would see mirrored · others: see `see_lamps`
    """
    hand = HandTensors.of(avatar)
    skin = posed_skin(hand, bones, frames, others)
    return skin.matt if eye_m is None else seen_from(skin, eye_m, hand)


def _covariance(
    sigma_m: torch.Tensor, ellipsoid: Ellipsoid[torch.Tensor] | None, linear: torch.Tensor
) -> torch.Tensor | None:
    if ellipsoid is None:
        return None
    log_scale = sigma_m.log()[:, None] + ellipsoid.log_stretch
    return posed_covariance(log_scale, ellipsoid.quaternion, linear)


def _of_hand(handedness: Handedness, vectors: torch.Tensor) -> torch.Tensor:
    """Vectors (N, 3) in the axes of the right-hand model -> those of the hand: a left one is its mirror image in x."""
    return vectors if handedness is Handedness.RIGHT else vectors * vectors.new_tensor([-1.0, 1.0, 1.0])
