"""Only what a scene's light calls for: what is decided, what it says, and that a new light redoes the light alone."""

from dataclasses import replace

import numpy as np
import pytest
from small_avatars import trained_avatar
from test_effects import RIGHT, camera, counted, plan_of, pose

from jghand_engine.avatar.corrective_task import NetworkStep
from jghand_engine.avatar.posing import Poser
from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.render.backend import GLOSS, LIGHT, SKIN
from jghand_engine.render.effect_plan import OF_CAPTURE, OF_SCENE, Choice, Effect
from jghand_engine.render.renderer import Frame, HandRenderer, SceneRenderer
from jghand_engine.render.settings import RenderSettings

TRAINED = trained_avatar(1500)
FIST = pose("fist", TRAINED)
DAY = World(np.random.default_rng(0).random((8, 16, 3)).astype(np.float32))


def sun(strength: float, *place: float, **changes) -> Lamp:
    return Lamp(LampKind.SUN, (strength, strength, strength), place, **changes)


LAMPS = (sun(2, 0.3, 0.6, 1), sun(1, -1, 0.2, 0.4), sun(0.5, 1, 0.1, 0.3))
LIGHT_OF_DAY = SceneLight(DAY, LAMPS)
FAINT = sun(0.005, 0, 1, 0)


def lit(light: SceneLight, effects: str = "auto", avatar=TRAINED) -> SceneRenderer:
    return SceneRenderer([avatar], RenderSettings(effects=Choice.parse(effects)), light)


def reasons(frame: Frame) -> dict[Effect, str]:
    return {one.effect: one.reason for one in plan_of(frame).decisions if one.effect in OF_SCENE}


def test_each_light_has_effects_of_its_own():
    """In the light of the capture nothing is said of lamps, and in that of a scene nothing of learned shadows."""
    captured = HandRenderer(TRAINED).render(FIST, camera())
    shown = lit(LIGHT_OF_DAY).render([FIST], camera())
    assert {one.effect for one in plan_of(captured).decisions} == set(Effect) - OF_SCENE
    assert {one.effect for one in plan_of(shown).decisions} == set(Effect) - OF_CAPTURE
    away = lit(LIGHT_OF_DAY).render([FIST + np.array([0.3, 0.2, 1.2])], camera())
    assert {one.effect for one in plan_of(away).decisions} == set(Effect) - OF_CAPTURE


@pytest.mark.parametrize(
    ("light", "avatar", "wanted"),
    [
        (
            SceneLight(),
            TRAINED,
            (
                "the scene has no lamps",
                "no lamp casts a shadow",
                "presets final and reference ask for it",
                *["no light is on the hand"] * 2,
            ),
        ),
        (LIGHT_OF_DAY, RIGHT, ("a painted hand shines with its own colors",) * 5),
    ],
    ids=["darkness", "painted"],
)
def test_what_no_hand_takes_is_skipped_for_a_reason(light, avatar, wanted):
    frame = lit(light, avatar=avatar).render([FIST], camera())
    assert tuple(reasons(frame).values()) == wanted
    assert not any(plan_of(frame).runs(effect) for effect in OF_SCENE)


def task_of(renderer: SceneRenderer):
    light = renderer._backend._hands[0]._light
    assert light is not None
    assert light._scene is not None
    return light._scene.task, light._scene.arrays


def test_a_lamp_that_nobody_sees_costs_nothing():
    plain, more = lit(LIGHT_OF_DAY), lit(replace(LIGHT_OF_DAY, lamps=(FAINT, *LAMPS)))
    frames = [renderer.render([FIST], camera()) for renderer in (plain, more)]
    (task, arrays), (other, others) = task_of(plain), task_of(more)
    assert (task.lamps, task.slots) == (other.lamps, other.slots) == (3, 3)
    assert np.array_equal(arrays["lamp"], others["lamp"])
    assert np.array_equal(arrays["casting"], others["casting"])
    assert np.array_equal(frames[0].rgba, frames[1].rgba)
    costs = [plan_of(frame)[Effect.LAMPS].estimated_ms for frame in frames]
    assert costs[0] == costs[1]


def test_shadows_that_nobody_sees_are_left_out_and_what_that_saves_is_said():
    lone = SceneLight(DAY, (sun(0.006, 0.3, 0.6, 1),))
    skipped, drawn = (plan_of(lit(lone, effects).render([FIST], camera())) for effects in ("auto", "all"))
    assert "too faint" in skipped[Effect.LAMP_SHADOW].reason
    saved, spent = (plan[Effect.LAMP_SHADOW].estimated_ms for plan in (skipped, drawn))
    assert saved == spent > 0


def test_a_lamp_that_is_dragged_redoes_the_light_alone(monkeypatch):
    skinned = counted(monkeypatch, Poser, "prepare")
    corrected = counted(monkeypatch, NetworkStep, "prepare")
    renderer = lit(LIGHT_OF_DAY)
    first = renderer.render([FIST], camera())
    assert {SKIN, GLOSS} <= set(first.report.stages)
    for x in (0.4, 0.5):
        renderer.light = SceneLight(DAY, (sun(2, x, 0.6, 1), *LAMPS[1:]))
        frame = renderer.render([FIST], camera())
    assert skinned == corrected == [1]
    assert LIGHT in frame.report.stages
    assert SKIN not in frame.report.stages
    plan = plan_of(frame)
    assert [plan.runs(effect) for effect in (Effect.SKIN, Effect.LAMPS, Effect.LAMP_SHADOW)] == [False, True, True]
    assert plan[Effect.WORLD_SHADOW].reason == "pose and world are kept"
    assert np.array_equal(frame.rgba, lit(renderer.light).render([FIST], camera()).rgba)


def test_a_camera_that_moves_alone_redoes_the_gloss_alone():
    renderer = lit(LIGHT_OF_DAY)
    renderer.render([FIST], camera())
    moved = renderer.render([FIST], camera(side_m=0.2))
    assert [effect for effect in sorted(OF_SCENE) if plan_of(moved).runs(effect)] == [Effect.GLOSS]
    assert set(reasons(moved).values()) > {"pose and light are kept"}
    assert not {SKIN, LIGHT} & set(moved.report.stages)
    again = renderer.render([FIST], camera(side_m=0.2))
    assert not any(plan_of(again).runs(effect) for effect in OF_SCENE)
    assert GLOSS not in again.report.stages


@pytest.mark.parametrize("effect", [Effect.LAMP_SHADOW, Effect.WORLD_SHADOW, Effect.GLOSS])
def test_what_is_not_chosen_is_not_computed(effect):
    others = ",".join({Effect.LAMP_SHADOW, Effect.WORLD_SHADOW, Effect.GLOSS, Effect.CORRECTIVES} - {effect})
    renderer, without = lit(LIGHT_OF_DAY), lit(LIGHT_OF_DAY, others)
    whole, less = (each.render([FIST], camera()) for each in (renderer, without))
    assert plan_of(less)[effect].reason == "not among the chosen effects"
    assert float(np.abs(whole.rgba - less.rgba).max()) > 1e-3
    task, arrays = task_of(without)
    done = {
        Effect.LAMP_SHADOW: task.slots,
        Effect.WORLD_SHADOW: task.shade or arrays["visible"].any(),
        Effect.GLOSS: task.lobes or arrays["lamp"][:, 19].any(),
    }
    assert [one for one, was_done in done.items() if not was_done] == [effect]


def test_all_draws_every_lamp_and_its_shadow_and_auto_is_off_by_what_it_says():
    lamps = (*LAMPS, sun(0.02, -0.5, 0.3, 1), FAINT)
    auto = lit(SceneLight(DAY, lamps)).render([FIST], camera())
    everything = lit(SceneLight(DAY, lamps), "all").render([FIST], camera())
    assert reasons(everything)[Effect.LAMPS] == "5 lamps on the hand"
    assert reasons(everything)[Effect.LAMP_SHADOW] == "of 5 lamps"
    # FAINT is left out, of all light a thousandth; half of it would be drawn from four thousandths on
    assert 0 < plan_of(auto)[Effect.LAMPS].figures[0] < 0.4
    stated = sum(plan_of(auto)[effect].figures[0] for effect in (Effect.LAMPS, Effect.LAMP_SHADOW)) / 100
    # of the brightest that skin can be here, and what a box of its own rounds elsewhere
    brightest = float(everything.rgba.max())
    assert float(np.abs(auto.rgba - everything.rgba).max()) <= stated * brightest + 1 / 255
