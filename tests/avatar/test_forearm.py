"""Where a hand ends: faded at the wrist or along the forearm, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_avatars import known_avatar, on_template, trained_avatar

from jghand_engine.avatar.avatar import FOREARM_WAY
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.detail import Detail
from jghand_engine.avatar.forearm import FOREARM_FADE_M, STRAYS, WRIST_CUT_M, WRIST_WAY, ended
from jghand_engine.avatar.posing import Posing
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose, pose_sequence_of_names
from jghand_engine.hand.rotations import quaternion_rotation
from jghand_engine.hand.sequence import HandPose
from jghand_engine.hand.wrist import BEND_M, NO_TURN, TWIST_M
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings, preset
from jghand_engine.template.builtin import WITH_FOREARM, load_template, load_template_with_forearm
from jghand_engine.template.surface import boundary_loop


def test_the_fade_lies_where_the_template_ends():
    hand, arm = load_template(), load_template_with_forearm()
    loop = hand.vertices_m[boundary_loop(hand.faces[: hand.skin_face_count])]
    assert np.linalg.norm([WRIST_WAY, FOREARM_WAY], axis=1) == pytest.approx([1, 1], abs=1e-3)
    # observed 0.8 mm: the cut is nearly flat
    np.testing.assert_allclose(loop @ WRIST_WAY, WRIST_CUT_M, atol=1e-3)
    # before the last ring, where the skin of a smooth mesh rounds off
    end_m = np.quantile(load_builtin(handedness=Handedness.RIGHT).position_m @ FOREARM_WAY, 1 - STRAYS)
    assert end_m - FOREARM_FADE_M[0] < (arm.vertices_m[-21:-1] @ FOREARM_WAY).min()


def test_a_hand_without_a_forearm_fades_over_the_last_15_mm_and_nowhere_else():
    hand = load_painted(handedness=Handedness.LEFT)
    shown = ended(hand)
    from_cut_m = hand.position_m @ WRIST_WAY - WRIST_CUT_M
    assert not hand.has_forearm
    assert (shown.opacity[from_cut_m < 0.003] == 0).all()
    assert np.array_equal(shown.opacity[from_cut_m > 0.015], hand.opacity[from_cut_m > 0.015])
    within = (from_cut_m > 0.004) & (from_cut_m < 0.014)
    assert (shown.opacity[within] < hand.opacity[within]).all()
    assert (shown.opacity[within] > 0).all()
    # only that
    assert shown.info == hand.info
    assert shown.position_m is hand.position_m
    assert np.array_equal(ended(hand, forearm=False).opacity, shown.opacity)


def test_a_forearm_is_shown_up_to_its_last_centimeters_or_hidden():
    arm = on_template(forearm=True)
    along_m = arm.position_m @ FOREARM_WAY
    assert arm.has_forearm
    assert arm.info.template == WITH_FOREARM
    shown, hidden = ended(arm), ended(arm, forearm=False)
    end_m = np.quantile(along_m, 1 - STRAYS)
    assert (shown.opacity[along_m < end_m - 0.030] == 1).all()
    assert (shown.opacity[along_m > end_m - 0.010] == 0).all()
    # one that has strayed does not move the end
    stray = arm.position_m.copy()
    stray[along_m.argmax()] += np.float32(0.05) * FOREARM_WAY.astype(np.float32)
    assert np.abs(ended(replace(arm, position_m=stray)).opacity - shown.opacity).max() < 0.05
    # hidden it is the hand that ends at the wrist, whose mesh goes with it
    assert (hidden.opacity[along_m > 0.02] == 0).all()
    assert hidden.info.template == load_template().identifier
    alone = ended(on_template(forearm=False))
    assert np.array_equal(hidden.opacity[:1609], alone.opacity[:1609])


def test_the_end_of_the_built_in_forearm_has_neither_holes_nor_a_cut():
    arm = ended(load_builtin(handedness=Handedness.RIGHT))
    renderer = HandRenderer(arm, preset("viewport"))
    joints_m = named_pose("open", arm.canonical_joints_m, handedness=Handedness.RIGHT)
    middle_m = joints_m[0] - 0.1 * (joints_m[9] - joints_m[0]) / np.linalg.norm(joints_m[9] - joints_m[0])
    for around in np.radians([8, 98, 190, 278]):
        eye_m = middle_m + 0.5 * np.array([np.sin(around), 0, np.cos(around)])
        camera = Camera.looking_at(eye_m, middle_m, (0, 1, 0), width=240, height=240, focal_px=1000)
        alpha = renderer.render(joints_m, camera).rgba[..., 3]
        inside = (alpha[:100] > 0.99).all(0)
        assert inside.sum() > 60
        down = np.diff(alpha[:, inside], axis=0)
        assert alpha[-1].max() == 0
        assert down.max() < 0.05  # observed 0.02
        # observed 0.30 where the outline of the end rounds off
        assert down.min() > -0.4


def test_a_hidden_forearm_has_no_detail_that_would_hide_what_is_behind_it():
    arm, template = on_template(forearm=True), load_template_with_forearm()
    skin = template.faces[: template.skin_face_count].astype(np.int32)
    uv = template.face_uv[: template.skin_face_count].astype(np.float32)
    weights = template.bone_weights.astype(np.float32)
    detail = Detail(template.vertices_m.astype(np.float32), weights, skin, uv, np.zeros((4, 4, 3), np.uint8), 0.001)
    shown, hidden = (ended(replace(arm, detail=detail), forearm=forearm).detail for forearm in (True, False))
    assert shown is not None
    assert hidden is not None
    assert len(hidden.face_uv) == len(hidden.faces) < len(shown.faces) <= len(skin)
    for ends_m, left in ((0.125, shown), (0.02, hidden)):
        assert ((detail.position_m @ FOREARM_WAY)[left.faces].min(1) < ends_m).all()
        assert left.whole is not None
        # what fades is not filled up where the surface ends the hand
        assert left.whole[left.faces].min() < 0.2
        assert left.whole.max() == 1


def test_manos_hands_fade_where_theirs_end_and_unknown_ones_stay():
    hand = on_template(forearm=False)
    mano = replace(hand, info=replace(hand.info, template="mano-right-mean-manopth-projected"))
    behind_m = mano.position_m[:, 1] - mano.position_m[:, 1].min()
    opacity = ended(mano).opacity
    assert (opacity[behind_m < 0.003] == 0).all()
    assert (opacity[behind_m > 0.0151] == 1).all()
    other = replace(hand, info=replace(hand.info, template="mine"))
    assert ended(other) is other


# ---- the wrist ------------------------------------------------------------------------------------------------------


def turned(axis: np.ndarray, degrees: float) -> np.ndarray:
    """A forearm's turn about an axis of the canonical hand."""
    palm = on_template(forearm=True).skeleton().canonical.frames[0]
    axis = palm.T @ axis / np.linalg.norm(axis)
    return Rotation.from_rotvec(np.radians(degrees) * axis).as_quat()[[3, 0, 1, 2]]


FLEXION = np.array([1.0, 0, 0])
TURNS = {
    "flexed": turned(FLEXION, 60),
    "extended": turned(FLEXION, -60),
    "deviated": turned(np.array([0, 0, 1.0]), 20),
    "pronated": turned(FOREARM_WAY, 90),
    "half a turn": turned(FOREARM_WAY, 180),
}


@pytest.mark.parametrize(
    "avatar", [on_template(True), trained_avatar(400), known_avatar(400)], ids=["painted", "trained", "known"]
)
def test_a_straight_wrist_is_the_hand_of_before_to_the_bit(avatar):
    arm = replace(avatar, info=replace(avatar.info, template=WITH_FOREARM))
    joints_m = named_pose("fist", arm.canonical_joints_m, handedness=Handedness.RIGHT)
    before = Posing(arm.with_stiff_wrist(), threads=1)(joints_m)
    posing = Posing(arm, threads=1)
    for forearm in (None, NO_TURN, -NO_TURN):
        after = posing(joints_m, forearm)
        for name in ("position_m", "sigma_m", "rgb", "covariance_m2"):
            assert np.array_equal(getattr(before, name), getattr(after, name)), name


@pytest.mark.parametrize("side", Handedness)
@pytest.mark.parametrize("name", ["fist", "table"])
def test_a_motion_that_closes_the_hand_leaves_the_forearm_where_it_is(side, name):
    """Its palm arches, and would take the forearm along by up to a centimeter."""
    arm = on_template(forearm=True)
    arm = arm.for_hand(side)
    motion = pose_sequence_of_names(["open", name], load_template().joints_m, handedness=side)
    posing, behind = Posing(arm, threads=1), arm.position_m @ FOREARM_WAY > BEND_M[1]
    end_of = arm.position_m @ FOREARM_WAY > TWIST_M[1]
    assert end_of.sum() > 10
    for pose in (motion.pose(len(motion) // 2), motion.pose(len(motion) - 1)):
        still, end = (posing(each.joints_m, each.forearm).position_m for each in (motion.pose(0), pose))
        assert np.linalg.norm(end - still, axis=1)[end_of].max() < 1e-4
        # a twist is undone evenly along the forearm: observed 2.6 mm behind the wrist
        assert np.linalg.norm(end - still, axis=1)[behind].max() < 3.5e-3
    carried = posing(motion.joints_m[-1]).position_m
    assert np.linalg.norm(carried - still, axis=1)[behind].max() > 5e-3


def test_a_motion_that_does_not_arch_the_palm_has_no_turn_of_the_forearm():
    names = ["open", "claw", "relaxed"]
    assert pose_sequence_of_names(names, load_template().joints_m, handedness=Handedness.RIGHT).forearm is None


@pytest.mark.parametrize("name", TURNS)
def test_the_end_of_a_forearm_turns_about_the_wrist_and_the_hand_stays(name):
    arm, turn = on_template(forearm=True), TURNS[name]
    rest_m, posing = arm.canonical_joints_m, Posing(arm, threads=1)
    straight, bent = posing(rest_m).position_m, posing(rest_m, turn).position_m
    along_m = arm.position_m @ FOREARM_WAY
    assert np.array_equal(bent[along_m < -0.015], straight[along_m < -0.015])
    palm, end = arm.skeleton().canonical.frames[0], along_m > 0.125
    expected = (straight[end] - rest_m[0]) @ (palm @ quaternion_rotation(turn) @ palm.T).T + rest_m[0]
    np.testing.assert_allclose(bent[end], expected, atol=1e-6)


@pytest.mark.parametrize("name", TURNS)
def test_no_skin_of_a_turned_forearm_collapses(name):
    """Neither a candy wrapper nor a fold: around each place there stays skin, and it stays outside."""
    template, arm = load_template_with_forearm(), on_template(forearm=True)
    skin = template.faces[: template.skin_face_count]
    posing, rest_m = Posing(arm, threads=1), arm.canonical_joints_m
    areas = []
    for turn in (None, TURNS[name]):
        corners = posing(rest_m, turn).position_m[skin]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas.append(np.linalg.norm(across, axis=1))
    # observed: extended 0.37, flexed 0.52, deviated 0.66, half a turn 0.89, pronated 0.92
    assert (areas[1] / areas[0]).min() > 0.3
    # all around a forearm that is twisted alone the skin keeps its distance from the axis
    if name in ("pronated", "half a turn"):
        along_m = arm.position_m @ FOREARM_WAY
        behind = (along_m > 0.0) & (along_m < 0.12)
        points = posing(rest_m, TURNS[name]).position_m[behind] - rest_m[0]
        before, after = (np.cross(each, FOREARM_WAY) for each in (arm.position_m[behind] - rest_m[0], points))
        assert (np.linalg.norm(after, axis=1) / np.linalg.norm(before, axis=1)).min() > 0.95


def test_a_picture_shows_the_turn_and_is_drawn_anew_for_it():
    arm = ended(on_template(forearm=True))
    joints_m = named_pose("relaxed", arm.canonical_joints_m, handedness=Handedness.RIGHT)
    middle_m = joints_m[0]
    camera = Camera.looking_at(middle_m + np.array([0, 0, 0.6]), middle_m, (0, 1, 0), width=64, height=96, focal_px=130)
    renderer = HandRenderer(arm, RenderSettings(threads=1))
    straight = renderer.render(joints_m, camera).rgba
    bent = renderer.render(HandPose(joints_m, TURNS["deviated"]), camera).rgba
    assert np.abs(bent - straight)[60:].max() > 0.5
    np.testing.assert_allclose(bent[:20], straight[:20], atol=0.02)
    # the part of an image that hands can touch holds all of the forearm
    below = renderer.render(HandPose(joints_m, TURNS["deviated"]), replace(camera, cy=camera.cy - 60)).rgba
    np.testing.assert_allclose(below[:36], bent[60:], atol=1e-3)
    again = renderer.render(joints_m, camera).rgba
    assert np.array_equal(again, straight)
