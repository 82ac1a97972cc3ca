"""Which poses a capture shows: named ones, letters, contacts, extremes, moments of transitions, and random ones.

They are ordered so that the first n are varied for every n: the kinds take turns, and within its kind the pose comes
next that is farthest from all that came before. So whoever stops a capture early has lost detail, not a kind of pose.
They are chosen by their bones; `closing` then brings the skin of the chosen ones together.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from jghand_engine.captures.making.rig import RiggedHand
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import FINGERS, PARENTS
from jghand_engine.hand.kinematics import RANGES_DEG, Contact, segment_gap
from jghand_engine.hand.poses import minimum_jerk
from jghand_engine.hand.shapes import LETTER_CONTACTS, LETTERS_DEG, POSES_DEG, pose_names

# poses of one capture: beyond it the choice of varied ones takes minutes
POSES_MAX = 5000
# transitions and random poses to choose from: so many for every pose, and at least
CANDIDATES = 4
CANDIDATES_LEAST = 200
# part of a range that an extreme pose uses: people reach the ends of a table of ranges one joint at a time
EXTREME_PART = 0.95
# largest delay of a finger in a transition, as a part of it
FINGER_DELAY = 0.25
# standard deviation of what is added to angles so that no shape is made twice alike, degrees
VARIATION_DEG = 4.0
# how far a finger of a random pose may leave the others, as a part of the range
FINGER_FREEDOM = 0.45
# DIP flexion that a PIP flexion brings along, and what is left to the finger, degrees (one standard deviation)
DIP_OF_PIP = 0.62
DIP_LOOSE_DEG = 7.0
# bones of random poses stay this part of the hand's length (wrist to middle tip) apart: about 11 mm, a little less than
# a finger is thick, because skin gives way
GAP_PART = 0.062

# transitions start and end at these: the shapes that hands really pass between
_WAYS = ("open", "relaxed", "fist", "spread", "point", "victory", "pinch", "grasp", "claw", "table", "thumb_up", "flat")
_FINGER_NAMES = FINGERS[1:]
# named poses that come first whatever is near them: what everybody looks at
_FIRST = ("open", "fist", "relaxed", "spread", "pinch")


@dataclass(frozen=True)
class Poses:
    """names (P) and angles_deg (P, 5, 4), anatomical, within RANGES_DEG."""

    names: tuple[str, ...]
    angles_deg: np.ndarray

    def __len__(self) -> int:
        return len(self.names)


def varied_poses(hand: RiggedHand, count: int, seed: int) -> Poses:
    """`count` different poses of `hand`, the same for the same seed. InputError for a count that is no count."""
    if not 1 <= count <= POSES_MAX:
        raise InputError("poses of a capture", wanted=f"1 to {POSES_MAX}", came=str(count))
    random = np.random.default_rng(seed)
    spare = CANDIDATES * count + CANDIDATES_LEAST
    kinds = [
        named_poses(hand),
        _eased(hand, extreme_poses()),
        transition_poses(hand, spare, random),
        letter_poses(hand),
        _apart(hand, _eased(hand, random_poses(spare, random))),
        contact_poses(hand),
    ]
    kinds[2] = _apart(hand, _eased(hand, kinds[2]))
    kinds = [_varied(kind, random) if place not in (2, 4) else kind for place, kind in enumerate(kinds)]
    return _taking_turns(kinds, count)


def named_poses(hand: RiggedHand) -> Poses:
    """The poses that have a name, touching where they touch."""
    return _of({name: hand.angles_of(name) for name in pose_names()})


def letter_poses(hand: RiggedHand) -> Poses:
    """The shapes of the manual alphabet that no named pose has."""
    named = POSES_DEG.values()
    letters = {letter: np.array(angles) for letter, angles in LETTERS_DEG.items() if angles not in named}
    shapes = {letter: hand.eased(_clipped(angles)) for letter, angles in letters.items()}
    touching = {letter: LETTER_CONTACTS[letter] for letter in shapes if letter in LETTER_CONTACTS}
    for letter, (contact, finger) in touching.items():
        shapes[letter] = hand.touching(shapes[letter], contact, finger)
    return _of({f"letter_{letter.lower()}": angles for letter, angles in shapes.items()})


def contact_poses(hand: RiggedHand) -> Poses:
    """The thumb touches each finger: at the tip with the others stretched or relaxed, and resting on each."""
    open_hand, relaxed, fist = (hand.angles_of(name) for name in ("open", "relaxed", "fist"))
    bent = np.array([[26, 12, 20, 28], *[[52, 0, 54, 34]] * 4], dtype=np.float64)
    shapes = {}
    for finger, name in enumerate(_FINGER_NAMES, start=1):
        for kind, base in (("open", open_hand), ("relaxed", relaxed)):
            start = base.copy()
            start[[0, finger]] = bent[[0, finger]]
            shapes[f"touch_{name}_{kind}"] = hand.touching(start, Contact.TIP, finger)
        shapes[f"rest_on_{name}"] = hand.touching(fist, Contact.REST, finger)
    return _of(shapes)


def extreme_poses() -> Poses:
    """Both ends of every range: all fingers together, one finger alone, one joint of all fingers alone."""
    low, high = RANGES_DEG[..., 0], RANGES_DEG[..., 1]
    rest = np.zeros((5, 4))
    rest[1:, 2:] = (6, 4)
    most = EXTREME_PART
    # a thumb cannot bend into fingers that are bent themselves
    bent, straight = most * high, most * low
    bent[:, 1], straight[:, 1] = 0, 0
    bent[0] = rest[0]
    spread, closed = straight.copy(), rest.copy()
    spread[:, 1], closed[:, 1] = most * high[:, 1], (-10, -6, 0, -7, -13)
    shapes = {
        "all_stretched": straight,
        "all_bent": bent,
        "stretched_and_spread": spread,
        "flat_and_closed": closed,
        "spread_only": _with(rest, np.s_[:, 1], most * high[:, 1]),
        "knuckles_bent": _with(rest, np.s_[1:, 0], most * high[1:, 0]),
        "middle_joints_bent": _with(rest, np.s_[1:, 2:], np.stack([most * high[1:, 2], 0.6 * high[1:, 3]], 1)),
        "knuckles_back_rest_bent": _with(_with(rest, np.s_[1:, 2:], most * high[1:, 2:]), np.s_[1:, 0], low[1:, 0] / 2),
        "thumb_across": _with(rest, np.s_[0], (45, -5, 40, 35)),
        "thumb_out": _with(rest, np.s_[0], low[0] * [most, 0, most, most] + high[0] * [0, most, 0, 0]),
        "thumb_bent": _with(rest, np.s_[0], (10, 5, 50, 75)),
    }
    for finger, name in enumerate(_FINGER_NAMES, start=1):
        shapes[f"{name}_alone_bent"] = _with(rest, np.s_[finger], most * high[finger] * [1, 0, 1, 1])
        other = bent.copy()
        other[finger] = (-12, 0, 0, 0)
        shapes[f"{name}_alone_stretched"] = other
    return _of(shapes)


def transition_poses(hand: RiggedHand, count: int, random: np.random.Generator) -> Poses:
    """Moments between two named poses, each finger with a delay of its own, as hands move (minimum jerk)."""
    solved = {name: hand.angles_of(name) for name in _WAYS}
    pairs = list(itertools.permutations(_WAYS, 2))
    shapes = {}
    for number in range(count):
        start, end = pairs[random.integers(len(pairs))]
        delay = random.uniform(0, FINGER_DELAY, (5, 1))
        part = minimum_jerk((random.uniform(0.2, 0.8) - delay) / (1 - delay))
        noise = VARIATION_DEG * random.standard_normal((5, 4))
        shapes[f"{start}_to_{end}_{number}"] = solved[start] + (solved[end] - solved[start]) * part + noise
    return _of(shapes)


def random_poses(count: int, random: np.random.Generator) -> Poses:
    """Poses from anywhere in the ranges: the fingers somewhat alike, DIP coupled to PIP as tendons couple them."""
    low, high = RANGES_DEG[..., 0], RANGES_DEG[..., 1]
    together, alone = random.random((count, 1, 4)), random.random((count, 5, 4))
    part = np.clip(together + FINGER_FREEDOM * (alone - 0.5) * 2, 0, 1)
    # joints are seldom bent backwards: start the flexions near straight
    start = np.maximum(low, [-8, -100, -100, -100])
    angles = start + part * (high - start)
    angles[:, 1:, 1] = random.normal(2, 8, (count, 4))
    angles[:, 0] = low[0] + random.beta(1.6, 1.8, (count, 4)) * (high[0] - low[0])
    loose = DIP_LOOSE_DEG * random.standard_normal((count, 4))
    angles[:, 1:, 3] = DIP_OF_PIP * angles[:, 1:, 2] + loose
    return Poses(tuple(f"random_{number}" for number in range(count)), _clipped(angles))


def gap_m(joints_m: np.ndarray) -> np.ndarray:
    """(F, 21, 3) level order -> (F,) smallest distance between bones of different fingers, and of the thumb's last
    bones from the palm, meters."""
    start, end = joints_m[:, PARENTS[6:]], joints_m[:, 6:]
    pairs = [(a, b) for a, b in itertools.combinations(range(15), 2) if a % 5 != b % 5]
    first, second = np.array(pairs).T
    fingers = segment_gap(start[:, first], end[:, first], start[:, second], end[:, second]).min(1)
    palm_start, palm_end = np.repeat(joints_m[:, :1], 4, axis=1), joints_m[:, 2:6]
    thumb = [segment_gap(start[:, [b] * 4], end[:, [b] * 4], palm_start, palm_end).min(1) for b in (5, 10)]
    return np.min([fingers, *thumb], axis=0)


def _apart(hand: RiggedHand, poses: Poses) -> Poses:
    """Those whose fingers do not run through one another or into the palm."""
    joints_m = hand.joints(poses.angles_deg)
    middle = np.linalg.norm(np.diff(hand.identity.joints_m[[0, 3, 8, 13, 18]], axis=0), axis=1).sum()
    good = np.flatnonzero(gap_m(joints_m) >= GAP_PART * middle)
    return Poses(tuple(poses.names[place] for place in good), poses.angles_deg[good])


def _eased(hand: RiggedHand, poses: Poses) -> Poses:
    return Poses(poses.names, np.stack([hand.eased(angles) for angles in poses.angles_deg]))


def _varied(poses: Poses, random: np.random.Generator) -> Poses:
    """The same poses a little different: nobody makes a shape twice alike."""
    noise = VARIATION_DEG / 2 * random.standard_normal(poses.angles_deg.shape)
    return Poses(poses.names, _clipped(poses.angles_deg + noise))


def _taking_turns(kinds: list[Poses], count: int) -> Poses:
    """The kinds in turn, from each the pose farthest from all taken, but _FIRST before. InputError for too many."""
    width = RANGES_DEG[..., 1] - RANGES_DEG[..., 0]
    features = [(kind.angles_deg / width).reshape(len(kind), 20) for kind in kinds]
    nearest = [np.full(len(kind), np.inf) for kind in kinds]
    taken: list[tuple[int, int]] = []
    for turn in itertools.count():
        kind = turn % len(kinds)
        if len(taken) == count:
            break
        if not any((left > 0).any() for left in nearest):
            raise InputError(
                "poses of a capture", wanted=f"at most the {len(taken)} different ones of this hand", came=str(count)
            )
        if not (nearest[kind] > 0).any():
            continue
        first = [kinds[kind].names.index(name) for name in _FIRST if name in kinds[kind].names]
        waiting = [place for place in first if (kind, place) not in taken]
        best = waiting[0] if waiting else int(np.argmax(nearest[kind]))
        taken.append((kind, best))
        for other, points in enumerate(features):
            distance = np.linalg.norm(points - features[kind][best], axis=1)
            nearest[other] = np.minimum(nearest[other], distance)
        nearest[kind][best] = -1
    names = tuple(kinds[kind].names[place] for kind, place in taken)
    return Poses(names, np.stack([kinds[kind].angles_deg[place] for kind, place in taken]))


def _of(shapes: dict[str, np.ndarray]) -> Poses:
    return Poses(tuple(shapes), _clipped(np.stack(list(shapes.values()))))


def _clipped(angles_deg: np.ndarray) -> np.ndarray:
    return np.clip(angles_deg, RANGES_DEG[..., 0], RANGES_DEG[..., 1])


def _with(angles_deg: np.ndarray, where: object, value: object) -> np.ndarray:
    changed = angles_deg.copy()
    changed[where] = value  # type: ignore[index]
    return changed
