"""Settings under which a picture depends on nothing that was drawn before it."""

from dataclasses import replace

import numpy as np
import pytest

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.render.backend import SKIN
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import PRESETS

CAMERA = Camera.looking_at([0.1, 0.1, 0.6], [0, 0.08, 0], [0, 1, 0], width=128, height=96, focal_px=250)
BUILTIN = load_builtin(handedness=Handedness.RIGHT)
POSES_M = pose_sequence_of_names(["open", "fist"], BUILTIN.canonical_joints_m, handedness=Handedness.RIGHT).joints_m
# little enough that the exact network's skin and shade may be kept
CREEP_M = 3e-4 * (POSES_M[13] - POSES_M[12])
TREMBLE_M = 2e-8
STEPS = {
    "the whole hand drifts by less than counts": lambda pose_m: pose_m + np.array([2e-5, 0, 0]),
    "the whole hand moves, its correctives stay": lambda pose_m: pose_m + np.array([1e-3, 0, 0]) + CREEP_M,
    "fingers creep": lambda pose_m: pose_m + CREEP_M,
    "joints tremble": lambda pose_m: pose_m + TREMBLE_M * np.random.default_rng(0).standard_normal((21, 3)),
}


def settings(repeatable: bool):
    return replace(PRESETS["final"], threads=1, repeatable=repeatable)


@pytest.mark.parametrize("step", STEPS.values(), ids=STEPS)
def test_a_frame_is_the_same_bits_after_any_other(step):
    before_m, here_m = POSES_M[12], step(POSES_M[12])
    renderer = HandRenderer(BUILTIN, settings(True))
    renderer.render(before_m, CAMERA)
    after = renderer.render(here_m, CAMERA)
    fresh = HandRenderer(BUILTIN, settings(True)).render(here_m, CAMERA)
    assert np.array_equal(after.rgba, fresh.rgba)
    assert np.array_equal(after.depth_m, fresh.depth_m)


def test_other_settings_do_remember():
    """Else the test above would say nothing."""
    seen = []
    for step in STEPS.values():
        renderer = HandRenderer(BUILTIN, settings(False))
        renderer.render(POSES_M[12], CAMERA)
        after = renderer.render(step(POSES_M[12]), CAMERA)
        fresh = HandRenderer(BUILTIN, settings(False)).render(step(POSES_M[12]), CAMERA)
        seen.append(np.array_equal(after.rgba, fresh.rgba))
    assert seen == [False, False, False, False]


def test_a_hand_that_did_not_move_at_all_is_still_not_moved_again():
    renderer = HandRenderer(BUILTIN, settings(True))
    first = renderer.render(POSES_M[12], CAMERA)
    again = renderer.render(POSES_M[12].copy(), CAMERA)
    assert SKIN not in again.report.stages
    assert np.array_equal(first.rgba, again.rgba)
