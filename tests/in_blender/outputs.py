# SPDX-License-Identifier: GPL-3.0-or-later
"""Exports and trainings as an artist meets them: progress, Esc, another file.

Debian builds Blender without USD: there bakes are refused in a sentence, and what needs one is not tried.
"""

import shutil
import sys
from pathlib import Path
from unittest import SkipTest

import bpy

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
    assert window.runtime().jobs.get("export") is None


def step_escape_ends_the_job(window):
    jobs, scene = window.runtime().jobs, bpy.context.scene
    scene.frame_end = 10 * FRAMES
    window.call("jghand.export")
    yield lambda: jobs.get("export") is not None
    window.redraw()
    yield 1.0
    window.picture("exporting")
    yield from window.point_at_view()
    yield from window.key("Escape")
    yield lambda: jobs.get("export").is_over
    assert jobs.get("export").state.phase.value == "canceled"
    scene.frame_end = FRAMES
    shutil.rmtree(window.out / "ply")


def step_without_usd_a_bake_is_refused_in_a_sentence(window):
    if _has_usd(window):
        raise SkipTest("this Blender has USD; tests/blender bakes and plays")
    window.picture("bake_refused")
    problem = ""
    try:
        window.call("jghand.bake")
    except RuntimeError as error:
        problem = str(error)
    assert "cannot read or write USD" in problem, problem
    assert window.runtime().jobs.get("bake") is None
    assert not list(window.out.glob("jghand_bake/**/bake.json"))


def _has_usd(window):
    return window.module("versions").has_usd()


def step_usd_ply_and_motion_files_are_exported(window):
    jobs, settings = window.runtime().jobs, bpy.context.scene.jghand.output
    wanted = [("usd", "*.usda", 2)] if _has_usd(window) else []
    for kind, pattern, count in (*wanted, ("ply", "*.ply", FRAMES), ("motion", "*.npz", 1)):
        settings.format, settings.folder = kind, f"//{kind}"
        window.call("jghand.export")
        folder = window.out / kind
        yield lambda folder=folder, pattern=pattern, count=count: len(list(folder.glob(pattern))) == count
        yield lambda: not jobs.runs("export")
    window.picture("exported")


def step_surfels_are_a_switch_with_a_count(window):
    jobs, scene = window.runtime().jobs, bpy.context.scene
    settings = scene.jghand.output
    bpy.context.object.jghand.avatar = ""
    settings.format, settings.folder, settings.use_surfels, settings.surfel_count = "ply", "//surfels", True, 60_000
    scene.frame_end = 1
    window.redraw()
    yield 1.0
    window.picture("surfels")
    window.call("jghand.export")
    yield lambda: jobs.get("export").spec.title == "Exporting PLY" and not jobs.runs("export")
    (file,) = (window.out / "surfels").glob("*.ply")
    count = int(file.read_bytes().split(b"element vertex ")[1].split(b"\n")[0])
    assert 55_000 < count <= 60_000, count
    settings.use_surfels, scene.frame_end = False, FRAMES


def step_a_training_survives_opening_another_file(window):
    """The engine's command line is stood in for by a program that counts: what is tried is Blender's side."""
    runtime, table = window.runtime(), window.runtime().jobs
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
