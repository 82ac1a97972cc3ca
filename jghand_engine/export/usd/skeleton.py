"""The skeleton that makes UsdSkel move a mesh exactly as the engine does. No files, no `pxr`: numpy only.

A bone transform of the engine is B_i = S_i diag(r_i, r_i, s_i) S_i^cT between the pivots (METHOD 2.6): a rotation, a
radius r_i and a stretch s_i along the bone. So the skeleton has, in this order,

* 21 **control** joints, named as everywhere. Rotation = frame of the bone that *starts* at the joint (the wrist has the
  palm's, a tip the last bone's), translation = bone length, scale 1, which therefore never inherits down a chain;
* 21 **skin** leaves, one per bone matrix, which carry the scale. `wrist/index1/index2_skin` moves the segment that
  *ends* at index2, where it sits (B_i maps both ends exactly, so either end can be the pivot, and at the far one
  Blender draws bones in their true length); `wrist/palm_skin` is B_0. Only these and the next have skin weights;
* 21 **fine** leaves beside them. UsdSkel stores scales as half, 11 bits: 0.04 mm at the end of a metacarpal. A fixed
  share FINE_SHARE of every weight goes to a twin whose scale is overdrawn by the rounding error of the first:
  (1 - share) coarse + share fine = the scale to 19 bits. A sum with fixed weights stays right between samples, and a
  client that keeps only the four largest weights loses the twin's 1/256 and with it those 0.04 mm, nothing more.

Joint axes: x = flexion axis, y = along the bone, z = out of the palm, right-handed for both hands: the engine's
(y, z, x). Blender draws a bone along y. A left hand is the mirror image with the flexion axis turned round, so that
no scale is negative and positive flexion curls it too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from jghand_engine.hand.joints import JOINT_COUNT, LEVEL_NAMES, PARENTS, Handedness
from jghand_engine.hand.orders import LEVEL_OF_STANDARD, STANDARD_OF_LEVEL
from jghand_engine.limits import USD_FINE_SHARE

# columns of an engine frame that become x, y, z of a joint
JOINT_AXES = (1, 2, 0)
MIRROR = np.diag([-1.0, 1.0, 1.0])
TURN_FLEXION_AXIS = np.diag([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class BonePoses:
    """Where the engine puts the bones of F frames, level order, in the world of the hand itself.

    joints_m: (F, 21, 3) meters · axes: (F, 21, 3, 3) joint axes of every bone, row 0 the palm's ·
    scales: (F, 21, 3) along those axes
    """

    joints_m: np.ndarray
    axes: np.ndarray
    scales: np.ndarray


@dataclass(frozen=True)
class LocalPoses:
    """Joints of the skeleton relative to their parents over F frames.

    translations_m: (F, 63, 3) · rotations_xyzw: (F, 63, 4), each on the side of the frame before ·
    scales: (F, 63, 3), values that half precision holds exactly
    """

    translations_m: np.ndarray
    rotations_xyzw: np.ndarray
    scales: np.ndarray


@dataclass(frozen=True)
class UsdSkeleton:
    """tokens: 63 paths, parents first · bind, rest: (63, 4, 4) world and local transforms of the rest pose, acting on
    column vectors · default: the rest pose as one frame."""

    tokens: tuple[str, ...]
    bind: np.ndarray
    rest: np.ndarray
    default: LocalPoses


def joint_tokens() -> tuple[str, ...]:
    """The paths of all 63 joints: control joints in standard order, then skin and fine leaves in the same order."""
    paths: dict[int, str] = {}
    for level, name in enumerate(LEVEL_NAMES):
        paths[level] = f"{paths[PARENTS[level]]}/{name}" if level else name
    leaves = [
        f"{paths[max(PARENTS[level], 0)]}/{LEVEL_NAMES[level] if level else 'palm'}_skin" for level in LEVEL_OF_STANDARD
    ]
    return (*(paths[level] for level in LEVEL_OF_STANDARD), *leaves, *(f"{leaf}_fine" for leaf in leaves))


def joint_axes(frames: np.ndarray, handedness: Handedness) -> np.ndarray:
    """Engine frames (..., 3, 3) of the *right-hand* code, columns x, y, z, to proper joint axes in the hand's world."""
    if handedness is Handedness.LEFT:
        frames = MIRROR @ frames @ TURN_FLEXION_AXIS
    return frames[..., JOINT_AXES]


def build_skeleton(rest: BonePoses) -> UsdSkeleton:
    """The skeleton at rest (one frame)."""
    rotations, positions_m = _world(rest.joints_m, rest.axes)
    default = _local_poses(rest)
    local = _homogeneous(Rotation.from_quat(default.rotations_xyzw[0]).as_matrix(), default.translations_m[0])
    return UsdSkeleton(joint_tokens(), _homogeneous(rotations[0], positions_m[0]), local, default)


def in_motion(skeleton: UsdSkeleton, batches: Iterable[BonePoses]) -> Iterator[LocalPoses]:
    """The skeleton's joints in the poses of a motion, which comes in parts; rotations go on from the rest pose."""
    before = skeleton.default.rotations_xyzw[-1:]
    for batch in batches:
        poses = _local_poses(batch)
        turned = same_hemisphere(np.concatenate([before, poses.rotations_xyzw]))[1:]
        before = turned[-1:]
        yield replace(poses, rotations_xyzw=turned)


def _local_poses(poses: BonePoses) -> LocalPoses:
    rotations, positions_m = _local(*_world(poses.joints_m, poses.axes))
    quaternions = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat().reshape(*rotations.shape[:2], 4)
    coarse, fine = split_scales(poses.scales[:, LEVEL_OF_STANDARD])
    scales = np.concatenate([np.ones_like(coarse), coarse, fine], axis=1)
    return LocalPoses(positions_m, same_hemisphere(quaternions), scales)


def split_scales(scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two arrays of half-precision values with (1 - share) * coarse + share * fine = scales to 2^-19 of them."""
    coarse = scales.astype(np.float16).astype(np.float64)
    fine = coarse + (scales - coarse) / USD_FINE_SHARE
    return coarse, fine.astype(np.float16).astype(np.float64)


def same_hemisphere(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions (F, J, 4) with the sign that is nearest to the frame before: clients interpolate between samples."""
    turn = np.sign((quaternions[1:] * quaternions[:-1]).sum(-1, keepdims=True))
    turn = np.cumprod(np.where(turn < 0, -1.0, 1.0), axis=0)
    return np.concatenate([quaternions[:1], quaternions[1:] * turn])


def skin_influences(
    bone_weights: np.ndarray, *, most: int = JOINT_COUNT, fine: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Joint indices and weights from bone weights (V, 21), level order; K = most bones of any vertex, at most `most`.

    What lies beyond that is shared out among the others, nothing else is dropped. The K shares of the skin leaves come
    first, in falling order, then those of their fine twins: (V, 2K). Without `fine` there are no twins: (V, K), and
    the skin is as exact as half precision.
    """
    has = bone_weights > 0
    count = max(1, int(has.sum(axis=1).max(initial=0)))
    bone = np.argsort(-bone_weights, axis=1, kind="stable")[:, : min(most, count)]
    weight = np.take_along_axis(bone_weights, bone, axis=1)
    if most < count:
        weight = weight / weight.sum(axis=1, keepdims=True)
    # unused slots point at the first joint: a weight of 0 on whatever joint means nothing
    skin = np.where(weight > 0, JOINT_COUNT + STANDARD_OF_LEVEL[bone], 0)
    if not fine:
        return skin, weight
    twin = np.where(weight > 0, skin + JOINT_COUNT, 0)
    return (
        np.concatenate([skin, twin], axis=1),
        np.concatenate([weight * (1 - USD_FINE_SHARE), weight * USD_FINE_SHARE], axis=1),
    )


def _world(joints_m: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World rotations (F, 63, 3, 3) and positions (F, 63, 3) of all joints."""
    level = list(LEVEL_OF_STANDARD)
    starts = [0 if bone == 0 else bone + 5 if bone <= 15 else bone for bone in level]
    rotations = np.concatenate([axes[:, starts], axes[:, level], axes[:, level]], axis=1)
    return rotations, np.concatenate([joints_m[:, level]] * 3, axis=1)


def _local(rotations: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same relative to the parents; the wrist stays in the world."""
    control = [STANDARD_OF_LEVEL[max(PARENTS[level], 0)] for level in LEVEL_OF_STANDARD]
    parent = np.array(control * 3)
    to_parent = rotations[:, parent].swapaxes(-1, -2)
    local_rotations = to_parent @ rotations
    local_positions = (to_parent @ (positions - positions[:, parent])[..., None])[..., 0]
    local_rotations[:, 0], local_positions[:, 0] = rotations[:, 0], positions[:, 0]
    return local_rotations, local_positions


def _homogeneous(rotations: np.ndarray, positions: np.ndarray) -> np.ndarray:
    matrices = np.zeros((*rotations.shape[:-2], 4, 4))
    matrices[..., :3, :3], matrices[..., :3, 3], matrices[..., 3, 3] = rotations, positions, 1
    return matrices
