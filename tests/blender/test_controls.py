"""Finger controls move the hand as they say, change nothing by being there, and cost nobody a key."""

import bpy
import hands
import numpy as np
import pytest

from blender_addon import versions
from blender_addon.core import kinematics, posing
from blender_addon.core.controls import CONTROLS, FINGER_CONTROLS, HAND_CONTROL, TIP_CONTROLS, moving_bones
from blender_addon.core.joints import FINGERS, HANDEDNESSES, NAMES, TIPS
from blender_addon.core.view import BUILTIN_AVATAR
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, controls, motion
from blender_addon.viewport import handlers

# float32 of a bone chain through constraints; worst observed 8.9e-8 m
EXACT_M = 2e-7


def controlled_hand(context: bpy.types.Context, handedness: str) -> bpy.types.Object:
    hand = armature.build_armature(context, handedness, posing.rest_joints_m(handedness), handedness)
    controls.add_controls(context, hand, kinematics.NO_FIST)
    return hand


@pytest.mark.parametrize("handedness", HANDEDNESSES)
@pytest.mark.parametrize("unit_m", [1.0, 0.01])
def test_neutral_controls_change_nothing_and_need_no_script(context, handedness, unit_m):
    context.scene.unit_settings.scale_length = unit_m
    hand = controlled_hand(context, handedness)
    np.testing.assert_allclose(hands.joints_of(hand), posing.rest_joints_m(handedness), atol=EXACT_M)
    assert controls.has_controls(hand)
    assert hand.animation_data is None or not hand.animation_data.drivers
    assert not any(hand.data.bones[name].use_deform for name in CONTROLS)


def test_an_axis_that_rounding_alone_has_moved_is_put_back(context):
    hand = controlled_hand(context, "right")
    hands.joints_of(hand)
    edits = bpy.app.handlers.depsgraph_update_post
    edits.append(handlers.on_change)
    try:
        for name in (HAND_CONTROL, *FINGER_CONTROLS):
            # as it was left of a ring that was turned in the view, and what somebody has typed
            for turn, shown in (((0.5, 0.0, -2.3e-6), (0.5, 0.0, 0.0)), ((0.0, 0.0, 2e-5), (0.0, 0.0, 2e-5))):
                hand.pose.bones[name].rotation_euler = turn
                context.view_layer.update()
                np.testing.assert_array_equal(hand.pose.bones[name].rotation_euler, np.float32(shown))
    finally:
        edits.remove(handlers.on_change)


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_curl_fist_spread_and_splay_move_the_fingers_they_name(context, handedness):
    hand = controlled_hand(context, handedness)
    rest = hands.joints_of(hand)
    across = rest[NAMES.index("index1")] - rest[NAMES.index("pinky1")]
    for finger, name in zip(FINGERS, FINGER_CONTROLS, strict=True):
        bone, tip = hand.pose.bones[name], NAMES.index(f"{finger}4")
        others = [place for place, joint in enumerate(NAMES) if not joint.startswith(finger)]
        bone.rotation_euler = (np.pi / 2, 0, 0)
        curled = hands.joints_of(hand)
        np.testing.assert_allclose(curled[others], rest[others], atol=EXACT_M)
        if finger == "thumb":
            assert np.linalg.norm(curled[tip] - rest[tip]) > 0.03
        else:  # the tip comes to the palm
            assert np.linalg.norm(curled[tip] - curled[tip - 3]) < 0.55 * np.linalg.norm(rest[tip] - rest[tip - 3])
            assert curled[tip, 2] > 0
        bone.rotation_euler = (0, 0, np.radians(15))
        spread = hands.joints_of(hand)
        if finger == "middle":  # to the thumb's side
            assert (spread[tip] - rest[tip]) @ across > 0
        else:
            middle = rest[NAMES.index("middle4")]
            assert np.linalg.norm(spread[tip] - middle) > np.linalg.norm(rest[tip] - middle) + 0.005
        bone.rotation_euler = (0, 0, 0)
    hand.pose.bones[HAND_CONTROL].rotation_euler = (np.pi / 2, 0, 0)
    fist = hands.joints_of(hand)
    tips = list(TIPS[1:])
    assert (np.linalg.norm(fist[tips] - fist[0], axis=-1) < 0.65 * np.linalg.norm(rest[tips] - rest[0], axis=-1)).all()
    hand.pose.bones[HAND_CONTROL].rotation_euler = (0, 0, np.radians(25))
    splayed = hands.joints_of(hand)
    wide = np.linalg.norm(splayed[NAMES.index("index4")] - splayed[NAMES.index("pinky4")])
    assert wide > 1.2 * np.linalg.norm(rest[NAMES.index("index4")] - rest[NAMES.index("pinky4")])


@pytest.mark.parametrize("handedness", HANDEDNESSES)
@pytest.mark.parametrize("avatar", ["", "strong"])
def test_a_full_curl_is_the_fist_that_apply_pose_closes_on_the_same_hand(extension, handedness, avatar):
    assert bpy.ops.jghand.add_hand(handedness=handedness, avatar=avatar or BUILTIN_AVATAR) == {"FINISHED"}
    hand = extension.object
    assert bpy.ops.jghand.apply_pose(pose="fist") == {"FINISHED"}
    fist = hands.joints_of(hand)
    for leaders in ((HAND_CONTROL,), FINGER_CONTROLS):
        assert bpy.ops.jghand.reset_pose() == {"FINISHED"}
        for name in leaders:
            hand.pose.bones[name].rotation_euler.x = np.pi / 2
        np.testing.assert_allclose(hands.joints_of(hand), fist, atol=EXACT_M)


def test_a_full_curl_is_the_fist_of_the_avatar_that_is_chosen_later_and_what_was_set_stays(extension):
    bpy.ops.jghand.add_hand()
    hand = extension.object
    bpy.ops.jghand.hold_tip(finger="ring")
    controls.use_joint_limits(hand, False)
    rules = [rule.name for rule in controls.rules_of(hand)]
    hand.jghand.avatar = "strong"
    assert [rule.name for rule in controls.rules_of(hand)] == rules
    assert controls.tip_rule(hand, FINGERS.index("ring")).influence == 1
    assert not controls.joint_limits_are_used(hand)
    controls.use_joint_limits(hand, True)
    bpy.ops.jghand.hold_tip(finger="ring", hold=False)
    bpy.ops.jghand.apply_pose(pose="fist")
    fist = hands.joints_of(hand)
    bpy.ops.jghand.reset_pose()
    hand.pose.bones[HAND_CONTROL].rotation_euler.x = np.pi / 2
    np.testing.assert_allclose(hands.joints_of(hand), fist, atol=EXACT_M)


def test_left_controls_are_the_mirror_image_of_right_ones(context):
    seen = {}
    for handedness in HANDEDNESSES:
        hand = controlled_hand(context, handedness)
        for at, name in enumerate((HAND_CONTROL, *FINGER_CONTROLS)):
            hand.pose.bones[name].rotation_euler = (0.1 + 0.1 * at, 0, 0.05 * at)
        seen[handedness] = hands.joints_of(hand)
    np.testing.assert_allclose(seen["left"], seen["right"] * (-1, 1, 1), atol=EXACT_M)


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_a_held_tip_stays_and_does_not_jump_when_it_is_taken(context, handedness):
    hand = controlled_hand(context, handedness)
    hand.pose.bones[FINGER_CONTROLS[1]].rotation_euler = (0.5, 0, 0)
    before = hands.joints_of(hand)
    assert not hand.data.collections[controls.TIP_COLLECTION].is_visible
    controls.hold_tip(hand, "index")
    assert hand.data.collections[controls.TIP_COLLECTION].is_visible
    np.testing.assert_allclose(hands.joints_of(hand), before, atol=EXACT_M)
    hand.pose.bones[TIP_CONTROLS[1]].location.z -= 0.02
    moved = hands.joints_of(hand)
    place = hand.pose.bones[TIP_CONTROLS[1]].head
    np.testing.assert_allclose(moved[NAMES.index("index4")], place, atol=EXACT_M)
    assert np.linalg.norm(moved[NAMES.index("index4")] - before[NAMES.index("index4")]) > 0.015
    hand.pose.bones["wrist"].location = (0.005, 0, 0.005)
    assert np.linalg.norm(hands.joints_of(hand)[NAMES.index("index4")] - place) < EXACT_M
    controls.reset_controls(hand)
    hand.pose.bones["wrist"].location = (0, 0, 0)
    np.testing.assert_allclose(hands.joints_of(hand), posing.rest_joints_m(handedness), atol=EXACT_M)


@pytest.mark.parametrize("pose", ["relaxed", "pinch", "fist"])
def test_pinning_the_tips_of_a_pose_moves_no_finger(extension, pose):
    """Not even one that is bent to its end; but for the little finger of a fist, whose joints move by 1.5 mm."""
    bpy.ops.jghand.add_hand()
    bpy.ops.jghand.apply_pose(pose=pose)
    before = hands.joints_of(extension.object)
    for finger in FINGERS:
        bpy.ops.jghand.hold_tip(finger=finger)
    moved_m = np.linalg.norm(hands.joints_of(extension.object) - before, axis=-1)
    assert moved_m[:-4].max() < 2e-5
    assert moved_m.max() < (2e-3 if pose == "fist" else 2e-5)


@pytest.mark.parametrize("change", [bpy.ops.jghand.add_controls, bpy.ops.jghand.remove_controls])
def test_axes_that_an_older_layer_locked_are_free_when_it_is_made_anew_or_removed(extension, change):
    bpy.ops.jghand.add_hand()
    bones = extension.object.pose.bones
    for name in NAMES:
        bones[name].lock_ik_y = bones[name].lock_ik_z = True
    assert change() == {"FINISHED"}
    moving = [name for finger in range(len(FINGERS)) for name in moving_bones(finger)]
    assert not any(bones[name].lock_ik_y or bones[name].lock_ik_z for name in moving)


def test_joint_limits_stop_a_finger_and_can_be_switched_off(context):
    hand = controlled_hand(context, "right")
    hand.pose.bones["index2"].rotation_quaternion = (np.cos(-0.5), np.sin(-0.5), 0, 0)
    limited = hands.joints_of(hand)
    controls.use_joint_limits(hand, False)
    free = hands.joints_of(hand)
    place = NAMES.index("index3")
    assert np.linalg.norm(free[place] - limited[place]) > 0.005
    fingertip = limited[place] - limited[place - 1]
    knuckle = limited[place - 1] - limited[place - 2]
    angle = np.degrees(np.arccos(fingertip @ knuckle / np.linalg.norm(fingertip) / np.linalg.norm(knuckle)))
    # five degrees beyond straight, and what the finger is bent sideways at rest
    assert angle == pytest.approx(5, abs=3)


def test_adding_and_removing_keeps_every_key_and_every_joint(context):
    joints = hands.moving_hand_m("left")
    hand = hands.keyed_hand(context, "left", joints)
    action = hand.animation_data.action
    before = [(curve.data_path, [tuple(key.co) for key in curve.keyframe_points]) for curve in versions.fcurves(hand)]
    controls.add_controls(context, hand, kinematics.NO_FIST)
    controls.use_joint_limits(hand, False)
    for place in range(len(joints)):
        seen = armature.read_hand(hand, armature.at_frame(context.scene, 1 + place))
        np.testing.assert_allclose(seen.joints_world_m, joints[place], atol=EXACT_M)
    bone = hand.pose.bones[HAND_CONTROL]
    bone.rotation_euler = (0.3, 0, 0)
    bone.keyframe_insert("rotation_euler", frame=2)
    controls.remove_controls(context, hand)
    assert set(hand.data.bones.keys()) == set(NAMES)
    assert not {controls.COLLECTION, controls.TIP_COLLECTION} & set(hand.data.collections.keys())
    assert not any(bone.constraints for bone in hand.pose.bones)
    assert not any(bone.ik_stiffness_y or bone.use_ik_limit_x for bone in hand.pose.bones)
    assert hand.animation_data.action is action
    curves = versions.fcurves(hand)
    after = [(curve.data_path, [tuple(key.co) for key in curve.keyframe_points]) for curve in curves]
    assert after[: len(before)] == before
    for place in range(len(joints)):
        seen = armature.read_hand(hand, armature.at_frame(context.scene, 1 + place))
        np.testing.assert_allclose(seen.joints_world_m, joints[place], atol=EXACT_M)
    controls.add_controls(context, hand, kinematics.NO_FIST)  # the key of the control works again
    armature.at_frame(context.scene, 2)
    assert hand.pose.bones[HAND_CONTROL].rotation_euler.x == pytest.approx(0.3)


def bake(context, hand):
    """The action that frames 1 to 5 are baked into."""
    for _ in controls.bake_steps(context, [hand], range(1, 6)):
        pass
    return hand.animation_data.action


def test_what_is_seen_can_be_baked_into_the_bare_armature(context):
    hand = controlled_hand(context, "right")
    bone = hand.pose.bones[HAND_CONTROL]
    for frame, angle in ((1, 0.0), (5, 1.2)):
        bone.rotation_euler = (angle, 0, 0)
        bone.keyframe_insert("rotation_euler", frame=frame)
    old = hand.animation_data.action
    seen = [armature.read_hand(hand, armature.at_frame(context.scene, frame)).joints_m for frame in range(1, 6)]
    bake(context, hand)
    assert set(hand.data.bones.keys()) == set(NAMES)
    assert old.use_fake_user
    for frame, wanted in zip(range(1, 6), seen, strict=True):
        baked = armature.read_hand(hand, armature.at_frame(context.scene, frame)).joints_m
        np.testing.assert_allclose(baked, wanted, atol=EXACT_M)


def test_a_motion_is_keyed_under_muted_controls(context):
    joints = hands.moving_hand_m("right")
    hand = controlled_hand(context, "right")
    controls.mute_controls(hand, True)
    assert controls.controls_are_muted(hand)
    motion.key_motion(hand, joints, context.scene, range(1, 1 + len(joints)))
    seen = armature.read_hand(hand, armature.at_frame(context.scene, 3))
    # the rest hand is not the motion's, but its joints are
    np.testing.assert_allclose(seen.joints_world_m, joints[2], atol=EXACT_M)


def test_joint_limits_that_were_off_stay_off_when_the_controls_are_on_again(context):
    hand = controlled_hand(context, "right")
    hand.pose.bones["index2"].rotation_quaternion = (np.cos(-0.5), np.sin(-0.5), 0, 0)
    limited = hands.joints_of(hand)
    controls.use_joint_limits(hand, False)
    free = hands.joints_of(hand)
    controls.mute_controls(hand, True)
    assert controls.controls_are_muted(hand)
    assert not controls.joint_limits_are_used(hand)
    controls.mute_controls(hand, False)
    assert not controls.joint_limits_are_used(hand)
    np.testing.assert_array_equal(hands.joints_of(hand), free)
    controls.mute_controls(hand, True)
    controls.use_joint_limits(hand, True)  # of a muted layer: how they will be
    assert controls.controls_are_muted(hand)
    assert controls.joint_limits_are_used(hand)
    controls.mute_controls(hand, False)
    np.testing.assert_allclose(hands.joints_of(hand), limited, atol=EXACT_M)


def test_hands_that_share_their_bones_part_before_one_gets_controls(context):
    hand = armature.build_armature(context, "a", posing.rest_joints_m("right"), "right")
    twin = hand.copy()
    context.scene.collection.objects.link(twin)
    controls.add_controls(context, hand, kinematics.NO_FIST)
    assert controls.has_controls(hand)
    assert not controls.has_controls(twin)
    assert set(twin.data.bones.keys()) == set(NAMES)


def test_controls_are_for_our_visible_armature_only(context):
    hand = armature.build_armature(context, "a", posing.rest_joints_m("right"), "right")
    hand.hide_set(True)
    with pytest.raises(JGHandFailure) as caught:
        controls.add_controls(context, hand, kinematics.NO_FIST)
    assert caught.value.kind == "not_editable"
    empty = bpy.data.objects.new("x", None)
    with pytest.raises(JGHandFailure) as caught:
        controls.add_controls(context, empty, kinematics.NO_FIST)
    assert caught.value.kind == "not_a_hand"
    with pytest.raises(JGHandFailure) as caught:
        controls.hold_tip(hand, "index")
    assert caught.value.kind == "not_a_hand"


@pytest.mark.parametrize("linked", [False, True])
def test_a_duplicated_hand_has_controls_of_its_own(context, linked):
    hand = controlled_hand(context, "right")
    hand.select_set(True)
    context.view_layer.objects.active = hand
    bpy.ops.object.duplicate(linked=linked)
    twin = context.view_layer.objects.active
    assert twin is not hand
    rest = hands.joints_of(hand)
    twin.pose.bones[HAND_CONTROL].rotation_euler.x = 1.0
    assert np.linalg.norm(hands.joints_of(twin) - rest, axis=-1).max() > 0.03
    np.testing.assert_allclose(hands.joints_of(hand), rest, atol=EXACT_M)
    controls.remove_controls(context, twin)
    assert controls.has_controls(hand)


def test_undo_takes_the_controls_away_and_redo_brings_them_back(context):
    hand = armature.build_armature(context, "hand", posing.rest_joints_m("right"), "right")
    bpy.ops.ed.undo_push(message="bare")
    controls.add_controls(context, hand, kinematics.NO_FIST)
    bpy.ops.ed.undo_push(message="controls")
    bpy.ops.ed.undo()
    hand = bpy.data.objects["hand"]  # every reference dies on undo
    assert not controls.has_controls(hand)
    assert not any(bone.constraints for bone in hand.pose.bones)
    bpy.ops.ed.redo()
    hand = bpy.data.objects["hand"]
    assert controls.has_controls(hand)
    hand.pose.bones[HAND_CONTROL].rotation_euler.x = 1.0
    rest = posing.rest_joints_m("right")
    assert np.linalg.norm(hands.joints_of(hand) - rest, axis=-1).max() > 0.03


def key_around(hand: bpy.types.Object) -> None:
    """What an artist keys on the object itself, and a modifier on one curve."""
    hand["glow"] = 0.0
    for frame, x, hidden in ((1, 0.0, False), (5, 1.0, True)):
        hand.location.x, hand.rotation_euler.z, hand.hide_render, hand["glow"] = x, x / 2, hidden, 2 * x
        for path in ("location", "rotation_euler", "hide_render", '["glow"]'):
            hand.keyframe_insert(path, frame=frame)
    versions.fcurves(hand)[0].modifiers.new("NOISE").strength = 0.3


def test_baking_keeps_all_other_animation_of_the_hand(context):
    hand = controlled_hand(context, "right")
    key_around(hand)
    bone = hand.pose.bones[HAND_CONTROL]
    for frame, angle in ((1, 0.0), (5, 1.2)):
        bone.rotation_euler = (angle, 0, 0)
        bone.keyframe_insert("rotation_euler", frame=frame)
    controls.tip_rule(hand, 1).keyframe_insert("influence", frame=1)
    old = hand.animation_data.action
    other = old.slots.new("OBJECT", "somebody else")
    count = len(versions.fcurves(hand))

    def seen() -> list[tuple]:
        each = []
        for frame in range(1, 6):
            joints = armature.read_hand(hand, armature.at_frame(context.scene, frame)).joints_world_m
            each.append((joints, hand.hide_render, hand["glow"]))
        return each

    before = seen()
    new = bake(context, hand)
    for (wanted, *rest), (joints, *same) in zip(before, seen(), strict=True):
        np.testing.assert_allclose(joints, wanted, atol=EXACT_M)
        assert same == rest
    assert new is not old
    assert len(new.slots) == 1
    assert other.identifier in old.slots
    paths = {curve.data_path for curve in versions.fcurves(hand)}
    assert not [path for path in paths if HAND_CONTROL in path or "JGHand" in path]
    hand.animation_data.action = old
    assert len(versions.fcurves(hand)) == count  # the old one is whole


def test_a_motion_keeps_where_the_object_goes(context):
    joints = hands.moving_hand_m("left")
    hand = hands.keyed_hand(context, "left", joints)
    key_around(hand)
    places = [hand.location.x for frame in range(1, 6) if armature.at_frame(context.scene, frame)]
    motion.key_motion(hand, joints[::-1], context.scene, range(1, 1 + len(joints)))
    for frame, wanted, x in zip(range(1, 6), joints[::-1], places, strict=True):
        seen = armature.read_hand(hand, armature.at_frame(context.scene, frame))
        np.testing.assert_allclose(seen.joints_m, wanted, atol=EXACT_M)
        assert hand.location.x == x
