"""What the engine is asked for a motion of another program, and what is made of its answer. No Blender, no engine."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from blender_addon.core.posing import rest_joints_m
from blender_addon.errors import JGHandFailure
from blender_addon.hand.motion_conversion import WANTS_HAND, ConversionChoices, read_converted, words
from blender_addon.hand.motion_files import MotionFile, write_motion

FILE, FOLDER = Path("dance.bvh"), Path("work")


def test_what_the_file_says_itself_is_not_said_again():
    said = words(FILE, FOLDER, ConversionChoices())
    assert said[:2] == ("motion", "dance.bvh")
    assert said[said.index("--up") + 1] == "z"
    options = {"--hand", "--unit", "--order", "--fps", "--hand-length", "--part", "--in-place"}
    assert not (options | {"--file-up", "--labels", "--bones", "--mirror"}) & set(said)


def test_what_was_chosen_is_said():
    chosen = ConversionChoices(
        "left", "cm", "interhand", 29.97, 185.0, "Take 2", True, up="z", labels="true", bones="map.json", mirror=True
    )
    said = words(FILE, FOLDER, chosen)
    options = {"--hand": "left", "--unit": "cm", "--order": "interhand", "--fps": "29.97", "--hand-length": "185"}
    options |= {"--part": "Take 2", "--file-up": "z", "--labels": "true", "--bones": "map.json"}
    for option, value in options.items():
        assert said[said.index(option) + 1] == value
    assert said[-2:] == ("--mirror", "--in-place")


def test_the_engine_knows_every_word_and_its_advice_to_choose_a_hand_is_understood(tmp_path, capsys):
    cli = pytest.importorskip("jghand_engine.cli", reason="needs the engine's packages")
    np.save(tmp_path / "motion.npy", np.tile(rest_joints_m("left"), (3, 1, 1)))
    (tmp_path / "map.json").write_text(json.dumps({"wrist": "hand"}))
    bones = str(tmp_path / "map.json")
    chosen = ConversionChoices(
        "", "m", "standard", 25.0, 185.0, "", True, up="z", labels="true", bones=bones, mirror=True
    )
    assert cli.main(list(words(tmp_path / "motion.npy", tmp_path, chosen))) == 2
    assert WANTS_HAND in " ".join(capsys.readouterr().err.split())
    assert cli.main(list(words(tmp_path / "motion.npy", tmp_path, replace(chosen, hand="left")))) == 0
    assert read_converted(tmp_path).handedness == "right"


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
