"""A motion as joint positions over time, and the repairs that real motions need. Knows no files.

Estimated motions have two defects that would show in the picture: frames in which joints are missing, and bone
lengths that wobble by millimeters, which makes the hand pulse. `with_gaps_held` and `with_constant_bone_lengths`
remove them; both say what they do, neither invents motion.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, LEVEL_NAMES, PARENTS, Handedness
from jghand_engine.hand.orders import bone_lengths, check_joint_shape
from jghand_engine.hand.rotations import quaternions, slerp, slerp_rotation, turns_between
from jghand_engine.hand.skeleton import PALM_NORMAL_MIN, ZERO_BONE_EPS
from jghand_engine.hand.wrist import NO_TURN, unit_turns

# frames per second of a motion: outside this range it is most likely a frame count or milliseconds
FPS_MIN = 0.1
FPS_MAX = 10_000.0
# part of a frame by which a time may miss it and still be that frame: round-off of clocks in text
FRAME_EPS = 1e-6
# more frames than this are a mistake of a file or of its clock: two hours at 120 per second
MOTION_FRAMES_MAX = 1_000_000
# poses that are taken between frames at once: 4096 with all that is on the way have 60 MB
POSES_AT_ONCE = 4096


@dataclass(frozen=True)
class GapReport:
    """Which frames miss joints. frames: their numbers · joints: name -> number of frames in which it is missing ·
    longest: longest run of frames with a gap · frame_count: of the whole sequence."""

    frames: tuple[int, ...]
    joints: dict[str, int]
    longest: int
    frame_count: int

    def __bool__(self) -> bool:
        return bool(self.frames)

    def sentence(self) -> str:
        """One line for people; '' without gaps."""
        if not self:
            return ""
        shown = ", ".join(str(frame) for frame in self.frames[:5]) + (", …" if len(self.frames) > 5 else "")
        worst = sorted(self.joints, key=lambda name: -self.joints[name])
        names = ", ".join(worst[:5]) + (", …" if len(worst) > 5 else "")
        return (
            f"{len(self.frames)} of {self.frame_count} frames miss joints (frames {shown}; joints {names}; "
            f"longest gap {self.longest})"
        )


@dataclass(frozen=True)
class HandPose:
    """One hand at one moment.

    joints_m: (21, 3) level order, meters
    forearm:  (4,) quaternion w, x, y, z by which its forearm is turned about the wrist from where the palm would carry
              it, in the palm's frame (METHOD 2.7: x out of the palm, y to the index finger, z to the fingers) of the
              right hand that a left one mirrors: the same however the hand lies. None: as the palm carries it
    """

    joints_m: np.ndarray
    forearm: np.ndarray | None = None

    @classmethod
    def of(cls, hand: np.ndarray | HandPose) -> HandPose:
        return hand if isinstance(hand, HandPose) else cls(hand)

    def between(self, other: HandPose, part: float) -> HandPose:
        """At `part`, 0..1, of the way to another one, see `pose_between`."""
        forearm = None
        if self.forearm is not None or other.forearm is not None:
            here, there = (NO_TURN if turn is None else turn for turn in (self.forearm, other.forearm))
            forearm = turns_between(here, there, np.array(part))
        return HandPose(pose_between(self.joints_m, other.joints_m, part), forearm)


@dataclass(frozen=True)
class PoseSequence:
    """One hand over time.

    joints_m: (F, 21, 3) float64, level order, meters; NaN where not valid
    fps:      frames per second
    handedness: which hand it is
    valid:    (F, 21) bool; default: where the joint is finite
    filled:   (F,) bool, frames whose joints nobody measured: a gap was closed there; default: none
    forearm:  (F, 4) how the forearm is turned, see `HandPose`; None: as the palm carries it
    InputError for another shape (20 or 42 joints are named), no frame, or an impossible fps.
    """

    joints_m: np.ndarray
    fps: float
    handedness: Handedness
    valid: np.ndarray = None  # type: ignore[assignment]
    filled: np.ndarray = None  # type: ignore[assignment]
    forearm: np.ndarray | None = None

    def __post_init__(self) -> None:
        joints = _as_joints(self.joints_m)
        fps = float(self.fps)
        if not (np.isfinite(fps) and FPS_MIN <= fps <= FPS_MAX):
            raise InputError("frames per second", wanted=f"{FPS_MIN:g} to {FPS_MAX:g}", came=f"{self.fps}")
        finite = np.isfinite(joints).all(axis=-1)
        valid = finite if self.valid is None else np.asarray(self.valid, dtype=bool)
        if valid.shape != joints.shape[:2]:
            raise InputError("valid joints of a motion", wanted=f"shape {joints.shape[:2]}", came=str(valid.shape))
        valid = valid & finite
        joints[~valid] = np.nan
        filled = np.zeros(len(joints), dtype=bool) if self.filled is None else np.array(self.filled, dtype=bool)
        if filled.shape != (len(joints),):
            raise InputError("filled frames of a motion", wanted=f"shape ({len(joints)},)", came=str(filled.shape))
        forearm = None if self.forearm is None else unit_turns(self.forearm)
        if forearm is not None and forearm.shape != (len(joints), 4):
            raise InputError("forearm of a motion", wanted=f"shape ({len(joints)}, 4)", came=str(forearm.shape))
        own = {"joints_m": joints, "fps": fps, "valid": valid, "filled": filled, "forearm": forearm}
        for name, value in own.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "handedness", Handedness(self.handedness))

    def __len__(self) -> int:
        return len(self.joints_m)

    @property
    def poses(self) -> list[HandPose]:
        """One for each frame."""
        return [self.pose(frame) for frame in range(len(self))]

    def pose(self, frame: int) -> HandPose:
        """The hand in a frame."""
        return HandPose(self.joints_m[frame], None if self.forearm is None else self.forearm[frame])

    @property
    def duration_s(self) -> float:
        """Seconds from the first frame to the last."""
        return (len(self) - 1) / self.fps

    @property
    def bone_lengths_m(self) -> np.ndarray:
        """(F, 20) lengths of bones 1..20; NaN where an end is missing."""
        return bone_lengths(self.joints_m)

    @property
    def gaps(self) -> GapReport:
        """Which joints are missing in which frames."""
        missing = ~self.valid
        bad = missing.any(axis=1)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], bad.astype(np.int8), [0]])))
        runs = edges[1::2] - edges[0::2]
        counts = missing.sum(axis=0)
        names = {LEVEL_NAMES[joint]: int(counts[joint]) for joint in np.flatnonzero(counts)}
        return GapReport(tuple(np.flatnonzero(bad).tolist()), names, int(runs.max(initial=0)), len(self))

    def with_gaps_held(self) -> PoseSequence:
        """Every frame that misses a joint repeats the last whole pose (before the first one, the first).

        They count as `filled`. The report of what was held is `gaps` of the sequence before. InputError when no frame
        is whole.
        """
        whole = self.valid.all(axis=1)
        if not whole.any():
            names = ", ".join(sorted(self.gaps.joints))
            raise InputError(
                "motion", wanted="at least one frame with all 21 joints", came="none", remedy=f"Missing: {names}."
            )
        source = np.maximum.accumulate(np.where(whole, np.arange(len(self)), -1))
        source[source < 0] = int(np.argmax(whole))
        held = self._with(self.joints_m[source])
        forearm = None if self.forearm is None else self.forearm[source]
        return dataclasses.replace(held, filled=self.filled[source] | ~whole, forearm=forearm)

    def without_gaps(self) -> PoseSequence:
        """The sequence itself; InputError with frames and joints when a joint is missing anywhere."""
        if self.gaps:
            raise InputError(
                "motion",
                wanted="all 21 joints in every frame",
                came=self.gaps.sentence(),
                remedy="Repair the motion, or let gaps hold the last whole pose.",
            )
        return self

    def with_constant_bone_lengths(self) -> PoseSequence:
        """The same directions of every bone, each with its median length over the frames.

        The joints are rebuilt from the wrist outwards. A bone without length points where it pointed in the frame
        before. Frames with gaps keep them: hold them first if they shall not stay.
        """
        measured = self.bone_lengths_m
        known = np.isfinite(measured).any(axis=0)
        if not known.all():
            name = LEVEL_NAMES[int(np.argmin(known)) + 1]
            raise InputError("motion", wanted="every bone in at least one frame", came=f"none with {name}")
        lengths_m = np.nanmedian(measured, axis=0)
        return self._with(rebuilt(self.joints_m[:, 0], bone_directions(self.joints_m), lengths_m))

    def resampled(self, fps: float) -> PoseSequence:
        """The same motion at another rate: bones keep their lengths while their directions turn between frames.

        Frames between a missing joint and a whole one miss it too. The first frame stays the first; the last one is
        the last that the new rate reaches. InputError for more than MOTION_FRAMES_MAX frames.
        """
        if not (np.isfinite(fps) and FPS_MIN <= fps <= FPS_MAX):
            raise InputError("frames per second", wanted=f"{FPS_MIN:g} to {FPS_MAX:g}", came=f"{fps}")
        count = self.duration_s * fps
        if count >= MOTION_FRAMES_MAX:
            wanted = f"at most {MOTION_FRAMES_MAX} frames"
            raise InputError("motion at another rate", wanted=wanted, came=f"{count:.0f} at {fps:g} per second")
        # the small addition keeps the last frame when its time is reached but for round-off
        places = np.arange(int(count + FRAME_EPS) + 1) * (self.fps / fps)
        joints = poses_at(self.joints_m, places)
        before, after, part = _neighbors(places, len(self))
        forearm = None if self.forearm is None else turns_between(self.forearm[before], self.forearm[after], part)
        filled, valid = self.filled[before] | self.filled[after], np.isfinite(joints).all(axis=-1)
        return dataclasses.replace(self, joints_m=joints, fps=fps, valid=valid, filled=filled, forearm=forearm)

    def mirrored(self) -> PoseSequence:
        """The other hand doing the same: x is negated and the handedness changes."""
        joints = self.joints_m * np.array([-1.0, 1.0, 1.0])
        return dataclasses.replace(self, joints_m=joints, handedness=self.handedness.other, valid=self.valid)

    def section(self, start: int = 0, stop: int | None = None, step: int = 1) -> PoseSequence:
        """Frames start, start + step, … before stop, as Python slices them; the rate follows the step."""
        if step < 1 or not len(range(len(self))[start:stop:step]):
            raise InputError(
                f"frames {start}:{stop}:{step}", wanted=f"at least one of the motion's {len(self)} frames", came="none"
            )
        part = slice(start, stop, step)
        return dataclasses.replace(
            self,
            joints_m=self.joints_m[part],
            fps=self.fps / step,
            valid=self.valid[part],
            filled=self.filled[part],
            forearm=None if self.forearm is None else self.forearm[part],
        )

    def _with(self, joints: np.ndarray) -> PoseSequence:
        return dataclasses.replace(self, joints_m=joints, valid=np.isfinite(joints).all(axis=-1))


def bone_directions(joints: np.ndarray) -> np.ndarray:
    """(F, 21, 3) level order -> (F, 20, 3) unit directions; a bone without length takes the one of the frame before,
    at the start of the next one that has it. NaN joints give NaN."""
    bones = joints[:, 1:] - joints[:, PARENTS[1:]]
    length = np.linalg.norm(bones, axis=-1, keepdims=True)
    size = np.nanmax(length, initial=0.0)
    gone = (length <= ZERO_BONE_EPS * np.finfo(np.float64).eps * size)[..., 0]
    directions = bones / np.where(length > 0, length, 1.0)
    for bone in np.flatnonzero(gone.any(axis=0)):
        known = np.flatnonzero(~gone[:, bone] & np.isfinite(length[:, bone, 0]))
        if not len(known):
            raise InputError("motion", wanted="bones with a length", came=f"none at {LEVEL_NAMES[bone + 1]}")
        lost = np.flatnonzero(gone[:, bone])
        last = np.maximum(np.searchsorted(known, lost) - 1, 0)
        directions[lost, bone] = directions[known[last], bone]
    return directions


def rebuilt(root_m: np.ndarray, directions: np.ndarray, lengths_m: np.ndarray) -> np.ndarray:
    """Joints (F, 21, 3) from wrists (F, 3), unit directions (F, 20, 3) and lengths (20,) or (F, 20), meters."""
    steps = directions * np.broadcast_to(lengths_m, directions.shape[:-1])[..., None]
    joints = np.empty((*directions.shape[:-2], JOINT_COUNT, 3))
    joints[..., 0, :] = root_m
    for first in (1, 6, 11, 16):
        parents = list(PARENTS[first : first + 5])
        joints[..., first : first + 5, :] = joints[..., parents, :] + steps[..., first - 1 : first + 4, :]
    return joints


def pose_between(first_m: np.ndarray, second_m: np.ndarray, part: float) -> np.ndarray:
    """Joints (21, 3) at `part`, 0..1, of the way between two poses (21, 3): bones turn and keep their lengths.

    For poses of neighboring moments, many times a frame: the palm is not turned as a whole as in `poses_between`.
    """
    first_m, second_m, share = first_m[None], second_m[None], np.full((1, 1), part)
    between = slerp(bone_directions(first_m), bone_directions(second_m), share)
    return _rebuilt_between(first_m, second_m, between, share)[0]


def poses_at(joints: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Joints (G, 21, 3) at `places` (G,), fractions of frames, 0..F - 1, of a motion (F, 21, 3): see `poses_between`.

    A place that is a frame but for round-off is that frame, whatever its neighbors miss.
    """
    before, after, part = _neighbors(places, len(joints))
    result = joints[before]
    between = np.flatnonzero(part > 0)
    for rows in np.split(between, range(POSES_AT_ONCE, len(between), POSES_AT_ONCE)):
        first, second = joints[before[rows]], joints[after[rows]]
        result[rows] = poses_between(first, second, part[rows, None, None])
    return result


def _neighbors(places: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of fractional places of `count` frames the frame before, the one after, and which part of the way lies between,
    0 at a frame."""
    places = np.clip(places, 0, count - 1)
    places = np.where(np.abs(places - np.rint(places)) < FRAME_EPS, np.rint(places), places)
    before, after = np.floor(places).astype(np.int64), np.ceil(places).astype(np.int64)
    return before, after, places - before


def poses_between(first_m: np.ndarray, second_m: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Joints (F, 21, 3) at `part` (F, 1, 1), 0..1, of the way between poses (F, 21, 3), level order; NaN stays NaN.

    Wrists and lengths go linearly, the palm turns the short way, and directions go along great circles inside of it:
    a hand that turns keeps its shape, and neither fingers nor palm shrink on the way. A joint that both poses show,
    while one of them misses a joint between it and the wrist, goes linearly.
    """
    share = part[..., 0]
    (palm_first, has_first), (palm_second, has_second) = palm_frames(first_m), palm_frames(second_m)
    # where either has none, the world's
    none = ~(has_first & has_second)
    palm_first[none] = palm_second[none] = np.eye(3)
    palm = slerp_rotation(palm_first, palm_second, share[:, 0])
    inside = slerp(
        np.einsum("fji,fbj->fbi", palm_first, bone_directions(first_m)),
        np.einsum("fji,fbj->fbi", palm_second, bone_directions(second_m)),
        share,
    )
    between = _rebuilt_between(first_m, second_m, np.einsum("fij,fbj->fbi", palm, inside), share)
    return np.where(np.isfinite(between), between, (1 - part) * first_m + part * second_m)


def _rebuilt_between(first: np.ndarray, second: np.ndarray, directions: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Joints (F, 21, 3) of these directions; wrists and lengths at `share` (F, 1) of the way between two."""
    lengths = (1 - share) * bone_lengths(first) + share * bone_lengths(second)
    return rebuilt((1 - share) * first[:, 0] + share * second[:, 0], directions, lengths)


def palm_frames(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frames of the palm (F, 3, 3), columns x out of the palm's plane, y, z along the metacarpals (METHOD 2.7), of
    (F, 21, 3) level-order joints; and which are one (F,). The others, of joints that are missing or on a line, are
    the identity."""
    fan = joints[:, 2:6] - joints[:, :1]
    axis, area = fan.sum(1), np.cross(fan[:, :-1], fan[:, 1:]).sum(1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        z = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
        across = area - (area * z).sum(-1, keepdims=True) * z
        size = np.linalg.norm(across, axis=-1, keepdims=True)
        x = across / size
        has_plane = (size > PALM_NORMAL_MIN * (axis * axis).sum(-1, keepdims=True))[:, 0]
    frames = np.stack([x, np.cross(z, x), z], axis=-1)
    has_plane &= np.isfinite(frames).all(axis=(1, 2))
    frames[~has_plane] = np.eye(3)
    return frames, has_plane


def forearm_turns(joints_m: np.ndarray, rest_joints_m: np.ndarray, carried: np.ndarray) -> np.ndarray:
    """(F, 4) how the forearms of right hands (F, 21, 3) are turned, see `HandPose`, that go by rotations `carried`
    (F, 3, 3) from where they are at the hand's rest (21, 3). Joints in level order."""
    (at_rest,), _ = palm_frames(rest_joints_m[None])
    return quaternions(np.swapaxes(palm_frames(joints_m)[0], -1, -2) @ carried @ at_rest)


def _as_joints(joints: np.ndarray) -> np.ndarray:
    """A private float64 copy of shape (F, 21, 3); InputError otherwise."""
    try:
        array = np.array(joints, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("motion", wanted="numbers of shape (frames, 21, 3)", came=str(error)) from error
    if array.ndim != 3:
        raise InputError("motion", wanted="shape (frames, 21, 3)", came=str(array.shape))
    check_joint_shape(array)
    if not len(array):
        raise InputError("motion", wanted="at least one frame", came="an empty motion")
    return array
