"""Every operator does its one thing in a real scene, says what is missing, and can be undone."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import bpy
import hands
import numpy as np
import pytest
from recording_layout import operator_type

from blender_addon import preferences, registration, versions
from blender_addon.core import bone_maps, kinematics, poses, posing
from blender_addon.core.controls import FINGER_CONTROLS, HAND_CONTROL
from blender_addon.core.joints import HANDEDNESSES, NAMES
from blender_addon.core.view import BUILTIN_AVATAR
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, avatar_files, controls, motion, motion_files, sources
from blender_addon.hand import poses as hand_poses
from blender_addon.hand import properties as hand_properties
from blender_addon.ops import PLUMBING, REGISTERED, UNDOABLE, sentence_of
from blender_addon.render import properties as scene_properties
from jghand_engine.captures.making.rig import load_identity
from jghand_engine.hand.orders import JointOrder, from_level, to_level

OPERATORS = [
    each for module in registration.WITH_CLASSES for each in module.CLASSES if issubclass(each, bpy.types.Operator)
]
_JOB = "starts a job, which writes files and nothing of the scene"
_SHOWS = "shows something"
SETTINGS = (*hand_properties.CLASSES, *scene_properties.CLASSES)
_ENGINE = "the engine is none of the file"
# what is not undone, and why
NOT_UNDONE = {
    "save_light": "writes files",
    **dict.fromkeys(("explain", "show_log"), _SHOWS),
    "restart_engine": _ENGINE,
    "preview_movie": "writes pictures, and leaves the scene as it is",
    **dict.fromkeys(("bake", "export", "hand_from_film", "render_training_set", "train"), _JOB),
    "cancel_job": "a job is none of the file",
    **dict.fromkeys(("install_tools", "remove_tools"), "the training tools are none of the file"),
    "make_pose_assets": "writes files and a preference",
    "install_hands": "writes files of the user",
}
_OF_FILE_BROWSERS = ("filepath", "directory", "files")
# float32 of bone chains through constraints; worst observed 3.4e-7 m
EXACT_M = 1e-6
ALL_CURLS = (HAND_CONTROL, *FINGER_CONTROLS)


def add(side: str = "right", **options: object) -> bpy.types.Object:
    assert bpy.ops.jghand.add_hand(handedness=side, **options) == {"FINISHED"}
    return bpy.context.object


def posed(name: str, side: str) -> np.ndarray:
    """On the built-in hand."""
    return poses.joints_on(name, posing.rest_joints_m(side), side, avatar_files.fist_of(BUILTIN_AVATAR))


def refuses(operator: Callable[..., object], **options: object) -> str:
    """The sentence with which an operator refuses, by its poll or by a report."""
    with pytest.raises(RuntimeError) as caught:
        operator(**options)
    return str(caught.value)


@pytest.mark.parametrize("side", HANDEDNESSES)
def test_add_hand_makes_a_hand_at_the_cursor_with_all_it_needs(extension, side):
    extension.scene.cursor.location = (1, 2, 3)
    thing = add(side)
    assert extension.scene.camera is None
    bpy.ops.jghand.add_camera()
    assert armature.handedness_of(thing) == side
    assert tuple(thing.location) == (1, 2, 3)
    assert extension.view_layer.objects.active == thing
    assert thing.select_get()
    assert controls.has_controls(thing)
    assert all(tuple(thing.pose.bones[name].rotation_euler) == (0, 0, 0) for name in ALL_CURLS)
    camera = extension.scene.camera
    joints = armature.read_hand(thing, extension.evaluated_depsgraph_get()).joints_world_m
    along = joints[12] - joints[0]
    assert along[2] > 0.95 * np.linalg.norm(along), "it stands upright"
    pixels = hands.blenders_pixels(extension.scene, camera, joints, (1920, 1080))
    assert (pixels > 0).all()
    assert (pixels < (1920, 1080)).all()
    # a tenth of the picture at the least: the camera is on the hand
    assert np.ptp(pixels[:, 1]) > 300


def test_add_hand_adds_as_many_hands_as_wanted(extension):
    first = add("right", use_controls=False)
    assert not controls.has_controls(first)
    second = add("right")
    assert second.name != first.name
    assert not first.select_get()
    assert len(armature.hands_at_any_frame(extension.view_layer)) == 2


def test_hands_that_are_added_at_one_place_stand_side_by_side(extension):
    extension.scene.unit_settings.scale_length = 0.5
    extension.scene.cursor.location = (1, 2, 3)
    places = [tuple(add(side).location) for side in ("right", "left", "left")]
    assert places == [(1, 2, 3), (1.5, 2, 3), (2, 2, 3)]


def test_add_hand_goes_into_the_active_collection_and_out_of_any_mode(extension):
    thing = add()
    inner = bpy.data.collections.new("Inner")
    extension.scene.collection.children.link(inner)
    extension.view_layer.active_layer_collection = extension.view_layer.layer_collection.children["Inner"]
    bpy.ops.object.mode_set(mode="POSE")
    other = add("left")
    assert other.users_collection == (inner,)
    assert thing.users_collection == (extension.scene.collection,)
    inner.hide_viewport = True  # there nothing can be made: the scene's own collection takes it
    assert add("left").users_collection == (extension.scene.collection,)


def test_add_hand_warns_of_a_thing_that_hides_it(extension, capfd):
    bpy.ops.mesh.primitive_cube_add(location=(0, 0, 0))
    add()
    assert "inside Cube" in capfd.readouterr().out
    extension.scene.cursor.location = (5, 0, 0)
    add()
    assert "inside" not in capfd.readouterr().out
    extension.scene.cursor.location, extension.scene.jghand.light = (0, 0, 0), "SCENE"
    add()
    assert "keeps lamps from it" in capfd.readouterr().out


def test_undo_takes_a_hand_away_and_redo_brings_it_back_whole(extension):
    bpy.ops.ed.undo_push(message="empty")
    add("left")
    bpy.context.object.jghand.avatar = "somebody.jghand"
    bpy.ops.ed.undo_push(message="hand")
    bpy.ops.ed.undo()
    assert not armature.hands_at_any_frame(bpy.context.view_layer)
    bpy.ops.ed.redo()
    (thing,) = armature.hands_at_any_frame(bpy.context.view_layer)
    assert thing.jghand.avatar == "somebody.jghand"
    np.testing.assert_allclose(hands.joints_of(thing), posing.rest_joints_m("left"), atol=EXACT_M)


def test_a_character_becomes_two_hands_and_is_forgotten_one_by_one(extension):
    rig, joints = hands.mixamo_rig(extension)
    assert bpy.ops.jghand.use_armature() == {"FINISHED"}
    seen = sources.read_hands(rig, extension.evaluated_depsgraph_get())
    for one, side in zip(seen, HANDEDNESSES, strict=True):
        np.testing.assert_allclose(one.joints_world_m, joints[side], atol=EXACT_M)
    bpy.ops.jghand.forget(handedness="right")
    assert [one.handedness for one in sources.read_hands(rig, extension.evaluated_depsgraph_get())] == ["left"]
    bpy.ops.jghand.forget()
    assert not armature.is_foreign(rig)


def test_where_two_answers_are_possible_the_first_is_taken_and_told_and_the_other_can_be_had(extension, capfd):
    rig = hands.named_bones(extension, _doubtful_names())
    candidates = sources.recognize(rig, "right").candidates
    assert len(candidates) == 2
    for answer, wanted in enumerate(candidates, 1):
        assert bpy.ops.jghand.use_armature(answer=answer) == {"FINISHED"}
        said = capfd.readouterr().out
        assert "Several sets of bones may be the right hand" in said
        assert f"Number {answer} is used" in said
        (stored,) = sources.stored_maps(rig)
        assert stored.sources == wanted.sources
        rig.jghand.joints["index2"].bone = ""
        assert bpy.ops.jghand.fill_bone_map() == {"FINISHED"}
        (stored,) = sources.stored_maps(rig)
        assert stored.sources == wanted.sources
        bpy.ops.jghand.forget()
    bpy.ops.jghand.use_armature(answer=7)
    assert "Number 2 is used" in capfd.readouterr().out


def _doubtful_names() -> list[str]:
    """Two sets of the same bones, told apart by their prefixes only."""
    return [f"{prefix}:RightHand{word}" for prefix in ("one", "two") for word in ("", *_mixamo_words())]


def _mixamo_words() -> list[str]:
    return [f"{finger}{level}" for finger in ("Thumb", "Index", "Middle", "Ring", "Pinky") for level in (1, 2, 3, 4)]


def test_a_rig_that_nobody_knows_gets_an_empty_list_to_fill_by_hand(extension):
    rig = hands.named_bones(extension, [f"bone {place}" for place in range(21)])
    assert bpy.ops.jghand.use_armature() == {"FINISHED"}
    (stored,) = sources.stored_maps(rig)
    assert stored.sources == (None,) * 21
    for place, row in enumerate(rig.jghand.joints):
        row.bone = f"bone {place}"
    rig.jghand.joints["thumb4"].bone, rig.jghand.joints["thumb4"].end = "bone 3", "tail"
    (stored,) = sources.stored_maps(rig)
    assert stored.complete
    assert stored.sources[4] == bone_maps.JointSource("bone 3", "tail")
    (seen,) = sources.read_hands(rig, extension.evaluated_depsgraph_get())
    bone = rig.data.bones["bone 3"]
    np.testing.assert_allclose(seen.joints_world_m[4], rig.matrix_world @ bone.tail_local, atol=EXACT_M)


def test_finding_bones_again_keeps_what_was_chosen_and_fills_what_is_missing(extension):
    rig, _ = hands.mixamo_rig(extension)
    bpy.ops.jghand.use_armature()
    rows = rig.jghand.joints
    rows["index1"].bone = "mixamorig:RightHandMiddle1"
    rows["index2"].bone = ""
    rows["index3"].bone = "gone"
    assert bpy.ops.jghand.fill_bone_map() == {"FINISHED"}
    assert rows["index1"].bone.endswith("Middle1")
    assert rows["index2"].bone.endswith("Index2")
    assert rows["index3"].bone.endswith("Index3")
    bpy.ops.jghand.fill_bone_map(only_missing=False)
    assert rows["index1"].bone.endswith("Index1")


def test_21_selected_objects_become_a_hand(extension):
    hands.joint_empties(extension, "left")
    assert bpy.ops.jghand.use_objects() == {"FINISHED"}
    holder = extension.object
    (seen,) = sources.read_hands(holder, extension.evaluated_depsgraph_get())
    np.testing.assert_allclose(seen.joints_world_m, posing.rest_joints_m("left"), atol=EXACT_M)
    bpy.ops.jghand.forget()
    assert not armature.is_foreign(holder)


def test_objects_of_which_one_has_another_name_are_refused_by_name(extension):
    things = hands.joint_empties(extension, "right")
    things[6].name = "something"
    assert "index2" in refuses(bpy.ops.jghand.use_objects)


@pytest.mark.parametrize("side", HANDEDNESSES)
@pytest.mark.parametrize("name", ["flat", "relaxed", "fist", "point", "pinch", "ASL V"])
def test_a_pose_is_applied_whatever_the_controls_were(extension, side, name):
    thing = add(side)
    thing.pose.bones[HAND_CONTROL].rotation_euler.x = 0.5
    controls.hold_tip(thing, "index")
    assert bpy.ops.jghand.apply_pose(pose=name) == {"FINISHED"}
    np.testing.assert_allclose(hands.joints_of(thing), posed(name, side), atol=EXACT_M)


@pytest.mark.parametrize("side", HANDEDNESSES)
@pytest.mark.parametrize("identity", ["adult_woman", "long_fingers", "child"])
def test_a_fist_and_a_pinch_close_on_the_hand_that_they_are_applied_to(extension, side, identity):
    """Bones are as far apart as skin is thick; worst seen 0.1 mm, and 5 mm with the built-in hand's angles."""
    joints_m = load_identity(identity).joints_m
    own = posing.rest_joints_m(side, from_level(joints_m, JointOrder.STANDARD)[None])
    thing = armature.build_armature(extension, "Hand", own, side)
    thing.select_set(True)
    extension.view_layer.objects.active = thing
    size_m = kinematics.ArchingHand(joints_m).finger_length_m
    bpy.ops.jghand.apply_pose(pose="fist")
    gaps_m = kinematics.palm_gaps_m(to_level(hands.joints_of(thing), JointOrder.STANDARD)[None])[0]
    parts = np.add(kinematics.PALM_GAP_PARTS, (0, *avatar_files.fist_of(BUILTIN_AVATAR).room_parts))
    np.testing.assert_allclose(gaps_m, size_m * parts, atol=1.5e-4)
    bpy.ops.jghand.apply_pose(pose="pinch")
    thumb, index = (hands.joints_of(thing)[NAMES.index(tip)] for tip in ("thumb4", "index4"))
    assert abs(np.linalg.norm(thumb - index) - size_m * kinematics.TIP_THICKNESS_PART) < 1.5e-4


def test_half_a_pose_lies_between(extension):
    thing = add()
    bpy.ops.jghand.apply_pose(pose="open")
    bone = thing.pose.bones["index2"]
    start = bone.rotation_quaternion.copy()
    bpy.ops.jghand.apply_pose(pose="fist", part=0.5)
    half = bone.rotation_quaternion.copy()
    bpy.ops.jghand.apply_pose(pose="fist")
    whole = start.rotation_difference(bone.rotation_quaternion).angle
    assert start.rotation_difference(half).angle == pytest.approx(whole / 2, abs=1e-3)


def test_a_pose_goes_to_all_selected_hands_each_of_its_side(extension):
    right, left = add("right"), add("left")
    right.select_set(True)
    bpy.ops.jghand.apply_pose(pose="fist")
    for thing, side in ((right, "right"), (left, "left")):
        np.testing.assert_allclose(hands.joints_of(thing), posed("fist", side), atol=EXACT_M)


def test_a_pose_is_keyed_where_it_is_asked_for_and_with_auto_keying(extension):
    thing = add()
    extension.scene.frame_set(7)
    bpy.ops.jghand.apply_pose(pose="fist")
    assert not versions.fcurves(thing)
    bpy.ops.jghand.apply_pose(pose="fist", use_keys=True)
    curves = {curve.data_path for curve in versions.fcurves(thing)}
    assert {f'pose.bones["{name}"].rotation_quaternion' for name in hand_poses.MOVING_BONES} <= curves
    extension.scene.tool_settings.use_keyframe_insert_auto = True
    extension.scene.frame_set(20)
    bpy.ops.jghand.apply_pose(pose="flat")
    assert {key.co[0] for curve in versions.fcurves(thing) for key in curve.keyframe_points} == {7.0, 20.0}
    extension.scene.frame_set(7)
    np.testing.assert_allclose(hands.joints_of(thing), posed("fist", "right"), atol=EXACT_M)


@pytest.mark.parametrize("is_selected", [True, False])
def test_the_timeline_shows_the_keys_of_a_pose_in_object_mode(extension, is_selected):
    """Blender jumps to keys that its timeline shows: those of selected bones, which Add Hand and a pose see to."""
    thing = add()
    assert versions.selected_bones(thing) >= {*hand_poses.MOVING_BONES, *FINGER_CONTROLS}
    assert not versions.selected_bones(thing) & {"tip_index"}, "it is hidden until its tip is pinned"
    if not is_selected:
        hands.select_bones(thing)
    for frame in (1, 12):
        extension.scene.frame_set(frame)
        bpy.ops.jghand.apply_pose(pose="fist", use_keys=True)
    extension.scene.frame_set(1)
    assert bpy.ops.screen.keyframe_jump(next=True) == {"FINISHED"}
    assert extension.scene.frame_current == 12


@pytest.mark.parametrize("what", ["apply_pose", "reset_pose"])
@pytest.mark.parametrize(
    ("selected", "posed", "neutral"),
    [
        ((), hand_poses.MOVING_BONES, ALL_CURLS),
        (("index2",), ("index2",), ()),
        (("index1", "index2", "index3", "wrist"), ("index1", "index2", "index3"), (FINGER_CONTROLS[1],)),
        ((FINGER_CONTROLS[4],), ("pinky1", "pinky2", "pinky3"), (FINGER_CONTROLS[4],)),
        ((HAND_CONTROL,), hand_poses.MOVING_BONES, ALL_CURLS),
    ],
    ids=["nothing", "a bone", "a finger", "a ring", "the bracelet"],
)
def test_in_pose_mode_selected_bones_alone_are_posed(extension, what, selected, posed, neutral):
    thing = add()
    for name in hand_poses.MOVING_BONES:
        thing.pose.bones[name].rotation_quaternion = (math.cos(0.1), 0.0, math.sin(0.1), 0.0)
    for name in ALL_CURLS:
        thing.pose.bones[name].rotation_euler.x = 0.1
    bpy.ops.object.mode_set(mode="POSE")
    hands.select_bones(thing, *selected)
    before = {bone.name: bone.matrix_basis.copy() for bone in thing.pose.bones}
    call = bpy.ops.jghand.reset_pose if what == "reset_pose" else partial(bpy.ops.jghand.apply_pose, pose="fist")
    assert call(use_keys=True) == {"FINISHED"}
    changed = {name for name, matrix in before.items() if thing.pose.bones[name].matrix_basis != matrix}
    assert changed == {*posed, *neutral}
    keyed = {curve.data_path.split('"')[1] for curve in versions.fcurves(thing)}
    assert {name for name in keyed if not name.startswith("tip_")} == {*posed, *neutral}
    assert versions.selected_bones(thing) == set(selected), "the selection stays"


@pytest.mark.parametrize("what", ["apply_pose", "reset_pose"])
def test_a_bone_selected_on_one_hand_leaves_the_other_hand(extension, what):
    pair = [add("left"), add("right")]
    for thing in pair:
        thing.select_set(True)
        thing.pose.bones["index2"].rotation_quaternion = (math.cos(0.1), 0.0, math.sin(0.1), 0.0)
    bpy.ops.object.mode_set(mode="POSE")
    assert {thing.mode for thing in pair} == {"POSE"}
    hands.select_bones(pair[0])
    hands.select_bones(pair[1], "index2")
    before = [{bone.name: bone.matrix_basis.copy() for bone in thing.pose.bones} for thing in pair]
    call = bpy.ops.jghand.reset_pose if what == "reset_pose" else partial(bpy.ops.jghand.apply_pose, pose="fist")
    assert call() == {"FINISHED"}
    changed = [
        {name for name, matrix in was.items() if thing.pose.bones[name].matrix_basis != matrix}
        for thing, was in zip(pair, before, strict=True)
    ]
    assert changed == [set(), {"index2"}]


def test_controls_that_still_bend_a_finger_posed_alone_are_told(extension, capfd):
    thing = add()
    bpy.ops.object.mode_set(mode="POSE")
    hands.select_bones(thing, "index1", "index2", "index3")
    bpy.ops.jghand.apply_pose(pose="fist")
    assert "still bend" not in capfd.readouterr().out
    thing.pose.bones[HAND_CONTROL].rotation_euler.x = 0.3
    controls.hold_tip(thing, "index")
    hands.select_bones(thing, "index1")
    bpy.ops.jghand.apply_pose(pose="fist")
    assert f"reset or mute {HAND_CONTROL}, tip_index." in capfd.readouterr().out
    hands.select_bones(thing)
    bpy.ops.jghand.apply_pose(pose="fist")
    assert "still bend" not in capfd.readouterr().out


def test_a_selection_without_a_finger_is_told(extension, capfd):
    thing = add()
    bpy.ops.object.mode_set(mode="POSE")
    hands.select_bones(thing, "wrist")
    assert bpy.ops.jghand.apply_pose(pose="fist") == {"FINISHED"}
    assert "No finger bone is selected" in capfd.readouterr().out


def key_by_hand(thing: bpy.types.Object, *, bones: bool) -> None:
    """A held and moved tip, a curled finger and, where it is wanted, stretched bones, keyed at the present frame."""
    bone = thing.pose.bones
    keyed = controls.hold_tip(thing, "middle")
    bone["tip_middle"].location.z -= 0.01
    bone[FINGER_CONTROLS[3]].rotation_euler.x = 0.4
    keyed.append((bone[FINGER_CONTROLS[3]], "rotation_euler"))
    if bones:
        bone["index2"].location.y, bone["index3"].scale = 0.01, (1.5, 1.5, 1.5)
        keyed += [(bone["index2"], "location"), (bone["index3"], "scale")]
    for owner, path in keyed:
        owner.keyframe_insert(path)


@pytest.mark.parametrize("what", ["apply_pose", "reset_pose", "flip_pose"])
def test_keys_of_a_pose_hold_all_that_it_changed(extension, what):
    """Keyed at two frames and looked at again: also held tips, moved tips and stretched bones are as they were."""
    add("left")
    thing = add("right")
    other = next(each for each in armature.hands_at_any_frame(extension.view_layer) if each != thing)
    if what == "flip_pose":
        thing, other = other, thing
    extension.scene.tool_settings.use_keyframe_insert_auto = True
    call = {
        "apply_pose": lambda: bpy.ops.jghand.apply_pose(pose="point"),
        "reset_pose": bpy.ops.jghand.reset_pose,
        "flip_pose": bpy.ops.jghand.flip_pose,
    }[what]
    wanted = {}
    for frame in (1, 20):
        extension.scene.frame_set(frame)
        extension.view_layer.update()
        assert call() == {"FINISHED"}
        wanted[frame] = hands.joints_of(thing)
        if frame == 1:  # what is keyed between is to end at the next pose
            extension.scene.frame_set(10)
            key_by_hand(thing, bones=what == "reset_pose")
            key_by_hand(other, bones=False)
    for frame in (1, 20, 1):
        extension.scene.frame_set(frame)
        np.testing.assert_allclose(hands.joints_of(thing), wanted[frame], atol=EXACT_M)
        extension.scene.frame_set(30)


def test_auto_keying_keys_a_held_tip_and_where_it_is(extension):
    thing = add()
    extension.scene.tool_settings.use_keyframe_insert_auto = True
    extension.scene.frame_set(5)
    bpy.ops.jghand.hold_tip(finger="index", hold=False)
    extension.scene.frame_set(6)
    thing.pose.bones[FINGER_CONTROLS[1]].rotation_euler.x = 0.5
    bpy.ops.jghand.hold_tip(finger="index")
    wanted = hands.joints_of(thing)
    curves = versions.fcurves(thing)
    assert len(curves) == 4  # the influence, and the place of the control
    assert {curve.group.name for curve in curves} == {"tip_index", "index3"}
    extension.scene.frame_set(5)
    assert controls.tip_rule(thing, 1).influence == 0
    extension.scene.frame_set(6)
    np.testing.assert_allclose(hands.joints_of(thing), wanted, atol=EXACT_M)


def test_bones_that_an_artist_keeps_in_euler_angles_stay_so(extension):
    thing = add(use_controls=False)
    for mode, name in (("XYZ", "index1"), ("AXIS_ANGLE", "index2"), ("ZYX", "thumb1")):
        thing.pose.bones[name].rotation_mode = mode
    bpy.ops.jghand.apply_pose(pose="fist", use_keys=True)
    assert thing.pose.bones["index1"].rotation_mode == "XYZ"
    np.testing.assert_allclose(hands.joints_of(thing), posed("fist", "right"), atol=EXACT_M)
    extension.scene.frame_set(3)
    np.testing.assert_allclose(hands.joints_of(thing), posed("fist", "right"), atol=EXACT_M)


def test_the_other_hand_takes_the_mirrored_pose_and_the_controls(extension):
    right, left = add("right"), add("left")
    bpy.ops.jghand.apply_pose(pose="point")
    for at, name in enumerate((HAND_CONTROL, *FINGER_CONTROLS)):
        left.pose.bones[name].rotation_euler = (0.05 * at, 0, 0.03)
    extension.view_layer.update()
    controls.hold_tip(left, "pinky")
    left.pose.bones["tip_pinky"].location += controls.Vector((0.004, -0.003, 0.002))
    assert bpy.ops.jghand.flip_pose() == {"FINISHED"}
    wanted = hands.joints_of(left) * (-1, 1, 1)
    np.testing.assert_allclose(hands.joints_of(right), wanted, atol=EXACT_M)


def test_a_hand_of_the_same_side_takes_the_pose_as_it_is(extension):
    first, second = add("right"), add("right", use_controls=False)
    first.select_set(True)
    bpy.ops.jghand.apply_pose(pose="victory")
    bpy.ops.jghand.reset_pose()
    second.pose.bones["index1"].rotation_quaternion = (math.cos(0.2), math.sin(0.2), 0, 0)
    bpy.ops.jghand.flip_pose()
    np.testing.assert_allclose(hands.joints_of(first), hands.joints_of(second), atol=EXACT_M)


def test_flip_needs_a_hand_to_take_the_pose(extension):
    add()
    assert "Select the hand that is to take the pose" in refuses(bpy.ops.jghand.flip_pose)
    add("left")
    add("left")
    assert "Select the hand that is to take the pose" in refuses(bpy.ops.jghand.flip_pose)


def test_reset_puts_fingers_and_controls_to_rest_and_leaves_the_wrist(extension):
    thing = add()
    bpy.ops.jghand.apply_pose(pose="fist")
    thing.pose.bones[HAND_CONTROL].rotation_euler.x = 0.4
    thing.pose.bones["index2"].location = (0, 0.01, 0)
    thing.pose.bones["wrist"].location = (0, 0.05, 0)
    bpy.ops.jghand.reset_pose()
    wanted = posing.rest_joints_m("right") + np.array(thing.pose.bones["wrist"].matrix.translation)
    np.testing.assert_allclose(hands.joints_of(thing), wanted, atol=EXACT_M)
    assert thing.pose.bones["wrist"].location[1] == pytest.approx(0.05)


def test_finger_controls_come_go_and_are_muted(extension):
    thing = add(use_controls=False)
    assert "Add Finger Controls" in refuses(bpy.ops.jghand.joint_limits)
    bpy.ops.jghand.add_controls()
    assert controls.has_controls(thing)
    assert controls.joint_limits_are_used(thing)
    bpy.ops.jghand.joint_limits()
    assert not controls.joint_limits_are_used(thing)
    bpy.ops.jghand.joint_limits()
    assert controls.joint_limits_are_used(thing)
    bpy.ops.jghand.mute_controls()
    assert controls.controls_are_muted(thing)
    assert "muted" in refuses(bpy.ops.jghand.hold_tip, finger="index")
    bpy.ops.jghand.mute_controls()
    bpy.ops.jghand.hold_tip(finger="ring")
    assert controls.tip_rule(thing, 3).influence == 1
    bpy.ops.jghand.hold_tip(finger="ring", hold=False)
    assert controls.tip_rule(thing, 3).influence == 0
    bpy.ops.jghand.remove_controls()
    assert not controls.has_controls(thing)


def test_baking_takes_all_selected_hands_over_the_preview_range(extension):
    first, second = add("right"), add("left")
    bare = add("left", use_controls=False)
    for thing in (first, second):
        thing.select_set(True)
        thing.pose.bones[HAND_CONTROL].rotation_euler.x = 0.6
    extension.view_layer.objects.active = second
    wanted = [hands.joints_of(thing) for thing in (first, second)]
    scene = extension.scene
    scene.use_preview_range, scene.frame_preview_start, scene.frame_preview_end = True, 5, 7
    assert bpy.ops.jghand.bake_controls() == {"FINISHED"}
    for thing, joints in zip((first, second), wanted, strict=True):
        assert not controls.has_controls(thing)
        assert {key.co[0] for curve in versions.fcurves(thing) for key in curve.keyframe_points} == {5.0, 6.0, 7.0}
        np.testing.assert_allclose(hands.joints_of(thing), joints, atol=EXACT_M)
    assert not versions.fcurves(bare)


def linked_hand(context: bpy.types.Context, path: Path) -> bpy.types.Object:
    """A hand with controls in a file of its own, linked into an empty one as an override of the object."""
    thing = add("right")
    bpy.data.libraries.write(str(path), {thing})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(path), link=True) as (_there, taken):
        taken.objects = [thing_name for thing_name in _there.objects if "Hand" in thing_name][:1]
    (linked,) = taken.objects
    bpy.context.scene.collection.objects.link(linked)
    return linked


def test_linked_hands_are_refused_by_the_poll_and_overrides_only_where_bones_change(extension, tmp_path):
    linked = linked_hand(extension, tmp_path / "hand.blend")
    own = add("left")
    linked.select_set(True)
    for operator in (bpy.ops.jghand.add_controls, bpy.ops.jghand.reset_pose):
        assert f"{linked.name} is linked" in refuses(operator)
    override = linked.override_create(remap_local_usages=True)
    extension.view_layer.objects.active = override
    assert bpy.ops.jghand.apply_pose(pose="fist") == {"FINISHED"}
    for operator in (bpy.ops.jghand.add_controls, bpy.ops.jghand.remove_controls, bpy.ops.jghand.bake_controls):
        assert "make object and armature local" in refuses(operator)
    override.select_set(False)
    extension.view_layer.objects.active = own
    assert bpy.ops.jghand.remove_controls() == {"FINISHED"}


def write_motion(path: Path, joints_m: np.ndarray, side: str, fps: float = 24.0) -> Path:
    np.savez(path, joints_m=joints_m, order="standard", unit="m", fps=fps, handedness=side)
    return path


@pytest.mark.parametrize("side", HANDEDNESSES)
def test_a_motion_goes_onto_the_active_hand_exactly_with_controls_on_it(extension, tmp_path, side):
    joints = hands.moving_hand_m(side)
    path = write_motion(tmp_path / "wave.npz", joints, side)
    thing = add(side)
    thing.pose.bones[HAND_CONTROL].rotation_euler.x = 0.7
    chosen = {"first_frame": 10, "use_scene_range": True, "placement": "FILE"}
    assert bpy.ops.jghand.import_motion(filepath=str(path), **chosen) == {"FINISHED"}
    assert extension.object == thing
    assert thing.animation_data.action.name == "wave"
    assert (extension.scene.frame_start, extension.scene.frame_end) == (10, 14)
    for place, wanted in enumerate(joints):
        seen = armature.read_hand(thing, armature.at_frame(extension.scene, 10 + place))
        np.testing.assert_allclose(seen.joints_world_m, wanted, atol=EXACT_M)
    # the controls act on top again
    thing.pose.bones[HAND_CONTROL].rotation_euler.x = 0.7
    assert np.abs(hands.joints_of(thing) - joints[-1]).max() > 0.01


@pytest.mark.parametrize("placement", ["", "FROM_HAND", "IN_PLACE"])
@pytest.mark.parametrize("is_there", [True, False])
def test_a_motion_begins_where_the_hand_stands_a_new_one_where_it_is_told(extension, tmp_path, is_there, placement):
    joints = hands.moving_hand_m("right")
    joints = joints + np.linspace((0.3, -0.2, 1.1), (0.8, 0.3, 1.6), len(joints))[:, None]
    path = write_motion(tmp_path / "wave.npz", joints, "right")
    extension.scene.cursor.location = (1, 2, 3)
    if is_there:
        add("right")
    chosen = {"placement": placement} if placement else {}
    assert bpy.ops.jghand.import_motion(filepath=str(path), **chosen) == {"FINISHED"}
    place = (1, 2, 3) if is_there else joints[0, 0]
    still = joints[:, :1] if placement == "IN_PLACE" else joints[:1, :1]
    for frame, wanted in enumerate(joints - still + place):
        seen = armature.read_hand(extension.object, armature.at_frame(extension.scene, 1 + frame))
        np.testing.assert_allclose(seen.joints_world_m, wanted, atol=3 * EXACT_M)


def test_a_motion_of_the_other_side_or_without_a_hand_makes_a_new_hand(extension, tmp_path):
    joints = hands.moving_hand_m("left")
    path = str(write_motion(tmp_path / "wave.npz", joints, "left"))
    right = add("right")
    assert bpy.ops.jghand.import_motion(filepath=path) == {"FINISHED"}
    made = extension.object
    assert made != right
    assert armature.handedness_of(made) == "left"
    right.select_set(True)
    extension.view_layer.objects.active = right
    assert "other hand" in refuses(bpy.ops.jghand.import_motion, filepath=path, target="ACTIVE")
    extension.view_layer.objects.active = None
    assert "no hand is active" in refuses(bpy.ops.jghand.import_motion, filepath=path, target="ACTIVE")


def test_a_motion_that_is_refused_leaves_the_controls_as_they_were(extension, tmp_path):
    path = str(write_motion(tmp_path / "wave.npz", hands.moving_hand_m("right"), "right"))
    thing = add("right")
    thing.pose.bones["index1"].constraints.new("COPY_ROTATION").name = "Mine"
    before = [(rule.name, rule.mute) for bone in thing.pose.bones for rule in bone.constraints]
    assert "index1: Mine" in refuses(bpy.ops.jghand.import_motion, filepath=path)
    assert [(rule.name, rule.mute) for bone in thing.pose.bones for rule in bone.constraints] == before


def test_what_is_refused_at_the_second_hand_leaves_the_first_one_alone(extension):
    right, left = add("right"), add("left")
    left.pose.bones["index2"].constraints.new("COPY_ROTATION")
    counts = {name: len(getattr(bpy.data, name)) for name in ("objects", "armatures", "actions")}
    contents = {side: motion_files.MotionFile(hands.moving_hand_m(side), 24.0, side) for side in HANDEDNESSES}
    wanted = [
        motion.WantedMotion(contents["right"], "wave", right),
        motion.WantedMotion(contents["right"], "new"),
        motion.WantedMotion(contents["left"], "left", left),
    ]
    with pytest.raises(JGHandFailure, match="index2"):
        motion.import_motions(extension, wanted)
    assert {name: len(getattr(bpy.data, name)) for name in counts} == counts
    assert right.animation_data is None


def test_motion_files_can_be_dropped_into_the_viewport(extension):
    handler = bpy.types.JGHAND_FH_motion
    assert handler.bl_import_operator == "jghand.import_motion"
    assert set(handler.bl_file_extensions.split(";")) == {".npz", ".json", ".csv", ".npy", ".bvh"}
    # a remembered path would be taken for one that was dropped
    assert operator_type("jghand.import_motion").properties["filepath"].is_skip_save


def test_selecting_a_hand_stays_in_pose_mode(extension):
    first, second = add("right"), add("left")
    bpy.ops.object.mode_set(mode="POSE")
    bpy.ops.jghand.select_hand(uid=first.session_uid)
    assert extension.object == first
    assert extension.mode == "POSE"
    assert not second.select_get()
    second.hide_set(True)
    assert "evaluate" in refuses(bpy.ops.jghand.select_hand, uid=second.session_uid)
    assert "view layer" in refuses(bpy.ops.jghand.select_hand, uid=2**30)


def test_standard_colors_undo_look_exposure_and_curves(extension):
    view = extension.scene.view_settings
    view.view_transform, view.exposure, view.gamma = "AgX", 2.0, 1.5
    view.look = "AgX - Punchy"
    view.use_curve_mapping = True
    bpy.ops.jghand.use_standard()
    assert (view.view_transform, view.look, view.exposure, view.gamma) == ("Standard", "None", 0.0, 1.0)
    assert not view.use_curve_mapping


def test_a_camera_is_added_for_a_hand_of_any_kind(extension):
    hands.mixamo_rig(extension)
    assert "Select a hand" in refuses(bpy.ops.jghand.add_camera)
    bpy.ops.jghand.use_armature()
    bpy.ops.jghand.add_camera()
    assert extension.scene.camera.name == "Hand Camera"
    assert extension.scene.camera.data.display_size < 0.1  # Blender's own of 1 m would be drawn across the hand


def test_the_manual_has_a_section_for_every_operator_and_setting(extension):
    from fnmatch import fnmatchcase

    written = preferences.PAGE.read_text(encoding="utf-8")
    address, entries = preferences.manual_map()
    assert address.startswith("file://")
    for _, section in entries:
        assert f'<h2 id="{section[1:]}">' in written, section
    patterns = [pattern for pattern, _ in entries]
    settings = [f"bpy.types.{each.__name__}.any".lower() for each in SETTINGS]
    for name in (*(f"bpy.ops.{each.bl_idname}" for each in OPERATORS), *settings):
        assert any(fnmatchcase(name, pattern) for pattern in patterns), name


def test_what_changes_data_can_be_undone_and_the_rest_says_why_not():
    names = {operator.bl_idname.partition(".")[2] for operator in OPERATORS}
    assert NOT_UNDONE.keys() <= names
    assert len(names) > 35
    for operator in OPERATORS:
        if not operator.bl_options >= UNDOABLE:
            assert operator.bl_idname.partition(".")[2] in NOT_UNDONE, operator
            assert operator.bl_options in (PLUMBING, REGISTERED), operator


def test_names_and_tooltips_follow_blenders_habits(extension):
    operators = [operator_type(operator.bl_idname) for operator in OPERATORS]
    for operator in operators:
        assert operator.description, operator
        assert not operator.description.endswith("."), operator
    preferences = bpy.types.AddonPreferences.bl_rna_get_subclass_py("JGHandPreferences").bl_rna
    for owner in (*operators, preferences, *(each.bl_rna for each in SETTINGS)):
        inherited = getattr(owner.base, "properties", ())
        for one in owner.properties:
            if one.identifier in inherited or one.identifier in ("rna_type", "name") or one.is_hidden:
                continue
            assert one.name, (owner, one)
            assert not one.description.endswith("."), (owner.identifier, one.identifier)
            # groups of settings and Blender's own properties of file browsers are not drawn with a tooltip
            if one.type not in ("POINTER", "COLLECTION") and one.identifier not in _OF_FILE_BROWSERS:
                assert one.description, (owner.identifier, one.identifier)
            for item in one.enum_items if one.type == "ENUM" else ():
                assert item.name, (owner.identifier, one.identifier, item.identifier)
                assert item.description, (owner.identifier, one.identifier, item.identifier)
                assert not item.description.endswith("."), (owner.identifier, one.identifier, item.identifier)


@pytest.mark.parametrize("path", ["/shots/hand--final.jghand", "/shots/hand--size/x"])
def test_a_report_names_the_file_it_is_about(path):
    assert sentence_of(JGHandFailure("no_avatar", path)).endswith(f" ({path})")
