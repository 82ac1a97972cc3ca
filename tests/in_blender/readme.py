# SPDX-License-Identifier: GPL-3.0-or-later
"""The README's steps in Blender, one after the other, with its pictures; then the saved file without a window."""

from __future__ import annotations

import subprocess

import bpy

from in_blender.animator import ADD_BUTTON, FIRST_ITEM, close_other_windows, read
from in_blender.pictures import skin

POSES = ((1, "open"), (13, "point"), (25, "victory"))
SIZE = (480, 360)


def step_add_hand(window):
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    yield from window.open_sidebar()
    window.picture("button")
    bar = window.region("UI")
    for x, from_top in (ADD_BUTTON, FIRST_ITEM):
        yield from window.click(bar.x + x, window.window.height - from_top)
    yield from window.look_at((0.02, 0.075, 0.01), 0.36, (0.75, 0.0, 0.75))
    yield from window.settle()
    window.picture("hand")


def step_poses_with_auto_keying(window):
    scene = bpy.context.scene
    scene.tool_settings.use_keyframe_insert_auto = True
    scene.frame_end = POSES[-1][0]
    for frame, pose in POSES:
        scene.frame_set(frame)
        assert window.call("jghand.apply_pose", pose=pose) == {"FINISHED"}
        yield from window.settle()
        window.picture(f"pose_{pose}")
    scene.frame_set(19)
    yield from window.settle()
    window.picture("between_poses")


def step_render_settings(window):
    scene = bpy.context.scene
    scene.frame_set(1)
    assert window.call("jghand.use_engine") == {"FINISHED"}
    assert window.call("jghand.use_standard") == {"FINISHED"}
    assert window.call("jghand.add_camera") == {"FINISHED"}
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    window.hide_overlays()
    yield from window.shading("RENDERED")
    yield from window.settle()
    window.picture("rendered")
    window.hide_overlays(False)


def step_f12_and_the_animation(window):
    scene = bpy.context.scene
    scene.render.filepath = str(window.out / "frame_")
    # that of the default scene stands behind the palm
    bpy.data.objects["Light"].location = (2, -4, 3)
    scene.frame_set(25)
    yield from window.f12()
    close_other_windows(window)
    scene.frame_step = 6
    done = []
    bpy.app.handlers.render_complete.append(lambda *_: done.append(True))
    yield from window.point_at_view()
    yield from window.key("ctrl+F12")
    yield lambda: done and len(list(window.out.glob("frame_*.png"))) == 5
    yield 1.0
    close_other_windows(window)
    assert all(skin(read(path)).mean() > 0.02 for path in window.out.glob("frame_*.png"))


def step_the_same_pictures_without_a_window(window):
    render = bpy.context.scene.render
    render.use_stamp_date = render.use_stamp_render_time = False  # what a PNG says of when it was made
    file = window.out / "hand.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    bpy.ops.wm.save_userpref()  # another Blender enables what the preferences on disk say
    once = ["-b", str(file), "-o", str(window.out / "b_####"), "-s", "1", "-e", "13", "-j", "12", "-a"]
    ours = ["--command", "jghand", "render", str(file), "--out", str(window.out / "command"), "--frames", "1-13,12"]
    for arguments in (once, ours):
        done = subprocess.run(["blender", *arguments], capture_output=True, text=True, check=False)
        print(done.stdout[-2000:], done.stderr[-2000:], flush=True)
        assert done.returncode == 0, arguments
        yield 0.2
    pictures = sorted(window.out.glob("b_*.png"))
    assert [path.name for path in pictures] == ["b_0001.png", "b_0013.png"]
    for path in pictures:
        (own,) = (window.out / "command").rglob(f"{path.stem[2:]}.png")
        assert path.read_bytes() == own.read_bytes(), "two ways to render give two pictures"
