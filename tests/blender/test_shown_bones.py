"""Along which lines the picture of a hand is left open for the bones that are shown in front of it."""

import bpy
import numpy as np
import pytest
from mathutils import Euler

from blender_addon.core import kinematics, posing
from blender_addon.core.joints import NAMES
from blender_addon.hand import armature, controls
from blender_addon.viewport import drawing


@pytest.fixture
def hand(context):
    hand = armature.build_armature(context, "right", posing.rest_joints_m("right"), "right")
    hand.location, hand.rotation_euler = (0.3, -0.2, 0.1), Euler((0.4, 1.0, -0.3))
    context.view_layer.update()
    return hand


def lines_of(context: bpy.types.Context, hand: bpy.types.Object) -> tuple[list[np.ndarray], list[np.ndarray]]:
    found = list(drawing._lines(hand.evaluated_get(context.evaluated_depsgraph_get())))
    return [lines for lines, shape in found if not shape], [lines for lines, shape in found if shape]


def test_every_bone_is_a_line_from_its_head_to_its_tail_in_the_world(context, hand):
    bones, shapes = lines_of(context, hand)
    assert shapes == []
    wanted = [[hand.matrix_world @ bone.head, hand.matrix_world @ bone.tail] for bone in hand.pose.bones]
    assert np.allclose(np.concatenate(bones), np.array(wanted), atol=1e-6)


def test_a_hidden_bone_leaves_no_hole(context, hand):
    bone = hand.pose.bones["index2"]
    (bone if hasattr(bone, "hide") else bone.bone).hide = True
    bones, _ = lines_of(context, hand)
    assert len(bones) == len(NAMES) - 1


def test_bones_of_a_hidden_collection_leave_no_hole(context, hand):
    group = hand.data.collections.new("fingers")
    for name in NAMES[1:5]:
        group.assign(hand.data.bones[name])
    group.is_visible = False
    context.view_layer.update()
    bones, _ = lines_of(context, hand)
    assert len(bones) == len(NAMES) - 4


def test_controls_are_the_wires_of_their_shapes(context, hand):
    controls.add_controls(context, hand, kinematics.NO_FIST)
    context.view_layer.update()
    _, shapes = lines_of(context, hand)
    assert len(shapes) >= 6
    ring = hand.pose.bones["control_index"]
    middle = np.array(hand.matrix_world @ ring.head)
    nearest = min(shapes, key=lambda lines: np.linalg.norm(lines.reshape(-1, 3).mean(0) - middle))
    # a ring around the finger: all its points equally far from the control's axis
    far = np.linalg.norm(nearest.reshape(-1, 3) - nearest.reshape(-1, 3).mean(0), axis=-1)
    assert far.std() < 1e-3 * far.mean()
