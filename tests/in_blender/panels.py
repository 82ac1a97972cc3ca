# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab as an artist meets it: empty, with a hand, with a pose chosen from pictures, with somebody else's rig."""

import importlib

import bpy


def _module(window, name):
    return importlib.import_module(f".{name}", window.addon.__name__)


def _assert_seen(window, hand):
    """All joints lie in what the bars leave of the view."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d

    region, view = window.region(), window.space().region_3d
    right = region.width - window.region("UI").width
    for bone in hand.pose.bones:
        place = location_3d_to_region_2d(region, view, hand.matrix_world @ bone.head)
        assert 0 < place.x < right, (bone.name, place, right)
        assert 0 < place.y < region.height, (bone.name, place)


def step_an_empty_scene_shows_one_button(window):
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    yield from window.open_sidebar("JGHand")
    window.picture("empty")


def step_a_hand_is_added_looked_at_and_listed(window):
    window.add_hand()
    yield 1.0
    hand = bpy.context.view_layer.objects.active
    assert hand.name == "Right Hand"
    assert bpy.context.scene.camera is not None
    _assert_seen(window, hand)
    window.picture("hand")


def step_baking_ends_with_escape_and_changes_nothing(window):
    controls = _module(window, "hand.controls")
    hand = bpy.data.objects["Right Hand"]
    bpy.context.scene.frame_end = 20000
    with window.override():
        assert bpy.ops.jghand.bake_controls("INVOKE_DEFAULT", True) == {"RUNNING_MODAL"}
    yield 2.0
    window.picture("baking")
    yield from window.point_at_view()
    yield from window.key("Escape")
    yield 1.0
    assert controls.has_controls(hand)
    assert hand.animation_data is None
    assert bpy.context.scene.frame_current == 1
    window.picture("canceled")


def step_baking_ends_by_itself(window):
    controls = _module(window, "hand.controls")
    bpy.context.scene.frame_end = 12
    with window.override():
        bpy.ops.jghand.bake_controls("INVOKE_DEFAULT", True)
    yield lambda: not controls.has_controls(bpy.data.objects["Right Hand"])
    assert bpy.data.objects["Right Hand"].animation_data.action is not None


def step_undo_brings_the_controls_back(window):
    controls = _module(window, "hand.controls")
    with window.override():
        bpy.ops.ed.undo()
    yield 0.5
    assert controls.has_controls(bpy.data.objects["Right Hand"])


def step_the_pose_library_is_installed_and_shown(window):
    hand = bpy.data.objects["Right Hand"]
    with window.override():
        bpy.ops.jghand.select_hand(uid=hand.session_uid)
        bpy.ops.jghand.make_pose_assets("INVOKE_DEFAULT")
    yield 0.2
    with window.override():
        bpy.ops.jghand.show_pose_shelf("INVOKE_DEFAULT", True)
    yield lambda: window.space().show_region_asset_shelf
    yield 3.0
    assert bpy.context.mode == "POSE"
    window.picture("shelf")
