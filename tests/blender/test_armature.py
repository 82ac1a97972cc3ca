"""One clean armature per hand, whose evaluated bones give the joints back wherever it stands."""

import bpy
import hands
import numpy as np
import pytest
from mathutils import Matrix

from blender_addon import versions
from blender_addon.core import posing
from blender_addon.core.joints import HANDEDNESSES, NAMES, PARENTS, TAILS, TIPS
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, motion
from blender_addon.hand.motion_files import MotionFile

# float32 of a bone chain near the origin; worst observed 4.3e-8 m
EXACT_M = 1e-7


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_the_armature_is_one_bone_per_joint(context, handedness):
    joints = posing.rest_joints_m(handedness)
    hand = armature.build_armature(context, "Hand", joints, handedness)
    bones = hand.data.bones
    assert sorted(bones.keys()) == sorted(NAMES)
    for place, name in enumerate(NAMES):
        bone, parent = bones[name], PARENTS[place]
        np.testing.assert_allclose(bone.head_local, joints[place], atol=EXACT_M)
        assert (bone.parent.name if bone.parent else None) == (NAMES[parent] if parent >= 0 else None)
        assert not bone.use_connect
        assert bone.use_deform == (place not in TIPS)
        if place in TIPS:
            assert bone.length == pytest.approx(0.001, abs=EXACT_M)
        else:
            np.testing.assert_allclose(bone.tail_local, joints[TAILS[place]], atol=EXACT_M)


def test_the_bones_lie_as_they_were_planned(context):
    for handedness in HANDEDNESSES:
        joints = posing.rest_joints_m(handedness)
        hand = armature.build_armature(context, handedness, joints, handedness)
        made, planned = armature.rest_matrices_of(hand), posing.rest_matrices(joints, handedness)
        turning = [place for place in range(21) if place not in TIPS]
        # worst observed 3e-7: Blender keeps a roll angle in float32
        np.testing.assert_allclose(made[turning], planned[turning], atol=2e-6)
        # a millimeter has its direction from two ends 0.2 m away, in float32: 1.5e-8 of 1e-3
        np.testing.assert_allclose(made[list(TIPS)], planned[list(TIPS)], atol=1.5e-5)


def test_building_leaves_the_scene_as_it_was(context):
    other = bpy.data.objects.new("Other", None)
    context.scene.collection.objects.link(other)
    context.view_layer.objects.active = other
    armature.build_armature(context, "Hand", posing.rest_joints_m("left"), "left")
    assert context.view_layer.objects.active is other
    assert context.mode == "OBJECT"


@pytest.mark.parametrize("handedness", HANDEDNESSES)
@pytest.mark.parametrize("unit_m", [1.0, 0.01, 0.0254])
def test_a_motion_comes_back_at_every_key(context, handedness, unit_m):
    context.scene.unit_settings.scale_length = unit_m
    joints = hands.moving_hand_m(handedness, frames=12)
    hand = hands.keyed_hand(context, handedness, joints)
    for place in range(len(joints)):
        seen = armature.read_hand(hand, armature.at_frame(context.scene, 1 + place))
        # worst observed 5e-8 m; the promise is 1e-5
        np.testing.assert_allclose(seen.joints_world_m, joints[place], atol=2e-7)
        assert seen.handedness == handedness


@pytest.mark.parametrize("place", hands.PLACES.values(), ids=hands.PLACES.keys())
@pytest.mark.parametrize("unit_m", [1.0, 0.01])
def test_joints_are_read_in_meters_whatever_the_object_and_the_unit(context, place, unit_m):
    context.scene.unit_settings.scale_length = unit_m
    hand = hands.keyed_hand(context, "left", hands.moving_hand_m("left"))
    hands.put(hand, place)
    depsgraph = armature.at_frame(context.scene, 3)
    seen = armature.read_hand(hand, depsgraph)
    evaluated = hand.evaluated_get(depsgraph)
    expected = [np.array(evaluated.matrix_world @ evaluated.pose.bones[name].head) * unit_m for name in NAMES]
    # worst observed 2e-7 m
    np.testing.assert_allclose(seen.joints_world_m, expected, atol=1e-6)
    rotation = seen.world_from_hand[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_constraints_are_included(context):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right"), "right")
    target = bpy.data.objects.new("Target", None)
    context.scene.collection.objects.link(target)
    target.location = (0.5, 0.4, 0.3)
    constraint = hand.pose.bones["index4"].constraints.new("COPY_LOCATION")
    constraint.target = target
    context.view_layer.update()
    seen = armature.read_hand(hand, context.evaluated_depsgraph_get())
    np.testing.assert_allclose(seen.joints_world_m[NAMES.index("index4")], (0.5, 0.4, 0.3), atol=EXACT_M)


def test_other_bones_and_another_order_do_not_disturb(context):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right"), "right")
    before = armature.read_hand(hand, context.evaluated_depsgraph_get()).joints_m
    context.view_layer.objects.active = hand
    bpy.ops.object.mode_set(mode="EDIT")
    arm = hand.data.edit_bones.new("a forearm")
    arm.head, arm.tail = (0, -0.3, 0), (0, 0, 0)
    hand.data.edit_bones["wrist"].parent = arm
    bpy.ops.object.mode_set(mode="OBJECT")
    after = armature.read_hand(hand, context.evaluated_depsgraph_get()).joints_m
    np.testing.assert_allclose(after, before, atol=EXACT_M)


@pytest.mark.parametrize("scale", [(1, 0, 1), (0, 0, 0)])
def test_a_scale_that_makes_no_hand_is_refused(context, scale):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right"), "right")
    hand.scale = scale
    context.view_layer.update()
    with pytest.raises(JGHandFailure) as caught:
        armature.read_hand(hand, context.evaluated_depsgraph_get())
    assert caught.value.kind == "zero_scale"


def test_an_armature_without_all_joints_is_refused(context):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right"), "right")
    hand.data.bones["ring3"].name = "something"
    with pytest.raises(JGHandFailure, match="ring3"):
        armature.read_hand(hand, context.evaluated_depsgraph_get())
    with pytest.raises(JGHandFailure):
        motion.key_motion(hand, hands.moving_hand_m("right"), context.scene, range(1, 6))


def test_an_armature_that_does_not_say_which_hand_it_is_is_refused(context):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right"), "right")
    hand[armature.HANDEDNESS_PROPERTY] = "both"
    with pytest.raises(JGHandFailure, match="both"):
        armature.read_hand(hand, context.evaluated_depsgraph_get())


def test_a_hand_that_blender_does_not_evaluate_is_never_shown_in_an_old_pose(context):
    hand = hands.keyed_hand(context, "right", hands.moving_hand_m("right"))
    hand.hide_viewport = True
    with pytest.raises(JGHandFailure) as caught:
        armature.read_hand(hand, armature.at_frame(context.scene, 3))
    assert caught.value.kind == "hidden"
    hand.hide_viewport = False
    armature.read_hand(hand, armature.at_frame(context.scene, 3))


def test_the_hands_of_a_scene_are_those_that_are_rendered(context):
    rest = posing.rest_joints_m("right")
    kept, hidden, in_hidden_collection = (
        armature.build_armature(context, name, rest, "right") for name in ("b", "a", "c")
    )
    bpy.data.objects.new("not a hand", bpy.data.armatures.new("x"))
    hidden.hide_render = True
    collection = bpy.data.collections.new("hidden")
    context.scene.collection.children.link(collection)
    context.scene.collection.objects.unlink(in_hidden_collection)
    collection.objects.link(in_hidden_collection)
    collection.hide_render = True
    kept.hide_set(True)  # hidden in the viewport only
    assert armature.hands_at_any_frame(context.view_layer) == [kept]
    collection.hide_render = False
    assert armature.hands_at_any_frame(context.view_layer) == [kept, in_hidden_collection]


def test_keys_are_grouped_by_bone_and_linear(context):
    hand = hands.keyed_hand(context, "right", hands.moving_hand_m("right"))
    curves = versions.fcurves(hand)
    assert len(curves) == 21 * 7
    assert {curve.group.name for curve in curves} == set(NAMES)
    assert {key.interpolation for curve in curves for key in curve.keyframe_points} == {"LINEAR"}


def test_keying_again_starts_a_new_action_and_keeps_the_old_one(context):
    hand = hands.keyed_hand(context, "right", hands.moving_hand_m("right", seed=1))
    first = hand.animation_data.action
    joints = hands.moving_hand_m("right", seed=2)
    second = motion.key_motion(hand, joints, context.scene, range(1, 1 + len(joints)))
    assert hand.animation_data.action is second
    assert first.name in bpy.data.actions
    seen = armature.read_hand(hand, armature.at_frame(context.scene, 4))
    np.testing.assert_allclose(seen.joints_world_m, joints[3], atol=2e-7)


def test_a_hand_that_was_posed_by_hand_takes_a_motion_exactly(context):
    joints = hands.moving_hand_m("right")
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right", joints), "right")
    bone = hand.pose.bones["index1"]
    bone.scale, bone.rotation_mode, bone.rotation_euler = (2, 2, 2), "XYZ", (0.3, 0, 0)
    hand.data.bones["ring2"].use_inherit_rotation = False
    hand.data.bones["thumb1"].use_local_location = False
    motion.key_motion(hand, joints, context.scene, range(1, 1 + len(joints)))
    for place in range(len(joints)):
        seen = armature.read_hand(hand, armature.at_frame(context.scene, 1 + place))
        np.testing.assert_allclose(seen.joints_world_m, joints[place], atol=2e-7)


@pytest.mark.parametrize("mover", ["constraint", "driver"])
def test_a_hand_that_something_else_moves_takes_no_motion_until_that_is_muted(context, mover):
    joints = hands.moving_hand_m("right")
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right", joints), "right")
    bone = hand.pose.bones["index1"]
    bone.scale = (2, 2, 2)
    if mover == "constraint":
        rule = bone.constraints.new("LIMIT_ROTATION")
        rule.use_limit_x = True
    else:
        rule = bone.driver_add("location", 0)
        rule.driver.expression = "0.01"
    wanted = motion.WantedMotion(MotionFile(joints, 24.0, "right"), "wave", hand)
    with pytest.raises(JGHandFailure, match="index1") as caught:
        motion.import_motions(context, [wanted])
    assert caught.value.kind == "constrained"
    assert bone.scale[0] == 2
    rule.mute = True
    motion.import_motions(context, [wanted])
    seen = armature.read_hand(hand, armature.at_frame(context.scene, 3))
    np.testing.assert_allclose(seen.joints_world_m, joints[2], atol=2e-7)


def test_constant_bone_lengths_are_keyed_by_rotations_alone(context):
    rest = posing.rest_joints_m("right")
    joints = np.stack([rest, rest])
    turn = np.array(Matrix.Rotation(0.7, 3, "X"))
    knuckle, rest_of_finger = NAMES.index("index2"), slice(NAMES.index("index3"), NAMES.index("index4") + 1)
    joints[1, rest_of_finger] = (rest[rest_of_finger] - rest[knuckle]) @ turn.T + rest[knuckle]
    hand = hands.keyed_hand(context, "right", joints)
    locations = [curve for curve in versions.fcurves(hand) if curve.data_path.endswith("location")]
    assert max(abs(key.co.y) for curve in locations for key in curve.keyframe_points) < EXACT_M


def test_keys_of_frames_that_were_filled_in_are_marked(context):
    joints = hands.moving_hand_m("left")
    filled = np.arange(len(joints)) % 3 == 1
    wanted = motion.WantedMotion(MotionFile(joints, 24.0, "left", (), filled), "Wave")
    (hand,) = motion.import_motions(context, [wanted])
    curves = list(versions.fcurves(hand))
    assert len(curves) == 21 * 7
    for curve in curves:
        assert [key.type for key in curve.keyframe_points] == ["JITTER" if mark else "KEYFRAME" for mark in filled]


@pytest.mark.parametrize("place", hands.PLACES.values(), ids=hands.PLACES.keys())
@pytest.mark.parametrize("is_child", [False, True])
@pytest.mark.parametrize("unit_m", [1.0, 0.01])
def test_a_motion_lies_in_the_world_as_its_file_says_from_where_the_object_stands(context, place, is_child, unit_m):
    """However the object, or what it hangs on, is turned and scaled: as on a new hand, which stands at the origin."""
    context.scene.unit_settings.scale_length = unit_m
    joints = hands.moving_hand_m("right")
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right"), "right")
    hands.put(hand, place)
    if is_child:
        parent = bpy.data.objects.new("Arm", None)
        context.scene.collection.objects.link(parent)
        hands.put(parent, ((0.3, 0.1, -0.2), (1.2, 0.3, -0.7), (1.1, 1.1, 1.1)))
        hand.parent = parent
        context.view_layer.update()
    stands = unit_m * np.array(hand.matrix_world.translation)
    content = MotionFile(joints, 24.0, "right")
    (new,) = motion.import_motions(context, [motion.WantedMotion(content, "New")])
    assert motion.import_motions(context, [motion.WantedMotion(content, "Wave", hand)]) == [hand]
    for frame in range(len(joints)):
        depsgraph = armature.at_frame(context.scene, 1 + frame)
        # single precision through the object's scale; worst seen 4e-7 m
        seen = armature.read_hand(hand, depsgraph).joints_world_m
        np.testing.assert_allclose(seen, joints[frame] + stands, atol=2e-6)
        np.testing.assert_allclose(armature.read_hand(new, depsgraph).joints_world_m, joints[frame], atol=2e-6)


def test_a_mirrored_hand_takes_motions_of_the_side_that_it_shows(context):
    joints = hands.moving_hand_m("left")
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right"), "right")
    hands.put(hand, ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6), (-1.0, 1.0, 1.0)))
    motion.import_motions(context, [motion.WantedMotion(MotionFile(joints, 24.0, "left"), "Wave", hand)])
    seen = armature.read_hand(hand, armature.at_frame(context.scene, 2))
    assert seen.handedness == "left"
    np.testing.assert_allclose(seen.joints_world_m, joints[1] + (0.1, 0.2, 0.3), atol=2e-6)
    with pytest.raises(JGHandFailure, match="other hand"):
        content = MotionFile(hands.moving_hand_m("right"), 24.0, "right")
        motion.import_motions(context, [motion.WantedMotion(content, "Wave", hand)])


def test_an_object_without_size_takes_no_motion(context):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right"), "right")
    hand.scale = (1.0, 0.0, 1.0)
    wanted = motion.WantedMotion(MotionFile(hands.moving_hand_m("right"), 24.0, "right"), "Wave", hand)
    with pytest.raises(JGHandFailure, match="scale of zero"):
        motion.import_motions(context, [wanted])
    assert hand.animation_data is None


def test_a_motion_file_becomes_keys_at_the_scenes_frame_rate(context):
    context.scene.render.fps, context.scene.render.fps_base = 30, 1.001
    joints = hands.moving_hand_m("left")
    read = MotionFile(joints, 60.0, "left")
    (hand,) = motion.import_motions(context, [motion.WantedMotion(read, "Wave")], first_frame=10)
    first = hand.animation_data.action
    assert first.name == "Wave"
    for place in range(len(joints)):
        frame = 10 + place * 30 / 1.001 / 60
        seen = armature.read_hand(hand, armature.at_frame(context.scene, frame))
        # worst observed 3.3e-8 m
        np.testing.assert_allclose(seen.joints_world_m, joints[place], atol=2e-7)
    assert motion.import_motions(context, [motion.WantedMotion(read, "Again", hand)]) == [hand]
    assert first.use_fake_user
    right = armature.build_armature(context, "Right", posing.rest_joints_m("right"), "right")
    with pytest.raises(JGHandFailure) as caught:
        motion.import_motions(context, [motion.WantedMotion(read, "Other", right)])
    assert caught.value.kind == "other_hand"
