# SPDX-License-Identifier: GPL-3.0-or-later
"""The hand in the viewport: it is there, right in color and depth, follows what happens, and blocks nobody.

A software driver encodes what a draw handler writes with an approximation of its own, up to 3/255 off (Mesa, llvmpipe):
what the shader writes is therefore also read from a target of floats, where nothing is encoded.
"""

import contextlib
import functools
import importlib
import os
import signal
import time
from types import ModuleType

import bpy
import numpy as np

from in_blender.pictures import changed, skin

# largest difference of a color on the screen from the engine's: in Solid on a software driver, and in Rendered
SOLID_MAX, RENDERED_MAX = 3, 1
# seconds that would be a hang: on a machine with nothing else to do, what is printed is below 0.05
KEPT_MAX_S = 0.5
# pixels of skin that a hand has at least in the view of `_begin`
HAND_PX = 15_000


def step_a_new_hand_shows_in_solid_and_becomes_sharp(window):
    yield from _begin(window)
    yield lambda: _is_sharp(window)
    assert _skin(window) > HAND_PX
    window.picture("solid")


def step_its_shader_writes_the_engines_colors(window):
    written = []
    draw = _draw_into_floats(window, written)
    handle = bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", "POST_PIXEL")
    window.redraw()
    yield lambda: written
    bpy.types.SpaceView3D.draw_handler_remove(handle, "WINDOW")
    linear = written[0].astype(np.float64)
    encoded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    assert np.abs(encoded * 255 - np.arange(256)).max() < 1e-3


def step_on_the_screen_they_are_the_same_whatever_the_view_transform(window):
    for transform in ("Standard", "AgX"):
        bpy.context.scene.view_settings.view_transform = transform
        yield 0.7
        yield lambda: _largest_difference(window) <= SOLID_MAX
    bpy.context.scene.view_settings.view_transform = "Standard"
    yield 0.5


def step_a_nearer_thing_hides_it_and_a_farther_one_does_not(window):
    whole = _skin(window)
    bpy.ops.mesh.primitive_cube_add(size=0.06, location=(0.0, 0.06, 0.06))
    cube = bpy.context.object
    yield lambda: _skin(window) < whole - 3000
    window.picture("behind_a_cube")
    cube.location.z = -0.08
    yield lambda: _skin(window) > whole - 300
    bpy.data.objects.remove(cube)
    yield 0.5


def step_it_follows_a_pose(window):
    before = window.crop(window.screen())
    hand = _hand()
    for name in ("index1", "index2", "index3"):
        hand.pose.bones[name].rotation_quaternion = (0.85, 0.5, 0.0, 0.0)
    window.redraw()
    yield lambda: changed(before, window.crop(window.screen()), 40).sum() > 1000


def step_bones_that_are_shown_in_front_are_seen_before_it(window):
    space = window.space()
    without = _hand().show_in_front
    space.overlay.show_overlays = True
    views = {}
    for name, in_front, shown in (("hand", False, True), ("bones", True, False), ("both", True, True)):
        _hand().show_in_front = in_front
        _switch(scene=shown)
        window.redraw()
        yield 0.3
        yield lambda shown=shown: not shown or _is_sharp(window)
        yield 0.5
        views[name] = window.crop(window.screen()).copy()
    window.picture("bones_in_front")
    hand = skin(views["hand"])
    bones = hand & ~changed(views["bones"], views["both"], 3) & changed(views["hand"], views["both"], 30)
    assert bones.sum() > 300, f"{bones.sum()} pixels of bones"
    assert (hand & ~changed(views["hand"], views["both"], 3)).sum() > 0.8 * hand.sum()
    _hand().show_in_front = without
    space.overlay.show_overlays = False
    yield 0.3


def step_a_local_view_of_something_else_does_not_show_it(window):
    bpy.ops.mesh.primitive_cube_add(size=0.01, location=(0.3, 0.3, 0.0))
    cube = bpy.context.object
    with window.override():
        bpy.ops.view3d.localview(frame_selected=False)
    yield lambda: not _is_there(window)
    with window.override():
        bpy.ops.view3d.localview(frame_selected=False)
    bpy.data.objects.remove(cube)
    yield lambda: _is_there(window)


def step_rendered_mode_shows_the_engines_colors(window):
    bpy.context.scene.render.engine = "JGHAND"
    bpy.context.scene.view_settings.view_transform = "Standard"
    window.space().overlay.show_overlays = False
    yield from window.shading("RENDERED")
    yield lambda: _is_sharp(window)
    yield lambda: _largest_difference(window) <= RENDERED_MAX
    window.picture("rendered")
    yield from window.shading("SOLID")
    yield lambda: _is_sharp(window)


def step_playing_shows_new_pictures_and_waits_no_longer_than_a_frame(window):
    waits, pictures = _watch_waits(window), _watch_pictures(window)
    with _watching(window) as kept:
        yield from _play(window, 4.0)
    assert len(pictures) >= 3  # a software driver draws two frames a second
    _check_kept(waits, kept)
    print(
        "JGHAND playing:",
        len(pictures),
        "pictures,",
        _part(window, ".viewport.views").late_frames(),
        "late",
        flush=True,
    )


def step_playing_goes_on_while_the_engine_hangs(window):
    pid = window.runtime().link().status.handshake["pid"]
    waits = _watch_waits(window)
    with _watching(window) as kept:
        os.kill(pid, signal.SIGSTOP)
        try:
            yield from _play(window, 3.0)
        finally:
            os.kill(pid, signal.SIGCONT)
    late = _part(window, ".viewport.views").late_frames()
    _check_kept(waits, kept)
    assert len(waits) <= _part(window, ".core.pacing").LATE_PATIENCE, "a hung engine is waited for again and again"
    assert late > len(waits)
    yield lambda: _is_sharp(window)


# ---- parts -----------------------------------------------------------------------------------------------------------


def _part(window, name: str) -> ModuleType:
    """A module of the extension."""
    return importlib.import_module(name, window.addon.__name__)


def _hand() -> bpy.types.Object:
    return next(thing for thing in bpy.context.scene.objects if "jghand_handedness" in thing)


def _begin(window):
    for thing in list(bpy.context.scene.objects):
        if thing.type == "MESH":
            bpy.data.objects.remove(thing)
    bpy.ops.jghand.add_hand()
    bpy.context.object.rotation_euler.zero()  # lying, so that the view from above sees its palm
    bpy.context.scene.view_settings.view_transform = "Standard"
    overlay = window.space().overlay
    overlay.show_overlays = False
    yield from window.look_at((0.0, 0.09, 0.0), 0.5, (0.6, 0.0, 0.3))


def _is_sharp(window) -> bool:
    """Whether every view has the best picture of what it wants."""
    shown = _part(window, ".viewport.views").all_views()
    paces = [view.pace for view in shown]
    return bool(paces) and all(
        p.grade == 2 and p.shown and p.shown.want == p.want and p.shown.grade == 2 for p in paces
    )


def _skin(window) -> int:
    return int(skin(window.crop(window.screen())).sum())


def _is_there(window) -> bool:
    """Whether the hand is on the screen; where it is not, almost nothing has its color."""
    return _skin(window) > HAND_PX / 2


def _switch(*, hand: bool = True, scene: bool = True) -> None:
    _hand().jghand.show_in_viewport = hand
    bpy.context.scene.jghand.show_in_viewport = scene


def _largest_difference(window) -> int:
    """Between the screen and the engine's picture, where that is opaque, of 255."""
    (view,) = _part(window, ".viewport.views").all_views()
    wanted = np.asarray(view.taken.message.arrays["rgba_u8"].view()).astype(int)
    region, part = window.region(), view.place.part
    top = window.window.height - (region.y + region.height)
    screen = window.screen().astype(int)
    there = screen[top + part.top : top + part.bottom, region.x + part.left : region.x + part.right]
    assert there.shape[:2] == wanted.shape[:2], "the picture was not drawn in its own size"
    return int(np.abs(there - wanted[..., :3])[wanted[..., 3] == 255].max())


def _draw_into_floats(window, written: list):
    """A draw handler that draws a picture of all 256 values and keeps what the shader wrote."""
    import gpu

    textures, cropping = _part(window, ".viewport.drawing"), _part(window, ".core.view")
    rgba = np.zeros((256, 1, 4), np.uint8)
    rgba[..., 0], rgba[..., 3] = np.arange(256)[:, None], 255

    def draw() -> None:
        if written:
            return
        target = gpu.types.GPUOffScreen(1, 256, format="RGBA32F")
        with target.bind():
            frame = gpu.state.active_framebuffer_get()
            frame.clear(color=(0, 0, 0, 0), depth=1.0)
            picture = textures.GpuPicture(rgba, np.ones((256, 1), np.float32))
            picture.draw(cropping.Part(0, 0, 1, 256), (1, 256), (0.0, 0.5, 0.0, 1.0), behind_scene=False)
            pixels = frame.read_color(0, 0, 1, 256, 4, 0, "FLOAT")
            pixels.dimensions = 4 * 256
            written.append(np.array(pixels, np.float32).reshape(256, 4)[::-1, 0])
        target.free()

    return draw


def _watch_waits(window) -> list[float]:
    """Seconds of every wait for the engine from now on."""
    link, waits = window.runtime().link(), []
    wait = type(link).wait

    def watched(*args):
        started = time.perf_counter()
        answer = wait(link, *args)
        waits.append(time.perf_counter() - started)
        return answer

    link.wait = watched
    return waits


@contextlib.contextmanager
def _watching(window):
    """Seconds that each call of ours keeps Blender's main thread, by its name; without those of making textures and
    drawing, which a software driver does on the same processor. Such a driver also needs longer for the scene than a
    view may wait after a new frame: here the frame is as new at each draw as with a quick one."""
    sync, views = (_part(window, name) for name in (".viewport.handlers", ".viewport.views"))
    clock = _part(window, ".clock")
    kept: dict[str, list[float]] = {"tick": [], "frame change": [], "draw": []}
    spent = [0.0]

    def timed(name, function):
        @functools.wraps(function)
        def call(*args):
            spent[0], started = 0.0, time.perf_counter()
            try:
                return function(*args)
            finally:
                kept[name].append(time.perf_counter() - started - spent[0])

        return call

    def drawn(view):
        started = time.perf_counter()
        try:
            return original_draw(view)
        finally:
            spent[0] += time.perf_counter() - started

    def draw() -> None:
        views.begin_step()
        original_handler()

    original_draw, original_tick = views._draw, clock._tick
    frames, ours = bpy.app.handlers.frame_change_post, sync.on_frame_change
    theirs = bpy.app.handlers.persistent(timed("frame change", ours))
    sync.remove_drawing()
    original_handler, sync.draw_overlay = sync.draw_overlay, timed("draw", draw)
    sync.add_drawing()
    views._draw, clock._tick = drawn, timed("tick", original_tick)
    frames[frames.index(ours)] = theirs
    try:
        yield kept
    finally:
        frames[frames.index(theirs)] = ours
        views._draw, clock._tick = original_draw, original_tick
        sync.remove_drawing()
        sync.draw_overlay = original_handler
        sync.add_drawing()


def _check_kept(waits: list[float], kept: dict[str, list[float]]) -> None:
    """Nothing of ours waited, or kept the main thread, for as long as a frame that is seen to be missing."""
    assert waits, "nothing was waited for: the test says nothing"
    assert max(waits) < KEPT_MAX_S, f"waited for {max(waits):.3f} s"
    for name, times in kept.items():
        assert times, f"no {name}: the test says nothing"
    print("JGHAND kept, ms:", {name: round(1e3 * max(times), 1) for name, times in kept.items()}, flush=True)
    for name, times in kept.items():
        assert max(times) < KEPT_MAX_S, f"{name} took {max(times):.3f} s"


def _watch_pictures(window) -> list[int]:
    """An entry for every picture that becomes textures from now on."""
    textures, made = _part(window, ".viewport.drawing"), []

    class Watched(textures.GpuPicture):
        def __init__(self, rgba: np.ndarray, depth_m: np.ndarray) -> None:
            super().__init__(rgba, depth_m)
            made.append(len(made))

    textures.GpuPicture = Watched
    return made


def _play(window, seconds: float):
    """Plays a waving finger."""
    bone = _hand().pose.bones["index1"]
    for frame, angle in ((1, 0.0), (30, 0.8), (60, 0.0)):
        bone.rotation_quaternion = (np.cos(angle / 2), np.sin(angle / 2), 0, 0)
        bone.keyframe_insert("rotation_quaternion", frame=frame)
    bpy.context.scene.frame_end = 60
    with window.override():
        bpy.ops.screen.animation_play()
    yield seconds
    with window.override():
        bpy.ops.screen.animation_cancel(restore_frame=False)
