# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of other programs are chosen in the browser: Blender is free while the engine reads, then a hand is keyed."""

from __future__ import annotations

import addon_utils
import bpy
import numpy as np

FRAMES = 240
_IMPORT, _TRACK = "JGHAND_OT_import_motion", "JGHAND_OT_track_video"


def step_blender_exports_a_moving_hand_as_gltf(window):
    _clear()
    posing = window.module("core.posing")
    joints_m = np.tile(posing.rest_joints_m("right"), (FRAMES, 1, 1))
    joints_m[..., 0] += 0.05 * np.sin(np.arange(FRAMES) / 20)[:, None]
    np.savez(window.out / "wave.npz", joints_m=joints_m, order="standard", unit="m", fps=24.0, handedness="right")
    with window.override():
        bpy.ops.jghand.import_motion(filepath=str(window.out / "wave.npz"), target="NEW", use_scene_range=True)
        addon_utils.enable("io_scene_gltf2")
        bpy.ops.export_scene.gltf(filepath=str(window.out / "wave.glb"), export_format="GLB")
    assert (window.out / "wave.glb").is_file()
    _clear()
    yield 0.2


def step_a_chosen_glb_is_keyed_and_blender_is_free_while_the_engine_reads_it(window):
    yield from window.open_sidebar()
    window.call("jghand.add_hand", handedness="right", use_camera=True, use_view=True)
    yield from window.settle()
    yield from window.choose_file("jghand.import_motion", window.out / "wave.glb")
    yield lambda: _job(window) is not None and window.modal(_IMPORT) is not None
    yield from window.point_at_view()
    yield from window.key("n")
    yield lambda: not window.space().show_region_ui
    assert not _job(window).is_over, "the key was heard while the engine read"
    window.picture("reading")
    yield from window.key("n")
    yield lambda: window.modal(_IMPORT) is None
    hand = _hand()
    assert hand.animation_data.action.name.startswith("wave")
    assert hand.animation_data.action.frame_range[1] >= FRAMES - 1
    assert not any(area.type == "FILE_BROWSER" for area in window.window.screen.areas)
    window.picture("keyed")
    with window.override():
        bpy.ops.ed.undo()
    yield 0.5
    assert _hand().animation_data is None or _hand().animation_data.action is None


def step_escape_while_the_engine_reads_leaves_nothing(window):
    yield from window.choose_file("jghand.import_motion", window.out / "wave.glb")
    yield lambda: window.modal(_IMPORT) is not None and _job(window) is not None and not _job(window).is_over
    yield from window.point_at_view()
    yield from window.key("Escape")
    yield lambda: window.modal(_IMPORT) is None
    assert _hand().animation_data is None or _hand().animation_data.action is None
    yield lambda: _job(window).is_over
    assert not _job(window).spec.folder.exists()


def step_a_chosen_video_that_is_none_is_refused_once(window):
    (window.out / "odd.mp4").write_bytes(b"no film")
    yield from window.choose_file("jghand.track_video", window.out / "odd.mp4")
    yield lambda: window.modal(_TRACK) is not None
    yield lambda: window.modal(_TRACK) is None
    assert _job(window).state.failure is not None
    assert not any(area.type == "FILE_BROWSER" for area in window.window.screen.areas)
    window.picture("refused")


def step_another_file_that_is_opened_while_the_engine_reads_gets_no_keys(window):
    yield from window.choose_file("jghand.import_motion", window.out / "wave.glb")
    yield lambda: window.modal(_IMPORT) is not None and _job(window) is not None and not _job(window).is_over
    with window.override():
        bpy.ops.wm.read_homefile(app_template="", use_empty=True)
    yield 1.0
    yield lambda: _job(window).is_over
    yield 0.5
    assert window.modal(_IMPORT) is None
    assert not bpy.data.actions
    assert not _job(window).spec.folder.exists()
    window.picture("another_file")


# ---- parts -----------------------------------------------------------------------------------------------------------


def _clear() -> None:
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)


def _hand() -> bpy.types.Object:
    return next(thing for thing in bpy.context.scene.objects if "jghand_handedness" in thing)


def _job(window):
    return window.module("renderer.runtime").jobs().get("import")
