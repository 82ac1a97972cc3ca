# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of other programs are chosen in the browser: Blender is free while the renderer reads, then a hand is keyed."""

import contextlib
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

FRAMES = 240
_IMPORT = "JGHAND_OT_import_motion"


def step_a_hand_and_a_motion_in_centimeters(window):
    """JGHand's own files are in meters and read in Blender; what the renderer has to convert is a job."""
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    joints_cm = 100 * np.tile(window.module("core.posing").rest_joints_m("right"), (FRAMES, 1, 1))
    joints_cm[..., 0] += 5 * np.sin(np.arange(FRAMES) / 20)[:, None]
    np.savez(window.out / "wave.npz", joints=joints_cm, order="standard", unit="cm", fps=24.0, handedness="right")
    yield from window.open_sidebar()
    window.add_hand()
    yield from window.settle()


def step_a_chosen_motion_is_keyed_and_blender_is_free_while_the_renderer_reads_it(window):
    yield from window.choose_file("jghand.import_motion", window.out / "wave.npz")
    with (yield from _reading(window)):
        yield from window.point_at_view()
        yield from window.key("n")
        yield lambda: not window.space().show_region_ui
        window.picture("reading")
        yield from window.key("n")
    yield lambda: window.modal(_IMPORT) is None
    action = _hand().animation_data.action
    assert action.name.startswith("wave")
    assert action.frame_range[1] >= FRAMES - 1
    assert not any(area.type == "FILE_BROWSER" for area in window.window.screen.areas)
    window.picture("keyed")
    with window.override():
        bpy.ops.ed.undo()
    yield 0.5
    assert _hand().animation_data is None or _hand().animation_data.action is None


def step_escape_while_the_renderer_reads_leaves_nothing(window):
    yield from window.choose_file("jghand.import_motion", window.out / "wave.npz")
    with (yield from _reading(window)):
        yield from window.point_at_view()
        yield from window.key("Escape")
        yield lambda: window.modal(_IMPORT) is None
    assert _hand().animation_data is None or _hand().animation_data.action is None
    yield lambda: _job(window).is_over
    yield lambda: not list(_job_folders(window))


def step_a_chosen_video_without_the_training_tools_starts_nothing(window):
    (window.out / "odd.mp4").write_bytes(b"no film")
    before = _job(window)
    yield from window.choose_file("jghand.track_video", window.out / "odd.mp4")
    yield 2.0
    window.picture("refused")
    assert _job(window) is before
    assert window.modal("JGHAND_OT_track_video") is None
    assert not any(area.type == "FILE_BROWSER" for area in window.window.screen.areas)


def step_another_file_that_is_opened_while_the_renderer_reads_gets_no_keys(window):
    yield from window.choose_file("jghand.import_motion", window.out / "wave.npz")
    with (yield from _reading(window)):
        with window.override():
            bpy.ops.wm.read_homefile(app_template="", use_empty=True)
        yield 1.0
    yield lambda: _job(window).is_over
    yield 0.5
    assert window.modal(_IMPORT) is None
    assert not bpy.data.actions
    yield lambda: not list(_job_folders(window))
    window.picture("another_file")


# ---- parts -----------------------------------------------------------------------------------------------------------


def _hand() -> bpy.types.Object:
    return next(thing for thing in bpy.context.scene.objects if "jghand_handedness" in thing)


def _job(window):
    return window.module("renderer.runtime").jobs.get("import")


def _job_folders(window) -> Iterator[Path]:
    return window.module("folders").user_folder("jobs").glob("job_*")


def _reading(window):
    """Waits until the renderer reads a motion, and stops it there for as long as the `with` that this is for."""
    yield lambda: window.modal(_IMPORT) is not None and _job(window) is not None and not _job(window).is_over
    return _stopped(_job(window)._process.popen.pid)


@contextlib.contextmanager
def _stopped(pid: int) -> Iterator[None]:
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):  # canceled, it has ended
            os.kill(pid, signal.SIGCONT)
