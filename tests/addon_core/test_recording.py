"""What is exported and baked: names, sizes, stamps, and the words that the engine's command line understands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from blender_addon.core import limits
from blender_addon.core.posing import rest_joints_m
from blender_addon.errors import JGHandFailure
from blender_addon.export import bakes
from blender_addon.export.recording import (
    Recording,
    SizeEstimate,
    Written,
    avatar_digest,
    check_place,
    estimate,
    file_names,
    readable,
    remove_beyond,
    with_file_name,
)
from blender_addon.hand.motion_files import MotionFile, read_motion, write_motion
from blender_addon.renderer import engine_words
from blender_addon.renderer.engine_words import CaptureChoices, TrainChoices, UsdChoices


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


def test_names_beyond_ascii_are_told_apart_in_exports_of_two_days():
    assert file_names(["Рука"]) != file_names(["Ладонь"])


def test_files_of_one_folder_have_folders_of_their_own():
    assert with_file_name("//jghand_bake/{blend_name}", "/shots/one.blend") == "//jghand_bake/one"
    assert with_file_name("//jghand_bake/{blend_name}", "") == "//jghand_bake/untitled"
    assert with_file_name("//mine", "/shots/one.blend") == "//mine"


def test_frames_of_a_longer_sequence_are_removed_and_nothing_else(tmp_path):
    for name in ("Hand.0003", "Hand.0004", "Hand.10005", "Hand.-0001", "Hand.5", "Hand.R.0009", "Hand_2.0009", "a"):
        (tmp_path / f"{name}.ply").touch()
    remove_beyond(tmp_path, "Hand", range(3, 5))
    left = {path.stem for path in tmp_path.iterdir()}
    assert left == {"Hand.0003", "Hand.0004", "Hand.5", "Hand.R.0009", "Hand_2.0009", "a"}


@pytest.mark.parametrize(("folder", "saved", "fine"), [("", True, False), ("//x", False, False), ("//x", True, True)])
def test_a_folder_beside_a_file_needs_a_file(folder, saved, fine):
    if fine:
        check_place(folder, saved=saved)
    else:
        with pytest.raises(JGHandFailure) as caught:
            check_place(folder, saved=saved)
        assert caught.value.kind == "no_place"


# ---- motion files ----------------------------------------------------------------------------------------------------


def test_a_motion_that_is_written_is_read_back_to_the_bit(tmp_path):
    recording = a_recording()
    recording.save(tmp_path / "motion.npz")
    back = read_motion(tmp_path / "motion.npz")
    assert (back.joints_m == recording.joints_m).all()
    assert (back.fps, back.handedness, back.notes) == (24.0, "right", ())


def test_the_engine_reads_it_back_too(tmp_path):
    engine = pytest.importorskip("jghand_engine.motion.read", reason="needs the engine's packages")
    from jghand_engine.hand.orders import JointOrder, from_level

    recording = a_recording()
    recording.save(tmp_path / "motion.npz")
    back = engine.read_motion_file(tmp_path / "motion.npz").sequence
    assert (from_level(back.joints_m, JointOrder.STANDARD) == recording.joints_m).all()
    assert (back.fps, str(back.handedness)) == (24.0, "right")


def test_a_motion_has_no_other_suffix_than_its_own(tmp_path):
    with pytest.raises(JGHandFailure) as caught:
        write_motion(tmp_path / "motion.json", MotionFile(a_recording().joints_m, 24.0, "right"))
    assert caught.value.kind == "bad_motion"


def test_the_engine_stamps_a_motion_as_this_side_does(tmp_path):
    pytest.importorskip("safetensors", reason="needs the engine's packages")
    from jghand_engine.avatar.builtin import load_painted
    from jghand_engine.export import made_from
    from jghand_engine.hand.joints import Handedness
    from jghand_engine.motion.read import read_motion_file

    recording = a_recording()
    recording.save(tmp_path / "motion.npz")
    stamp = made_from.made_from(
        load_painted(handedness=Handedness.RIGHT), read_motion_file(tmp_path / "motion.npz").sequence
    )
    assert stamp["joints_sha256"] == recording.digest


# ---- sizes -----------------------------------------------------------------------------------------------------------


def test_sizes_are_said_in_few_digits():
    assert [readable(size) for size in (720e3, 4.08e6, 45.9e6, 1.34e9)] == ["720 kB", "4.1 MB", "46 MB", "1.3 GB"]


def test_a_disk_that_is_too_small_is_told():
    assert SizeEstimate(10, None).fits
    assert "only 1 kB are free" in SizeEstimate(10_000_000, 1000).sentence()


def test_estimates_are_translated_before_figures_are_put_in():
    words = {"Up to {size}": "Bis {size}", "Up to {size}, and only {free} are free": "Bis {size}, frei sind {free}"}
    assert SizeEstimate(10_000_000, None).sentence(words.__getitem__) == "Bis 10 MB"
    assert SizeEstimate(10_000_000, 1000).sentence(words.__getitem__) == "Bis 10 MB, frei sind 1 kB"


def test_the_estimate_of_an_export_is_its_size(tmp_path):
    """Of a motion without two frames alike. Worst observed: 5 % too much of a USD stage, which packs colors a bit."""
    pytest.importorskip("torch", reason="needs the engine's packages")
    from jghand_engine.avatar.builtin import load_builtin, load_painted
    from jghand_engine.export.splats.files import export_splats
    from jghand_engine.export.usd.package import export_usd
    from jghand_engine.hand.joints import Handedness
    from jghand_engine.motion.read import read_motion_file

    avatar = load_builtin(handedness=Handedness.RIGHT)
    still = a_recording(12)
    moving_m = still.joints_m + np.random.default_rng(0).normal(0, 2e-3, still.joints_m.shape)
    replace(still, joints_m=moving_m).save(tmp_path / "motion.npz")
    motion = read_motion_file(tmp_path / "motion.npz").sequence
    painted = load_painted(handedness=Handedness.RIGHT)
    for written, hand, ply, learned in (
        (export_splats(tmp_path / "ply", avatar, motion).bytes, avatar, True, True),
        (sum(export_usd(tmp_path / "usd", avatar, motion).bytes.values()), avatar, False, True),
        (sum(export_usd(tmp_path / "painted", painted, motion).bytes.values()), painted, False, False),
    ):
        size = estimate(tmp_path / "not" / "there", [(len(hand), learned)], len(motion), Written(ply=ply))
        assert size.fits
        assert size.bytes == pytest.approx(written, rel=0.1)


# ---- bakes -----------------------------------------------------------------------------------------------------------


def a_bake(folder: Path, recording: Recording) -> list[bakes.BakedHand]:
    """As a job leaves it."""
    folder.mkdir(exist_ok=True)
    recording.save(folder / f"{recording.name}.npz")
    (folder / f"{recording.name}.usda").write_text("#usda 1.0\n")
    made_from = {"engine_version": "0.1.0", "joints_sha256": recording.digest}
    (folder / f"{recording.name}.json").write_text(json.dumps({"gaussians": 9, "made_from": made_from}))
    bakes.write_stamp(folder, [recording])
    return bakes.read_bake(folder)


def test_a_bake_knows_what_it_was_made_from(tmp_path):
    recording = a_recording()
    (hand,) = a_bake(tmp_path, recording)
    assert (hand.first_frame, hand.frames, hand.fps, hand.gaussians) == (7, 3, 24.0, 9)
    assert bakes.stale_reasons(hand, recording=recording, engine_version="0.1.0") == []


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"first_frame": 8}, "frames"),
        ({"fps": 25.0}, "frame rate"),
        ({"joints_m": a_recording().joints_m + 1e-6}, "moves"),
        ({"avatar": "painted"}, "avatar"),
    ],
)
def test_a_bake_of_something_else_is_stale(tmp_path, change, word):
    recording = a_recording()
    (hand,) = a_bake(tmp_path, recording)
    (reason,) = bakes.stale_reasons(hand, recording=replace(recording, **change))
    assert word in reason


def test_a_bake_of_another_engine_is_stale_where_that_is_known(tmp_path):
    (hand,) = a_bake(tmp_path, a_recording())
    assert "engine" in bakes.stale_reasons(hand, engine_version="9.9")[0]
    assert bakes.stale_reasons(hand, engine_version=None) == []


def test_an_avatar_that_was_changed_on_disk_is_another_one(tmp_path):
    file = tmp_path / "a.jghand"
    file.write_bytes(b"one")
    before = avatar_digest(str(file))
    file.write_bytes(b"two")
    assert avatar_digest(str(file)) != before


def test_a_hand_that_moved_at_one_frame_is_seen(tmp_path):
    recording = a_recording()
    (hand,) = a_bake(tmp_path, recording)
    assert not bakes.moved_at(hand, tmp_path, 8.0, recording.joints_m[1])
    assert bakes.moved_at(hand, tmp_path, 8.0, recording.joints_m[1] + 1e-4)
    assert not bakes.moved_at(hand, tmp_path, 8.5, recording.joints_m[1] + 1)
    assert not bakes.moved_at(hand, tmp_path, 99.0, recording.joints_m[1] + 1)


def test_an_engine_that_wrote_another_motion_makes_no_bake(tmp_path):
    recording = a_recording()
    a_bake(tmp_path, recording)
    (tmp_path / bakes.STAMP).unlink()
    with pytest.raises(JGHandFailure, match="other joints"):
        bakes.write_stamp(tmp_path, [replace(recording, joints_m=recording.joints_m + 1)])
    with pytest.raises(JGHandFailure) as caught:
        bakes.read_bake(tmp_path)
    assert caught.value.kind == "no_bake"


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: "",
        lambda content: "[]",
        lambda content: "[" * 100000,
        lambda content: content.replace('"Hand"', '"../../Hand"'),
        lambda content: content.replace('"version": 1', '"version": 2'),
        lambda content: content.replace('"frames": 3', '"frames": "x"'),
        lambda content: content.replace('"fps"', '"f"'),
        lambda content: content + " " * limits.STAMP_MAX_BYTES,
    ],
)
def test_a_damaged_or_hostile_stamp_is_no_bake(tmp_path, damage):
    a_bake(tmp_path, a_recording())
    stamp = tmp_path / bakes.STAMP
    stamp.write_text(damage(stamp.read_text()))
    with pytest.raises(JGHandFailure) as caught:
        bakes.read_bake(tmp_path)
    assert caught.value.kind == "no_bake"


# ---- generations of bakes --------------------------------------------------------------------------------------------


def finished(folder: Path, owner: str) -> Path:
    generation = bakes.new_generation(folder)
    recording = a_recording()
    a_bake(generation, recording)
    bakes.write_stamp(generation, [recording], owner)
    return generation


def test_every_bake_has_a_folder_of_its_own(tmp_path):
    first = finished(tmp_path / "Hand", "shot:a")
    second, third = (bakes.new_generation(tmp_path / "Hand") for _ in range(2))
    assert [path.name for path in (first, second, third)] == ["v0001", "v0002", "v0003"]


def test_bakes_of_another_owner_are_neither_joined_nor_removed(tmp_path):
    theirs = finished(tmp_path / "Hand", "other:b")
    assert bakes.hand_folder(tmp_path, "Hand", "shot:a") == tmp_path / "Hand_2"
    assert bakes.hand_folder(tmp_path, "Hand", "other:b") == tmp_path / "Hand"
    bakes.remove(theirs, "shot:a")
    assert bakes.read_bake(theirs)


def test_what_is_removed_is_the_bake_and_nothing_that_is_not_of_it(tmp_path):
    old = finished(tmp_path / "Hand", "shot:a")
    (old / "Hand.cache").mkdir()
    (old / "Hand.cache" / "Hand.0001.splat").touch()
    (old / "notes.txt").touch()
    bakes.remove(old, "shot:a")
    assert [path.name for path in old.rglob("*")] == ["notes.txt"]
    unfinished = bakes.new_generation(tmp_path / "Other")
    a_recording().save(unfinished / "Hand.npz")
    bakes.remove_unfinished(unfinished)
    assert not (tmp_path / "Other").exists()


def test_only_what_is_unfinished_is_removed_as_such(tmp_path):
    done = finished(tmp_path / "Hand", "shot:a")
    bakes.remove_unfinished(done)
    assert bakes.read_bake(done)


def test_undo_to_a_bake_that_was_replaced_finds_the_newest_of_the_same_hand(tmp_path):
    first, second = (finished(tmp_path / "Hand", "shot:a") for _ in range(2))
    finished(tmp_path / "Hand", "other:b")
    assert bakes.newest(first, "shot:a") == first
    bakes.remove(first, "shot:a")
    assert bakes.newest(first, "shot:a") == second


def test_a_bake_whose_stage_is_gone_is_none(tmp_path):
    (hand,) = a_bake(tmp_path, a_recording())
    hand.stage(tmp_path).unlink()
    with pytest.raises(JGHandFailure):
        bakes.read_bake(tmp_path)


# ---- the words of jobs -----------------------------------------------------------------------------------------------


def all_words() -> list[tuple[str, ...]]:
    recording, there = a_recording(first_frame=-3), Path("/a folder")
    capture = CaptureChoices("3", 16, 60, (334, 512), 16, 0, 0)
    training = TrainChoices("paper-faithful", 12.5, 3, True, True)
    return [
        engine_words.export_usd(recording, there / "m.npz", there, there / "f.json", UsdChoices("points")),
        engine_words.export_ply(recording, there / "m.npz", there, there / "f.json", "rub"),
        engine_words.capture(there, capture),
        engine_words.capture(there, capture, there / "m.npz"),
        *(engine_words.train(there, there / "a.jghand", training, start) for start in ("", "resume", "fresh")),
    ]


def test_programs_are_suited_as_the_engine_does_it():
    pytest.importorskip("torch", reason="needs the engine's packages")
    from jghand_engine.export.usd.package import PRESETS

    wanted = {name: (str(preset.variant), preset.width_factor) for name, preset in PRESETS.items()}
    assert wanted == engine_words.USD_PRESETS


@pytest.mark.parametrize("words", all_words(), ids=lambda words: " ".join(words[:2]))
def test_the_engine_understands_the_words_of_a_job(words):
    pytest.importorskip("tyro", reason="needs the engine's packages")
    from blender_addon.renderer.jobs import PROGRESS_OPTION
    from jghand_engine import cli

    verb = cli.parsed([*words, PROGRESS_OPTION])
    assert type(verb).__name__.lower() == words[0]
    assert verb.report.progress_json
