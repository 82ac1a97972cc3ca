# SPDX-License-Identifier: GPL-3.0-or-later
"""A newcomer's first minutes, on a machine that has nothing but Blender and the zip.

Install from Disk, Add Hand, the hand on the screen, F12; then the renderer is killed while the animation plays, comes
back, and the scene is what it was. Continuous integration runs this story (scripts/test.py).
"""

import os
import signal
import sys
import time

import bpy

from in_blender.animator import ADD_BUTTON, FIRST_ITEM, close_other_windows, read
from in_blender.pictures import skin

INSTALLS = True  # the zip's way into the profile is a step of this story
SIZE = (480, 320)
PACKAGE = "bl_ext.user_default.jghand"
started: dict[str, float] = {}


def hand() -> bpy.types.Object:
    return next(obj for obj in bpy.data.objects if obj.type == "ARMATURE")


def step_the_zip_is_installed_from_disk(window):
    assert not [name for name in sys.modules if "jghand" in name], "the profile is not empty"
    yield from window.choose_file("extensions.package_install_files", window.archive)
    started["install"] = time.monotonic()
    yield lambda: PACKAGE in bpy.context.preferences.addons
    print(f"JGHAND installed after {time.monotonic() - started['install']:.1f} s", flush=True)
    window.addon = sys.modules[PACKAGE]
    yield 0.5
    window.picture("installed")


def step_add_hand_shows_a_hand(window):
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    yield from window.open_sidebar()
    window.picture("button")
    bar = window.region("UI")
    for x, from_top in (ADD_BUTTON, FIRST_ITEM):
        yield from window.click(bar.x + x, window.window.height - from_top)
    started["hand"] = time.monotonic()
    yield lambda: any(view.pace.shown for view in window.module("viewport.views").all_views())
    now = time.monotonic()
    print(
        f"JGHAND first picture {now - started['hand']:.1f} s after Add Hand, {now - started['install']:.1f} s after "
        "Install",
        flush=True,
    )
    yield from window.settle()
    window.picture("hand_from_afar")
    yield from window.point_at_view()
    yield from window.key("KP_Decimal")  # Frame Selected
    yield from window.settle()
    assert skin(window.crop(window.picture("hand"))).mean() > 0.03


def step_f12_renders_it(window):
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    for operator in ("jghand.use_engine", "jghand.use_standard", "jghand.add_camera"):
        assert window.call(operator) == {"FINISHED"}
    # that of the default scene stands behind the palm
    bpy.data.objects["Light"].location = (2, -4, 3)
    yield from window.f12()
    path = window.out / "f12.png"
    bpy.data.images["Render Result"].save_render(str(path))
    rendered = read(path)
    assert rendered.shape[:2] == SIZE[::-1]
    assert skin(rendered).mean() > 0.1, "F12 is empty"
    yield from window.key("Escape")
    close_other_windows(window)
    yield 0.5


def step_the_renderer_is_a_small_process_of_blenders_own_python(window):
    pid = window.runtime().link().status.handshake["pid"]
    with open(f"/proc/{pid}/cmdline", encoding="utf-8") as stream:
        command = stream.read().split("\0")
    assert command[0] == sys.executable
    with open(f"/proc/{pid}/status", encoding="utf-8") as stream:
        sizes = [line.strip() for line in stream if line.startswith(("VmRSS", "VmHWM"))]
    print("JGHAND renderer:", command, sizes, flush=True)


def step_a_renderer_killed_while_playing_comes_back_and_the_scene_is_unhurt(window):
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 24
    for frame, pose in ((1, "open"), (24, "fist")):
        scene.frame_set(frame)
        assert window.call("jghand.apply_pose", pose=pose, use_keys=True) == {"FINISHED"}
        yield 0.2
    yield from window.settle()
    before = _scene()
    yield from window.point_at_view()
    yield from window.key("space")
    yield 1.0
    pid = window.runtime().link().status.handshake["pid"]
    os.kill(pid, signal.SIGKILL)
    yield lambda: window.runtime().link().status.state == "failed"
    window.picture("killed")
    assert window.window.screen.is_animation_playing
    yield lambda: window.runtime().link().status.state == "ready"  # a short loop asks in every round
    assert window.window.screen.is_animation_playing
    assert window.runtime().link().status.handshake["pid"] != pid
    yield from window.key("space")
    assert not window.window.screen.is_animation_playing
    yield from window.settle()
    assert _scene() == before
    assert skin(window.crop(window.picture("back"))).mean() > 0.03


def _scene() -> dict[str, object]:
    """What must not change: objects, keys and poses."""
    keys = [(tuple(point.co)) for curve in _curves(hand().animation_data.action) for point in curve.keyframe_points]
    return {"objects": sorted(bpy.data.objects.keys()), "keys": keys}


def _curves(action: bpy.types.Action) -> list[bpy.types.FCurve]:
    return [curve for layer in action.layers for strip in layer.strips for bag in strip.channelbags
            for curve in bag.fcurves]  # fmt: skip
