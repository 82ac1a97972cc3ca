"""The study of effects: what is skipped on a motion, how wrong that is and what it saves."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_avatars import trained_avatar

from jghand_engine.avatar.file import save_avatar
from jghand_engine.cli import main
from jghand_engine.render.camera import Camera
from jghand_engine.render.effect_plan import Effect
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings, ShadowMode
from jghand_engine.render.subject import Subject
from jghand_engine.study import effects as study
from jghand_engine.study import effects_in_light
from jghand_engine.study.effects_in_light import light_table, measure_lights
from jghand_engine.study.report import plain

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
    assert 0 < by_effect[Effect.SKIN].skipped < 24
    # frames that rest are the same to a bit, others within the limit of the skin
    assert max(by_effect[Effect.SKIN].errors) < 0.1
    # the largest of each kind of bound is told, and not that of every frame
    assert len(by_effect[Effect.SKIN].bounds) <= 2


def test_the_error_of_a_skipped_effect_is_the_largest_difference_that_it_makes():
    plain_hand = replace(subject(3), avatar=replace(AVATAR, learned=None))
    settings = RenderSettings(threads=1)
    rows, _strip = study.effects_of_motion(plain_hand, settings, lambda: None)
    (row,) = (row for row in rows if row.effect is Effect.SHADOW)
    without, always = (
        HandRenderer(plain_hand.avatar, replace(settings, shadow=mode)) for mode in (ShadowMode.OFF, ShadowMode.ALWAYS)
    )
    expected = [
        np.abs(without.render(joints, plain_hand.camera).rgba - always.render(joints, plain_hand.camera).rgba).max()
        for joints in plain_hand.poses
    ]
    assert min(expected) > 0.05
    np.testing.assert_allclose(row.errors, expected, atol=1e-6)
    (table,) = study.EffectsStudy("a test", rows, {}).tables()
    (told,) = (cells[2] for cells in table.rows if cells[0] == Effect.SHADOW)
    assert float(told) == pytest.approx(255 * max(expected), rel=0.05)


def test_tables_and_figures_say_the_same():
    rows, strip = study.effects_of_motion(subject(6), RenderSettings(threads=1), lambda: None)
    made = study.EffectsStudy("a test", rows, strip)
    (table,) = made.tables()
    assert len(table.rows) == len(rows) == len(plain(made)["effects"])


def test_in_the_light_of_a_scene_what_is_left_out_is_told_and_not_seen(monkeypatch):
    monkeypatch.setattr(effects_in_light, "FRAMES", 3)
    rows = {row.name: row for row in measure_lights(subject(), RenderSettings(threads=1))}
    captured, *scenes = rows.values()
    world, lamps, weak, dragged = scenes
    # what a scene's light costs is told beside what stands there without one
    assert captured.skipped == []
    assert len(captured.ms) == 3
    assert "lamps: the scene has no lamps" in world.skipped
    assert lamps.skipped == []
    assert [told.split(":")[0] for told in weak.skipped] == ["lamps"]
    assert "1 lamp left out" in weak.skipped[0]
    assert dragged.skipped == ["world-shadow: pose and world are kept"]
    assert all(len(row.errors) == len(row.ms) == len(row.all_ms) for row in rows.values())
    # what the hand's box, drawn alone, rounds elsewhere; a weak lamp beside
    assert max(max(row.errors) for row in scenes) < 1.5 / 255
    assert len(light_table(list(rows.values())).rows) == 5


def test_a_hand_that_no_scene_lights_is_measured_in_its_own_light_alone():
    assert measure_lights(replace(subject(), avatar=replace(AVATAR, learned=None)), RenderSettings(threads=1)) == []


def test_the_command_measures_tells_and_writes(tmp_path, capsys, monkeypatch):
    few = subject(9).poses
    monkeypatch.setattr(effects_in_light, "FRAMES", 2)
    monkeypatch.setattr(study, "named_motion", lambda avatar: few)
    save_avatar(tmp_path / "hand.jghand", AVATAR)
    out = tmp_path / "study"
    assert main(["study", "effects", str(tmp_path / "hand.jghand"), "--size", "64x48", "--out", str(out)]) == 0
    assert "Effects skipped" in capsys.readouterr().out
    rows = {row["effect"]: row for row in json.loads((out / "effects.json").read_text())["effects"]}
    # an error is measured only where the effect could be drawn
    assert rows["motion-blur"]["errors"] == []
    assert rows["motion-blur"]["skipped"] == rows["motion-blur"]["frames"] > 0
    assert (out / "effects.png").stat().st_size > 10_000
    assert (out / "effects_effects_skipped.csv").is_file()
    assert (out / "effects_in_the_light_of_a_scene.csv").is_file()
