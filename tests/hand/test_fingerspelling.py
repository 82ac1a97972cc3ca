"""Letters of the manual alphabet are hand shapes within the ranges of the joints, each one another."""

import itertools

import numpy as np
import pytest

from jghand_engine.hand.kinematics import RANGES_DEG, ArticulatedHand
from jghand_engine.hand.shapes import LETTERS_DEG, SAME_SHAPE, letter_angles_on
from jghand_engine.template.builtin import load_template


@pytest.fixture(scope="module")
def hand() -> ArticulatedHand:
    return ArticulatedHand(load_template().joints_m)


def test_every_letter_but_z_has_a_shape_within_the_ranges(hand):
    alphabet = {chr(code) for code in range(ord("A"), ord("Z"))}
    assert {*LETTERS_DEG, *SAME_SHAPE} == alphabet
    for letter in sorted(alphabet):
        angles = letter_angles_on(hand, letter)
        assert (angles >= RANGES_DEG[..., 0]).all(), letter
        assert (angles <= RANGES_DEG[..., 1]).all(), letter


def test_letters_with_shapes_of_their_own_look_different(hand):
    joints = hand.joints(np.stack([letter_angles_on(hand, letter) for letter in LETTERS_DEG]))
    for (one, first), (other, second) in itertools.combinations(zip(LETTERS_DEG, joints, strict=True), 2):
        # the nearest two, U and V: 23 mm
        assert np.linalg.norm(first - second, axis=-1).max() > 0.02, (one, other)


def test_letters_that_differ_by_the_wrist_alone_share_a_shape(hand):
    for letter, shape in SAME_SHAPE.items():
        np.testing.assert_array_equal(letter_angles_on(hand, letter), letter_angles_on(hand, shape))
