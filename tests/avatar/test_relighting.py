"""Hands in a light that they were not made for: what a known hand looks like where nobody gives a light."""

from dataclasses import replace

import numpy as np
from small_avatars import known_avatar, trained_avatar
from small_hands import joints_of

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.posing import Poser, Posing
from jghand_engine.avatar.relighting import estimated, in_studio, studio
from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.color import linear_to_srgb
from jghand_engine.hand.joints import Handedness
from jghand_engine.native import library as native_library
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.settings import RenderSettings


def test_hands_that_carry_a_light_stay_as_they_are():
    avatar = trained_avatar()
    assert in_studio(avatar) is avatar


def test_a_known_hand_without_a_scene_looks_much_as_the_studio_lights_it():
    avatar = estimated(load_builtin(handedness=Handedness.RIGHT)).prefix(4000)
    joints_m = joints_of("flat")
    eye_m = joints_m[3] + [0.1, 0.1, 0.4]
    camera = Camera.looking_at(eye_m, joints_m[3], [0, 1, 0], width=64, height=64, focal_px=150.0)
    settings = RenderSettings(antialias=False)
    shown = SceneRenderer([avatar], settings).render([joints_m], camera)
    lit = SceneRenderer([avatar], settings, SceneLight(studio())).render([joints_m], camera)
    assert not shown.linear
    assert lit.linear
    ours, theirs = shown.rgba, lit.displayed()
    inside = ours[..., 3] > 0.5
    assert inside.sum() > 100
    # colors are blended after the curve here, before it there; harmonics stand for the light
    assert np.abs(ours[inside] - theirs[inside])[:, :3].mean() < 0.04
    assert np.corrcoef(ours[inside][:, :3].ravel(), theirs[inside][:, :3].ravel())[0, 1] > 0.95


def test_what_is_exported_of_a_lit_hand_is_what_its_renderer_shows_but_for_the_gloss():
    avatar, joints_m = known_avatar(), joints_of("fist")
    assert avatar.learned is not None
    assert avatar.learned.response is not None
    matt = replace(avatar.learned.response, reflectance=np.zeros(len(avatar), np.float32))
    lamp = Lamp(LampKind.POINT, (0.02, 0.03, 0.04), (0.1, 0.2, 0.2))
    light = SceneLight(World(np.full((4, 8, 3), 0.2)), (lamp,))
    poser = Poser(native_library.load(), replace(avatar, learned=replace(avatar.learned, response=matt)))
    bones = avatar.skeleton().bones(joints_m)
    poser.prepare(bones, np.zeros(3), light=light)
    poser.run()
    posed = Posing(avatar, light=light)(joints_m)
    same = 0
    for eye_m in ([0.1, 0.2, 0.5], [-0.2, 0.1, -0.5]):
        assert poser.prepare_gloss(np.array(eye_m))
        poser.run_gloss()
        seen = linear_to_srgb(poser.into.rgb[np.argsort(poser.blocks.order)])
        # what faces away is darker there: it is seen through gaps
        assert (seen < posed.rgb + 1e-5).all()
        same += (np.abs(seen - posed.rgb) < 1e-5).all(1).mean()
    # of two views from opposite sides: each sees about half of the skin
    assert same > 0.8


def test_what_is_exported_of_a_known_hand_is_what_the_renderer_shows_without_a_scene():
    avatar, joints_m = known_avatar(), joints_of("fist")
    posed, same = Posing(avatar)(joints_m), Posing(in_studio(avatar))(joints_m)
    assert np.array_equal(posed.rgb, same.rgb)
    assert not np.array_equal(posed.rgb, avatar.rgb)
