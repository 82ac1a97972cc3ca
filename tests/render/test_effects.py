"""Only the effects a scene calls for: what is decided, that what is skipped costs nothing and is not missed."""

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from small_avatars import coarse_builtin, ellipsoid_avatar, trained_avatar

from jghand_engine.avatar.avatar import HandAvatar, LearnedFrom
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.corrective_task import NetworkStep
from jghand_engine.avatar.correctives import CorrectiveChange, PoseNetShape
from jghand_engine.avatar.posing import Poser
from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.avatar.tiers import Tier
from jghand_engine.color import srgb_to_linear
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.shapes import pose_names
from jghand_engine.hand.skeleton import Bones
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.pose_features import Angles
from jghand_engine.learn.skinning import skin_maps
from jghand_engine.learn.tensors import HandTensors
from jghand_engine.native import contract
from jghand_engine.native import library as native_library
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.render import backend, blur, effects
from jghand_engine.render.blur import Moment, shutter_at, way_px
from jghand_engine.render.camera import Camera, Lens
from jghand_engine.render.crop import View, views_box
from jghand_engine.render.effect_plan import CHOOSABLE, NOT_CHOSEN, OF_SCENE, Choice, Effect, EffectPlan
from jghand_engine.render.effects import CROP_SHADOW, SHADOW_MISSED
from jghand_engine.render.hand_facts import HandFacts
from jghand_engine.render.image import Box
from jghand_engine.render.renderer import Frame, HandRenderer, SceneRenderer
from jghand_engine.render.settings import PRESETS, RenderSettings, ShadowMode, preset

RIGHT = load_painted(handedness=Handedness.RIGHT)
TRAINED = trained_avatar(3000)
# ... from pictures whose pixels are large
COARSE = replace(TRAINED, info=replace(TRAINED.info, learned_from=LearnedFrom("it", "all", 1, "0", pixel_m=4e-3)))
SMALL = RenderSettings(gaussians=4000)
ALL = Choice.parse("all")
WHOLE = replace(SMALL, effects=Choice(forced=frozenset([Effect.WHOLE])))
# cut-off of preset final: contributions between this and 1/255 are the faint tail
TAIL_ALPHA_MIN = 1 / 1024
pytestmark = pytest.mark.skipif(not native_library.runnable_variants(), reason="no native variant runs here")


def pose(name: str, avatar=RIGHT) -> np.ndarray:
    return named_pose(name, avatar.canonical_joints_m, handedness=Handedness.RIGHT)


def camera(width: int = 200, height: int = 160, *, away_m: float = 0.5, focal_px: float = 300.0, side_m: float = 0.15):
    eye, target = (side_m, 0.18, away_m), (0, 0.08, 0)
    return Camera.looking_at(eye, target, (0, 1, 0), width=width, height=height, focal_px=focal_px)


def difference(first: Frame, second: Frame) -> float:
    return float(np.abs(first.rgba - second.rgba).max())


def scene_of(joints_m: Sequence[np.ndarray], bones: Sequence[Bones], view: Camera) -> effects.Scene:
    """New poses in the light of their captures."""
    return effects.Scene(joints_m, bones, view, moved_m=None, reshaped=True, lit=None)


def box_of(scene: effects.Scene, hands: Sequence[HandFacts]) -> Box:
    return views_box(scene.views(hands, contract.ALPHA_MIN), contract.ALPHA_MIN)


def most_outside(frame: Frame, box: Box) -> float:
    """The largest alpha beside a box."""
    alpha = frame.rgba[..., 3].copy()
    alpha[box.slices] = 0
    return float(alpha.max())


def plan_of(frame: Frame):
    assert frame.report.plan is not None
    return frame.report.plan


def skipped_worst(plan) -> float:
    """Sum of what the skipped effects may change of a channel; infinite where one has no such bound."""
    return sum(float("inf") if one.worst is None else one.worst for one in plan.decisions if not one.runs)


# ---- the choice -----------------------------------------------------------------------------------------------------


def test_a_choice_is_read_as_it_is_written():
    assert Choice.parse("auto") == Choice()
    assert all(Choice.parse("all").forces(effect) for effect in CHOOSABLE)
    assert not any(Choice.parse("none").allows(effect) for effect in CHOOSABLE)
    some = Choice.parse("self-shadow, filter")
    assert some.allows(Effect.SHADOW)
    assert not some.allows(Effect.CAST)
    assert not some.forces(Effect.SHADOW)


@pytest.mark.parametrize("text", ["auto", "all", "none", "filter", "filter,self-shadow"])
def test_a_choice_is_written_as_it_is_read(text: str):
    assert str(Choice.parse(text)) == text
    assert json.loads(json.dumps(replace(SMALL, effects=Choice.parse(text)).as_dict()))["effects"] == text


@pytest.mark.parametrize("text", ["", "shadows", "all,filter", "skin"])
def test_an_unknown_effect_is_refused_by_name(text: str):
    with pytest.raises(InputError, match=r"effects: wanted auto \| all \| none"):
        Choice.parse(text)


def test_the_estimate_of_a_shadow_grows_with_its_samples_and_the_hand():
    def estimate(samples: int, focal_px: float) -> float:
        settings = replace(SMALL, shadow=ShadowMode.ALWAYS, shadow_samples=samples)
        plan = plan_of(HandRenderer(RIGHT, settings).render(pose("fist"), camera(focal_px=focal_px)))
        return plan[Effect.SHADOW].estimated_ms

    assert estimate(32, 150.0) == pytest.approx(2 * estimate(16, 150.0))
    assert estimate(16, 300.0) == pytest.approx(4 * estimate(16, 150.0), rel=0.01)
    assert estimate(16, 150.0) > 0


def test_the_estimate_of_blur_is_that_of_all_gaussians_in_every_further_picture():
    for gaussians, shift_m in ((500, 0.005), (1000, 0.005), (500, 0.02)):
        renderer = HandRenderer(RIGHT, replace(SMALL, gaussians=gaussians))
        plan = plan_of(renderer.render_moments(moving(shift_m, camera()), EVEN))
        each_ms = gaussians * (effects.RASTER_MS + effects.SKIN_MS)
        assert plan.runs(Effect.MOTION)
        assert plan[Effect.MOTION].estimated_ms == pytest.approx((plan.exposures - 1) * each_ms)


@pytest.mark.parametrize(
    "light", [None, SceneLight(World(np.ones((8, 16, 3))), (Lamp(LampKind.SUN, (3, 3, 3), (0.3, 0.6, 1)),))],
    ids=["its own light", "a scene's"],
)  # fmt: skip
def test_no_effect_is_said_to_cost_less_than_microseconds_or_more_than_a_frame(light: SceneLight | None):
    """Of the built-in hand, some ten thousand Gaussians: what its parts take on any machine."""
    avatar = load_builtin(handedness=Handedness.RIGHT)
    settings = replace(preset("viewport"), effects=ALL)
    frame = HandRenderer(avatar, settings, light).render(pose("fist", avatar), camera())
    costs = {one.effect: one.estimated_ms for one in plan_of(frame).decisions if one.estimated_ms}
    assert len(costs) >= 6
    assert min(costs.values()) > 0.005, costs
    assert max(costs.values()) < 50, costs


def test_correctives_are_said_to_cost_what_their_tier_does():
    for avatar, each_ms in (
        (TRAINED, effects.NETWORK_MS),
        (load_builtin(handedness=Handedness.RIGHT), effects.LINEAR_MS),
    ):
        plan = plan_of(HandRenderer(avatar, preset("viewport")).render(pose("fist", avatar), camera()))
        assert plan[Effect.CORRECTIVES].estimated_ms == pytest.approx(len(avatar) * each_ms)


@pytest.mark.parametrize("avatar", [RIGHT, TRAINED, ellipsoid_avatar(1000)], ids=["painted", "trained", "ellipsoids"])
def test_of_a_large_picture_with_a_small_hand_no_more_than_a_quarter_is_drawn(avatar):
    view = camera(1024, 1024, focal_px=200.0)
    plan = plan_of(HandRenderer(avatar, SMALL).render(pose("open", avatar), view))
    assert not plan.runs(Effect.WHOLE)
    assert plan.box.width * plan.box.height < 1024 * 1024 / 4


def test_what_blur_misses_is_said_in_percent():
    plan = plan_of(HandRenderer(RIGHT, SMALL).render_moments(moving(0.02, camera()), EVEN))
    travel_px, count = plan[Effect.MOTION].figures[0], plan.exposures
    missed = 100 * blur.motion_error(travel_px, count)
    wanted = f"joints travel {travel_px:.1f} px, {count} images, which miss {missed:.1g} % of an edge's contrast"
    assert plan[Effect.MOTION].reason == wanted
    assert 0 < missed <= 100 * blur.MOTION_ERROR_MAX


def test_every_effect_is_decided_about_once_and_has_a_line():
    frame = HandRenderer(RIGHT, SMALL).render(pose("open"), camera())
    decided = [decision.effect for decision in plan_of(frame).decisions]
    assert sorted(decided) == sorted(set(Effect) - OF_SCENE)
    lines = frame.report.lines()
    for effect in decided:
        assert any(line.startswith(str(effect)) for line in lines)
    assert len(frame.report.as_dict()["effects"]) == len(decided)


# ---- auto is all ----------------------------------------------------------------------------------------------------

APART_M = np.array([0.1, 0.0, 0.0])
SCENES = {
    "fingers apart": ([pose("spread")], camera()),
    "fist": ([pose("fist")], camera()),
    "close-up": ([pose("relaxed")], camera(away_m=0.12)),
    "tiny": ([pose("fist")], camera(400, 300, focal_px=60.0)),
    "wide angle": ([pose("open")], camera(400, 160, focal_px=60.0, away_m=0.1)),
    "two hands near": ([pose("open"), pose("fist") + APART_M], camera()),
    "two hands far": ([pose("open"), pose("fist") + 4.5 * APART_M], camera(focal_px=120.0, away_m=0.8)),
    "two hands interlocked": ([pose("spread"), pose("spread") + 0.12 * APART_M], camera()),
    "half behind the camera": ([pose("open")], camera(away_m=-0.06, side_m=0.0, focal_px=150.0)),
}
# worst difference of a channel between `auto` and `all` that was measured, 8-bit steps
MEASURED_STEPS = {
    "fingers apart": 32.84,
    "fist": 33.32,
    "close-up": 0.0,
    "tiny": 15.73,
    "wide angle": 21.97,
    "two hands near": 0.0,
    "two hands far": 28.84,
    "two hands interlocked": 0.0,
    "half behind the camera": 35.92,
}


def auto_and_all(avatars, joints, view) -> tuple[float, float, Frame]:
    """Worst difference of a channel, 0..1, what the receipt states of it, and the frame of `auto`."""
    settings = replace(SMALL, alpha_min=TAIL_ALPHA_MIN)
    auto, everything = (
        SceneRenderer(avatars, replace(settings, effects=choice)).render(joints, view) for choice in (Choice(), ALL)
    )
    plan = plan_of(auto)
    stated = skipped_worst(plan) + 1.1e-4
    if 0 < plan.strength < 1:
        # it fades in with the gate and with the size of the hand
        stated += (1 - plan.strength) * SHADOW_MISSED
    return difference(auto, everything), stated, auto


@pytest.mark.parametrize("name", SCENES)
def test_auto_is_all_within_what_the_receipt_says(name: str):
    joints, view = SCENES[name]
    error, stated, _ = auto_and_all([RIGHT] * len(joints), joints, view)
    assert error <= stated < 0.4
    assert 255 * error <= 1.05 * MEASURED_STEPS[name] + 0.1


# ten others are taken by JGHAND_FIRST_SEED=10
FIRST_SEED = int(os.environ.get("JGHAND_FIRST_SEED", "0"))


@pytest.mark.parametrize("seed", range(FIRST_SEED, FIRST_SEED + 10))
def test_bounds_hold_on_random_scenes(seed: int):
    """Any pose, one hand or two, from anywhere: also from between the fingers and with the hand behind the camera."""
    rng = np.random.default_rng(seed)
    avatars = [(RIGHT, TRAINED)[rng.integers(2)] for _ in range(rng.integers(1, 3))]
    joints = [pose(str(rng.choice(pose_names())), avatar) + rng.normal(0, 0.08, 3) for avatar in avatars]
    eye_m, target_m = rng.normal(0, rng.choice([0.05, 0.2, 0.8]), 3), rng.normal(0, 0.05, 3)
    focal_px = float(rng.choice([60.0, 150.0, 600.0]))
    view = Camera.looking_at(eye_m, target_m, (0.1, 1.0, 0.2), width=160, height=120, focal_px=focal_px)
    error, stated, _ = auto_and_all(avatars, joints, view)
    assert error <= stated


@pytest.mark.parametrize(
    ("effect", "avatar", "focal_px"),
    [(Effect.CORRECTIVES, TRAINED, 300.0), (Effect.CAST, TRAINED, 300.0), (Effect.SHADOW, RIGHT, 900.0),
     (Effect.SHADOW, TRAINED, 900.0), (Effect.FILTER, RIGHT, 60.0), (Effect.FILTER, TRAINED, 60.0)],
)  # fmt: skip
def test_what_an_image_would_lack_is_said_of_what_runs_and_of_what_was_not_chosen(effect, avatar, focal_px: float):
    joints, view = pose("fist", avatar), camera(focal_px=focal_px)
    others = Choice(frozenset(CHOOSABLE) - {effect})
    whole, without = (
        HandRenderer(avatar, replace(SMALL, effects=choice)).render(joints, view) for choice in (Choice(), others)
    )
    missed = float(np.abs(whole.rgba.clip(0, 1) - without.rgba.clip(0, 1)).max())
    assert missed > 1e-3
    assert plan_of(whole).runs(effect)
    assert not plan_of(without).runs(effect)
    for plan in (plan_of(whole), plan_of(without)):
        worst = plan[effect].worst
        assert worst is None or worst >= missed


@pytest.mark.parametrize("avatar", [RIGHT, TRAINED, ellipsoid_avatar(1000)], ids=["painted", "trained", "ellipsoids"])
@pytest.mark.parametrize("name", SCENES)
def test_but_for_the_gate_auto_is_all_to_the_cut_off(name: str, avatar):
    joints, view = SCENES[name]
    settings = replace(SMALL, alpha_min=TAIL_ALPHA_MIN)
    hands = [avatar] * len(joints)
    auto = SceneRenderer(hands, settings).render(joints, view)
    forced = frozenset(CHOOSABLE) - {Effect.SHADOW}
    everything = SceneRenderer(hands, replace(settings, effects=Choice(forced=forced))).render(joints, view)
    # what is drawn in a box rounds the centers of pixels, and the samples of the shadow, elsewhere
    bound = TAIL_ALPHA_MIN + (CROP_SHADOW if plan_of(auto).strength > 0 else 0.0)
    assert difference(auto, everything) <= bound


def test_preset_viewport_keeps_50_db_without_the_faint_tail():
    joints, view = pose("relaxed"), camera(300, 240, focal_px=500.0)
    short, long = (
        HandRenderer(RIGHT, RenderSettings(shadow=ShadowMode.OFF, alpha_min=cut)).render(joints, view).rgba
        for cut in (contract.ALPHA_MIN, TAIL_ALPHA_MIN)
    )
    lost_db = -10 * np.log10(float(((short - long) ** 2).mean()))
    assert lost_db > 50  # observed 51.1 on the painted hand, 54.9 on the trained one


# ---- what is skipped costs nothing ----------------------------------------------------------------------------------


def counted(monkeypatch, owner: object, name: str) -> list[int]:
    calls, real = [0], getattr(owner, name)

    def counting(self, *arguments, **named):
        calls[0] += 1
        return real(self, *arguments, **named)

    monkeypatch.setattr(owner, name, counting)
    return calls


def test_a_camera_that_moves_alone_asks_for_no_skin_and_no_correctives(monkeypatch):
    skinned = counted(monkeypatch, Poser, "prepare")
    corrected = counted(monkeypatch, NetworkStep, "prepare")
    renderer = HandRenderer(TRAINED, SMALL)
    for side_m in (0.1, 0.15, 0.2):
        frame = renderer.render(pose("relaxed", TRAINED), camera(side_m=side_m))
    assert skinned == corrected == [1]
    assert not plan_of(frame).runs(Effect.SKIN)
    assert not plan_of(frame).runs(Effect.CORRECTIVES)


def test_a_hand_that_moves_as_a_whole_keeps_its_correctives(monkeypatch):
    corrected = counted(monkeypatch, NetworkStep, "prepare")
    renderer, joints, view = HandRenderer(TRAINED, SMALL), pose("relaxed", TRAINED), camera()
    renderer.render(joints, view)
    turn = torch.linalg.matrix_exp(
        torch.tensor([[0.0, -0.3, 0.1], [0.3, 0.0, 0.2], [-0.1, -0.2, 0.0]]).double()
    ).numpy()
    moved = joints @ turn.T + np.array([0.01, 0.0, 0.02])
    kept = renderer.render(moved, view)
    assert corrected == [1]
    decision = plan_of(kept)[Effect.CORRECTIVES]
    assert (decision.reason, decision.bound) == ("the hand moved as a whole", "0.05 mm of skin")
    fresh = HandRenderer(TRAINED, SMALL).render(moved, view)
    assert difference(kept, fresh) < 2e-4
    renderer.render(pose("fist", TRAINED), view)
    assert corrected == [3]


@pytest.mark.parametrize("tier", [Tier.EXACT, Tier.LINEAR])
def test_correctives_change_by_no_more_than_the_weights_allow(tier: Tier):
    avatar = load_builtin(handedness=Handedness.RIGHT).prefix(2000)
    assert avatar.learned is not None
    learned = avatar.learned.with_tier(tier)[0]
    assert learned.correctives is not None
    change, generator = CorrectiveChange(learned.correctives), torch.Generator().manual_seed(0)
    net, transform = HandTensors.of(replace(avatar, learned=learned)).learned.correctives, transform_of(avatar)
    for name in ("open", "relaxed", "fist"):
        frames = transform.frames(torch.from_numpy(pose(name, avatar)))
        angles = torch.cat([frames.angles.flatten(), frames.palm_p, frames.palm_n])
        for size_rad in (2e-4, 0.01, 0.3):
            step = size_rad * torch.randn(37, generator=generator, dtype=torch.float64).sign()
            with torch.no_grad():
                before, after = (net(Angles.of(a.float())) for a in (angles, angles + step))
            most_m, most_shade = change(angles.numpy(), (angles + step).numpy())
            assert float((after.offset_m - before.offset_m).norm(dim=-1).max()) <= most_m
            assert float((after.shade - before.shade).abs().max()) <= most_shade


def test_one_finger_joint_that_bends_makes_the_correctives_new():
    """However many others keep still: what counts is the largest change, and not their mean."""
    avatar = load_builtin(handedness=Handedness.RIGHT).prefix(500)
    facts, bones = HandFacts(avatar), avatar.skeleton().bones(pose("relaxed", avatar))
    assert effects.same_shape(facts, bones, bones.angles_rad, SMALL)
    for angle in range(30):
        bent = bones.angles_rad.copy()
        bent[angle] += 2e-3
        assert min(facts.corrective_change(bones.angles_rad, bent)) > 0
    bent = bones.angles_rad.copy()
    bent[0] += 2e-3
    assert not effects.same_shape(facts, replace(bones, angles_rad=bent), bones.angles_rad, SMALL)


@pytest.mark.parametrize("repeatable", [False, True])
def test_creases_are_shaded_anew_where_correctives_move_nothing(repeatable: bool, monkeypatch):
    corrected = counted(monkeypatch, NetworkStep, "prepare")
    shape = PoseNetShape(octaves=(4, 4, 2), angle_channels=8, angle_texels=6, hidden=32, reach_m=0.0)
    avatar, settings = trained_avatar(500, shape=shape), replace(SMALL, repeatable=repeatable)
    renderer = HandRenderer(avatar, settings)
    renderer.render(pose("relaxed", avatar), camera())
    bent = renderer.render(pose("fist", avatar), camera())
    assert corrected == [2]
    assert np.array_equal(bent.rgba, HandRenderer(avatar, settings).render(pose("fist", avatar), camera()).rgba)


# where no hand can be seen: behind the camera, beside it, and above it
ELSEWHERE = {
    "behind": [0.0, 0.0, 1.5],
    "beside": [1.0, 0.0, -0.5],
    "above": [0.0, -1.5, 0.0],
    "beside the camera itself": [2.0, 0.0, 0.0],
}


@pytest.mark.parametrize("where", ELSEWHERE)
def test_nothing_is_posed_for_a_hand_that_is_not_in_the_picture(where: str, monkeypatch):
    skinned, corrected = counted(monkeypatch, Poser, "prepare"), counted(monkeypatch, NetworkStep, "prepare")
    drawn = counted(monkeypatch, backend.Backend, "draw")
    renderer = HandRenderer(TRAINED, replace(SMALL, ids=True, normals=True))
    away = renderer.render(pose("relaxed", TRAINED) + ELSEWHERE[where], camera())
    assert skinned == corrected == drawn == [0]
    assert not any(values.any() for values in (away.rgba, away.depth_m, away.normal, away.ids))
    assert away.rgba.shape == (160, 200, 4)
    assert not renderer.bone_ids(camera()).any()
    assert not any(one.runs or one.worst for one in plan_of(away).decisions)
    assert plan_of(away).enlarged == 1
    everything = HandRenderer(TRAINED, replace(SMALL, effects=ALL))
    assert not everything.render(pose("relaxed", TRAINED) + ELSEWHERE[where], camera()).rgba.any()
    # and it is there as soon as it comes in
    before = skinned[0]
    here = renderer.render(pose("relaxed", TRAINED), camera())
    assert skinned[0] == before + 1
    assert np.array_equal(here.rgba, HandRenderer(TRAINED, SMALL).render(pose("relaxed", TRAINED), camera()).rgba)
    assert renderer.bone_ids(camera()).any()
    renderer.render(pose("relaxed", TRAINED) + ELSEWHERE[where], camera())
    assert not renderer.bone_ids(camera()).any()


@pytest.mark.parametrize("where", ELSEWHERE)
def test_of_two_hands_one_that_is_not_in_the_picture_is_not_posed(where: str, monkeypatch):
    skinned, corrected = counted(monkeypatch, Poser, "prepare"), counted(monkeypatch, NetworkStep, "prepare")
    # shadow and filter are of both hands: what asks for them may be the other one, so that nothing pops as it leaves
    settings = replace(SMALL, ids=True, threads=1, shadow=ShadowMode.OFF, antialias=False)
    here = pose("relaxed", TRAINED)
    both = SceneRenderer([TRAINED, TRAINED], settings)
    frame = both.render([here, here + ELSEWHERE[where]], camera())
    assert skinned == corrected == [1]
    alone = HandRenderer(TRAINED, settings).render(here, camera())
    for name in ("rgba", "depth_m", "ids"):
        assert np.array_equal(getattr(frame, name), getattr(alone, name))
    assert frame.report.invalid_gaussians == alone.report.invalid_gaussians == 0
    assert frame.report.visible_gaussians == alone.report.visible_gaussians


def test_a_hand_that_rests_is_posed_when_the_camera_finds_it(monkeypatch):
    skinned = counted(monkeypatch, Poser, "prepare")
    settings, here = replace(SMALL, threads=1), pose("relaxed", TRAINED)
    joints_m, wide = [here, here - [0.5, 0.0, 0.0]], camera(focal_px=60.0)
    close = camera(focal_px=400.0)
    renderer = SceneRenderer([TRAINED, TRAINED], settings)
    renderer.render(joints_m, close)
    assert skinned == [1]
    found = renderer.render(joints_m, wide)
    assert skinned == [3]
    assert np.array_equal(found.rgba, SceneRenderer([TRAINED, TRAINED], settings).render(joints_m, wide).rgba)
    renderer.render(joints_m, close)
    renderer.render(joints_m, wide)
    # what was posed stays posed
    assert skinned == [5]


def test_pictures_are_as_fresh_ones_whoever_was_hidden_before():
    """Two lit hands with detail: one is hidden and found, the light changes meanwhile, and a shutter is open."""
    avatar, rng = coarse_builtin(600, 64), np.random.default_rng(4)
    settings = replace(SMALL, gaussians=0, threads=1, repeatable=True, ids=True)
    lights = [
        SceneLight(lamps=(Lamp(LampKind.SUN, (3.0, 2.0, 1.0), way),)) for way in ((1.0, 1.0, 1.0), (-1.0, 0.5, 0.2))
    ]
    scene, here = SceneRenderer([avatar, avatar], settings, lights[0]), pose("relaxed", avatar)
    found = set()
    for frame in range(12):
        joints_m = [here, pose(("fist", "open")[frame % 2], avatar) + [(0.12, 0, 0), (0, 0, 2.0)][rng.integers(2)]]
        scene.light = lights[rng.integers(2)]
        ways = [0.0, 0.01] if frame % 4 == 3 else [0.0]
        moments = [Moment([one + np.array([way, 0, 0]) for one in joints_m], camera()) for way in ways]
        fresh = SceneRenderer([avatar, avatar], settings, scene.light)
        frames = [each.render_moments(moments, [1.0] * len(moments)) for each in (scene, fresh)]
        for name in ("rgba", "depth_m", "ids"):
            assert np.array_equal(getattr(frames[0], name), getattr(frames[1], name)), frame
        assert np.array_equal(scene.bone_ids(camera()), fresh.bone_ids(camera()))
        found.add(plan_of(frames[0]).seen)
    assert found == {(True, True), (True, False)}


def test_a_hand_behind_the_camera_has_no_surface():
    avatar = coarse_builtin(600, 64)
    scene = SceneRenderer([avatar, avatar], replace(SMALL, gaussians=0))
    scene.render([pose("open", avatar), pose("open", avatar) + np.array([0, 0, 2.0])], camera())
    detail = scene._backend._detail
    assert detail is not None
    assert [task.groups > 0 for task in detail._tasks] == [True, False]
    assert detail._tasks[1].side_blocks == 0


def test_the_box_knows_the_low_pass_of_a_hand_that_is_not_in_the_picture():
    coarse = replace(TRAINED, info=replace(TRAINED.info, learned_from=LearnedFrom("it", "all", 1, "0", pixel_m=0.03)))
    view, sharp = camera(640, 480, focal_px=300.0), pose("open", RIGHT)
    behind = pose("open", coarse) + 9 * (view.eye_m - sharp.mean(0))
    boxes = [
        plan_of(SceneRenderer([RIGHT, other], SMALL).render([sharp, behind], view)).box for other in (RIGHT, coarse)
    ]
    assert boxes[1].width > boxes[0].width


def test_a_receipt_tells_of_the_hands_in_the_picture_alone():
    here, there = pose("relaxed", TRAINED), pose("relaxed", TRAINED) + np.array([0, 0, 2.0])
    alone = plan_of(HandRenderer(TRAINED, SMALL).render(here, camera()))
    both = plan_of(SceneRenderer([TRAINED, TRAINED], SMALL).render([here, there], camera()))
    for effect in (Effect.SKIN, Effect.CORRECTIVES, Effect.CAST):
        assert both[effect].estimated_ms == alone[effect].estimated_ms > 0


def test_a_hand_that_flies_into_the_picture_is_blurred_there():
    """The middle of its way is out of the picture, and the end is not."""
    joints = pose("relaxed") + np.array([0.9, 0.0, 0.0])
    moments = [Moment([one], camera()) for one in (joints, joints, pose("relaxed"))]
    assert not HandRenderer(RIGHT, SMALL).render(joints, camera()).rgba.any()
    assert HandRenderer(RIGHT, SMALL).render_moments(moments, EVEN).rgba.any()


def test_normals_come_without_depth():
    frame = HandRenderer(RIGHT, replace(SMALL, depth=False, normals=True)).render(pose("open"), camera())
    assert frame.normal is not None
    assert float(np.abs(frame.normal).max()) > 0.9
    assert not frame.depth_m.any()


def test_the_shadow_does_not_pop_when_a_hand_comes_nearer():
    renderer, joints = HandRenderer(RIGHT, SMALL), pose("fist")
    strengths = [
        plan_of(renderer.render(joints, camera(away_m=0.5, focal_px=focal_px))).strength
        for focal_px in np.geomspace(100.0, 1000.0, 120)
    ]
    assert strengths[0] == 0
    assert strengths[-1] == 1
    assert float(np.abs(np.diff(strengths)).max()) < 0.1


def test_a_learned_shadow_that_may_not_be_drawn_is_no_loss_of_nothing():
    settings = replace(SMALL, effects=Choice.parse("filter"))
    decision = plan_of(HandRenderer(TRAINED, settings).render(pose("fist", TRAINED), camera()))[Effect.SHADOW]
    assert not decision.runs
    assert decision.worst is not None
    assert decision.worst >= 0.5  # the tint of the small avatar's shadow is 0.7
    # what the receipt says is that figure
    assert decision.bound == f"darker by up to {100 * decision.worst:.0f} %"


def test_a_hand_that_learned_the_papers_shadow_was_not_learned_under_the_gate():
    assert TRAINED.learned is not None
    assert TRAINED.learned.shadow is not None
    look = replace(TRAINED.learned.shadow, printed=True)
    printed = replace(TRAINED, learned=replace(TRAINED.learned, shadow=look))
    missed = {}
    for avatar in (TRAINED, printed):
        frame = HandRenderer(avatar, SMALL).render(pose("open", avatar), camera())
        decision = plan_of(frame)[Effect.SHADOW]
        assert not decision.runs
        assert "gate" in decision.reason
        missed[avatar is printed] = decision.worst
        assert any("shadow of the paper" in note for note in frame.report.notes) == (avatar is printed)
    assert missed == {False: 0.0, True: SHADOW_MISSED}
    # its colors have in them what a shadow in every pose leaves out
    always = replace(SMALL, shadow=ShadowMode.ALWAYS)
    assert plan_of(HandRenderer(printed, always).render(pose("open", printed), camera())).strength == 1


def test_a_tiny_hand_without_the_filter_is_not_said_to_be_right():
    frame = HandRenderer(RIGHT, replace(SMALL, antialias=False)).render(pose("open"), camera(focal_px=20.0))
    decision = plan_of(frame)[Effect.FILTER]
    assert not decision.runs
    assert decision.worst is None
    assert "2 px" in decision.bound


def test_only_the_box_of_a_small_hand_is_drawn(monkeypatch):
    sizes = []
    real = backend.NativeShade.__init__

    def noted(self, library, width, height):
        sizes.append((width, height))
        real(self, library, width, height)

    monkeypatch.setattr(backend.NativeShade, "__init__", noted)
    view = camera(1024, 768, focal_px=200.0)
    frame = HandRenderer(RIGHT, SMALL).render(pose("open"), view)
    whole = HandRenderer(RIGHT, WHOLE).render(pose("open"), view)
    assert sizes == [(plan_of(frame).box.width, plan_of(frame).box.height), (1024, 768)]
    assert frame.rgba.shape == whole.rgba.shape
    assert difference(frame, whole) <= 1 / 255
    assert np.abs(frame.depth_m - whole.depth_m).max() < 1e-4
    # the receipt says what that may change, where there is a shadow and where there is none, and what it saves
    left_out, box = plan_of(frame)[Effect.WHOLE], plan_of(frame).box
    rows, columns = (np.flatnonzero(whole.rgba[..., 3].any(axis)) for axis in (1, 0))
    ends = (box.left + box.width - columns[-1], box.top + box.height - rows[-1])
    assert max(columns[0] - box.left, rows[0] - box.top, *ends) < 40  # observed 38 px
    part = box.width * box.height / (1024 * 768)
    assert left_out.estimated_ms == pytest.approx((1 - part) * plan_of(whole)[Effect.WHOLE].estimated_ms)
    shaded = plan_of(HandRenderer(RIGHT, SMALL).render(pose("fist"), camera(1024, 768, focal_px=600.0)))
    assert (plan_of(frame).strength, shaded.strength) == (0, 1)
    assert (left_out.worst, shaded[Effect.WHOLE].worst) == (SMALL.alpha_min, SMALL.alpha_min + CROP_SHADOW)


def folded(degrees: float, avatar: HandAvatar, longer: float = 1.0) -> np.ndarray:
    """An open hand whose fingers are folded at their knuckles, onto the palm or (below 0) onto its back."""
    joints = pose("open", avatar).copy()
    across = joints[5] - joints[2]
    turn = Rotation.from_rotvec(np.radians(degrees) * across / np.linalg.norm(across))
    for knuckle in range(2, 6):
        finger = [knuckle + 5, knuckle + 10, knuckle + 15]
        joints[finger] = joints[knuckle] + longer * turn.apply(joints[finger] - joints[knuckle])
    return joints


POSED = {name: partial(pose, name) for name in ("open", "fist", "point")} | {
    "folded": partial(folded, 150),
    "folded back": partial(folded, -130),
}


@pytest.mark.parametrize("longer", [1.0, 3.0])
@pytest.mark.parametrize("degrees", [150, -130])
def test_no_offset_is_stretched_farther_than_the_box_knows(degrees: float, longer: float):
    joints, facts = folded(degrees, TRAINED, longer), HandFacts(TRAINED)
    assert TRAINED.learned is not None
    assert TRAINED.learned.correctives is not None
    longest_m = TRAINED.learned.correctives.longest_offset_m()
    bones, weights = TRAINED.skeleton().bones(joints), torch.from_numpy(TRAINED.bone_weights).double()
    maps = skin_maps(weights, transform_of(TRAINED).bones(torch.from_numpy(joints)))
    stretched_m = bones.scale * float(torch.linalg.matrix_norm(maps.turning, 2).max()) * longest_m
    assert not bones.flags
    assert stretched_m > 1.5 * longest_m  # otherwise this would say nothing
    view = View(joints, bones, facts, camera(), contract.ALPHA_MIN)
    assert stretched_m <= view.offset_by_m * (1 + 1e-6)  # maps are in 32 bits


@pytest.mark.parametrize("joints_of", POSED.values(), ids=POSED)
@pytest.mark.parametrize("avatar", [RIGHT, TRAINED, ellipsoid_avatar(1000)], ids=["painted", "trained", "ellipsoids"])
def test_nothing_is_seen_outside_of_the_hands_box(joints_of, avatar):
    for focal_px in (60.0, 300.0, 1500.0):
        view = camera(640, 480, focal_px=focal_px)
        scene = SceneRenderer([avatar], WHOLE)
        frame = scene.render([joints_of(avatar)], view)
        posed = scene._posed
        assert posed is not None
        box = box_of(posed.scene(view), scene._facts)
        assert most_outside(frame, box) == 0


@pytest.mark.parametrize(
    "avatar",
    [RIGHT, TRAINED, ellipsoid_avatar(1000), COARSE],
    ids=["painted", "trained", "ellipsoids", "of coarse pictures"],
)
def test_nothing_is_seen_outside_of_the_box_of_a_hand_around_the_near_plane(avatar):
    joints, rng, smaller = pose("relaxed", avatar), np.random.default_rng(3), 0
    scene = SceneRenderer([avatar], WHOLE)
    for _ in range(40):
        eye_m, way = joints[rng.integers(21)] + rng.normal(0, 0.04, 3), rng.normal(size=3)
        view = Camera.looking_at(eye_m, eye_m + way, (0.3, 1.0, 0.2), width=160, height=160, focal_px=120.0)
        if not (view.project(joints)[1] < contract.Z_NEAR_M).any():
            continue
        frame = scene.render([joints], view)
        bones = [avatar.skeleton().bones(joints)]
        box = box_of(scene_of([joints], bones, view), [HandFacts(avatar)])
        assert most_outside(frame, box) == 0
        smaller += box.width * box.height < 160 * 160
    assert smaller > 0 or avatar is not RIGHT  # the others are small avatars whose bones move everything a little


def test_nothing_is_seen_outside_of_the_box_of_a_hand_that_another_one_softens():
    """A painted hand is drawn with the low pass of the pictures of the one beside it, which is behind the eye."""
    coarse = replace(TRAINED, info=replace(TRAINED.info, learned_from=LearnedFrom("it", "all", 1, "0", pixel_m=0.03)))
    avatars, view = [RIGHT, coarse], camera(640, 480, focal_px=300.0)
    joints = [pose("open", RIGHT), pose("open", coarse) + 9 * (view.eye_m - pose("open", RIGHT).mean(0))]
    scene = SceneRenderer(avatars, WHOLE)
    frame = scene.render(joints, view)
    bones = [avatar.skeleton().bones(each) for avatar, each in zip(avatars, joints, strict=True)]
    box = box_of(scene_of(joints, bones, view), [HandFacts(avatar) for avatar in avatars])
    assert float(frame.rgba[box.slices][..., 3].max()) > 0.5
    assert most_outside(frame, box) == 0
    assert box.width * box.height < 640 * 480


# ---- single effects -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [None, *PRESETS])
def test_a_small_hand_is_as_slim_as_a_large_one_seen_from_afar(name: str | None):
    """With the settings that somebody gets who asks for none, and with every preset."""
    view, joints = camera(96, 96, focal_px=100.0), pose("spread")
    settings = replace(RenderSettings() if name is None else preset(name), shadow=ShadowMode.OFF)
    large = HandRenderer(RIGHT, settings).render(joints, view.scaled(8)).rgba
    truth = large.reshape(96, 8, 96, 8, 4).mean((1, 3))
    swollen = np.abs(HandRenderer(RIGHT, replace(settings, antialias=False)).render(joints, view).rgba - truth)
    frame = HandRenderer(RIGHT, settings).render(joints, view)
    slim = np.abs(frame.rgba - truth)
    assert plan_of(frame).runs(Effect.FILTER)
    assert float(swollen.mean()) > 5 * float(slim.mean())
    assert float(frame.rgba[..., 3].sum()) == pytest.approx(
        float(truth[..., 3].sum()), rel=0.06
    )  # without it 1.5 times as much
    assert frame.rgba.shape == (96, 96, 4)


def test_the_filter_fades_in_with_distance():
    """Between its ends no step of distance changes the picture more than the steps beside it."""
    renderer, joints = HandRenderer(RIGHT, replace(SMALL, gaussians=0)), pose("spread")
    scales = np.linspace(330.0, 480.0, 16)
    covered = np.array(
        [renderer.render(joints, camera(200, 200, focal_px=f)).rgba[..., 3].sum() / f**2 for f in scales]
    )
    steps = np.abs(np.diff(covered)) / covered[:-1]
    assert float(steps.max()) < 0.03


def linear(frame: Frame) -> np.ndarray:
    """(H, W, 4) premultiplied, in linear light."""
    alpha = frame.rgba[..., 3:]
    straight = np.divide(frame.rgba[..., :3], alpha, out=np.zeros_like(frame.rgba[..., :3]), where=alpha > 0)
    return np.concatenate([srgb_to_linear(straight) * alpha, alpha], -1)


# ---- time and lens --------------------------------------------------------------------------------------------------


EVEN = (1.0, 1.0, 1.0)


def moving(shift_m: float, view: Camera) -> list[Moment]:
    """While the shutter is open, a hand moves by so much."""
    joints, step = pose("relaxed"), np.array([shift_m, 0.0, 0.0])
    return shutter_at(np.stack([joints - step, joints, joints + step]), 1, 1.0, view)


def mean_of(renderer: HandRenderer, shift_m: float, view: Camera, count: int) -> np.ndarray:
    """In linear light, of `count` images while a hand moves by so much."""
    places = [pose("relaxed") + np.array([shift_m * ((k + 0.5) / count - 0.5), 0.0, 0.0]) for k in range(count)]
    return sum(linear(renderer.render(place, view)).astype(np.float64) / count for place in places)


@pytest.mark.parametrize("shift_m", [0.0002, 0.002, 0.01, 0.08, 0.45])
def test_motion_blur_is_the_mean_of_very_many_pictures(shift_m: float):
    settings = replace(SMALL, shadow=ShadowMode.OFF, reuse=False, depth=False)
    renderer, view = HandRenderer(RIGHT, settings), camera()
    blurred = renderer.render_moments(moving(shift_m, view), EVEN)
    brute = mean_of(renderer, shift_m, view, max(96, round(1800 * shift_m)))
    assert float(np.abs(linear(blurred) - brute).max()) <= blur.MOTION_ERROR_MAX  # observed 0.012


def test_pictures_of_a_faster_hand_stand_for_no_more_than_their_bound():
    """Ways of 20 to 160 px: the stairs of all fingers that pass a pixel."""
    for travel_px in (20.0, 60.0, 94.0, 160.0, 600.0):
        count = blur.motion_count(travel_px)
        assert blur.motion_error(travel_px, count) <= blur.MOTION_ERROR_MAX
        assert blur.motion_error(travel_px, count - 1) > blur.MOTION_ERROR_MAX
    # the midpoint rule, which misses a 24th of the second derivative
    assert blur.motion_error(0.1, 1) == pytest.approx(0.1**2 / 24 * blur.EDGE_CURVATURE)
    # ten edges at once, in as many pictures as there are at most
    assert blur.motion_count(float("inf")) == blur.MOTION_COUNT_MAX
    assert blur.motion_error(float("inf"), blur.MOTION_COUNT_MAX) == pytest.approx(0.5 * 10 / blur.MOTION_COUNT_MAX)


@pytest.mark.parametrize("travel_px", [0.35, 0.5])
def test_the_stated_error_of_few_pictures_is_neither_less_nor_ten_times_more_than_there_is(travel_px: float):
    """Below a pixel a single picture is off by what is stated, to a factor of ten."""
    view = camera()
    shift_m = travel_px * 0.53 / 300.0
    way_of_joints_px = way_px(moving(shift_m, view), [0])
    assert way_of_joints_px == pytest.approx(travel_px, rel=0.2)
    plain = replace(SMALL, shadow=ShadowMode.OFF, reuse=False, depth=False, antialias=False)
    renderer = HandRenderer(RIGHT, plain)
    stated = blur.motion_error(way_of_joints_px, 1)
    one, many = (mean_of(renderer, shift_m, view, count) for count in (1, 64))
    assert 0.12 * stated < float(np.abs(one - many).max()) <= stated


@pytest.mark.parametrize("aperture_m", [0.002, 0.01, 0.03])
def test_a_lens_is_the_mean_of_very_many_pinholes(aperture_m: float):
    joints = pose("relaxed")
    view = replace(camera(), lens=Lens(aperture_m, 0.45))
    renderer = HandRenderer(RIGHT, replace(SMALL, shadow=ShadowMode.OFF))
    seen = renderer.render(joints, view)
    points = np.random.default_rng(0).normal(size=(400, 2))
    radius = np.sqrt((np.arange(400) + 0.5) / 400)
    angle = np.arange(400) * np.pi * (3 - np.sqrt(5))
    points = 0.5 * aperture_m * radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    brute = sum(linear(renderer.render(joints, view.through(float(x), float(y)))) / 400 for x, y in points)
    assert float(np.abs(linear(seen) - brute).max()) <= blur.FOCUS_ERROR_MAX  # observed 0.044


def test_a_hand_that_only_the_rim_of_the_lens_sees_is_blurred_there():
    """Seen from the rim, what is at 0.5 m goes aside by 20 mm times 0.5 / 0.2 - 1, where 0.2 m are sharp."""
    renderer, joints = HandRenderer(RIGHT, replace(SMALL, gaussians=500)), pose("open")
    pinhole = camera(side_m=0.0)

    def farthest_m(view: Camera, is_seen: Callable[[EffectPlan], bool]) -> float:
        inside_m, outside_m = 0.0, 1.0
        while outside_m - inside_m > 0.001:
            middle_m = (inside_m + outside_m) / 2
            seen = is_seen(plan_of(renderer.render(joints + np.array([middle_m, 0.0, 0.0]), view)))
            inside_m, outside_m = (middle_m, outside_m) if seen else (inside_m, middle_m)
        return inside_m

    from_middle_m = farthest_m(pinhole, lambda plan: plan.box.width > 0)
    from_rim_m = farthest_m(replace(pinhole, lens=Lens(0.04, 0.2)), lambda plan: plan.runs(Effect.FOCUS))
    assert 0.030 < from_rim_m - from_middle_m < 0.040  # the box is a little deeper


def test_blur_that_was_not_chosen_is_a_picture_of_the_middle_through_a_pinhole():
    settings, view = replace(SMALL, effects=Choice.parse("self-shadow")), replace(camera(), lens=Lens(0.01, 0.45))
    frame = HandRenderer(RIGHT, settings).render_moments(moving(0.04, view), EVEN)
    plan = plan_of(frame)
    assert plan.exposures == 1
    for effect, lost in ((Effect.MOTION, "moving edges are sharp"), (Effect.FOCUS, "everything is sharp")):
        assert (plan[effect].runs, plan[effect].reason, plan[effect].bound) == (False, NOT_CHOSEN, lost)
        assert plan[effect].worst == 1
    assert np.array_equal(frame.rgba, HandRenderer(RIGHT, settings).render(pose("relaxed"), camera()).rgba)


def test_a_shutter_over_a_hand_at_rest_and_a_pinhole_cost_one_picture():
    frame = HandRenderer(RIGHT, SMALL).render_moments(moving(0.0, camera()), EVEN)
    plan = plan_of(frame)
    assert plan.exposures == 1
    assert not plan.runs(Effect.MOTION)
    assert not plan.runs(Effect.FOCUS)


BEHIND_M = np.array([0.3, 0.2, 1.2])


def test_a_hand_behind_the_camera_takes_one_picture_and_nothing_is_drawn(monkeypatch):
    monkeypatch.setattr(backend.Backend, "draw", lambda *_args, **_named: pytest.fail("something was drawn"))
    view = replace(camera(), lens=Lens(0.01, 0.45))
    moments = [Moment([moment.joints_m[0] + BEHIND_M], view) for moment in moving(0.04, view)]
    frame = SceneRenderer([RIGHT], replace(SMALL, ids=True)).render_moments(moments, EVEN)
    assert plan_of(frame).exposures == 1
    assert plan_of(frame)[Effect.MOTION].reason == "no hand is in the image"
    assert not frame.rgba.any()
    assert not frame.covered_depth_m.any()


def test_a_hand_behind_the_camera_leaves_the_box_to_the_one_before_it():
    here, facts, bones_of = pose("open"), HandFacts(RIGHT), RIGHT.skeleton().bones
    alone, both = (
        box_of(scene_of(all_m, [bones_of(one) for one in all_m], camera()), [facts] * len(all_m))
        for all_m in ([here], [here + BEHIND_M, here])
    )
    assert both == alone
    assert alone.width > 0


def test_the_box_of_two_hands_is_that_around_the_boxes_of_each():
    here, view, facts = pose("open"), camera(640, 480), HandFacts(RIGHT)

    def edges(*hands_m: np.ndarray) -> tuple[int, int, int, int]:
        bones = [RIGHT.skeleton().bones(hand_m) for hand_m in hands_m]
        box = box_of(scene_of(hands_m, bones, view), [facts] * len(hands_m))
        return box.left, box.top, box.left + box.width, box.top + box.height

    for place_m in ([0.3, 0.15, 0.0], [-0.3, 0.15, 0.0]):
        there = here + np.array(place_m)
        each = np.array([edges(here), edges(there)])
        assert edges(here, there) == edges(there, here) == (*each[:, :2].min(0), *each[:, 2:].max(0))


def test_parallel_rays_that_begin_within_a_hand_may_meet_it_anywhere():
    view = replace(camera(away_m=0.03, side_m=0.02), orthographic=True)
    box = box_of(scene_of([pose("open")], [RIGHT.skeleton().bones(pose("open"))], view), [HandFacts(RIGHT)])
    assert (box.left, box.top, box.width, box.height) == (0, 0, view.width, view.height)


@pytest.mark.parametrize("lens", [None, Lens(0.01, 0.45)], ids=["a pinhole", "a lens"])
def test_a_hand_behind_the_camera_asks_for_no_more_pictures_of_another(lens: Lens | None):
    view = replace(camera(), lens=lens)
    moments = moving(0.004, view)
    alone = HandRenderer(RIGHT, SMALL).render_moments(moments, EVEN)
    places = [moment.joints_m[0] for moment in moments]
    pairs = [Moment([place, 2 * place + BEHIND_M], view) for place in places]
    beside = SceneRenderer([RIGHT, RIGHT], SMALL).render_moments(pairs, EVEN)
    assert 1 < plan_of(beside).exposures == plan_of(alone).exposures < 40


def test_a_hand_that_crosses_the_picture_between_two_moments_is_seen():
    sides = [pose("relaxed") + np.array([x_m, 0.0, 0.0]) for x_m in (-0.6, 0.6)]
    moments = [Moment([side], camera()) for side in sides]
    crossing = SceneRenderer([RIGHT], replace(SMALL, gaussians=500)).render_moments(moments, (1.0, 1.0))
    assert plan_of(crossing).exposures > 40
    assert crossing.rgba.any()
    assert "travel" in plan_of(crossing)[Effect.MOTION].reason


def test_the_receipt_of_a_mean_is_of_a_moment_that_shows_a_hand():
    moments = [Moment([pose("relaxed") + np.array([x_m, 0.0, 0.0])], camera()) for x_m in (0.0, 0.6, 0.7)]
    frame = SceneRenderer([RIGHT], replace(SMALL, gaussians=500)).render_moments(moments, EVEN)
    assert frame.rgba.any()
    assert not frame.depth_m.any()
    assert "no hand is in the image" not in " ".join(frame.report.lines())
