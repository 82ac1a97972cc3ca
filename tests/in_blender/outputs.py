# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes, exports and trainings as an artist meets them: progress, Esc, another file, what plays without the engine.

Debian builds Blender without USD: there bakes are refused in a sentence, and what needs one is not tried.
"""

from __future__ import annotations

import json
import shutil
import sys
import time
from pathlib import Path
from unittest import SkipTest

import bpy
import numpy as np

FRAMES = 24


def step_the_panels_of_output_and_training_alone(window):
    """The others are tried elsewhere; without them these are seen whole on one screen, and open."""
    bpy.context.preferences.addons[window.addon.__name__].preferences.show_training = True
    for name in ("hand.panel", "render.panel"):
        for panel in reversed(window.module(name).CLASSES):
            if panel.__name__ not in ("HandPanel", "JointList"):
                bpy.utils.unregister_class(panel)
    for name in ("export.panel", "train.panel"):
        panels = window.module(name).CLASSES
        for panel in reversed(panels):
            bpy.utils.unregister_class(panel)
        for panel in panels:
            panel.bl_options = set()
            bpy.utils.register_class(panel)


def step_an_animated_hand(window):
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, FRAMES
    yield from window.open_sidebar("JGHand")
    window.add_hand()
    yield 1.0
    hand = bpy.context.view_layer.objects.active
    hand.jghand.avatar = "painted"
    for frame, pose in ((1, "flat"), (FRAMES, "fist")):
        scene.frame_set(frame)
        window.call("jghand.apply_pose", pose=pose, use_keys=True)
        yield 0.2
    scene.frame_set(12)
    bpy.ops.wm.save_as_mainfile(filepath=str(window.out / "scene.blend"))
    yield 0.5


def step_a_preview_movie_has_hands_and_all_else_and_changes_no_setting(window):
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_cube_add(size=0.04, location=(0.05, -0.03, 0.1))
    cube = bpy.context.object
    bpy.context.view_layer.objects.active = bpy.data.objects["Right Hand"]
    scene.render.engine, scene.render.filepath = "CYCLES", str(window.out / "preview" / "####.png")
    scene.frame_end = 4
    view = window.space().region_3d
    for name, perspective in (("camera", "CAMERA"), ("view", "PERSP"), ("ortho", "ORTHO")):
        view.view_perspective = perspective
        yield from window.settle()
        window.picture(f"before_preview_{name}")
        about, started = _kept_by_a_preview(), time.monotonic()
        window.call("jghand.preview_movie")
        yield lambda: not bpy.app.is_job_running("RENDER") and len(bpy.data.scenes) == 1
        print(f"JGHAND a preview of 4 frames took {time.monotonic() - started:.1f} s", flush=True)
        yield 0.5
        window.picture(f"preview_{name}")
        yield from window.key("Escape")
        assert not _changes_since(about), _changes_since(about)
        written = sorted((window.out / "preview").glob("*.png"))
        assert len(written) == 4, written
        for path in written:
            path.rename(window.out / f"preview_{name}_{path.name}")
    scene.frame_end = 2000
    about = _kept_by_a_preview()
    window.call("jghand.preview_movie")
    yield lambda: len(list((window.out / "preview").glob("*.png"))) > 2
    yield from window.key("Escape")
    yield lambda: not bpy.app.is_job_running("RENDER") and len(bpy.data.scenes) == 1
    assert not _changes_since(about), _changes_since(about)
    window.picture("preview_canceled")
    bpy.data.meshes.remove(cube.data)
    scene.render.engine, scene.frame_end = "BLENDER_EEVEE", FRAMES


def _changes_since(before):
    now = _kept_by_a_preview()
    return {key: (value, now.get(key)) for key, value in before.items() if now.get(key) != value}


def _kept_by_a_preview():
    """What a preview must leave as it is: how many data-blocks there are, and every setting of the scene."""
    scene = bpy.context.scene
    owners = (scene, scene.render, scene.display, scene.display.shading, scene.view_settings, scene.jghand)
    owners = (*owners, bpy.context.preferences.view, bpy.context.view_layer)
    found = {
        (type(owner).__name__, each.identifier): str(getattr(owner, each.identifier))
        for owner in owners
        for each in owner.bl_rna.properties
        if each.type in ("BOOLEAN", "INT", "FLOAT", "STRING", "ENUM")
    }
    for name in ("scenes", "objects", "cameras", "node_groups", "worlds"):
        found["data", name] = len(getattr(bpy.data, name))
    return found


def step_escape_ends_the_reading_of_an_animation(window):
    scene = bpy.context.scene
    scene.jghand.output.format, scene.jghand.output.folder = "ply", "//ply"
    scene.frame_end = 20000
    assert window.call("jghand.export") == {"RUNNING_MODAL"}
    yield 1.5
    window.picture("reading")
    yield from window.point_at_view()
    yield from window.key("Escape")
    yield 1.0
    assert scene.frame_current == 12
    assert window.runtime().jobs().get("output") is None


def step_escape_ends_the_job(window):
    jobs, scene = window.runtime().jobs(), bpy.context.scene
    scene.frame_end = 10 * FRAMES
    window.call("jghand.export")
    yield lambda: jobs.get("output") is not None
    window.redraw()
    yield 1.0
    window.picture("exporting")
    yield from window.point_at_view()
    yield from window.key("Escape")
    yield lambda: jobs.get("output").is_over
    assert jobs.get("output").state.phase.value == "canceled"
    scene.frame_end = FRAMES
    shutil.rmtree(window.out / "ply")


def step_a_bake_is_made_beside_blenders_own_work(window):
    jobs = window.runtime().jobs()
    before, started = jobs.get("output"), time.monotonic()
    window.call("jghand.bake")
    if not _has_usd(window):
        yield 2.0
        window.picture("bake_refused")
        assert jobs.get("output") is before
        assert not list(window.out.glob("jghand_bake/**/bake.json"))
        problem = ""
        try:
            with window.override():
                bpy.ops.jghand.bake()
        except RuntimeError as error:
            problem = str(error)
        assert "cannot read or write USD" in problem, problem
        raise SkipTest("this Blender has no USD: the bake was refused")
    yield lambda: jobs.get("output") is not before and _phase(jobs) == "done"
    print(f"JGHAND baked {FRAMES} frames in {time.monotonic() - started:.1f} s", flush=True)
    (stamp,) = window.out.glob("jghand_bake/**/bake.json")
    assert json.loads(stamp.read_text())["hands"][0]["frames"] == FRAMES
    window.redraw()
    yield 0.5
    window.picture("baked")


def step_a_bake_is_one_step_of_undo(window):
    _needs_usd(window)
    for change, end in ((bpy.ops.ed.undo, ""), (bpy.ops.ed.redo, "Right_Hand")):
        with window.override():
            change()
        yield 1.0
        assert Path(bpy.context.view_layer.objects.active.jghand.bake).name == end


def _needs_usd(window):
    if not _has_usd(window):
        raise SkipTest("this Blender has no USD")


def _has_usd(window):
    return window.module("versions").has_usd()


def _phase(jobs):
    job = jobs.get("output")
    return job.state.phase.value if job is not None else ""


def _places(thing):
    """(3 N) float32 places of the points, as Blender evaluated them."""
    now = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    geometry = None if thing.type == "POINTCLOUD" else now.evaluated_geometry()  # its parts live as long as it does
    cloud = now.data if geometry is None else geometry.pointcloud
    values = np.zeros(len(cloud.attributes["position"].data) * 3, np.float32)
    cloud.attributes["position"].data.foreach_get("vector", values)
    return values


def step_the_bake_plays_as_an_object(window):
    _needs_usd(window)
    hand = bpy.context.view_layer.objects.active
    window.call("jghand.play_bake")
    yield 1.0
    (thing,) = [thing for thing in bpy.data.objects if "jghand_bake" in thing]
    assert bpy.context.view_layer.objects.active == hand
    seen = []
    for frame in (1, 12, FRAMES):
        bpy.context.scene.frame_set(frame)
        yield 0.5
        seen.append(_places(thing))
    assert np.abs(seen[0] - seen[1]).max() > 0.005
    assert np.abs(seen[1] - seen[2]).max() > 0.005
    window.hide_overlays()
    window.picture("playing_solid")
    yield from window.shading("MATERIAL")
    # without a graphics card EEVEE compiles for a while, and shows nothing until then
    yield lambda: window.crop(window.screen()).std() > 12
    yield 1.0
    window.picture("playing")
    yield from window.shading("SOLID")
    window.hide_overlays(False)
    bpy.context.scene.frame_set(12)


def step_the_panel_says_that_a_bake_is_of_another_pose(window):
    _needs_usd(window)
    hand = bpy.context.view_layer.objects.active
    hand.location.x += 0.1
    yield 1.0
    window.picture("stale")
    hand.location.x -= 0.1
    window.call("jghand.clear_bake")
    yield 0.3
    assert not [thing for thing in bpy.data.objects if "jghand_bake" in thing]


def step_usd_ply_and_motion_files_are_exported(window):
    jobs, settings = window.runtime().jobs(), bpy.context.scene.jghand.output
    wanted = [("usd", "*.usda", 2)] if _has_usd(window) else []
    for kind, pattern, count in (*wanted, ("ply", "*.ply", FRAMES), ("motion", "*.npz", 1)):
        settings.format, settings.folder = kind, f"//{kind}"
        window.call("jghand.export")
        folder = window.out / kind
        yield lambda folder=folder, pattern=pattern, count=count: len(list(folder.glob(pattern))) == count
        yield lambda: not jobs.runs("output")
    window.picture("exported")


def step_a_training_survives_opening_another_file(window):
    """The engine's command line is stood in for by a program that counts: what is tried is Blender's side."""
    runtime, table = window.runtime(), window.runtime().jobs()
    stand_in = Path(__file__).parents[1] / "addon_core" / "stand_in_job.py"
    runtime.program = lambda **_: (sys.executable, "-I", str(stand_in), "hours")
    pictures = window.out / "jghand_capture"
    pictures.mkdir()
    work = window.out / "my_hand.training"
    (work / "pictures").mkdir(parents=True)
    (work / "training.json").write_text("{}")
    shots = sorted(window.out.glob("*_exported.png"))
    shutil.copy(shots[-1], work / "pictures" / "step_00000500.png")
    window.call("jghand.train", start="resume")
    yield lambda: table.get("training").state.total > 0
    bpy.context.scene.jghand.output.format = "usd"
    window.redraw()
    yield 1.5
    window.picture("training")
    job = table.get("training")
    bpy.ops.wm.open_mainfile(filepath=str(window.out / "scene.blend"))
    yield 1.0
    assert table.get("training") is job
    before = job.state.done
    yield lambda: job.state.done > before  # the timer looks after it in the other file too
    bpy.ops.jghand.cancel_job(key="training")
    yield lambda: job.state.phase.value == "canceled"
