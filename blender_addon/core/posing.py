# SPDX-License-Identifier: GPL-3.0-or-later
"""Joint positions to bone matrices and back, in numpy: what a rig's rest pose and its keys are made of.

Every bone's y axis runs along it and its z axis points to the palm's side (for the thumb: to its pad), so that a
positive rotation about the local x axis bends the finger, on both hands. Positions only say where a bone points; its
twist about itself follows the parent bone by the smallest rotation. Source: BLENDER 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import JGHandFailure
from .joints import ELBOW_RIGHT_M, INDEX, LEFT, MIDDLE, NAMES, PARENTS, PINKY, REST_RIGHT_M, RING, TAILS, THUMB, WRIST

# a rest bone shorter than this part of the mean bone has no direction, and Blender deletes bones of no length
REST_BONE_MIN = 1e-2
# sine between palm bones below which a frame has no palm plane and holds the orientation of the one before
PALM_SINE_MIN = 1e-3
# part of the squared sum of the metacarpals below which their fan has no plane: the engine's PALM_NORMAL_MIN
_PALM_NORMAL_MIN = 1e-4
# cosine below which two directions count as opposite: the smallest rotation between them has no axis of its own
OPPOSITE_COSINE = -0.999999

# Where the thumb's pad looks at rest, in the palm's axes (to the index side, to the fingers, out of the palm):
# opposite to the mean normal of the thumb nail of the built-in hand.
_THUMB_PAD = np.array([-0.93, 0.27, 0.26])


@dataclass(frozen=True)
class BoneKeys:
    """What is keyed: location (F, 21, 3) in the unit of the joints and quaternion (F, 21, 4) as w, x, y, z, both
    relative to the rest pose in the bone's own axes, in the standard order; those of a forearm's bone last."""

    location: np.ndarray
    quaternion: np.ndarray


def rest_joints_m(handedness: str, like_m: np.ndarray | None = None) -> np.ndarray:
    """(21, 3) joints of the rest pose, meters: an open, relaxed hand with the wrist at the origin.

    like_m: (F, 21, 3) joints of a motion, meters; the rest hand then has its median bone lengths, so that a motion
    with constant lengths is keyed by rotations (and the place of the knuckles in the palm) alone.
    """
    joints = np.array(REST_RIGHT_M)
    if handedness == LEFT:
        joints = joints * (-1.0, 1.0, 1.0)
    if like_m is None:
        return joints
    frames = checked_joints(like_m)
    result = np.zeros_like(joints)
    for place in range(1, len(NAMES)):
        parent = PARENTS[place]
        bone = joints[place] - joints[parent]
        length = np.median(np.linalg.norm(frames[:, place] - frames[:, parent], axis=-1))
        result[place] = result[parent] + bone * (length / np.linalg.norm(bone))
    return result


def rest_matrices(joints: np.ndarray, handedness: str) -> np.ndarray:
    """(21, 3) joints of a rest pose -> (21, 4, 4) bone matrices: columns x, y, z, head; any unit."""
    joints = checked_joints(joints[None])[0]
    lengths = np.linalg.norm(joints[1:] - joints[list(PARENTS[1:])], axis=-1)
    if lengths.min() < REST_BONE_MIN * lengths.mean():
        raise JGHandFailure("bad_joints", f"the bone to {NAMES[1 + int(lengths.argmin())]} has no length at rest")
    palm = palm_axes(joints[None], handedness)[0]
    side = -1.0 if handedness == LEFT else 1.0
    # x = y x z points to the index side on a right hand and away from it on a left one
    pad = palm @ (_THUMB_PAD * (side, 1.0, 1.0))
    axes = np.empty((len(NAMES), 3, 3))
    axes[WRIST] = palm
    for place in range(1, len(NAMES)):
        parent = PARENTS[place]
        tail = TAILS[place]
        along = axes[parent][:, 1] if tail < 0 else joints[tail] - joints[place]
        if parent == WRIST:
            axes[place] = _axes_along(along, pad if place in THUMB else palm[:, 2])
        else:
            axes[place] = _smallest_rotation(axes[parent][None], along[None])[0]
    matrices = np.tile(np.eye(4), (len(NAMES), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = axes, joints
    return matrices


def forearm_rest(rest: np.ndarray, handedness: str) -> np.ndarray:
    """(21, 4, 4) rest matrices -> (4, 4) that of the bone from the elbow to the wrist; same space and unit."""
    palm, wrist = rest[WRIST, :3, :3], rest[WRIST, :3, 3]
    side = -1.0 if handedness == LEFT else 1.0
    size = np.linalg.norm(rest[MIDDLE, :3, 3] - wrist) / np.linalg.norm(REST_RIGHT_M[MIDDLE])
    # x of the palm points to the index side on a right hand and away from it on a left one
    way = palm @ (size * np.array(ELBOW_RIGHT_M) * (side, 1.0, 1.0))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = _axes_along(-way, palm[:, 2]), wrist + way
    return matrix


def forearm_rotations(joints: np.ndarray, handedness: str, turns: np.ndarray) -> np.ndarray:
    """How forearms are turned about the wrist from where the palm carries them, in the space of the joints (F, 21, 3):
    (F, 4) quaternions w, x, y, z in the palm's frame, as motion files have them -> (F, 3, 3)."""
    palm = palm_frames(joints, handedness)
    return palm @ _rotations(turns) @ np.swapaxes(palm, -1, -2)


def forearm_turns(joints: np.ndarray, handedness: str, rotations: np.ndarray) -> np.ndarray:
    """The other way round: (F, 3, 3) -> (F, 4)."""
    palm = palm_frames(joints, handedness)
    return _quaternions(np.swapaxes(palm, -1, -2) @ rotations @ palm)


def palm_rotations(joints: np.ndarray, rest: np.ndarray, handedness: str) -> np.ndarray:
    """(F, 21, 3) joints and (21, 4, 4) rest matrices -> (F, 3, 3) how the engine's palm is turned from rest: with the
    knuckles where these arch it, and so another way than the wrist's bone."""
    at_rest = palm_frames(rest[None, :, :3, 3], handedness)
    return palm_frames(joints, handedness) @ np.swapaxes(at_rest, -1, -2)


def palm_frames(joints: np.ndarray, handedness: str) -> np.ndarray:
    """(F, 21, 3) -> (F, 3, 3) the engine's frame of the palm (METHOD 2.7): z along the metacarpals index to pinky, x
    out of the palm; of a left hand the mirror image of a right one's. A frame without a palm, wrist and knuckles on a
    line, takes that of the frame before it; where no frame has one, the axes of their space."""
    mirror = np.array([-1.0 if handedness == LEFT else 1.0, 1.0, 1.0])
    frames, good = _fan_frames(joints * mirror)
    if good.any():
        frames = frames[_last_good(good)]
    return mirror[:, None] * frames


def has_palm(joints: np.ndarray) -> np.ndarray:
    """(F, 21, 3) -> (F,) whether `palm_frames` finds a plane there."""
    return _fan_frames(joints)[1]


def _fan_frames(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F, 3, 3) of the metacarpals' fan, the identity where it has no plane, and where it has one (F,)."""
    fan = joints[:, (INDEX, MIDDLE, RING, PINKY)] - joints[:, WRIST : WRIST + 1]
    axis, area = fan.sum(1), np.cross(fan[:, :-1], fan[:, 1:]).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
        across = area - z * np.sum(z * area, -1, keepdims=True)
        size = np.linalg.norm(across, axis=-1, keepdims=True)
        x = across / size
    good = (size > _PALM_NORMAL_MIN * np.sum(axis * axis, -1, keepdims=True))[:, 0]
    return np.where(good[:, None, None], np.stack([x, np.cross(z, x), z], -1), np.eye(3)), good


def _last_good(good: np.ndarray) -> np.ndarray:
    """(F,) of each frame the last one until then that is good; before the first one that is, that one."""
    return np.maximum.accumulate(np.where(good, np.arange(len(good)), int(np.argmax(good))))


def bone_keys(
    joints: np.ndarray,
    rest: np.ndarray,
    handedness: str,
    forearm: tuple[np.ndarray, np.ndarray] | None = None,
    *,
    still_wrist: bool = False,
) -> BoneKeys:
    """(F, 21, 3) joints and (21, 4, 4) rest matrices, both in the armature's space and unit -> what is keyed.

    The posed bone heads equal the joints for any lengths and any palm. Quaternions keep their sign from frame to
    frame, so that interpolation never takes the long way.
    forearm: (4, 4) rest matrix of the bone that the wrist hangs on, and (F, 4) how forearms are turned, see
    `forearm_rotations`.
    still_wrist: the wrist's bone stays, however the knuckles move, instead of turning with the palm.
    """
    joints = checked_joints(joints)
    rest = np.asarray(rest, np.float64)
    axes = posed_axes(joints, rest, handedness, still_wrist=still_wrist)
    count = len(NAMES) + (forearm is not None)
    location, quaternion = np.empty((len(joints), count, 3)), np.empty((len(joints), count, 4))
    above = np.broadcast_to(np.eye(3), axes[:, WRIST].shape), rest[WRIST, :3, 3]
    if forearm is not None:
        bone, turns = forearm
        turn = forearm_rotations(joints, handedness, turns) @ palm_rotations(joints, rest, handedness)
        head = joints[:, WRIST] + turn @ (bone[:3, 3] - rest[WRIST, :3, 3])
        location[:, -1] = (head - bone[:3, 3]) @ bone[:3, :3]
        quaternion[:, -1] = _continuous(_quaternions(bone[:3, :3].T @ turn @ bone[:3, :3]))
        above = turn, joints[:, WRIST]
    for place, parent in enumerate(PARENTS):
        if parent < 0:
            unposed_axes, unposed_head = above[0] @ rest[place, :3, :3], above[1]
        else:
            turn = axes[:, parent] @ rest[parent, :3, :3].T
            unposed_axes = turn @ rest[place, :3, :3]
            unposed_head = joints[:, parent] + turn @ (rest[place, :3, 3] - rest[parent, :3, 3])
        inverse = np.swapaxes(unposed_axes, -1, -2)
        location[:, place] = np.einsum("fij,fj->fi", inverse, joints[:, place] - unposed_head)
        quaternion[:, place] = _continuous(_quaternions(inverse @ axes[:, place]))
    return BoneKeys(location, quaternion)


def posed_axes(
    joints: np.ndarray,
    rest: np.ndarray,
    handedness: str,
    *,
    still_wrist: bool = False,
    metacarpals: np.ndarray | None = None,
) -> np.ndarray:
    """(F, 21, 3) joints and (21, 4, 4) rest matrices -> (F, 21, 3, 3) axes of the bones in the poses.

    metacarpals: (F, 5, 3, 3) rotations that carry the fingers; None: the wrist's bone does."""
    axes = np.empty((len(joints), len(NAMES), 3, 3))
    axes[:, WRIST] = rest[0, :3, :3]
    if not still_wrist:
        at_rest = palm_axes(rest[None, :, :3, 3], handedness)[0]
        axes[:, WRIST] = palm_axes(joints, handedness) @ (at_rest.T @ rest[0, :3, :3])
    for place in range(1, len(NAMES)):
        parent = PARENTS[place]
        if metacarpals is not None and parent == WRIST:
            carried = metacarpals[:, place // 4] @ rest[place, :3, :3]
        else:
            carried = axes[:, parent] @ (rest[parent, :3, :3].T @ rest[place, :3, :3])
        tail = TAILS[place]
        axes[:, place] = carried if tail < 0 else _smallest_rotation(carried, joints[:, tail] - joints[:, place])
    return axes


def checked_joints(joints: np.ndarray) -> np.ndarray:
    """(F, 21, 3) as float64; JGHandFailure (bad_joints) for another shape, for none, or for numbers that are not."""
    joints = np.asarray(joints)
    if joints.ndim != 3 or joints.shape[1:] != (len(NAMES), 3) or len(joints) == 0:
        raise JGHandFailure("bad_joints", f"wanted frames x 21 joints x 3, got {joints.shape}")
    if joints.dtype.kind not in "fiu" or not np.isfinite(joints).all():
        raise JGHandFailure("bad_joints", "wanted finite numbers, got some that are not")
    return joints.astype(np.float64)


def polar_rotation(linear: np.ndarray) -> np.ndarray:
    """The rotation nearest to a (3, 3) matrix with positive determinant (polar decomposition)."""
    left, _, right = np.linalg.svd(linear)
    return left @ right


def palm_axes(joints: np.ndarray, handedness: str) -> np.ndarray:
    """(F, 21, 3) -> (F, 3, 3) axes of the palm: y to the middle MCP, z out of the palm, x = y x z (on a right hand to
    the index side, on a left one away from it).

    A frame whose palm has no plane (wrist and knuckles on a line) takes the normal of the frame before it.
    """
    index, middle, pinky = (joints[:, place] - joints[:, WRIST] for place in (INDEX, MIDDLE, PINKY))
    normal = np.cross(index, pinky) * (-1.0 if handedness == LEFT else 1.0)
    good = _sine(index, pinky) > PALM_SINE_MIN
    good &= _sine(middle, normal) > PALM_SINE_MIN
    if not good.any():
        raise JGHandFailure("bad_joints", "wrist and knuckles lie on a line in every frame")
    last_good = _last_good(good)
    return _axes_along(middle[last_good], normal[last_good])


def _sine(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(F, 3), (F, 3) -> (F,) sine of the angle between them; 0 where one has no length."""
    size = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.linalg.norm(np.cross(a, b), axis=-1) / np.where(size > 0, size, 1.0)


def _axes_along(along: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """(..., 3), (..., 3) -> (..., 3, 3) with y along the first vector and z as near as possible to the second."""
    y = along / np.linalg.norm(along, axis=-1, keepdims=True)
    z = towards - y * np.sum(y * towards, -1, keepdims=True)
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], -1)


def _smallest_rotation(axes: np.ndarray, along: np.ndarray) -> np.ndarray:
    """(F, 3, 3) turned by the smallest rotation that brings y along (F, 3); about x when that is the opposite way.

    A vector without length leaves the axes as they are.
    """
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    a = axes[..., 1]
    b = np.where(length > 0, along / np.where(length > 0, length, 1.0), a)
    cosine = np.sum(a * b, -1)
    v = np.cross(a, b)
    opposite = cosine < OPPOSITE_COSINE
    k = 1.0 / np.where(opposite, 1.0, 1.0 + cosine)
    turn = cosine[:, None, None] * np.eye(3) + _cross_matrix(v) + k[:, None, None] * v[:, :, None] * v[:, None, :]
    x = axes[..., 0]
    half_turn = 2.0 * x[:, :, None] * x[:, None, :] - np.eye(3)
    turned = np.where(opposite[:, None, None], half_turn, turn) @ axes
    return _axes_along(b, turned[..., 2])  # orthonormal again: nothing drifts along a chain


def _cross_matrix(v: np.ndarray) -> np.ndarray:
    x, y, z = np.moveaxis(v, -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)


def _quaternions(rotations: np.ndarray) -> np.ndarray:
    """(F, 3, 3) -> (F, 4) w, x, y, z; from the largest of the four candidates, so nothing small is divided by."""
    r = rotations
    xx, yy, zz = r[:, 0, 0], r[:, 1, 1], r[:, 2, 2]
    wx, wy, wz = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    xy, xz, yz = r[:, 0, 1] + r[:, 1, 0], r[:, 0, 2] + r[:, 2, 0], r[:, 1, 2] + r[:, 2, 1]
    candidates = np.stack(
        [
            np.stack([1 + xx + yy + zz, wx, wy, wz], -1),
            np.stack([wx, 1 + xx - yy - zz, xy, xz], -1),
            np.stack([wy, xy, 1 - xx + yy - zz, yz], -1),
            np.stack([wz, xz, yz, 1 - xx - yy + zz], -1),
        ],
        1,
    )
    best = np.argmax(np.diagonal(candidates, axis1=1, axis2=2), axis=1)
    chosen = candidates[np.arange(len(r)), best]
    return chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)


def _rotations(quaternions: np.ndarray) -> np.ndarray:
    """(F, 4) unit w, x, y, z -> (F, 3, 3)."""
    w, v = quaternions[:, 0, None, None], quaternions[:, 1:]
    return (2 * w * w - 1) * np.eye(3) + 2 * v[:, :, None] * v[:, None, :] + 2 * w * _cross_matrix(v)


def _continuous(quaternions: np.ndarray) -> np.ndarray:
    """The same rotations with signs such that neighbors in time are near each other; the first has w >= 0."""
    agrees = np.sum(quaternions[1:] * quaternions[:-1], -1) >= 0
    first = 1.0 if quaternions[0, 0] >= 0 else -1.0
    signs = first * np.cumprod(np.concatenate([[1.0], np.where(agrees, 1.0, -1.0)]))
    return quaternions * signs[:, None]
