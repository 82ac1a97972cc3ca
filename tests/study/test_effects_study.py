"""The study of effects: what is skipped on a motion, how wrong that is and what it saves."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_avatars import trained_avatar

from jghand_engine.avatar.file import save_avatar
from jghand_engine.cli import main
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.render.camera import Camera
from jghand_engine.render.effect_plan import Effect
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings, ShadowMode
from jghand_engine.render.subject import Subject
from jghand_engine.study import effects_study as study

AVATAR = trained_avatar(1500)


def subject(frames: int = 24) -> Subject:
    poses = study.named_motion(AVATAR, ("open", "fist"))
    poses = poses[np.linspace(0, len(poses) - 1, frames).astype(int)]
    middle = torch.from_numpy(poses.mean((0, 1)))
    eye = middle + torch.tensor([0.1, 0.1, 0.5], dtype=torch.float64)
    up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    view = Camera.looking_at(eye, middle, up, width=96, height=80, focal_px=200.0)
    return Subject("motion", AVATAR, poses, view)


def test_the_motion_rests_bends_and_moves_as_a_whole():
    ticks = []
    rows, strip = study.effects_of_motion(subject(), RenderSettings(threads=1), lambda: ticks.append(1))
    assert len(ticks) == 24
    assert any(strip[Effect.SKIN])
    assert not all(strip[Effect.SKIN])
    by_effect = {row.effect: row for row in rows}
    assert by_effect[Effect.SKIN].frames == 24
    skin = by_effect[Effect.SKIN].as_dict()
    assert 0 < skin["skipped"] < 24
    # frames that rest are the same to a bit, others within the limit of the joints
    assert skin["worst_error"] < 0.1


def test_tables_and_figures_say_the_same():
    rows, strip = study.effects_of_motion(subject(6), RenderSettings(threads=1), lambda: None)
    made = study.EffectsStudy("a test", rows, [], strip)
    (table,) = made.tables()
    assert len(table.rows) == len(rows) == len(made.as_dict()["effects"])


def test_a_tighter_gate_skips_more_and_says_the_worst_of_what_it_skips():
    rows = [
        study.GateRow("apart", 0.1, 0.0, 0.0, 0.01, (30.0, 30.1)),
        study.GateRow("near", 3.0, 1.0, 0.02, 0.05, (28.0, 30.0)),
        study.GateRow("fist", 50.0, 1.0, 0.3, 0.4, None),
    ]
    made = study.EffectsStudy("a test", [], rows, {})
    by_score = {row["score"]: row for row in made.gate_rows()}
    assert [row["skipped"] for row in by_score.values()] == [1, 1, 2, 2, 2, 3]
    assert by_score[4.0] == {
        "score": 4.0, "skipped": 2, "occluded": 0.02, "darkest": 0.05, "db_without": 29.0, "db_with": 30.05,
    }  # fmt: skip
    assert by_score[None]["darkest"] == 0.4
    *_, everything = made.tables()[1].rows
    assert everything[1] == "3 of 3"
    assert json.dumps(made.as_dict(), allow_nan=False)


@pytest.mark.parametrize("name", ["open", "fist"])
def test_the_gate_is_judged_by_the_shadow_that_would_be_drawn(name: str):
    joints = named_pose(name, AVATAR.canonical_joints_m, handedness=Handedness.RIGHT)
    view = replace(subject(2).camera, fx=400.0, fy=400.0, width=160, height=140, cx=80.0, cy=70.0)
    bare = HandRenderer(AVATAR, RenderSettings(shadow=ShadowMode.OFF))
    row = study.gate_row(bare, AVATAR, (name, joints, view))
    assert (row.strength == 0) == (name == "open")
    if name == "fist":
        drawn = HandRenderer(AVATAR, RenderSettings(shadow_samples=32)).render(joints, view).rgba
        plain = bare.render(joints, view).rgba
        assert row.darkest == pytest.approx(float(np.abs(drawn - plain).max()), abs=0.05)


def test_the_command_measures_tells_and_writes(tmp_path, capsys, monkeypatch):
    few = subject(9).poses
    monkeypatch.setattr(study, "named_motion", lambda avatar: few)
    save_avatar(tmp_path / "hand.jghand", AVATAR)
    out = tmp_path / "study"
    assert main(["study", "effects", str(tmp_path / "hand.jghand"), "--size", "64x48", "--out", str(out)]) == 0
    assert "The gate against the whole shadow" in capsys.readouterr().out
    rows = {row["effect"]: row for row in json.loads((out / "effects.json").read_text())["effects"]}
    # an error is measured only where the effect could be drawn
    assert rows["motion-blur"]["worst_error"] is None
    assert rows["motion-blur"]["skipped"] == rows["motion-blur"]["frames"] > 0
    assert (out / "effects.png").stat().st_size > 10_000
    assert (out / "effects_effects_skipped.csv").is_file()
