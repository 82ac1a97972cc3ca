"""From 21 joint positions to the 21 affine maps that carry the canonical hand onto them, and to the joint angles.

    B_i(x) = j_p(i) + L_i (x - j^c_p(i))
    L_i    = r_i (A_i - (A_i d_i^c) d_i^cT) + s_i d_i d_i^cT,      A_i = S_i(J) S_i(J^c)^T

Both ends of every bone map exactly, for any joints; only the twist about the bone and the radial scale r_i are
conventions. B_0 is a similarity of the palm frame. The native kernel (native/skeleton.cpp) computes a pose; here is
what it needs to know of the canonical hand. The differentiable form is `learn.skeleton`. METHOD 2.4 to 2.10.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntFlag, StrEnum
from functools import cache

import numpy as np

from jghand_engine.errors import InputError, RetryError
from jghand_engine.hand.canonical import PALM_CLAMP, CanonicalHand
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import check_joint_shape
from jghand_engine.hand.rotations import half_turns
from jghand_engine.hand.wrist import Wrist
from jghand_engine.native import library

# ---- thresholds of the transform, relative to the hand's size unless a unit is given ----
# multiple of machine epsilon below which a bone has no direction
ZERO_BONE_EPS = 32.0
# weight of the canonical palm plane, carried by the palm, against the sine between two palm bones: what two short or
# nearly parallel bones say of their plane is mostly the error of their joints. A canonical palm has sines from 0.22 on
PALM_PRIOR = 0.2
# distance (radians, nearly) to a pole of the swing inside which the fallback acts, and euler raises its flag
SWING_POLE = 1e-3
# cosine to the canonical direction below which the minimal swing turns towards flexion (110 degrees; real poses stay
# within 107), and how much at the opposite of that direction: this puts its poles some 142 degrees to either side
SWING_TURN_COSINE = -0.342
SWING_TURN = 0.25
# distance to those poles, radians, inside which a flag is raised: half a millimeter moves skin over 2 mm there
SWING_POLE_NEAR = math.radians(25.0)
# where the angle of a flexion jumps by a whole turn, radians: opposite the middle of what joints can do, -30 to 130
# degrees, so that a joint folded back to 180 has the same angle in every precision
FLEXION_CUT = math.radians(-135.0)
# |z x n| below which a metacarpal takes its flexion axis from the canonical hand
FLEXION_AXIS_MIN = 1e-3
# part of the palm's area vector perpendicular to the palm axis below which there is no palm normal
PALM_NORMAL_MIN = 1e-4
# floor of s_i / s_g inside the power of the blended scale: its gradient is infinite at a zero bone
SCALE_RATIO_MIN = 1e-2

# flexion and abduction of 15 bones, 4 angles between palm bones and 3 between palm planes
ANGLE_COUNT = 37


class Swing(StrEnum):
    """How the twist of a phalanx follows from its direction. An avatar keeps the swing it was trained with.

    MINIMAL: smallest rotation from the canonical direction, and where a bone folds back on itself flexion instead; two
    poles, backwards and sideways, far from real poses. EULER: flexion, then abduction, as in the paper; poles at
    abduction +-90 degrees, which thumbs approach.
    """

    MINIMAL = "minimal"
    EULER = "euler"

    @classmethod
    def _missing_(cls, value: object) -> Swing:
        raise InputError("swing", wanted=" or ".join(cls), came=repr(value)[:200])


# a named mode or the exponent of the blended one
ScaleMode = str | float
_SCALE_EXPONENTS = {"axial": 0.0, "uniform": 1.0}


def scale_exponent(scale_mode: ScaleMode) -> float:
    """The exponent alpha of r_i = s_g (s_i / s_g)^alpha: 'axial' 0 (thickness follows the whole hand), 'uniform' 1
    (thickness follows each bone), or a number between. InputError otherwise."""
    if isinstance(scale_mode, str) and scale_mode in _SCALE_EXPONENTS:
        return _SCALE_EXPONENTS[scale_mode]
    if isinstance(scale_mode, int | float) and not isinstance(scale_mode, bool) and 0 <= scale_mode <= 1:
        return float(scale_mode)
    raise InputError("scale mode", wanted="'axial', 'uniform' or a number from 0 to 1", came=repr(scale_mode)[:200])


class Transform(StrEnum):
    """From joints to bones: ours, or that of the ablation "w/o trans" (`learn.baselines`), which is only compared."""

    JOINTS = "joints"
    HALO_LIKE = "halo-like"


class FrameFlag(IntFlag):
    """Where a hand left the ordinary; joints stay exact except for NOT_FINITE."""

    NONE = 0
    ZERO_BONE = 1
    PALM_CLAMPED = 2
    SWING_POLE = 4
    NO_PALM = 8
    NOT_FINITE = 16


_FLAG_SENTENCES = {
    FrameFlag.ZERO_BONE: "a bone has no length",
    FrameFlag.PALM_CLAMPED: "palm bones are collinear or crossed",
    FrameFlag.SWING_POLE: "a finger is bent so far back or sideways that its twist is uncertain",
    FrameFlag.NO_PALM: "the palm has no plane",
    FrameFlag.NOT_FINITE: "a joint is not a finite number",
}


def describe_flags(flags: int) -> list[str]:
    """Sentences for the bits of `flags`."""
    return [sentence for flag, sentence in _FLAG_SENTENCES.items() if flags & flag] if flags else []


@dataclass(frozen=True)
class Bones:
    """The bones of one posed hand.

    linear_offset: (21, 3, 4), x_posed_m - root_m = linear_offset @ [x_m - canonical_root_m, 1]; behind them, of a hand
                   with a forearm, the changes of its slices, see `Wrist`
    root_m:        (3,) float64, the wrist; added last, so that a hand far from the origin loses nothing before
    scale:         of the whole hand against the canonical one, s_g
    flags:         bits of FrameFlag
    angles_rad:    (37,) float64: flexion and abduction of bones 6..20, then 4 angles between neighboring palm bones
                   and 3 between neighboring palm planes
    """

    linear_offset: np.ndarray
    root_m: np.ndarray
    scale: float
    flags: int
    angles_rad: np.ndarray

    @property
    def maps(self) -> np.ndarray:
        """(21, 3, 4) as `linear_offset`, and behind them those of slices."""
        palm, changes = self.linear_offset[:1], self.linear_offset[JOINT_COUNT:]
        return (
            np.concatenate([self.linear_offset[:JOINT_COUNT], palm + changes]) if len(changes) else self.linear_offset
        )

    @property
    def phalanx_angles_rad(self) -> np.ndarray:
        """(15, 2) flexion and abduction of bones 6..20."""
        return self.angles_rad[:30].reshape(15, 2)


class Skeleton:
    """Computes Bones from joints against one canonical right hand, in microseconds, without gradients.

    canonical_joints_m: (21, 3) level order, right hand, meters
    handedness:         of the joints that `bones` will get; left ones are mirrored, the canonical hand stays right
    swing:              'minimal' or 'euler', see Swing
    scale_mode:         'axial', 'uniform' or the exponent between, see scale_exponent
    variant:            which native library; 'auto' is the fastest that runs here
    forearm_way:        (3,) of the canonical hand, from the wrist along its forearm; None for a hand without one
    InputError for an unusable canonical hand or an unknown option, RetryError without a native library.
    """

    def __init__(
        self,
        canonical_joints_m: np.ndarray,
        *,
        handedness: Handedness,
        swing: str = Swing.MINIMAL,
        scale_mode: ScaleMode = "axial",
        variant: str = "auto",
        forearm_way: np.ndarray | None = None,
    ) -> None:
        self.handedness = Handedness(handedness)
        self.canonical = CanonicalHand.build(canonical_joints_m)
        self._wrist = None if forearm_way is None else Wrist(self.canonical.frames[0], forearm_way)
        self.packed = _packed(self.canonical, self.handedness, Swing(swing), scale_exponent(scale_mode))
        native = library.load(variant) or library.load(library.best_variant() or "auto")
        if native is None:
            raise RetryError("native kernels", wanted="a library for this processor", came="none")
        if (size := native.call.jg_skeleton_bytes()) != self.packed.nbytes:
            wanted = f"a Skeleton of {self.packed.nbytes} bytes"
            raise RetryError(f"native library {native.path.name}", wanted=wanted, came=str(size))
        self._call = native.call.jg_bone_transforms
        self._address = self.packed.ctypes.data

    @property
    def canonical_root_m(self) -> np.ndarray:
        """(3,) wrist of the canonical hand, meters."""
        return self.canonical.root_m

    def bones(
        self, joints_m: np.ndarray, dtype: type[np.floating] = np.float32, *, forearm: np.ndarray | None = None
    ) -> Bones:
        """(21, 3) level-order joints, meters -> Bones. NaN matrices and NOT_FINITE for a joint that is not finite.

        dtype: of the matrices, which are computed in double · forearm: (4,) its turn, see `HandPose`; of a hand without
        one it counts for nothing. InputError for another shape.
        """
        joints = np.ascontiguousarray(joints_m, dtype=np.float64)
        if joints.shape != (JOINT_COUNT, 3):
            check_joint_shape(joints)
            raise InputError("joints of one hand", wanted="shape (21, 3)", came=str(joints.shape))
        matrices, scale, angles = np.empty((JOINT_COUNT, 3, 4)), np.empty(1), np.empty(ANGLE_COUNT)
        outputs = (array.ctypes.data for array in (matrices, scale, angles))
        flags = self._call(self._address, joints.ctypes.data, *outputs)
        if self._wrist is not None:
            matrices = np.concatenate([matrices, self._wrist.changes(matrices[0], forearm)])
        # a hand too large for float32 becomes infinite without a word: the kernels cull it
        with np.errstate(over="ignore"):
            return Bones(matrices.astype(dtype, copy=False), joints[0].copy(), float(scale[0]), flags, angles)

    def frames(self, bones: Bones) -> tuple[np.ndarray, np.ndarray]:
        """The frames (21, 3, 3) of the palm and of bones 1..20 in one pose, and their scales (21, 3) along x, y and z;
        behind them those of a forearm's slices, which are turned palms.

        Columns x out of the palm, y the flexion axis, z along the bone, in right-hand space: those of a left hand are
        its mirror image's. L_i = S_i diag(scales) S_i^cT. A bone whose length and thickness both vanish has the frame
        in which the palm carries it.
        """
        linear = bones.maps[..., :3].astype(np.float64)
        own = self.canonical.frames
        own = np.concatenate([own, own[:1].repeat(len(linear) - len(own), 0)])
        if self.handedness is Handedness.LEFT:
            linear = np.array([-1.0, 1.0, 1.0])[:, None] * linear
        scaled = linear @ own
        scales = np.linalg.norm(scaled, axis=-2)
        palm = scaled[0] / scales[0] if scales[0].all() else own[0]
        carried = palm @ own[0].T @ own
        axes = np.where(scales[:, None] > 0, scaled / np.where(scales > 0, scales, 1.0)[:, None], carried)
        x, y, z = np.moveaxis(axes, -1, 0)
        # a bone without a length has lost its direction alone
        z = np.where((scales[:, :2] > 0).all(axis=1, keepdims=True), np.cross(x, y), z)
        return np.stack([x, y, z], axis=-1), scales


@cache
def swing_pole() -> tuple[float, float]:
    """Where the minimal swing has its poles, as (|y|, z) in the canonical bone's frame: there z the twist that leads
    back to flexion, SWING_TURN h(z)^2, is as large as the square of the stereographic radius, (1 + z) / (1 - z)."""
    low, z, high = -1.0, SWING_TURN_COSINE, SWING_TURN_COSINE
    for _ in range(60):
        turn = SWING_TURN * ((SWING_TURN_COSINE - z) / (SWING_TURN_COSINE + 1)) ** 2
        low, high = (low, z) if turn * (1 - z) < 1 + z else (z, high)
        z = (low + high) / 2
    return math.sqrt(1 - z * z), z


def _packed(hand: CanonicalHand, handedness: Handedness, swing: Swing, exponent: float) -> np.ndarray:
    """The doubles of `Skeleton` in native/skeleton.cpp, in its order; matrices column by column.

    Its last matrices are the half turns that replace a minimal rotation at its pole: of the palm and the metacarpals.
    """
    options = [
        ZERO_BONE_EPS * np.finfo(np.float64).eps,
        PALM_CLAMP,
        PALM_PRIOR,
        SWING_POLE,
        SWING_TURN_COSINE,
        SWING_TURN,
        *swing_pole(),
        math.cos(SWING_POLE_NEAR),
        FLEXION_CUT,
        FLEXION_AXIS_MIN,
        PALM_NORMAL_MIN,
        SCALE_RATIO_MIN,
        # floor of the hand's size, which everything is divided by: its fourth power is still a normal number
        float(np.finfo(np.float64).tiny) ** 0.25,
        exponent,
        float(swing is Swing.EULER),
        -1.0 if handedness is Handedness.LEFT else 1.0,
    ]
    matrices = [hand.frames[1:], hand.frames[0]]
    flips = [half_turns(axis) for axis in (hand.frames[0, :, 0], hand.frames[1:6, :, 0])]
    vectors = [np.array(options), hand.joints_m, hand.length_m, hand.direction]
    parts = [*vectors, *map(_columns, matrices), hand.u, _columns(hand.swing), hand.palm_normal, *map(_columns, flips)]
    return np.concatenate([part.ravel() for part in parts])


def _columns(matrices: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrices, -1, -2)
