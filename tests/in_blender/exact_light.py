# SPDX-License-Identifier: GPL-3.0-or-later
"""Exact Light in the default scene: what stands before the lamp shades the hand, and Esc ends it at any moment."""

import subprocess

import bpy
import numpy as np

from in_blender.animator import close_other_windows, read

SIZE = (240, 160)
KINDS = ("scenes", "objects", "meshes", "materials", "collections", "images", "worlds", "lights", "node_groups")
kept: dict[str, object] = {}


def step_a_cube_between_lamp_and_hand_shades_it_in_f12(window):
    window.call("jghand.add_hand")
    window.call("jghand.use_engine")
    window.call("jghand.add_camera")
    scene = bpy.context.scene
    assert scene.jghand.light == "SCENE"
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.jghand.use_exact_light = True
    lamp, cube = bpy.data.objects["Light"], bpy.data.objects["Cube"]
    lamp.location = (2.0, -4.0, 3.0)
    cube.scale, cube.location = (0.03,) * 3, 0.05 * lamp.location + 0.95 * bpy.context.object.location
    cube.location.z += 0.08
    yield from window.settle()
    shaded = yield from _rendered(window, "shaded")
    kept["shaded"] = shaded
    cube.hide_render = True
    clear = yield from _rendered(window, "clear")
    cube.hide_render = False
    hand = clear.mean(-1) > clear[:4].mean() + 40
    darker = clear.mean(-1) - shaded.mean(-1) > 30
    assert 0.1 < darker.sum() / hand.sum() < 0.9, darker.sum() / hand.sum()


def step_esc_ends_an_animation_at_any_moment(window):
    """Before a bake, in it, and while the engine draws; the next F12 is as it was before."""
    exact, engine = window.module("render.exact_light"), window.module("render.engine").JGHandRenderEngine
    scene = bpy.context.scene
    path, (scene.frame_start, scene.frame_end) = scene.render.filepath, (1, 40)
    before = _state()
    for moment, owner, name in (
        ("before", window.module("render.handover"), "_run"),
        ("in", exact.probe, "bake"),
        ("after", engine, "_ask"),
    ):
        frames = window.out / moment
        scene.render.filepath = str(frames / "####.png")
        _escape_within(window, owner, name, 2)
        done = []
        bpy.app.handlers.render_cancel.append(lambda *_, done=done: done.append("canceled"))
        bpy.app.handlers.render_complete.append(lambda *_, done=done: done.append("complete"))
        yield from window.point_at_view()
        yield from window.key("ctrl+F12")
        yield lambda done=done: done and not bpy.app.is_job_running("RENDER")
        yield 1.0
        window.picture(f"esc_{moment}")
        assert done == ["canceled"]
        written = sorted(frames.glob("*"))
        assert len(written) in (1, 2), written
        for frame in written:
            assert np.abs(read(frame) - kept["shaded"]).mean() < 1, f"{frame} is not whole"
        scene.render.filepath = path
        close_other_windows(window)
        yield 0.5
        assert _state() == before
    scene.frame_set(1)
    again = yield from _rendered(window, "again")
    assert np.abs(again - kept["shaded"]).mean() < 1


def _escape_within(window, owner, name: str, turn: int):
    """Has Escape pressed as a function begins for this many times, and never after that."""
    real, turns = getattr(owner, name), []

    def pressed(*given, **named):
        turns.append(name)
        if len(turns) == turn:
            subprocess.run(["xdotool", "key", "Escape"], check=True)
            setattr(owner, name, real)
        return real(*given, **named)

    setattr(owner, name, pressed)


def _state() -> dict[str, object]:
    """What a render must leave as it is."""
    scene = bpy.context.scene
    owners = (scene, scene.render, scene.cycles, scene.jghand, scene.view_settings, bpy.context.view_layer)
    found = {
        (type(owner).__name__, each.identifier): str(getattr(owner, each.identifier))
        for owner in owners
        for each in owner.bl_rna.properties
        if each.type in ("BOOLEAN", "INT", "FLOAT", "STRING", "ENUM")
        and each.identifier not in ("frame_current", "frame_float", "frame_current_final")
    }
    for kind in KINDS:
        found["data", kind] = sorted((thing.name, thing.users) for thing in getattr(bpy.data, kind))
    found["selected"] = [thing.name for thing in bpy.context.view_layer.objects.selected]
    return found


def _rendered(window, name: str):
    """(H, W, 3) of F12."""
    yield from window.f12(name)
    path = window.out / f"{name}.png"
    bpy.data.images["Render Result"].save_render(str(path))
    close_other_windows(window)
    yield 0.5
    return read(path).astype(float)
