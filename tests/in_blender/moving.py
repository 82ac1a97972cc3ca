# SPDX-License-Identifier: GPL-3.0-or-later
"""Fingers turned by hand in the viewport, recorded: the moving picture of the README (`scripts/moving_picture.py`)."""

import bpy

from in_blender.pictures import changed, write_png

# what the recording shows: a control, how many pictures it has, and how far the pointer goes meanwhile (pixels)
TURNS = (("control_pinky", 8, 120), ("control_ring", 8, 115), ("control_middle", 8, 110), ("control_index", 8, 90))


def step_a_hand_with_finger_controls(window):
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    yield from window.open_sidebar()
    assert window.call("jghand.add_hand") == {"FINISHED"}
    assert window.call("jghand.add_controls") == {"FINISHED"}
    space = window.space()
    space.overlay.show_floor = space.overlay.show_axis_x = space.overlay.show_axis_y = False
    space.overlay.show_cursor = space.overlay.show_text = False
    space.show_region_toolbar = space.show_gizmo = False
    yield from window.look_at((0.02, 0.0, 0.085), 0.25, (1.4, 0.0, 0.55))
    yield from window.settle()
    window.picture("before")


def step_fingers_are_turned(window):
    """R X X and the pointer, as an animator turns a bone; every picture waits for the renderer's."""
    recorded = window.out / "recorded"
    recorded.mkdir()
    hand = bpy.context.active_object
    with window.override():
        bpy.ops.object.mode_set(mode="POSE")
    region, number = window.region(), 0
    first = window.crop(window.screen())
    for name, count, far in TURNS:
        for bone in hand.pose.bones:
            bone.select = bone.name == name
        hand.data.bones.active = hand.data.bones[name]
        x, y = region.x + region.width * 0.62, region.y + region.height * 0.3
        yield from window.move(x, y)
        for key in ("r", "x", "x"):
            yield from window.key(key)
        for at in range(count):
            yield from window.drag(x, y + far * (at + 1) / count)
            yield 0.35
            write_png(recorded / f"{number:03d}.png", window.screen())
            number += 1
        yield from window.key("Return")
    assert changed(first, window.crop(window.screen()), 40).mean() > 0.01
