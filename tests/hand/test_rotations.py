"""Rotations in numpy: right everywhere, exact at their ends, and the same turns as those of the reference in torch."""

import numpy as np
import pytest
import torch
from hand import sampled_hands as hands
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from jghand_engine.hand import rotations as rot
from jghand_engine.hand.kinematics import bounded_least_squares
from jghand_engine.learn import rotations as reference


def _units(n, seed=0):
    v = np.random.default_rng(seed).standard_normal((n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def _rotations(n, seed=0):
    return hands.random_rotations(n, torch.Generator().manual_seed(seed)).numpy()


def test_a_rotation_about_an_axis_keeps_it_and_turns_what_is_across_by_the_angle():
    axis, angle = _units(50), np.linspace(-3, 3, 50)
    across = np.cross(axis, _units(50, 1))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    turn = rot.axis_rotation(axis, angle)
    assert np.abs(np.einsum("fij,fj->fi", turn, axis) - axis).max() < 1e-15
    wanted = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(axis, across)
    assert np.abs(np.einsum("fij,fj->fi", turn, across) - wanted).max() < 1e-15
    assert np.abs(rot.vector_rotation(angle[:, None] * axis) - turn).max() < 1e-15


def test_no_turn_is_the_identity():
    assert np.array_equal(rot.vector_rotation(np.zeros((2, 3))), np.broadcast_to(np.eye(3), (2, 3, 3)))


@pytest.mark.parametrize("angle", [0.0, 1e-8, 1.0, 3.0, np.pi - 1e-5, np.pi])
def test_minimal_rotations_are_those_of_the_reference(angle):
    a = _units(200)
    across = np.cross(a, _units(200, 1))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    b = np.cos(angle) * a + np.sin(angle) * across
    found = rot.minimal_rotation(a, b, rot.half_turns(across))
    tensors = (torch.from_numpy(x.T.copy()) for x in (a, b))
    wanted = reference.minimal_rotation(*tensors, reference.half_turn(torch.from_numpy(across.T.copy())))
    assert np.abs(found - wanted.permute(2, 0, 1).numpy()).max() < 1e-14


@given(seed=st.integers(0, 2**31), part=st.floats(0, 1))
def test_slerp_divides_the_angle(seed, part):
    a, b = _units(20, seed), _units(20, seed + 1)
    c = rot.slerp(a, b, np.array(part))

    def between(x, y):
        return np.arctan2(np.linalg.norm(np.cross(x, y), axis=1), (x * y).sum(1))

    assert np.abs(between(a, c) - part * between(a, b)).max() < 1e-7
    assert np.abs(np.linalg.norm(c, axis=1) - 1).max() < 1e-12


def test_slerp_is_exact_at_its_ends_and_defined_between_equal_and_opposite_vectors():
    a, b = _units(50), _units(50, 1)
    for other in (b, a, -a):
        for part, end in ((0.0, a), (1.0, other)):
            assert np.abs(rot.slerp(a, other, np.array(part)) - end).max() < 1e-15
        middle = rot.slerp(a, other, np.array(0.5))
        assert np.abs(np.linalg.norm(middle, axis=1) - 1).max() < 1e-12


def test_between_opposite_vectors_the_answer_is_the_first_up_to_the_middle_and_then_the_second():
    """No great circle is distinguished, and in the middle the mixture has no length."""
    a = _units(50)
    for part, end in ((0.3, a), (0.5 - 1e-8, a), (0.5, a), (0.5 + 1e-8, -a), (0.7, -a)):
        assert np.abs(rot.slerp(a, -a, np.array(part)) - end).max() < 1e-15


def test_quaternions_and_rotations_are_the_same_turns():
    for turns in (_rotations(200), rot.half_turns(np.eye(3))):
        assert np.abs(rot.quaternion_rotation(rot.quaternions(turns)) - turns).max() < 1e-14
    quaternions = rot.quaternions(_rotations(200))
    wanted = reference.quaternion_rotation(torch.from_numpy(quaternions.T.copy())).permute(2, 0, 1).numpy()
    assert np.abs(rot.quaternion_rotation(quaternions) - wanted).max() < 1e-15


def test_rotations_between_two_turn_by_their_share():
    axis, angle, start = _units(50), np.linspace(0.1, 3.0, 50), _rotations(50, 3)
    end = rot.axis_rotation(axis, angle) @ start
    between = rot.slerp_rotation(start, end, np.array(0.25))
    assert np.abs(between - rot.axis_rotation(axis, 0.25 * angle) @ start).max() < 1e-12


def test_alignment_finds_the_turn_between_two_clouds():
    turns, points = _rotations(20), np.random.default_rng(0).standard_normal((20, 5, 3))
    found = rot.alignment(points, np.einsum("fij,fnj->fni", turns, points))
    assert np.abs(found - turns).max() < 1e-13


@given(seed=st.integers(0, 2**31), rows=st.integers(8, 11), width=st.floats(0.01, 10))
def test_bounded_least_squares_are_those_of_scipy(seed, rows, width):
    random = np.random.default_rng(seed)
    matrix, target = random.standard_normal((rows, 8)), random.standard_normal(rows)
    matrix = np.concatenate([matrix, 0.1 * np.eye(8)])
    target = np.concatenate([target, random.standard_normal(8)])
    low, high = -width * random.random(8), width * random.random(8) + 1e-9
    found = bounded_least_squares(matrix, target, low, high)
    wanted = lsq_linear(matrix, target, (low, high), method="bvls", tol=1e-14).x
    assert ((found >= low) & (found <= high)).all()
    assert np.abs(found - wanted).max() < 1e-9 * max(1.0, width)
