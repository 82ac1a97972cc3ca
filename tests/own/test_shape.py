"""Shapes in which hands differ beyond their bones."""

from dataclasses import replace

import numpy as np
import pytest

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.hand.joints import PARENTS, Handedness
from jghand_engine.own.shape import SHAPE_COUNT, in_shape, shape_basis

PRIOR = replace(load_builtin(handedness=Handedness.RIGHT).prefix(500), detail=None)


@pytest.fixture(scope="module")
def basis() -> np.ndarray:
    return shape_basis(PRIOR, PRIOR.position_m)


def test_an_avatar_in_no_other_shape_is_itself():
    same = in_shape(PRIOR, np.zeros(SHAPE_COUNT))
    np.testing.assert_array_equal(same.position_m, PRIOR.position_m)
    np.testing.assert_array_equal(same.sigma_m, PRIOR.sigma_m)


def test_the_basis_is_how_shapes_move_the_gaussians(basis):
    shape = 0.5 * np.random.default_rng(2).uniform(-1, 1, SHAPE_COUNT)
    moved = PRIOR.position_m + np.einsum("k,knc->nc", shape, basis)
    off = np.linalg.norm(moved - in_shape(PRIOR, shape).position_m, axis=1)
    assert np.median(off) < 2e-5, "seen: 0.01 mm"
    assert np.median(np.linalg.norm(moved - PRIOR.position_m, axis=1)) > 3e-4


@pytest.mark.parametrize("finger", range(5))
def test_a_finger_that_grows_by_a_tenth_stands_a_tenth_farther_from_its_bones(basis, finger):
    first, last = 1 + 5 + finger, 1 + 15 + finger
    of_finger = PRIOR.bone_weights[:, [first, first + 5, last]].max(1) > 0.99
    moved = basis[2 + finger]
    bone = PRIOR.bone_weights[of_finger].argmax(1)
    start, end = (PRIOR.canonical_joints_m[joint] for joint in (np.array(PARENTS)[bone], bone))
    way = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    away = PRIOR.position_m[of_finger] - start
    radial = away - (away * way).sum(1, keepdims=True) * way
    radius_m = np.linalg.norm(radial, axis=1)
    # they keep their depth under the skin that grows, up to a millimeter, of which a tenth is added: observed 0.13 mm
    np.testing.assert_allclose((moved[of_finger] * radial).sum(1) / radius_m, 0.1 * radius_m, atol=1.5e-4)
    others = PRIOR.bone_weights[:, [joint for joint in range(21) if (joint - 1) % 5 != finger]].sum(1) > 0.99
    # skin between two fingers moves with both
    assert np.abs(moved[others]).max() < 2e-4
