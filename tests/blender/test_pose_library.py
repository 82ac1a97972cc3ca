"""The poses are real pose assets of this Blender: marked, catalogued, with pictures, applied to bones."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_addon.core import poses, posing
from blender_addon.core.joints import HANDEDNESSES, NAMES
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, controls, pose_library
from blender_addon.hand import poses as hand_poses


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """The folder of the library, made once, by a Blender with an action of an asset's name in its file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    kept = bpy.data.actions.new("Fist (right)")
    folder = tmp_path_factory.mktemp("poses")
    pose_library.build_library(folder)
    assert kept.name == "Fist (right)"
    assert list(bpy.data.actions) == [kept]
    return folder


def joints_of(context: bpy.types.Context, hand: bpy.types.Object) -> np.ndarray:
    context.view_layer.update()
    return armature.read_hand(hand, context.evaluated_depsgraph_get()).joints_m


def wanted_of(name: str, handedness: str) -> np.ndarray:
    rest = posing.rest_matrices(posing.rest_joints_m(handedness), handedness)
    return poses.posed_joints(rest, poses.pose_named(name, handedness).quaternions)


def test_the_folder_holds_assets_of_both_hands_in_catalogs_with_pictures(context, library):
    with bpy.data.libraries.load(str(library / pose_library.BLEND), assets_only=True) as (there, here):
        here.actions = there.actions
    titles = {pose.title for side in HANDEDNESSES for pose in poses.all_poses(side)}
    assert {action.name for action in here.actions} == titles
    catalogs = (library / pose_library.CATALOG_FILE).read_text()
    for action in here.actions:
        assert action.asset_data.catalog_id in catalogs
        assert tuple(action.preview.image_size) == (128, 128)
        assert action.slots[0].target_id_type == "OBJECT"
        assert list(action.frame_range) == [1.0, 1.0]
    assert "VERSION 1" in catalogs


@pytest.mark.parametrize("handedness", HANDEDNESSES)
@pytest.mark.parametrize("with_controls", [False, True], ids=["bare", "with controls"])
def test_an_asset_poses_the_hand_with_and_without_controls(context, library, handedness, with_controls):
    title = poses.pose_named("point", handedness).title
    with bpy.data.libraries.load(str(library / pose_library.BLEND)) as (_there, here):
        here.actions = [title]
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m(handedness), handedness)
    if with_controls:
        controls.add_controls(context, hand)
        controls.use_joint_limits(hand, False)
        hand.pose.bones["control_hand"].rotation_euler.x = 0.5
    hand.pose.apply_pose_from_action(here.actions[0], evaluation_time=1.0)
    # worst observed 3.2e-8 m
    np.testing.assert_allclose(joints_of(context, hand), wanted_of("point", handedness), atol=2e-7)


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_every_pose_lies_within_the_joint_limits_of_the_controls(context, handedness):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m(handedness), handedness)
    controls.add_controls(context, hand)
    for pose in poses.all_poses(handedness):
        hand_poses.take_pose(hand, pose)
        away = np.linalg.norm(joints_of(context, hand) - wanted_of(pose.name, handedness), axis=-1)
        assert away.max() < 5e-7, (pose.name, NAMES[int(away.argmax())], away.max())


def test_a_pose_of_the_other_hand_is_refused(context):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("left"), "left")
    with pytest.raises(JGHandFailure, match="no right hand"):
        hand_poses.take_pose(hand, poses.pose_named("fist", "right"))


def test_the_library_becomes_one_of_the_users_once(context, library):
    libraries = context.preferences.filepaths.asset_libraries
    before = len(libraries)
    for _ in range(2):
        pose_library.use_library(library)
    assert len(libraries) == before + 1


def test_a_library_of_the_users_with_our_name_stays_what_it_is(context, library, tmp_path):
    theirs = context.preferences.filepaths.asset_libraries.new(name="JGHand", directory=str(tmp_path))
    assert not pose_library.is_used(library)
    name = pose_library.use_library(library)
    assert pose_library.is_used(library)
    assert name != "JGHand"
    assert theirs.path == str(tmp_path)


def test_making_the_library_stopped_half_way_writes_nothing(context, tmp_path):
    steps = pose_library.library_steps(tmp_path / "poses")
    next(steps)
    steps.close()
    assert not (tmp_path / "poses").exists()


def test_a_folder_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(JGHandFailure) as caught:
        pose_library.build_library(tmp_path / "file" / "folder")
    assert caught.value.kind == "cannot_write"
