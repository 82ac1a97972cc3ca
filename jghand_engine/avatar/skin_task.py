"""What the kernels of the skin read of an avatar at rest: fields of their tasks by name (native/skin.h, learned.h)."""

from __future__ import annotations

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import Blocks
from jghand_engine.avatar.learned import LIGHT_EXPONENT_MAX, Learned, Light
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.rotations import quaternion_rotation
from jghand_engine.native.binding import aligned_zeros
from jghand_engine.native.learned_tasks import LearnedTask
from jghand_engine.native.tasks import LANES, SkinTask

# posed radius relative to the whole hand's scale. Blending rotations shrinks the determinant at a bent joint, but the
# skin on its back is stretched, up to twice its area: with smaller radii one looks through it, at the palm's lines
SIGMA_STRETCH_MIN = 1.0
SIGMA_STRETCH_MAX = 1.4
# length of a quaternion at or below which it is no rotation, and counts as none
QUATERNION_MIN = 1e-6
# |det L| / s_g^3 that a blend counts as having at least, where what is attached to the skin is turned with it: at a
# joint folded by 180 degrees it has none, and what is divided by that is neither bounded nor steady
BLEND_DET_MIN = 0.1
# squared length below which a normal counts as none
NORMAL_LENGTH2_MIN = 1e-12


def skin_task(blocks: Blocks) -> SkinTask:
    """The task of skinning, without arrays."""
    return SkinTask(blocks=blocks.count, stretch_min=SIGMA_STRETCH_MIN, stretch_max=SIGMA_STRETCH_MAX)


def surface_task(blocks: Blocks) -> LearnedTask:
    """The task of a surface that bones and correctives move, without arrays."""
    return LearnedTask(skin=skin_task(blocks), volume_min=BLEND_DET_MIN, length2_min=NORMAL_LENGTH2_MIN)


def skin_arrays(avatar: HandAvatar, blocks: Blocks) -> dict[str, np.ndarray]:
    """What the kernel reads of an avatar at rest: fields of SkinTask by name."""
    relative = avatar.position_m.astype(np.float64) - avatar.canonical_joints_m[0]
    rest = np.concatenate([relative, avatar.sigma_m[:, None]], axis=1)
    arrays = {"rest": blocks.blocked(rest)} | blocks.bones(avatar.map_weights(avatar.position_m, avatar.bone_weights))
    if (axes := ellipsoid_axes(avatar)) is not None:
        arrays["axes"] = blocks.blocked(axes)
    return arrays


def ellipsoid_axes(avatar: HandAvatar) -> np.ndarray | None:
    """(N, 9) float64 the axes of its ellipsoids in the canonical hand, meters, row by row; None for spheres."""
    ellipsoid = None if avatar.learned is None else avatar.learned.ellipsoid
    if ellipsoid is None:
        return None
    scale_m = np.exp(np.log(avatar.sigma_m.astype(np.float64))[:, None] + ellipsoid.log_stretch)
    turn = ellipsoid.quaternion.astype(np.float64)
    length, none = np.linalg.norm(turn, axis=1, keepdims=True), np.array([1.0, 0.0, 0.0, 0.0])
    turn = np.where(length > QUATERNION_MIN, turn / np.maximum(length, QUATERNION_MIN), none)
    return (quaternion_rotation(turn) * scale_m[:, None]).reshape(-1, 9)


def learned_task(learned: Learned, handedness: Handedness) -> LearnedTask:
    """What the kernel is told of a trained avatar, without arrays."""
    side = -1 if handedness is Handedness.LEFT else 1
    return LearnedTask(
        rim=float(learned.light.rim),
        volume_min=BLEND_DET_MIN,
        exponent_max=LIGHT_EXPONENT_MAX,
        length2_min=NORMAL_LENGTH2_MIN,
        world_offsets=side if learned.world_offsets else 0,
    )


def learned_arrays(avatar: HandAvatar, learned: Learned, blocks: Blocks) -> dict[str, np.ndarray]:
    """What the kernel reads of colors: fields of LearnedTask by name; `matt`, which it writes, where it reflects."""
    look = np.concatenate([learned.normal, avatar.rgb, learned.shine[:, None]], 1)
    arrays = {"look": blocks.blocked(look)} | _light(learned.light)
    if learned.reflects:
        arrays["matt"] = aligned_zeros((blocks.count, 6, LANES))
    return arrays


def _light(light: Light) -> dict[str, np.ndarray]:
    length2 = np.square(light.lobe_direction).sum(-1, keepdims=True)
    direction = light.lobe_direction / np.sqrt(np.maximum(length2, NORMAL_LENGTH2_MIN))
    lobe = np.concatenate([direction, light.lobe_sharpness[:, None] / np.log(2), light.lobe_rgb], 1)
    arrays = {}
    for name, values in (("irradiance", light.irradiance), ("lobe", lobe)):
        arrays[name] = aligned_zeros(values.shape)
        arrays[name][...] = values
    return arrays
