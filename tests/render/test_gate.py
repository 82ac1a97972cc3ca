"""The gate of the shadow: from the joints alone, 0 on the canonical hand, the same from every side."""

import numpy as np
import pytest

from jghand_engine.avatar.learned import CAPSULE_RADII_MM
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.render.gate import (
    GATE_HIGH,
    GATE_LOW,
    GATE_RADIUS_M,
    ShadowGate,
    _far_pairs,
    contact_between,
    fade,
    gap_between,
)
from jghand_engine.template.builtin import load_template

CANONICAL_M = load_template().joints_m


@pytest.fixture(scope="module")
def gate() -> ShadowGate:
    return ShadowGate(CANONICAL_M)


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


PARENTS = [0] * 5 + list(range(1, 16))
RADII_M = np.array(CAPSULE_RADII_MM) * 1e-3


def penetration(joints_a: np.ndarray, a: int, joints_b: np.ndarray, b: int) -> float:
    part = np.linspace(0, 1, 5)[:, None]
    first = joints_a[PARENTS[a]] + part * (joints_a[a + 1] - joints_a[PARENTS[a]])
    second = joints_b[PARENTS[b]] + part * (joints_b[b + 1] - joints_b[PARENTS[b]])
    gap = np.linalg.norm(first[:, None] - second[None], axis=-1).min() - RADII_M[a] - RADII_M[b]
    return float(np.clip(1 - gap / 0.06, 0, 1.5) ** 2)


def far_pairs() -> list[tuple[int, int]]:
    """Bones that are not neighbors, in plain loops."""
    pairs = []
    for a in range(20):
        for b in range(a + 1, 20):
            chained = PARENTS[a] == b + 1 or PARENTS[b] == a + 1
            siblings = PARENTS[a] == PARENTS[b] != 0
            if not (chained or siblings or (a < 5 and b < 5)):
                pairs.append((a, b))
    return pairs


def slow_score(joints_m: np.ndarray, canonical_m: np.ndarray) -> float:
    """METHOD 5.4 in plain loops."""
    return sum(
        max(penetration(joints_m, a, joints_m, b) - penetration(canonical_m, a, canonical_m, b), 0.0)
        for a, b in far_pairs()
    )


def test_the_pairs_of_the_score_are_those_that_are_not_neighbors():
    assert list(zip(*(side.tolist() for side in _far_pairs()), strict=True)) == far_pairs()


@pytest.mark.parametrize("pose", ["open", "relaxed", "fist", "pinch", "point"])
def test_score_is_that_of_the_method(gate: ShadowGate, pose: str):
    joints = named_pose(pose, CANONICAL_M, handedness=Handedness.RIGHT)
    assert gate.score(joints) == pytest.approx(slow_score(joints, CANONICAL_M), abs=1e-9)


def test_score_is_that_of_the_method_when_the_palm_moves_too(gate: ShadowGate):
    joints = named_pose("relaxed", CANONICAL_M, handedness=Handedness.RIGHT) + np.random.default_rng(2).normal(
        0, 0.01, (21, 3)
    )
    assert gate.score(joints) == pytest.approx(slow_score(joints, CANONICAL_M), abs=1e-9)


def test_canonical_hand_scores_nothing_and_a_fist_much(gate: ShadowGate):
    assert gate.score(CANONICAL_M) == 0
    assert fade(gate.score(CANONICAL_M)) == 0
    assert fade(gate.score(named_pose("fist", CANONICAL_M, handedness=Handedness.RIGHT))) == 1


def test_score_does_not_depend_on_where_the_hand_is_and_which_it_is(gate: ShadowGate):
    joints = named_pose("pinch", CANONICAL_M, handedness=Handedness.RIGHT)
    score = gate.score(joints)
    assert gate.score(joints @ rotation(1).T + [3.0, -2.0, 5.0]) == pytest.approx(score, abs=1e-9)
    left = named_pose("pinch", CANONICAL_M, handedness=Handedness.LEFT)
    assert gate.score(left) == pytest.approx(score, abs=1e-9)


def test_a_larger_hand_scores_the_same(gate: ShadowGate):
    joints = named_pose("pinch", CANONICAL_M, handedness=Handedness.RIGHT)
    assert gate.score(1.3 * joints, 1.3) == pytest.approx(gate.score(joints), rel=1e-9)


def test_collapsed_hands_have_a_finite_score(gate: ShadowGate):
    assert np.isfinite(gate.score(np.zeros((21, 3))))
    assert np.isfinite(gate.score(np.zeros((21, 3)), 0.0))


def test_fade_is_smooth_and_ends_at_its_thresholds():
    scores = np.linspace(GATE_LOW - 0.2, GATE_HIGH + 0.2, 901)
    strength = np.array([fade(float(score)) for score in scores])
    assert strength[0] == 0
    assert strength[-1] == 1
    assert (np.diff(strength) >= 0).all()
    assert np.abs(np.diff(strength)).max() < 4e-3  # no step: nothing pops
    assert fade(GATE_LOW) == 0
    assert fade(GATE_HIGH) == 1


def test_contact_is_the_sum_over_all_bones_of_different_hands():
    hands = [CANONICAL_M + 0.7, CANONICAL_M @ rotation(3).T + 0.72, CANONICAL_M @ rotation(4).T + [0.65, 0.7, 0.75]]
    slow = sum(
        penetration(hands[i], a, hands[j], b) for i, j in ((0, 1), (0, 2), (1, 2)) for a in range(20) for b in range(20)
    )
    assert slow > 10
    assert contact_between(hands) == pytest.approx(slow, rel=1e-9)


def test_the_gap_between_hands_is_that_of_the_nearest_two_boxes():
    flesh_m = 2 * 0.016
    boxes = np.ptp(CANONICAL_M, axis=0)
    for away, gap in (
        ([0.5, 0.0, 0.0], 0.5 - boxes[0] - flesh_m),
        ([0.0, -0.5, 0.0], 0.5 - boxes[1] - flesh_m),
        ([0.3, 0.0, 0.4], np.hypot(0.3 - boxes[0] - flesh_m, 0.4 - boxes[2] - flesh_m)),
        ([0.0, 0.0, 0.01], 0.0),
    ):
        for hands in ([CANONICAL_M, CANONICAL_M + away], [CANONICAL_M + away, CANONICAL_M]):
            assert gap_between(hands) == pytest.approx(gap, abs=1e-12)
    far, near = (CANONICAL_M + np.array([0.0, up, 0.0]) for up in (9.0, 8.7))
    assert gap_between([CANONICAL_M, far, near]) == pytest.approx(max(0.3 - boxes[1] - flesh_m, 0), abs=1e-12)
    assert gap_between([CANONICAL_M]) == np.inf
    # a promise: what is farther apart than the radius of influence casts nothing
    beyond = np.array([0.0, boxes[1] + flesh_m + GATE_RADIUS_M, 0.0])
    assert contact_between([CANONICAL_M, CANONICAL_M + beyond]) == 0


def test_two_hands_shade_each_other_only_when_they_are_near():
    first, near, far = CANONICAL_M, CANONICAL_M + np.array([0.0, 0.0, 0.05]), CANONICAL_M + np.array([0.4, 0.0, 0.0])
    assert contact_between([first, near]) > 1
    assert contact_between([first, far]) == 0
    assert contact_between([first]) == 0
