"""What extension and renderer hand to each other as motions: files that say what they hold, and words."""

import ast
import json
import re
from pathlib import Path

import numpy as np
import pytest

from blender_addon.core import panel_text
from blender_addon.core.posing import rest_joints_m
from blender_addon.errors import JGHandFailure
from blender_addon.hand import motion_files
from blender_addon.hand.motion_files import WANTS_HAND, read_converted, words

ROOT = Path(__file__).resolve().parents[2]
SAID = {"order": "standard", "unit": "m", "fps": 25.0, "handedness": "left"}


def motion_m(frames: int = 5) -> np.ndarray:
    return rest_joints_m("left") + 0.01 * np.arange(frames)[:, None, None]


@pytest.mark.parametrize("filled", [np.array([False, True, False, False, True]), None])
def test_a_written_motion_is_read_again_with_what_was_filled_in(tmp_path, filled):
    motion_files.write_motion(tmp_path / "a.npz", motion_files.MotionFile(motion_m(), 30.0, "left", (), filled))
    motion = motion_files.read_motion(tmp_path / "a.npz")
    np.testing.assert_array_equal(motion.joints_m, motion_m())
    np.testing.assert_array_equal(motion.filled, filled)
    assert (motion.fps, motion.handedness) == (30.0, "left")


@pytest.mark.parametrize(
    "said",
    [
        *({name: None} for name in SAID),
        {"order": "mano"},
        {"unit": "mm"},
        {"handedness": "both"},
        {"fps": 0.0},
        {"fps": float("nan")},
        {"joints_m": np.zeros((3, 20, 3))},
        {"joints_m": np.zeros((0, 21, 3))},
        {"joints_m": np.full((3, 21, 3), np.nan)},
        {"filled": np.zeros(3, bool)},
        {"valid": np.zeros((5, 21), bool)},
        {"joints_m": np.array([None])},
    ],
)
def test_what_is_not_as_we_write_it_is_left_to_the_renderer(tmp_path, said):
    content = {**SAID, "joints_m": motion_m(), **said}
    np.savez(tmp_path / "a.npz", **{name: np.array(value) for name, value in content.items() if value is not None})
    with pytest.raises(JGHandFailure) as caught:
        motion_files.read_motion(tmp_path / "a.npz")
    assert caught.value.kind == "bad_motion"


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 no archive"])
def test_damaged_files_are_refused(tmp_path, content):
    path = tmp_path / "a.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(JGHandFailure) as caught:
        motion_files.read_motion(path)
    assert caught.value.kind == "bad_motion"


def test_files_larger_than_a_motion_are_refused(tmp_path, monkeypatch):
    motion_files.write_motion(tmp_path / "a.npz", motion_files.MotionFile(motion_m(), 30.0, "left"))
    monkeypatch.setattr(motion_files, "MAX_BYTES", 100)
    with pytest.raises(JGHandFailure, match="larger than a motion"):
        motion_files.read_motion(tmp_path / "a.npz")


def test_what_was_not_chosen_is_not_said():
    said = words(
        "motion", Path("dance.bvh"), Path("work"), {"--hand": "", "--fps": "25", "--mirror": True, "--in-place": False}
    )
    assert said[:2] == ("motion", "dance.bvh")
    assert said[-5:] == ("--up", "z", "--fps", "25", "--mirror")


def test_the_renderers_advice_to_choose_a_hand_is_understood(tmp_path, capsys):
    cli = pytest.importorskip("jghand_engine.cli", reason="needs the engine's packages")
    np.save(tmp_path / "motion.npy", np.tile(rest_joints_m("left"), (3, 1, 1)))
    options = {"--unit": "m", "--order": "standard", "--fps": "25", "--mirror": True}
    assert cli.main(list(words("motion", tmp_path / "motion.npy", tmp_path, options))) == 2
    assert WANTS_HAND in " ".join(capsys.readouterr().err.split())
    assert cli.main(list(words("motion", tmp_path / "motion.npy", tmp_path, {**options, "--hand": "left"}))) == 0
    assert read_converted(tmp_path).handedness == "right"


def test_the_renderers_sentences_become_notes(tmp_path):
    motion_files.write_motion(tmp_path / "motion.npz", motion_files.MotionFile(motion_m(), 25.0, "left"))
    (tmp_path / "figures.json").write_text(json.dumps({"notes": ["Its unit is not said."]}))
    assert read_converted(tmp_path).notes == ("Its unit is not said.",)


def engine_sentences(folder: str) -> list[str]:
    """All texts in the engine's modules that name an option, as they stand in the source."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "jghand_engine" / folder).glob("*.py")]
    texts = [node.value for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    return [
        text for text in texts if isinstance(text, str) and " --" in f" {text}" and " " in text and "\n" not in text
    ]


@pytest.mark.parametrize(
    ("folder", "fields", "said"),
    [
        ("motion", motion_files.MOTION_FIELDS, '"Frame Rate" plays its frames without their times.'),
        ("track", motion_files.VIDEO_FIELDS, "Cut it into shorter ones."),
    ],
)
def test_what_the_renderer_says_names_blenders_fields_and_no_option(folder, fields, said):
    sentences = engine_sentences(folder)
    shown = [panel_text.in_blenders_words(text, fields) for text in sentences]
    assert len(sentences) > 3
    assert said in shown
    assert not [text for text in shown if re.search(r"(^|\W)--[a-z]|jghand [a-z]+ ", text)]
