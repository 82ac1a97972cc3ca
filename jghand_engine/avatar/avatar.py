"""The avatar of one hand: canonical Gaussians and what is needed to pose them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from jghand_engine.avatar.detail import Detail
from jghand_engine.avatar.end_cap import EndCap
from jghand_engine.avatar.learned import Learned
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, PARENTS, Handedness
from jghand_engine.hand.kinematics import NO_FIST, Fist
from jghand_engine.hand.orders import STANDARD_OF_LEVEL
from jghand_engine.hand.skeleton import ScaleMode, Skeleton, Transform
from jghand_engine.hand.wrist import SLICE_COUNT, slice_shares

# radius of a Gaussian, meters
SIGMA_MIN_M = 1e-4
SIGMA_MAX_M = 4e-3
# Gaussians deeper than this, meters, grow in a coarser level of detail only until they are this many of their own
# radii below the skin: further grown they would show as a halo around the hand
DEEP_M = 1e-3
DEEP_RADII = 1.8
# signed distance that d = 0..1 of the UVD coordinates spans, meters (a fixed range: features must not shift)
UVD_RANGE_M = 0.010
# how identifiers of templates with a forearm end, and where that goes from the wrist
FOREARM_SUFFIX, FOREARM_WAY = "-forearm", np.array([0.1751, -0.9778, 0.1149])


@dataclass(frozen=True)
class LearnedFrom:
    """The pictures that an avatar was learned from.

    capture:  its name
    split:    how the others were held out
    pictures: how many
    digest:   of which they are, see `captures.sample.image_digest`
    pixel_m:  size of a pixel where the hand is, meters: two fifths of the pictures have finer ones; 0: not known
    """

    capture: str
    split: str
    pictures: int
    digest: str
    pixel_m: float = 0.0


@dataclass(frozen=True)
class AvatarInfo:
    """What is written beside the arrays of an avatar.

    swing, scale_mode: as `Skeleton` takes them.
    transform: how its bones follow the joints; another than JOINTS is only drawn by what measures ablations.
    pose_statistics: per-angle minimum and maximum of the training poses, radians, by name; empty when nothing was
    trained.
    learned_from: the pictures; None when nothing was trained, or by a JGHand that did not write it down.
    """

    name: str
    template: str
    license: str
    swing: str = "minimal"
    scale_mode: ScaleMode = "axial"
    transform: Transform = Transform.JOINTS
    pose_statistics: dict[str, tuple[float, float]] = field(default_factory=dict)
    learned_from: LearnedFrom | None = None


@dataclass(frozen=True)
class HandAvatar:
    """Canonical Gaussians of a hand. All arrays describe a *right* hand in the template's frame; a left hand is the
    same model with mirrored joints, so `handedness` says only which hand the joints given to it are of.

    info:                 names, license, conventions
    handedness:           which hand the driving joints belong to
    canonical_joints_m:   (21, 3) float64, level order, meters
    position_m:           (N, 3) float32, canonical centers, meters
    sigma_m:              (N,)   float32, canonical radii, meters
    opacity:              (N,)   float32, 0..1
    rgb:                  (N, 3) float32, display-referred sRGB 0..1; of a trained avatar without its light
    bone_weights:         (N, 21) float32, rows sum to 1, column i = B_i
    uvd:                  (N, 3) float32, texture coordinates and normalized signed distance, 0..1
    learned:              what training adds; None for a painted avatar
    detail:               the texture of what the Gaussians cannot hold; None for none
    own_joints_m:         (21, 3) float64, level order, meters: of the right hand that it stands for, at rest, where
                          its bones are not as long as the canonical hand's; None where they are
    fist:                 how its fingers touch one another and the palm in named poses; `learn.fist` finds it
    cap:                  what closes it where it ends, of one that is shown; None for nothing. No file has one
    """

    info: AvatarInfo
    handedness: Handedness
    canonical_joints_m: np.ndarray
    position_m: np.ndarray
    sigma_m: np.ndarray
    opacity: np.ndarray
    rgb: np.ndarray
    bone_weights: np.ndarray
    uvd: np.ndarray
    learned: Learned | None = None
    detail: Detail | None = None
    own_joints_m: np.ndarray | None = None
    fist: Fist = NO_FIST
    cap: EndCap | None = None

    def __len__(self) -> int:
        return self.position_m.shape[0]

    @property
    def rest_joints_m(self) -> np.ndarray:
        """(21, 3) of a right hand that nobody drives yet: what poses are made from."""
        return self.canonical_joints_m if self.own_joints_m is None else self.own_joints_m

    @property
    def canonical_angles_rad(self) -> np.ndarray:
        """(37,) of the canonical hand, see `Bones`."""
        return self.for_hand(Handedness.RIGHT).skeleton().bones(self.canonical_joints_m).angles_rad

    @property
    def pixel_m(self) -> float:
        """Of the pictures that it was learned from, see `LearnedFrom`; 0: not known."""
        return 0.0 if self.info.learned_from is None else self.info.learned_from.pixel_m

    def for_hand(self, handedness: Handedness) -> HandAvatar:
        """The same avatar, driven by joints of the named hand."""
        return replace(self, handedness=Handedness(handedness))

    @property
    def has_forearm(self) -> bool:
        """Whether it was learned with one."""
        return forearm_way(self.info.template) is not None

    @property
    def map_count(self) -> int:
        """How many maps move its skin: those of 21 bones, and of the slices of a forearm."""
        return JOINT_COUNT + SLICE_COUNT * self.has_forearm

    def map_weights(self, position_m: np.ndarray, bone_weights: np.ndarray) -> np.ndarray:
        """(N, map_count) weights of all maps, see `Bones.linear_offset`, of canonical places (N, 3) with weights of
        bones (N, 21): slices take their shares of what follows the palm."""
        if not self.has_forearm:
            return bone_weights
        return with_slices(position_m, bone_weights, self.canonical_joints_m[0])

    def with_stiff_wrist(self) -> HandAvatar:
        """The same, whose forearm goes with the palm."""
        return replace(self, info=replace(self.info, template=self.info.template.removesuffix(FOREARM_SUFFIX)))

    def skeleton(self, variant: str = "auto") -> Skeleton:
        """What moves its bones with the joints; variant: of the native library. InputError for an avatar that follows
        them in another way."""
        check_follows_joints(self)
        info = self.info
        return Skeleton(
            self.canonical_joints_m,
            handedness=self.handedness,
            swing=info.swing,
            scale_mode=info.scale_mode,
            variant=variant,
            forearm_way=forearm_way(info.template),
        )

    def prefix(self, count: int) -> HandAvatar:
        """The first `count` Gaussians: a level of detail, since they are in farthest-point order.

        Those that are left grow by `sigma_scale_for_prefix`, so that the skin stays closed.
        """
        if count <= 0 or count >= len(self):
            return self
        cap = slice(0, 0) if self.cap is None else self.cap.rows
        size = cap.stop - cap.start
        # those of a cap are there besides
        before, after = min(count, cap.start), max(count - cap.start, 0)
        numbers = np.arange(len(self))
        which = np.concatenate([numbers[:before], numbers[cap], numbers[cap.stop :][:after]])
        shorter, scale = self.rows(which), sigma_scale_for_prefix(count, len(self) - size)
        sigma_m, own = grown_radii(shorter.sigma_m, scale, shorter.uvd[:, 2]), slice(before, before + size)
        sigma_m[own] = shorter.sigma_m[own]
        kept = None if self.cap is None else replace(self.cap, rows=own)
        return replace(shorter, sigma_m=sigma_m, cap=kept)

    def rows(self, which: np.ndarray | slice) -> HandAvatar:
        """The same with these of its Gaussians, by their numbers, in this order."""
        arrays = ("position_m", "sigma_m", "opacity", "rgb", "bone_weights", "uvd")
        learned = None if self.learned is None else self.learned.rows(which)
        return replace(self, learned=learned, **{name: getattr(self, name)[which] for name in arrays})


def forearm_way(template: str) -> np.ndarray | None:
    """(3,) from the wrist along the forearm of a template by its identifier; None for one without."""
    return FOREARM_WAY if template.endswith(FOREARM_SUFFIX) else None


def with_slices(position_m: np.ndarray, bone_weights: np.ndarray, root_m: np.ndarray) -> np.ndarray:
    """(N, 21 + SLICE_COUNT) `HandAvatar.map_weights` of a hand with a forearm, whose wrist is at root_m (3,)."""
    shares = slice_shares((position_m - root_m) @ FOREARM_WAY)
    return np.concatenate([bone_weights, (bone_weights[:, :1] * shares).astype(bone_weights.dtype)], 1)


def check_follows_joints(avatar: HandAvatar) -> None:
    """InputError for an avatar that learned to follow the joints in another way than the renderer moves it."""
    if avatar.info.transform is not Transform.JOINTS:
        raise InputError(
            f"avatar {avatar.info.name}: transform from joints to bones",
            wanted=Transform.JOINTS,
            came=avatar.info.transform,
            remedy="It was trained to be compared, for `jghand ablate`, which draws it. Take the variant `full`.",
        )


def sigma_scale_for_prefix(count: int, total: int) -> float:
    """How much the radii of the first `count` of `total` Gaussians grow: as their distance on a surface does."""
    return math.sqrt(total / count) if 0 < count < total else 1.0


def grown_radii(sigma_m: np.ndarray, scale: float, uvd_depth: np.ndarray) -> np.ndarray:
    """Radii (N,) times `scale`, but what lies deep under the skin does not grow through it: it would show as a halo.

    sigma_m: meters · uvd_depth: (N,) the third of the UVD coordinates. A scale of 1 changes no bit.
    """
    if scale == 1.0:
        return sigma_m
    depth_m = (0.5 - uvd_depth) * (2 * UVD_RANGE_M)
    limit_m = np.where(depth_m > DEEP_M, depth_m / DEEP_RADII, np.inf)
    grown = np.minimum(np.maximum(sigma_m, np.minimum(sigma_m * scale, limit_m)), SIGMA_MAX_M)
    return grown.astype(sigma_m.dtype)


# level order: the bones from the wrist to the knuckles
_PALM = slice(1, 6)


def bone_numbers(avatar: HandAvatar) -> np.ndarray:
    """(N,) uint8, 1..20: the bone that moves a Gaussian most, by the number of the joint at which it ends, in the
    standard order.

    What moves with the palm as a whole (B_0, METHOD 2.6) belongs to the nearest of the five bones of the palm.
    """
    weights = avatar.bone_weights
    bone = weights.argmax(1)
    palm = bone == 0
    bone[palm] = 1 + _palm_distances(avatar, palm).argmin(1)
    return STANDARD_OF_LEVEL[bone].astype(np.uint8)


def _palm_distances(avatar: HandAvatar, rows: np.ndarray) -> np.ndarray:
    """(M, 5) squared distances of the canonical centers of these rows from the bones of the palm."""
    points = avatar.position_m[rows].astype(np.float64)[:, None]
    joints = avatar.canonical_joints_m
    start, end = joints[list(PARENTS[_PALM])], joints[_PALM]
    along = ((points - start) * (end - start)).sum(-1) / np.square(end - start).sum(-1)
    nearest = start + along.clip(0, 1)[..., None] * (end - start)
    return np.square(points - nearest).sum(-1)
