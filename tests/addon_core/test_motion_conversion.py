"""What the engine is asked for a motion of another program, and what is made of its answer. No Blender, no engine."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from blender_addon.core.messages import JGHandFailure
from blender_addon.core.motion_conversion import ConversionChoices, read_converted, words
from blender_addon.core.motion_files import MotionFile, write_motion
from blender_addon.core.posing import rest_joints_m

FILE, FOLDER = Path("dance.bvh"), Path("work")


def test_what_the_file_says_itself_is_not_said_again():
    said = words(FILE, FOLDER, ConversionChoices())
    assert said[:2] == ("motion", "dance.bvh")
    assert said[said.index("--up") + 1] == "z"
    assert not {"--hand", "--unit", "--order", "--fps", "--hand-length", "--part", "--in-place"} & set(said)


def test_what_was_chosen_is_said():
    chosen = ConversionChoices("left", "cm", "interhand", 29.97, 185.0, "Take 2", True)
    said = words(FILE, FOLDER, chosen)
    options = {"--hand": "left", "--unit": "cm", "--order": "interhand", "--fps": "29.97", "--hand-length": "185"}
    for option, value in {**options, "--part": "Take 2"}.items():
        assert said[said.index(option) + 1] == value
    assert said[-1] == "--in-place"


def test_the_engines_sentences_become_notes(tmp_path):
    joints = np.tile(rest_joints_m("left"), (3, 1, 1))
    write_motion(tmp_path / "motion.npz", MotionFile(joints, 25.0, "left"))
    (tmp_path / "figures.json").write_text(json.dumps({"notes": ["Its unit is not said."]}))
    motion = read_converted(tmp_path)
    assert (motion.fps, motion.handedness, motion.notes) == (25.0, "left", ("Its unit is not said.",))
    np.testing.assert_array_equal(motion.joints_m, joints)


@pytest.mark.parametrize("figures", [None, "", "[]", '{"notes": 5}'])
def test_an_answer_that_is_none_is_a_failure(tmp_path, figures):
    write_motion(tmp_path / "motion.npz", MotionFile(np.tile(rest_joints_m("left"), (3, 1, 1)), 25.0, "left"))
    if figures is not None:
        (tmp_path / "figures.json").write_text(figures)
    with pytest.raises(JGHandFailure) as caught:
        read_converted(tmp_path)
    assert caught.value.kind == "bad_motion"
