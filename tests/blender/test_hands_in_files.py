"""Hands and their settings are Blender's own data: they survive duplicating, saving, appending, linking and undo."""

from pathlib import Path

import bpy
import hands
import numpy as np
import pytest

from blender_addon.core import posing
from blender_addon.core.controls import HAND_CONTROL
from blender_addon.core.joints import HANDEDNESSES
from blender_addon.hand import armature, controls, seen_hands, sources

# float32 of bone chains through constraints; worst observed 3.4e-7 m
EXACT_M = 1e-6


def two_hands() -> dict[str, bpy.types.Object]:
    made = {}
    for side in HANDEDNESSES:
        bpy.ops.jghand.add_hand(handedness=side)
        made[side] = bpy.context.object
        made[side].jghand.avatar = f"{side}.jghand"
        made[side].jghand.show_in_viewport = side == "right"
    return made


def test_a_duplicate_has_its_own_settings_and_pose(extension):
    two_hands()
    bpy.ops.object.duplicate()
    twin = bpy.context.object
    assert twin.name != "Left Hand"
    assert (twin.jghand.avatar, twin.jghand.show_in_viewport) == ("left.jghand", False)
    twin.jghand.avatar = "twin.jghand"
    bpy.ops.jghand.apply_pose(pose="fist")
    first = bpy.data.objects["Left Hand"]
    assert first.jghand.avatar == "left.jghand"
    np.testing.assert_allclose(hands.joints_of(first), posing.rest_joints_m("left"), atol=EXACT_M)
    assert np.abs(hands.joints_of(twin) - hands.joints_of(first)).max() > 0.05
    assert len({thing.session_uid for thing in armature.hands_at_any_frame(bpy.context.view_layer)}) == 3


def test_a_file_keeps_hands_settings_and_bone_maps(extension, tmp_path):
    two_hands()["left"].pose.bones[HAND_CONTROL].rotation_euler.x = 0.6
    wanted = hands.joints_of(bpy.data.objects["Left Hand"])
    rig, _ = hands.mixamo_rig(extension)
    bpy.ops.jghand.use_armature()
    rig.jghand.joints["index1"].bone = ""
    bpy.context.scene.jghand.viewport_preset = "draft"
    bpy.context.scene.jghand.viewport_budget_ms = 12.5
    path = str(tmp_path / "hands.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=path)
    left = bpy.data.objects["Left Hand"]
    assert (left.jghand.avatar, left.jghand.show_in_viewport) == ("left.jghand", False)
    np.testing.assert_allclose(hands.joints_of(left), wanted, atol=EXACT_M)
    assert bpy.context.scene.jghand.viewport_preset == "draft"
    assert bpy.context.scene.jghand.viewport_budget_ms == 12.5
    rows = bpy.data.objects["Body"].jghand.joints
    assert len(rows) == 21
    assert rows["index1"].bone == ""
    assert rows["index2"].bone == "mixamorig:RightHandIndex2"


@pytest.mark.parametrize("linked", [False, True], ids=["appended", "linked"])
def test_hands_of_another_file_keep_their_settings(extension, tmp_path, linked):
    two_hands()
    path = str(tmp_path / "hands.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.jghand.add_hand(handedness="left")
    with bpy.data.libraries.load(path, link=linked) as (_there, here):
        here.objects = ["Left Hand", "Right Hand"]
    for thing in here.objects:
        bpy.context.scene.collection.objects.link(thing)
    come = {armature.handedness_of(thing): thing for thing in here.objects}
    assert come["right"].jghand.avatar == "right.jghand"
    assert controls.has_controls(come["left"])
    for side, thing in come.items():
        np.testing.assert_allclose(hands.joints_of(thing), posing.rest_joints_m(side), atol=EXACT_M)
    assert len(armature.hands_at_any_frame(bpy.context.view_layer)) == 3
    bpy.context.view_layer.objects.active = come["left"]
    come["left"].select_set(True)
    for other in list(bpy.context.view_layer.objects.selected):
        other.select_set(other == come["left"])
    if linked:
        with pytest.raises(RuntimeError, match="linked from another file"):
            bpy.ops.jghand.apply_pose(pose="fist")
    else:
        bpy.ops.jghand.apply_pose(pose="fist")


def test_a_library_override_of_a_hand_can_be_posed_and_has_settings_of_its_own(extension, tmp_path):
    two_hands()
    path = str(tmp_path / "hands.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_there, here):
        here.objects = ["Right Hand"]
    bpy.context.scene.collection.objects.link(here.objects[0])
    own = here.objects[0].override_hierarchy_create(bpy.context.scene, bpy.context.view_layer)
    assert own.override_library is not None
    bpy.context.view_layer.objects.active = own
    own.select_set(True)
    bpy.ops.jghand.apply_pose(pose="fist")
    assert np.abs(hands.joints_of(own) - posing.rest_joints_m("right")).max() > 0.05
    assert own.jghand.avatar == "right.jghand"
    own.jghand.avatar = "other.jghand"
    own.jghand.show_in_viewport = False
    name = own.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
    own = next(thing for thing in bpy.data.objects if thing.name == name and thing.override_library)
    assert (own.jghand.avatar, own.jghand.show_in_viewport) == ("other.jghand", False)


def test_what_was_evaluated_of_an_override_has_the_avatar_beside_its_library(extension, tmp_path):
    two_hands()
    bpy.data.objects["Right Hand"].jghand.avatar = "//right.jghand"
    (tmp_path / "hands").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hands" / "hands.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    with bpy.data.libraries.load(str(tmp_path / "hands" / "hands.blend"), link=True) as (_there, here):
        here.objects = ["Right Hand"]
    own = here.objects[0].override_create()
    bpy.context.scene.collection.objects.link(own)
    evaluated = own.evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert evaluated.is_evaluated
    for thing in (own, evaluated):
        assert Path(seen_hands.avatar_of(thing)) == tmp_path / "hands" / "right.jghand"
    own.jghand.avatar = "//mine.jghand"
    evaluated = own.evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert Path(seen_hands.avatar_of(evaluated)) == tmp_path / "mine.jghand"


def test_undo_and_redo_of_a_bone_that_was_chosen(extension):
    rig, _ = hands.mixamo_rig(extension)
    bpy.ops.jghand.use_armature()
    bpy.ops.ed.undo_push(message="mapped")
    rig.jghand.joints["ring2"].bone = "mixamorig:LeftHandRing2"
    bpy.ops.ed.undo_push(message="chosen")
    bpy.ops.ed.undo()
    assert sources.source_of(bpy.data.objects["Body"], "ring2").bone == "mixamorig:RightHandRing2"
    bpy.ops.ed.redo()
    assert sources.source_of(bpy.data.objects["Body"], "ring2").bone == "mixamorig:LeftHandRing2"


def test_a_duplicated_rig_and_a_duplicated_set_of_objects_stay_hands(extension):
    rig, joints = hands.mixamo_rig(extension)
    bpy.ops.jghand.use_armature()
    rig.select_set(True)
    bpy.ops.object.duplicate()
    twin = bpy.context.object
    twin.jghand.joints["index1"].bone = ""
    assert rig.jghand.joints["index1"].bone != ""
    seen = sources.read_hands(rig, bpy.context.evaluated_depsgraph_get())
    np.testing.assert_allclose(seen[0].joints_world_m, joints["right"], atol=EXACT_M)
    for thing in bpy.context.view_layer.objects:
        thing.select_set(False)
    hands.joint_empties(extension, "left")
    bpy.ops.jghand.use_objects()
    bpy.ops.object.duplicate()
    copy = bpy.context.object
    (again,) = sources.read_hands(copy, bpy.context.evaluated_depsgraph_get())
    np.testing.assert_allclose(again.joints_world_m, posing.rest_joints_m("left"), atol=EXACT_M)
