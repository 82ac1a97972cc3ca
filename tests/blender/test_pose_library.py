"""The poses are real pose assets of this Blender: marked, catalogued, with pictures, applied to bones."""

import bpy
import hands
import numpy as np
import pytest

from blender_addon.core import poses, posing
from blender_addon.core.joints import HANDEDNESSES, NAMES
from blender_addon.core.view import BUILTIN_AVATAR
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, avatar_files, controls
from blender_addon.hand import poses as hand_poses
from blender_addon.hand import poses as pose_library

FIST = avatar_files.fist_of(BUILTIN_AVATAR)


def wanted_of(name: str, handedness: str) -> np.ndarray:
    return poses.joints_on(name, posing.rest_joints_m(handedness), handedness, FIST)


def shipped_actions(titles: list[str] | None = None) -> list[bpy.types.Action]:
    path = pose_library.FOLDER / pose_library.BLEND
    with bpy.data.libraries.load(str(path), assets_only=True) as (there, here):
        here.actions = titles if titles is not None else there.actions
    return here.actions


def test_the_folder_holds_assets_of_both_hands_in_catalogs_with_pictures(context):
    actions = shipped_actions()
    titles = {pose.title(side) for side in HANDEDNESSES for pose in poses.ALL_POSES}
    assert {action.name for action in actions} == titles
    catalogs = (pose_library.FOLDER / pose_library.CATALOG_FILE).read_text()
    for action in actions:
        assert action.asset_data.catalog_id in catalogs
        size = tuple(action.preview.image_size)
        pixels = np.empty(4 * size[0] * size[1], np.float32)
        action.preview.image_pixels_float.foreach_get(pixels)
        assert 0.1 < pixels[3::4].mean() < 0.9
        assert action.slots[0].target_id_type == "OBJECT"
        assert list(action.frame_range) == [1.0, 1.0]
    assert "VERSION 1" in catalogs


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_every_asset_is_the_pose_of_the_built_in_hand(context, handedness):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m(handedness), handedness)
    for pose in poses.ALL_POSES:
        (action,) = shipped_actions([pose.title(handedness)])
        hand.pose.apply_pose_from_action(action, evaluation_time=1.0)
        # worst observed 3.2e-8 m
        np.testing.assert_allclose(hands.joints_of(hand), wanted_of(pose.name, handedness), atol=2e-7)


def test_an_asset_puts_the_controls_back_to_neutral(context):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right"), "right")
    controls.add_controls(context, hand, FIST)
    controls.use_joint_limits(hand, False)
    hand.pose.bones["control_hand"].rotation_euler.x = 0.5
    (action,) = shipped_actions(["Point (right)"])
    hand.pose.apply_pose_from_action(action, evaluation_time=1.0)
    np.testing.assert_allclose(hands.joints_of(hand), wanted_of("point", "right"), atol=2e-7)


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_every_pose_lies_within_the_joint_limits_of_the_controls(context, handedness):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m(handedness), handedness)
    controls.add_controls(context, hand, FIST)
    rest = armature.rest_matrices_of(hand)
    for pose in poses.ALL_POSES:
        hand_poses.take_pose(hand, poses.pose_on(pose.name, rest, handedness, FIST))
        wanted = poses.joints_on(pose.name, rest[:, :3, 3], handedness, FIST)
        away = np.linalg.norm(hands.joints_of(hand) - wanted, axis=-1)
        assert away.max() < 5e-7, (pose.name, NAMES[int(away.argmax())], away.max())


def test_a_pose_of_the_other_hand_is_refused(context):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("left"), "left")
    with pytest.raises(JGHandFailure, match="no right hand"):
        hand_poses.take_pose(hand, poses.pose_on("fist", armature.rest_matrices_of(hand), "right"))


def test_the_library_becomes_one_of_the_users_once(context):
    libraries = context.preferences.filepaths.asset_libraries
    before = len(libraries)
    for _ in range(2):
        pose_library.use_library()
    assert len(libraries) == before + 1


def test_a_library_of_the_users_with_our_name_stays_what_it_is(context, tmp_path):
    theirs = context.preferences.filepaths.asset_libraries.new(name="JGHand", directory=str(tmp_path))
    assert not pose_library.library()
    name = pose_library.use_library()
    assert pose_library.library()
    assert name != "JGHand"
    assert theirs.path == str(tmp_path)


@pytest.mark.parametrize("avatar", [BUILTIN_AVATAR, "strong"])
def test_the_shelf_says_of_another_persons_hand_which_poses_close_on_it(extension, avatar, capfd):
    bpy.ops.jghand.make_pose_assets()
    bpy.ops.jghand.add_hand(avatar=avatar)
    capfd.readouterr()
    assert bpy.ops.jghand.show_pose_shelf() == {"FINISHED"}
    assert bpy.context.mode == "POSE"
    assert ('"Apply Pose" closes' in capfd.readouterr().out) == (avatar == "strong")
