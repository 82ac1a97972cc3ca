"""A bake knows what it was made from, and takes the place of the one before and of nothing else."""

import contextlib
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy", reason="needs the bpy wheel of this Python")

from blender_addon.core.posing import rest_joints_m
from blender_addon.errors import JGHandFailure
from blender_addon.export import bakes, ops
from blender_addon.export.recording import Recording


def a_recording(name: str = "Hand") -> Recording:
    joints = np.tile(rest_joints_m("right"), (3, 1, 1)) + 0.01 * np.arange(3)[:, None, None]
    return Recording(name, "right", "builtin", joints, first_frame=7, fps=24.0)


def a_bake(folder: Path, recording: Recording) -> list[bakes.BakedHand]:
    """As a job leaves it, and put into its place."""
    made = folder.with_name(f".{folder.name}.made")
    made.mkdir()
    recording.save(made / f"{recording.name}.npz")
    (made / f"{recording.name}.usda").write_text("#usda 1.0\n")
    (made / f"{recording.name}.splats.usdc").touch()
    bakes.put_in_place(made, folder, [recording])
    made.rmdir()
    return bakes.read_bake(folder)


def test_a_bake_knows_what_it_was_made_from(tmp_path):
    recording = a_recording()
    (hand,) = a_bake(tmp_path / "bake", recording)
    assert (hand.first_frame, hand.last_frame, hand.fps) == (7, 9, 24.0)


def test_the_next_bake_takes_the_place_of_this_one_and_of_no_other_file(tmp_path):
    folder = tmp_path / "bake"
    a_bake(folder, a_recording("Hand"))
    for name in ("notes.txt", "Hand.txt", "other.usda"):
        (folder / name).write_text("mine")
    (hand,) = a_bake(folder, replace(a_recording("Hand"), first_frame=8))
    assert hand.first_frame == 8
    assert sorted(path.name for path in folder.iterdir()) == [
        *("Hand.npz", "Hand.splats.usdc", "Hand.txt", "Hand.usda"),
        *("bake.json", "notes.txt", "other.usda"),
    ]


class KilledError(BaseException):
    """As SIGKILL: nothing of the extension's runs after it."""


def test_a_bake_that_is_killed_at_any_move_leaves_a_whole_one_or_none(tmp_path, monkeypatch):
    replace_file, left, finished = os.replace, 0, []

    def counted(source, target):
        nonlocal left
        left -= 1
        if left < 0:
            raise KilledError
        replace_file(source, target)

    for moves in range(11):
        folder = tmp_path / str(moves) / "bake"
        folder.parent.mkdir()
        a_bake(folder, a_recording())
        left = moves
        monkeypatch.setattr(os, "replace", counted)
        with contextlib.suppress(KilledError):
            a_bake(folder, replace(a_recording(), first_frame=8))
        monkeypatch.setattr(os, "replace", replace_file)
        with contextlib.suppress(JGHandFailure):
            finished += [(moves, hand.first_frame) for hand in bakes.read_bake(folder)]
    # two moves before the first that touches the folder; four files out of it, and four into it
    assert finished == [(0, 7), (1, 7), (2, 7), (10, 8)]


def test_the_next_bake_sweeps_what_a_killed_one_left(tmp_path):
    left = ops._folder_beside(tmp_path / "Hand") / "Hand.splats.usdc"
    left.touch()
    assert not list(ops._folder_beside(tmp_path / "Hand").iterdir())


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: "",
        lambda content: "[]",
        lambda content: json.dumps({**json.loads(content), "hands": []}),
        lambda content: content.replace('"Hand"', '"../../Hand"'),
        lambda content: content.replace('"version": 1', '"version": 2'),
        lambda content: content.replace('"frames": 3', '"frames": "x"'),
        lambda content: content.replace('"fps"', '"f"'),
    ],
)
def test_a_damaged_stamp_is_no_bake(tmp_path, damage):
    a_bake(tmp_path / "bake", a_recording())
    stamp = tmp_path / "bake" / bakes.STAMP
    stamp.write_text(damage(stamp.read_text()))
    with pytest.raises(JGHandFailure) as caught:
        bakes.read_bake(tmp_path / "bake")
    assert caught.value.kind == "no_bake"


@pytest.mark.parametrize("lit", [False, True])
def test_in_solid_mode_which_shows_no_colors_of_points_a_bake_is_of_the_color_of_skin(context, lit):
    red, green, blue, alpha = bakes.points_material(lit=lit).diffuse_color
    assert red > green > blue > 0.1  # Blender's own gray is even
    assert alpha == 1
