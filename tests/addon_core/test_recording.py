"""What is exported and baked: names, and the words that the engine's command line understands."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from blender_addon.core.posing import rest_joints_m
from blender_addon.export.recording import USD_PRESETS, Recording, avatar_digest, file_names, usd_options
from blender_addon.train.training_folder import capture_words, train_words


def a_recording(frames: int = 3, **more) -> Recording:
    joints = np.tile(rest_joints_m("right"), (frames, 1, 1))
    joints += 0.01 * np.arange(frames)[:, None, None]
    values = {"name": "Hand", "handedness": "right", "avatar": "builtin", "first_frame": 7, "fps": 24.0, **more}
    return Recording(joints_m=joints, **values)


# ---- names and places ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["Hand"], ["Hand"]),
        (["Hand.R", "Hand_R", "hand.r"], ["Hand_R", "Hand_R_2", "hand_r_3"]),
        (["Рука", "../..", "3D hand", ""], ["hand_2494e9cb", "hand", "_3D_hand", "hand_2"]),
    ],
)
def test_names_of_objects_become_names_of_files_each_its_own(names, expected):
    found = file_names(names)
    assert found == expected
    assert all(name.isidentifier() and name.isascii() for name in found)


def test_no_file_has_a_name_that_windows_keeps_for_a_device():
    assert file_names(["CON", "nul", "com1", "Console", "com10"]) == ["CON_", "nul_", "com1_", "Console", "com10"]


# ---- motion files ----------------------------------------------------------------------------------------------------


def test_the_engine_reads_it_back_too(tmp_path):
    engine = pytest.importorskip("jghand_engine.motion.read", reason="needs the engine's packages")
    from jghand_engine.hand.orders import JointOrder, from_level

    recording = a_recording()
    recording.save(tmp_path / "motion.npz")
    back = engine.read_motion_file(tmp_path / "motion.npz").sequence
    assert (from_level(back.joints_m, JointOrder.STANDARD) == recording.joints_m).all()
    assert (back.fps, str(back.handedness)) == (24.0, "right")


# ---- avatars ---------------------------------------------------------------------------------------------------------


def test_an_avatar_that_was_changed_on_disk_is_another_one(tmp_path):
    file = tmp_path / "a.jghand"
    file.write_bytes(b"one")
    before = avatar_digest(str(file))
    file.write_bytes(b"two")
    assert avatar_digest(str(file)) != before


# ---- the words of jobs -----------------------------------------------------------------------------------------------


def all_words(scratch: Path) -> list[tuple[str, ...]]:
    recording = a_recording(first_frame=-3)
    capture = SimpleNamespace(identity="adult_man", cameras=16, poses=60, size=(334, 512), samples=16, seed=0)
    training = SimpleNamespace(preset="paper-faithful", time_s=750.0, seed=3, all_pictures=True)
    return [
        recording.export_words("usd", scratch, scratch, *usd_options("points", 2.0)),
        recording.export_words("ply", scratch, scratch, "--axes", "rub"),
        capture_words(scratch, capture),
        capture_words(scratch, capture, scratch / "m.npz"),
        *(
            train_words(scratch, scratch / "a.jghand", training, start, overwrite=bool(start))
            for start in ("", "resume", "fresh")
        ),
    ]


def test_programs_are_suited_as_the_engine_does_it():
    pytest.importorskip("torch", reason="needs the engine's packages")
    from jghand_engine.export.usd.package import PRESETS

    wanted = {name: (str(preset.variant), preset.width_factor) for name, preset in PRESETS.items()}
    assert wanted == USD_PRESETS


def test_the_engine_understands_the_words_of_jobs(tmp_path):
    pytest.importorskip("tyro", reason="needs the engine's packages")
    from blender_addon.renderer.jobs import PROGRESS_OPTION
    from jghand_engine import cli
    from jghand_engine.cli.progress_json import PROGRESS_JSON

    assert PROGRESS_OPTION == PROGRESS_JSON
    for words in all_words(tmp_path):
        assert type(cli.parsed(list(words))).__name__.lower() == words[0]
