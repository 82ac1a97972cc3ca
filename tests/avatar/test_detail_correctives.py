"""The surface of a detail moves with the joint angles near it, and with none far away."""

import numpy as np
import pytest

from jghand_engine.avatar.detail_correctives import NUMBERS, SIMPLE, angle_numbers
from jghand_engine.hand.skeleton import ANGLE_COUNT


def test_a_straight_hand_says_nothing():
    assert not angle_numbers(np.zeros(ANGLE_COUNT)).any()


@pytest.mark.parametrize("bone", range(6, 21))
def test_a_joint_speaks_to_the_three_bones_of_its_finger_alone(bone):
    angles_rad = np.zeros(ANGLE_COUNT)
    angles_rad[2 * (bone - 6)] = 0.5
    told = angle_numbers(angles_rad).any(-1)
    assert sorted(np.flatnonzero(told)) == [6 + (bone - 6) % 5 + 5 * level for level in range(3)]


def test_the_palms_angles_speak_to_wrist_and_metacarpals():
    angles_rad = np.zeros(ANGLE_COUNT)
    angles_rad[-1] = 0.5
    assert sorted(np.flatnonzero(angle_numbers(angles_rad).any(-1))) == list(range(6))


def test_numbers_are_angles_and_products_of_two():
    angles_rad = np.random.default_rng(0).normal(0, 1, (3, ANGLE_COUNT))
    numbers = angle_numbers(angles_rad)
    assert numbers.shape == (3, 21, NUMBERS)
    knuckle, middle = angles_rad[1, 2:4], angles_rad[1, 12:14]
    for bone in (7, 12, 17):
        a = numbers[1, bone]
        np.testing.assert_array_equal(a[:4], [*knuckle, *middle])
        products = sorted(a[i] * a[j] for i in range(4) for j in range(i + 1))
        np.testing.assert_allclose(sorted(a[SIMPLE:]), products)
    np.testing.assert_array_equal(angle_numbers(angles_rad[1]), numbers[1])
