"""Named poses as joints, and motions through them; the poses are those of `hand.shapes`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import FINGERS, Handedness
from jghand_engine.hand.kinematics import NO_FIST, ArchingHand, ArticulatedHand, Fist
from jghand_engine.hand.sequence import FPS_MAX, FPS_MIN, PoseSequence, forearm_turns
from jghand_engine.hand.shapes import angles_on
from jghand_engine.hand.wrist import NO_TURN, ZERO


def named_pose(
    name: str,
    canonical_joints_m: np.ndarray,
    *,
    handedness: Handedness,
    fist: Fist = NO_FIST,
) -> np.ndarray:
    """(21, 3) level-order joints of a named pose, meters; the wrist stays where the canonical hand has it.

    canonical_joints_m: (21, 3) right hand. A left hand is the mirror image, x negated. fist: of an avatar
    """
    hand = ArchingHand(canonical_joints_m, fist)
    return _handed(hand.joints(angles_on(hand, name)[None])[0], handedness)


@dataclass(frozen=True)
class MotionOptions:
    """How a motion through named poses moves.

    fps:           frames per second
    move_s:        seconds of a move
    hold_s:        seconds at each pose
    finger_delay:  the largest delay of a finger, as a part of the move
    variation_deg: standard deviation of the angles from the named poses
    seed:          of the delays and the variation
    """

    fps: float = 30.0
    move_s: float = 0.7
    hold_s: float = 0.25
    finger_delay: float = 0.25
    variation_deg: float = 0.0
    seed: int = 0

    def check(self) -> None:
        """InputError names the option that cannot be."""
        lowest, highest = FPS_MIN, FPS_MAX
        checks = (
            ("fps", lowest <= self.fps <= highest, f"{lowest:g} to {highest:g} frames per second"),
            ("move_s", 0 <= self.move_s < math.inf, "seconds >= 0"),
            ("hold_s", 0 <= self.hold_s < math.inf, "seconds >= 0"),
            ("finger_delay", 0 <= self.finger_delay < 1, "a part from 0 to below 1"),
            ("variation_deg", 0 <= self.variation_deg < math.inf, "degrees >= 0"),
            ("seed", self.seed >= 0, "0 or a positive number"),
        )
        for name, good, wanted in checks:
            if not good:
                raise InputError(f"motion option {name}", wanted=wanted, came=str(getattr(self, name)))


def minimum_jerk(part: np.ndarray) -> np.ndarray:
    """10 u^3 - 15 u^4 + 6 u^5: from 0 to 1 with speed and acceleration 0 at both ends, as hands move."""
    u = np.clip(part, 0.0, 1.0)
    return u**3 * (10 - 15 * u + 6 * u**2)


def pose_sequence_of_names(
    names: Sequence[str],
    canonical_joints_m: np.ndarray,
    *,
    handedness: Handedness,
    options: MotionOptions | None = None,
    fist: Fist = NO_FIST,
) -> PoseSequence:
    """A motion through named poses: minimum jerk, each finger a little late, the wrist and the forearm at rest.

    canonical_joints_m: (21, 3) right hand, level order, meters; its bone lengths are kept exactly. fist: of an avatar
    """
    options = options or MotionOptions()
    if not names:
        raise InputError("poses of a motion", wanted="at least one name", came="none")
    options.check()
    hand = ArchingHand(canonical_joints_m, fist)
    random = np.random.default_rng(options.seed)
    solved = {name: angles_on(hand, name) for name in dict.fromkeys(names)}
    keys = [solved[name] + options.variation_deg * random.standard_normal((5, 4)) for name in names]
    move = max(1, round(options.move_s * options.fps))
    hold = round(options.hold_s * options.fps)
    frames = [keys[0]] * (1 + hold)
    for start, end in itertools.pairwise(keys):
        delay = random.uniform(0.0, options.finger_delay, (len(FINGERS), 1))
        for time in np.arange(1, move + 1) / move:
            frames.append(start + (end - start) * minimum_jerk((time - delay) / (1 - delay)))
        frames += [end] * hold
    joints = hand.joints(np.stack(frames))
    return PoseSequence(_handed(joints, handedness), options.fps, handedness, forearm=_still_forearm(hand, joints))


def _still_forearm(hand: ArticulatedHand, joints_m: np.ndarray) -> np.ndarray | None:
    """(F, 4) turns that keep the forearm of a right hand (F, 21, 3) where it is at rest, while the palm, which would
    carry it (`HandPose`), arches with the knuckles; None where it never does."""
    turns = forearm_turns(joints_m, hand.straight_joints_m, np.eye(3))
    turns[np.linalg.norm(turns[:, 1:], axis=-1) < ZERO] = NO_TURN
    return None if (turns == NO_TURN).all() else turns


def _handed(joints: np.ndarray, handedness: Handedness) -> np.ndarray:
    return joints * np.array([-1.0, 1.0, 1.0]) if Handedness(handedness) is Handedness.LEFT else joints
