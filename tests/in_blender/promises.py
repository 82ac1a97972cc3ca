# SPDX-License-Identifier: GPL-3.0-or-later
"""A long motion is one step of undo, and what viewport renders leave out is what the panel says."""

import bpy
import numpy as np

from in_blender.pictures import skin

FRAMES = 6_000


def step_a_hand_is_there(window):
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    yield from window.open_sidebar()
    window.add_hand()
    yield from window.settle()
    window.picture("hand")


def step_a_long_motion_is_keyed_and_undone_as_one_step(window):
    posing = window.module("core.posing")
    turns = 0.2 * np.sin(np.arange(FRAMES) / 30)[:, None]
    joints_m = np.tile(posing.rest_joints_m("right"), (FRAMES, 1, 1))
    joints_m[:, 5:9, 2] += turns * np.array([0.0, 0.01, 0.02, 0.03])
    np.savez(window.out / "long.npz", joints_m=joints_m, order="standard", unit="m", fps=30.0, handedness="right")
    yield from window.choose_file("jghand.import_motion", window.out / "long.npz")
    yield lambda: _hand().animation_data is not None and window.modal("JGHAND_OT_import_motion") is None
    action = _hand().animation_data.action
    assert action.name == "long"
    assert action.frame_range[1] > FRAMES * 24 / 30 - 2
    window.picture("imported")
    with window.override():
        bpy.ops.ed.undo()
    yield 0.5
    assert _hand().animation_data is None or _hand().animation_data.action is None


def step_viewport_renders_have_no_hands_which_the_panel_says(window):
    """Should this fail, Blender has begun to draw what extensions add: the sentence is then to be taken away."""
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 320, 200
    scene.render.filepath = str(window.out / "viewport_render.png")
    window.hide_overlays()
    yield from window.settle()
    assert skin(window.crop(window.screen())).sum() > 5000
    with window.override():
        bpy.ops.render.opengl(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    values = np.array(image.pixels[:], np.float32).reshape(image.size[1], image.size[0], 4)
    bpy.data.images.remove(image)
    assert skin((255 * values[::-1, :, :3]).astype(np.uint8)).sum() < 50
    window.hide_overlays(False)


# ---- parts -----------------------------------------------------------------------------------------------------------


def _hand() -> bpy.types.Object:
    return next(thing for thing in bpy.context.scene.objects if "jghand_handedness" in thing)
