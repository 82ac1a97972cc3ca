"""The bone transforms of a single hand in microseconds: the same as JointTransform, computed by the native library.

In torch one hand takes over a millisecond, because each of some hundred small operations has a fixed cost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from jghand_engine import limits
from jghand_engine.errors import InputError, RetryError
from jghand_engine.hand.frames import CanonicalHand, FrameFlag, Swing
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import check_joint_shape
from jghand_engine.hand.transform import JointTransform, ScaleMode
from jghand_engine.native import library

# flexion and abduction of 15 bones, 4 angles between palm bones and 3 between palm planes
ANGLES = 37


@dataclass(frozen=True)
class FastBones:
    """The bone transforms of one hand.

    linear_offset: (21, 3, 4) float32, x_posed_m - root_m = linear_offset @ [x_m - canonical_root_m, 1]
    root_m: (3,) float64 · scale: of the whole hand, s_g · flags: bits of FrameFlag
    angles_rad: (37,) float64, flexion and abduction of bones 6..20, then palm_p and palm_n of `HandFrames`
    """

    linear_offset: np.ndarray
    root_m: np.ndarray
    scale: float
    flags: int
    angles_rad: np.ndarray


class FastTransform:
    """Like JointTransform, for one hand at a time, numpy in and out, no gradients.

    canonical_joints_m: (21, 3) numpy or torch, level order, right hand, meters; the other arguments as for
    JointTransform. variant: which native library ('auto', 'torch' for none: then JointTransform computes).
    """

    def __init__(
        self,
        canonical_joints_m: np.ndarray | torch.Tensor,
        *,
        handedness: Handedness,
        swing: str = Swing.MINIMAL,
        scale_mode: ScaleMode = "axial",
        variant: str = "auto",
    ) -> None:
        self._reference = JointTransform(canonical_joints_m, handedness=handedness, swing=swing, scale_mode=scale_mode)
        self.canonical_root_m = self._reference.canonical.root_m.numpy()
        native = None if variant == "torch" else library.load(variant)
        self._call = native.call.jg_bone_transforms if native else None
        self._skeleton = packed_skeleton(self._reference)
        if native and (size := native.call.jg_skeleton_bytes()) != self._skeleton.nbytes:
            wanted = f"a Skeleton of {self._skeleton.nbytes} bytes"
            raise RetryError(f"native library {native.path.name}", wanted=wanted, came=str(size))
        self._skeleton_address = self._skeleton.ctypes.data

    def bones(self, joints_m: np.ndarray) -> FastBones:
        """(21, 3) level-order joints, meters -> FastBones. NaN matrices and NOT_FINITE for a joint that is not finite.

        InputError for another shape.
        """
        bones = self.bones64(joints_m)
        # a hand too large for float32 becomes infinite without a word: the kernels cull it
        with np.errstate(over="ignore"):
            return replace(bones, linear_offset=bones.linear_offset.astype(np.float32))

    def bones64(self, joints_m: np.ndarray) -> FastBones:
        """The same with matrices before rounding, float64."""
        joints = np.ascontiguousarray(joints_m, dtype=np.float64)
        if joints.shape != (JOINT_COUNT, 3):
            check_joint_shape(joints)
            raise InputError("joints of one hand", wanted="shape (21, 3)", came=str(joints.shape))
        root = joints[0].copy()
        if self._call is None:
            bones = self._reference.bones(torch.from_numpy(joints))
            matrices = torch.cat([bones.linear, bones.offset_m.unsqueeze(-1)], -1)
            frames = bones.frames
            angles = torch.cat([frames.angles.flatten(), frames.palm_p, frames.palm_n])
            if frames.flags & FrameFlag.NOT_FINITE:
                angles = torch.full_like(angles, torch.nan)
            return FastBones(matrices.numpy(), root, float(bones.scale), int(frames.flags), angles.numpy())
        matrices, scale, angles = np.empty((JOINT_COUNT, 3, 4)), np.empty(1), np.empty(ANGLES)
        outputs = (array.ctypes.data for array in (matrices, scale, angles))
        flags = self._call(self._skeleton_address, joints.ctypes.data, *outputs)
        return FastBones(matrices, root, float(scale[0]), flags, angles)


def packed_skeleton(transform: JointTransform) -> np.ndarray:
    """The doubles of `Skeleton` in native/skeleton.cpp, in its order; matrices column by column."""
    hand = transform.canonical
    options = [
        limits.ZERO_BONE_EPS * np.finfo(np.float64).eps,
        limits.PALM_CLAMP,
        limits.SWING_POLE,
        limits.FLEXION_AXIS_MIN,
        limits.PALM_NORMAL_MIN,
        limits.PALM_PLANE_MIN,
        limits.SCALE_RATIO_MIN,
        float(np.finfo(np.float64).tiny) ** 0.25,
        transform.exponent,
        float(transform.swing is Swing.EULER),
        -1.0 if transform.handedness is Handedness.LEFT else 1.0,
    ]
    parts = [np.array(options), *map(_vectors_or_matrices, _fields(hand))]
    return np.ascontiguousarray(np.concatenate([part.ravel() for part in parts]))


def _fields(hand: CanonicalHand) -> list[torch.Tensor]:
    return [
        hand.joints_m,
        hand.length_m,
        hand.direction,
        hand.S,
        hand.S0,
        hand.u,
        hand.swing,
        hand.palm_normal,
        hand.palm_flip,
        hand.metacarpal_flip,
        hand.swing_flip,
    ]


def _vectors_or_matrices(tensor: torch.Tensor) -> np.ndarray:
    """Component first and batch last -> one vector or one matrix (columns one after the other) per bone."""
    order = list(range(tensor.dim()))[::-1]
    return tensor.permute(order)[0].numpy()
