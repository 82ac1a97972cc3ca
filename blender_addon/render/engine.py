# SPDX-License-Identifier: GPL-3.0-or-later
"""The render engine JGHand: F12, animations and `blender -b -a` draw the hands of a scene through its camera.

A frame that cannot be exact fails the render with a report and writes nothing: `error_set` or an exception alone would
let Blender write an empty picture and go on (BLENDER 8.3). Where another scene's compositor asks for the hands, Blender
goes on after a report too, so the frame is filled with magenta, nearer than everything. Source: BLENDER 8.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..core import panel_text, view
from ..core.view import Moment, Part, SceneLight, picture_request
from ..errors import JGHandFailure
from ..hand import seen_hands
from ..ops import sentence_of
from ..preferences import preferences
from ..renderer import runtime
from ..renderer.runtime import RenderNote
from ..renderer.state import REQUEST_S
from ..ui import popup_text
from ..viewport.views import ViewportEngine
from . import ENGINE, camera, composite, exact_light, rendering, samples, scene_light

COMBINED, DEPTH, IDS = "Combined", "Depth", "JGHandId"
# as Blender shows what is missing
MAGENTA = (1.0, 0.0, 1.0, 1.0)
# Blender's own panels that show what this engine honors; those of other engines stay hidden
_PANELS_OF_OTHERS = (
    *("CAMERA_PT_presets", "CAMERA_PT_safe_areas_presets", "DATA_PT_context_camera", "DATA_PT_lens"),
    *("DATA_PT_camera", "DATA_PT_camera_animation", "DATA_PT_camera_background_image", "DATA_PT_camera_display"),
    *("DATA_PT_camera_display_composition_guides", "DATA_PT_camera_dof", "DATA_PT_camera_dof_aperture"),
    *("DATA_PT_camera_safe_areas", "DATA_PT_camera_safe_areas_center_cut", "DATA_PT_custom_props_camera"),
    *("RENDER_PT_color_management", "RENDER_PT_color_management_advanced", "RENDER_PT_color_management_curves"),
    *("RENDER_PT_color_management_white_balance", "RENDER_PT_color_management_working_space"),
    *("RENDER_PT_encoding", "RENDER_PT_encoding_audio", "RENDER_PT_encoding_video", "RENDER_PT_format"),
    *("RENDER_PT_frame_range", "RENDER_PT_output", "RENDER_PT_output_color_management"),
    *("RENDER_PT_output_pixel_density", "RENDER_PT_post_processing", "RENDER_PT_stamp", "RENDER_PT_stamp_burn"),
    *("RENDER_PT_stamp_note", "RENDER_PT_time_stretching", "OBJECT_PT_custom_props", "OBJECT_PT_visibility"),
    *("VIEWLAYER_PT_context_layer", "VIEWLAYER_PT_layer", "WORLD_PT_animation", "WORLD_PT_context_world"),
    *("WORLD_PT_custom_props", "WORLD_PT_viewport_display"),
)


class JGHandRenderEngine(ViewportEngine, bpy.types.RenderEngine):
    bl_idname = ENGINE
    bl_label = "JGHand"
    bl_use_postprocess = True
    bl_use_eevee_viewport = True
    bl_use_gpu_context = False

    def update_render_passes(self, scene: bpy.types.Scene | None = None, renderlayer: Any = None) -> None:
        self.register_pass(scene, renderlayer, COMBINED, 4, "RGBA", "COLOR")
        if renderlayer is not None and renderlayer.use_pass_z:
            self.register_pass(scene, renderlayer, DEPTH, 1, "Z", "VALUE")
        if scene is not None and scene.jghand.use_pass_ids:
            self.register_pass(scene, renderlayer, IDS, 1, "X", "VALUE")

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """One frame of one view layer. A failure is an error report, which ends the render and writes no file."""
        failure = None
        try:
            self._render(depsgraph)
        except JGHandFailure as reason:
            failure = reason
        except KeyboardInterrupt:
            failure = JGHandFailure("interrupted")
        except Exception as error:  # a mistake of ours must not become an empty picture either
            traceback.print_exc()
            failure = JGHandFailure("internal", f"{type(error).__name__}: {error}")
        if failure is not None:
            runtime.render_note = RenderNote(failure=failure)
            if failure.kind == "canceled" and self.test_break():
                return
            scene = depsgraph.scene.original
            if composite.is_hands_scene(scene):
                self._fill_magenta(depsgraph.view_layer.name)
                rendering.hands_failed(scene, failure)
            self._say(sentence_of(failure))

    def _say(self, text: str) -> None:
        """Above the image, where it stays, at the pointer, and in the status bar."""
        self.error_set(text)
        self.update_stats("", "")  # shows it
        self.report({"ERROR"}, popup_text(text))

    def _render(self, depsgraph: bpy.types.Depsgraph) -> None:
        clock = time.perf_counter()
        # what is keyed of a scene and its world is only in what was evaluated for this render
        scene = depsgraph.scene_eval
        if scene.render.use_multiview:
            raise JGHandFailure("stereo")
        if (self.camera_override or scene.camera) is None:
            raise JGHandFailure("no_camera")
        # what is composited has the size of the scene that it is for
        size = (self.resolution_x, self.resolution_y)
        part = camera.region(scene.render, size)
        frame = samples.Frame(lambda: self.camera_override or depsgraph.scene_eval.camera, size, part)
        seen = samples.read_moments(depsgraph, frame, self.frame_set)
        light = scene_light.of_render(depsgraph, seen_hands.evaluated_sources(depsgraph), self._is_canceled)
        hands = seen[(len(seen) - 1) // 2].hands
        light = scene_light.shaded(light, hands, depsgraph)
        light = exact_light.with_baked(light, depsgraph, hands, self._is_canceled)
        evaluated, scene = time.perf_counter(), depsgraph.scene_eval
        wanted = {COMBINED: "rgba_f32", **_other_outputs(scene, depsgraph.view_layer_eval)}
        reply = self._ask(seen, list(wanted.values()), scene, light)
        answered = time.perf_counter()
        arrays = {name: np.asarray(reply.arrays[output].view()) for name, output in wanted.items()}
        drawn = _drawn(arrays, scene)
        arrays = {name: values[drawn.top : drawn.bottom, drawn.left : drawn.right] for name, values in arrays.items()}
        passes = dict(_passes(arrays, scene, linear=light is not None))
        self._fill(part, drawn, depsgraph.view_layer_eval.name, passes)
        self._tell(reply.header.get("reports", []), seen, (evaluated - clock, answered - evaluated))

    def _ask(self, seen: list[Moment], outputs: list[str], scene: bpy.types.Scene, light: SceneLight | None) -> Any:
        """The engine's answer. Escape, and whatever else stops the render, ends the wait: JGHandFailure (canceled)."""
        self.update_stats("JGHand", "Waiting for the renderer")
        header, arrays = picture_request(seen, outputs=outputs, preset=scene.jghand.render_preset, light=light)
        chosen = preferences()
        timeout_s = chosen.render_timeout_s if chosen is not None else REQUEST_S
        return runtime.link().request(header, arrays, timeout_s=timeout_s, canceled=self._is_canceled)

    def _is_canceled(self) -> bool:
        return self.test_break() or runtime.render_canceled.is_set()

    def _fill(self, part: Part, drawn: Part, layer: str, values: dict[str, np.ndarray]) -> None:
        """Hands over what was drawn of a part of the view; the rest of it stays empty."""
        result = self.begin_result(drawn.left, part.height - drawn.bottom, drawn.width, drawn.height, layer=layer)
        if (result.resolution_x, result.resolution_y) != (drawn.width, drawn.height):
            came = f"{drawn.width} x {drawn.height}, Blender wants {result.resolution_x} x {result.resolution_y}"
            self.end_result(result, cancel=True)
            raise JGHandFailure("other_region", came)
        for each in result.layers[0].passes:  # a pass that the view layer does not ask for is not there
            if each.name in values:
                each.rect.foreach_set(values[each.name])
        self.end_result(result)

    def _fill_magenta(self, layer: str) -> None:
        """What nobody takes for a picture, before everything that it is combined with."""
        result = self.begin_result(0, 0, self.resolution_x, self.resolution_y, layer=layer)
        pixels = result.resolution_x * result.resolution_y
        for each in result.layers[0].passes:
            value = MAGENTA if each.name == COMBINED else (0.0,) * each.channels
            each.rect.foreach_set(np.tile(np.array(value, np.float32), pixels))
        self.end_result(result)

    def _tell(self, reports: list[dict[str, Any]], seen: list[Moment], times: tuple[float, float]) -> None:
        evaluate_ms, request_ms = (1e3 * seconds for seconds in times)
        if reports:
            names = tuple(hand.name for hand in seen[0].hands)
            runtime.reports[runtime.RENDER] = {**reports[0], panel_text.HANDS: names}
        before = runtime.render_note
        if before is None or before.failure is None:  # another view layer of this frame may have failed
            runtime.render_note = RenderNote(None, reports, evaluate_ms, request_ms)
        counts = [f"{len(seen[0].hands)} hands"] + ([f"{len(seen)} sub-frames"] if len(seen) > 1 else [])
        drawn = [panel_text.milliseconds(report.get("total_ms", 0.0)) for report in reports]
        self.update_stats("JGHand", " · ".join([*counts, *drawn]))
        self.update_progress(1.0)


def _other_outputs(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> dict[str, str]:
    """Pass -> output of the engine, of what this view layer asks for besides the color."""
    wanted = {}
    if layer.use_pass_z:
        # what is blurred has to be somewhere when pictures are combined by depth
        wanted[DEPTH] = "depth_covered" if composite.is_hands_scene(scene) else "depth"
    if scene.jghand.use_pass_ids:
        wanted[IDS] = "ids"
    return wanted


def _drawn(arrays: dict[str, np.ndarray], scene: bpy.types.Scene) -> Part:
    """What of the picture has to be handed over: all of it, or, where the rest is as empty as Blender's passes are
    anyway, what covers anything."""
    height, width = arrays[COMBINED].shape[:2]
    rows, columns = view.covered(arrays[COMBINED][..., 3])
    if not scene.render.film_transparent or DEPTH in arrays or rows.start == rows.stop:
        return Part(0, 0, width, height)
    return Part(columns.start, rows.start, columns.stop, rows.stop)


def _passes(arrays: dict[str, np.ndarray], scene: bpy.types.Scene, *, linear: bool) -> Iterator[tuple[str, np.ndarray]]:
    """The passes as Blender takes them, of an evaluated scene. linear: whether colors are scene-linear already"""
    combined = arrays[COMBINED] if linear else view.scene_linear(arrays[COMBINED])
    if not scene.render.film_transparent:
        combined = view.over(combined, samples.background(scene.world))
    yield COMBINED, view.from_bottom(combined)
    if DEPTH in arrays:
        yield DEPTH, view.from_bottom(view.depth_units(arrays[DEPTH], scene.unit_settings.scale_length))
    if IDS in arrays:
        yield IDS, view.from_bottom(arrays[IDS])


CLASSES = (JGHandRenderEngine,)


@persistent
def on_frame(scene: bpy.types.Scene, *_: Any) -> None:
    """A frame is about to be rendered. In a window that is said on another thread; without one its world is measured
    and its light baked now: to do so within `render` ends Blender (run, 5.2.3)."""
    if threading.current_thread() is not threading.main_thread():
        return
    for each in (scene, composite.hands_scene_of(scene)):
        if each is None or each.render.engine != ENGINE or not scene_light.is_chosen(each):
            continue
        each.frame_set(scene.frame_current, subframe=scene.frame_subframe)  # evaluates what is keyed
        for layer in each.view_layers:
            if layer.use:
                scene_light.measure(layer.depsgraph)
                exact_light.prepare(layer.depsgraph)


def _panels() -> Iterator[set[str]]:
    """The sets in which Blender's panels say for which engines they show themselves."""
    for name in _PANELS_OF_OTHERS:
        engines = getattr(getattr(bpy.types, name, None), "COMPAT_ENGINES", None)
        if isinstance(engines, set):
            yield engines


# worlds are measured before frames, and the light of scenes follows hands that come from other files
APP_HANDLERS = (("render_pre", on_frame), ("blend_import_post", scene_light.on_import))


def register() -> None:
    for engines in _panels():
        engines.add(JGHandRenderEngine.bl_idname)


def unregister() -> None:
    for engines in _panels():
        engines.discard(JGHandRenderEngine.bl_idname)
