"""The script that builds the hand, as far as it goes without the package it builds from."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from jghand_engine.template.builtin import load_fields

SCRIPT = Path(__file__).parents[2] / "scripts" / "build_template.py"


@pytest.fixture(scope="module")
def script():
    specification = importlib.util.spec_from_file_location("build_template", SCRIPT)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_metacarpals_and_the_forearm_count_as_the_wrist(script):
    names = [*script.SOMA_JOINTS, "RightHandIndex1", "RightForeArm"]
    weights = np.eye(len(names))
    result = script.weights_of_21_joints(weights, names)
    np.testing.assert_array_equal(result[:21], np.eye(21))
    np.testing.assert_array_equal(result[21:], np.eye(21)[[0, 0]])


def test_a_bone_nobody_thought_of_is_an_error(script):
    with pytest.raises(ValueError, match="RightHandSixth1"):
        script.weights_of_21_joints(np.ones((2, 1)), ["RightHandSixth1"])


def test_the_canonical_frame_comes_out_of_any_other(script):
    joints = load_fields()["joints"].astype(float)
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    moved = joints @ turn.T + [1, 2, 3]
    np.testing.assert_allclose((moved - moved[0]) @ script.canonical_rotation(moved).T, joints, atol=1e-9)
