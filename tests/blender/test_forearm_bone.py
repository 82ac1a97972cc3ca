"""A wrist that hangs on a forearm: what an animator turns is what the renderer is told, and nothing else changes."""

import bpy
import hands
import numpy as np
import pytest
from mathutils import Quaternion

from blender_addon.core import posing
from blender_addon.core.joints import FOREARM, HANDEDNESSES
from blender_addon.core.view import HandInSpace
from blender_addon.export.ops_common import record_steps
from blender_addon.hand import armature, avatar_files, motion, stand_ins
from blender_addon.hand.motion_files import MotionFile, read_motion, write_motion

NO_TURN = (1.0, 0.0, 0.0, 0.0)


def arm_of(context: bpy.types.Context, side: str) -> bpy.types.Object:
    return armature.build_armature(context, side, posing.rest_joints_m(side), side, forearm=True)


def seen(hand: bpy.types.Object) -> HandInSpace:
    bpy.context.view_layer.update()
    return armature.read_hand(hand, bpy.context.evaluated_depsgraph_get())


def turn_of(read: HandInSpace) -> np.ndarray:
    assert read.forearm_turn is not None
    return read.forearm_turn


def forearm_way(read: HandInSpace) -> np.ndarray:
    """Where the renderer then has it, in the world: the rest hand's way, carried by the palm and turned."""
    rest = posing.rest_matrices(posing.rest_joints_m(read.handedness), read.handedness)
    way = posing.forearm_rest(rest, read.handedness)[:3, 3] - rest[0, :3, 3]
    joints = read.joints_world_m[None]
    carried = posing.palm_rotations(joints, rest, read.handedness)[0]
    return posing.forearm_rotations(joints, read.handedness, turn_of(read)[None])[0] @ carried @ way


def random_turns(frames: int) -> np.ndarray:
    turns = np.random.default_rng(4).normal(size=(frames, 4))
    return turns / np.linalg.norm(turns, axis=1, keepdims=True)


def test_a_hand_of_an_avatar_with_a_forearm_hangs_on_its_bone(extension, monkeypatch):
    monkeypatch.setattr(avatar_files, "has_forearm", lambda avatar: False)
    bpy.ops.jghand.add_hand(handedness="right")
    assert not armature.has_forearm_bone(bpy.context.object)
    monkeypatch.setattr(avatar_files, "has_forearm", lambda avatar: True)
    bpy.ops.jghand.add_hand(handedness="left")
    hand = bpy.context.object
    bone = hand.data.bones[FOREARM]
    assert hand.data.bones["wrist"].parent == bone
    assert bone.parent is None
    np.testing.assert_allclose(bone.tail_local, hand.data.bones["wrist"].head_local, atol=1e-6)
    assert bone.length == pytest.approx(0.24, abs=1e-3)


@pytest.mark.parametrize("side", HANDEDNESSES)
def test_a_bone_for_the_forearm_moves_nothing_of_a_hand_that_is_posed(extension, monkeypatch, side):
    monkeypatch.setattr(avatar_files, "has_forearm", lambda avatar: False)
    bpy.ops.jghand.add_hand(handedness=side)
    hand = bpy.context.object
    hand.pose.bones["wrist"].rotation_quaternion = Quaternion((0.3, 1, 0.2), 0.7)
    hand.pose.bones["index2"].rotation_quaternion = Quaternion((1, 0, 0), 0.7)
    before = seen(hand).joints_m
    assert bpy.ops.jghand.add_forearm_bone() == {"FINISHED"}
    np.testing.assert_allclose(seen(hand).joints_m, before, atol=1e-6)
    assert not bpy.ops.jghand.add_forearm_bone.poll()


def test_a_bone_for_the_forearm_hangs_on_what_the_wrist_hung_on(context):
    hand = armature.build_armature(context, "right", posing.rest_joints_m("right"), "right")
    with armature.edit_mode(context, hand):
        arm = hand.data.edit_bones.new("arm")
        arm.head, arm.tail = (0.1, -0.5, 0), (0.1, -0.3, 0)
        hand.data.edit_bones["wrist"].parent = arm
    hand.pose.bones["arm"].rotation_mode = "QUATERNION"
    hand.pose.bones["arm"].rotation_quaternion = Quaternion((0.3, 1, 0.2), 0.7)
    before = seen(hand).joints_m
    assert np.abs(before[0]).max() > 0.05
    armature.add_forearm(context, hand)
    assert hand.data.bones[FOREARM].parent == hand.data.bones["arm"]
    np.testing.assert_allclose(seen(hand).joints_m, before, atol=1e-6)


@pytest.mark.parametrize("place", ["where it was made", "moved and turned", "scaled", "turned inside out"])
@pytest.mark.parametrize("side", HANDEDNESSES)
def test_the_forearm_carries_the_hand_and_stays_where_it_is_when_the_wrist_bends(context, side, place):
    hand = arm_of(context, side)
    hands.put(hand, hands.PLACES[place])
    straight = seen(hand)
    np.testing.assert_allclose(turn_of(straight), NO_TURN, atol=1e-6)
    hand.pose.bones[FOREARM].rotation_quaternion = Quaternion((0.3, 1, 0.2), 1.2)
    carried = seen(hand)
    np.testing.assert_allclose(turn_of(carried), NO_TURN, atol=1e-6)
    assert np.abs(carried.joints_m - straight.joints_m).max() > 0.05
    way = forearm_way(carried)
    hand.pose.bones["wrist"].rotation_quaternion = Quaternion((1, 0.2, 0.4), 1.0)
    bent = seen(hand)
    # the hand turned, and the skin of the forearm did not
    np.testing.assert_allclose(bent.joints_m[0], carried.joints_m[0], atol=1e-6)
    assert np.abs(bent.joints_m - carried.joints_m).max() > 0.05
    np.testing.assert_allclose(forearm_way(bent), way, atol=1e-6)


@pytest.mark.parametrize("side", HANDEDNESSES)
def test_a_motion_with_a_forearm_comes_back_from_its_keys(extension, side, tmp_path):
    context = bpy.context
    hand, joints, turns = arm_of(context, side), hands.moving_hand_m(side), random_turns(5)
    motion.key_motion(hand, joints, context.scene, range(1, 6), turns=turns)
    for frame in range(5):
        read = armature.read_hand(hand, armature.at_frame(context.scene, 1 + frame))
        np.testing.assert_allclose(read.joints_m, joints[frame], atol=1e-6)
        assert abs(turn_of(read) @ turns[frame]) == pytest.approx(1, abs=1e-6)
    # ... and from what is written of it
    recordings = []
    list(record_steps(context, [hand], range(1, 6), recordings))
    recordings[0].save(tmp_path / "motion.npz")
    again = read_motion(tmp_path / "motion.npz").forearm
    assert again is not None
    np.testing.assert_allclose(np.abs((again * turns).sum(1)), 1, atol=1e-6)


@pytest.mark.parametrize("side", HANDEDNESSES)
def test_a_motion_without_a_forearm_moves_it_with_the_hand(context, side):
    hand, joints = arm_of(context, side), hands.moving_hand_m(side)
    motion.key_motion(hand, joints, context.scene, range(1, 6))
    for frame in range(5):
        read = armature.read_hand(hand, armature.at_frame(context.scene, 1 + frame))
        np.testing.assert_allclose(read.joints_m, joints[frame], atol=1e-6)
        np.testing.assert_allclose(np.abs(turn_of(read)), NO_TURN, atol=1e-6)


def test_a_motion_that_knows_the_forearm_makes_a_hand_with_its_bone(context):
    turns = random_turns(5)
    content = MotionFile(hands.moving_hand_m("right"), 24.0, "right", forearm=turns)
    plain = MotionFile(content.joints_m, 24.0, "right")
    there = armature.build_armature(context, "there", posing.rest_joints_m("right"), "right")
    wanted = [
        motion.WantedMotion(each, "Wave", hand) for each, hand in ((content, None), (plain, None), (content, there))
    ]
    turned, straight, there = motion.import_motions(context, wanted)
    assert not armature.has_forearm_bone(straight)
    for hand in (turned, there):
        read = armature.read_hand(hand, armature.at_frame(context.scene, 1))
        assert abs(turn_of(read) @ turns[0]) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("overrides_data", [False, True], ids=["armature linked", "armature overridden"])
def test_a_motion_on_linked_bones_is_keyed_without_its_forearm_and_says_so(extension, tmp_path, capfd, overrides_data):
    armature.build_armature(bpy.context, "there", posing.rest_joints_m("right"), "right")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hand.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "hand.blend"), link=True) as (_there, here):
        here.objects = ["there"]
    linked = bpy.data.objects["there"]
    bpy.context.scene.collection.objects.link(linked)
    hand = linked.override_create(remap_local_usages=True)
    assert isinstance(hand, bpy.types.Object)
    if overrides_data:
        bones = hand.data
        assert isinstance(bones, bpy.types.Armature)
        bones.override_create(remap_local_usages=True)
    bpy.context.view_layer.objects.active = hand
    joints = hands.moving_hand_m("right")
    write_motion(tmp_path / "wave.npz", MotionFile(joints, 24.0, "right", forearm=random_turns(len(joints))))
    bpy.ops.jghand.import_motion(filepath=str(tmp_path / "wave.npz"), target="ACTIVE", placement="FILE")
    assert "The turn of the forearm is left out on there" in capfd.readouterr().out
    read = armature.read_hand(hand, armature.at_frame(bpy.context.scene, 1))
    np.testing.assert_allclose(read.joints_m, joints[0], atol=1e-6)
    assert not armature.has_forearm_bone(hand)


@pytest.mark.parametrize("has_bone", [True, False], ids=["its own", "the wrist's"])
@pytest.mark.parametrize("side", HANDEDNESSES)
def test_a_fist_leaves_the_forearm_where_its_bone_is(extension, monkeypatch, side, has_bone):
    """A fist arches the palm, in whose frame the turn is told: it says how that is undone."""
    monkeypatch.setattr(avatar_files, "has_forearm", lambda avatar: has_bone)
    bpy.ops.jghand.add_hand(handedness=side)
    hand = bpy.context.object
    hand.pose.bones["wrist"].rotation_quaternion = Quaternion((1, 0, 0), 0.5)
    before = seen(hand)
    bpy.ops.jghand.apply_pose(pose="fist")
    after = seen(hand)
    assert np.abs(after.joints_m - before.joints_m).max() > 0.02
    np.testing.assert_allclose(forearm_way(after), forearm_way(before), atol=1e-6)
    assert np.abs(turn_of(after) - turn_of(before)).max() > 0.03
    assert bpy.ops.jghand.remove_controls.poll()


@pytest.mark.parametrize("closed", [False, True], ids=["bent", "in a fist"])
@pytest.mark.parametrize("side", HANDEDNESSES)
def test_the_shadow_of_a_forearm_stays_when_the_wrist_bends(extension, monkeypatch, side, closed):
    monkeypatch.setattr(avatar_files, "has_forearm", lambda avatar: True)
    monkeypatch.setattr(stand_ins.avatar_files, "has_forearm", lambda avatar: True)
    bpy.ops.jghand.add_hand(handedness=side)
    hand = bpy.context.object
    (shadow,) = hands.stand_ins_of(hand)
    shadow.hide_viewport = False

    def surface() -> np.ndarray:
        bpy.context.view_layer.update()
        vertices = shadow.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices
        return np.array([vertex.co for vertex in vertices])

    straight = surface()
    hand.pose.bones["wrist"].rotation_quaternion = Quaternion((1, 0, 0), 0.8)
    if closed:
        bpy.ops.jghand.apply_pose(pose="fist")
    moved = np.linalg.norm(surface() - straight, axis=1)
    behind = straight[:, 1] < -0.05
    assert behind.sum() > 50
    assert moved[behind].max() < 1e-6
    assert moved[straight[:, 1] > 0.05].min() > 0.02
