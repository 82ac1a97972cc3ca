# SPDX-License-Identifier: GPL-3.0-or-later
"""Preview Movie: a playblast that shows hands. Blender's own *Viewport Render* asks no extension when it draws.

A copy of the scene is rendered into the scene's output, as Blender renders any animation: with its progress, its Esc,
its formats. The copy shares all objects; Workbench draws it in Solid shading and the hands are combined with it by
depth. What is set for the movie is set in the copy, so whatever ends it, the scene itself never was another one.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import Any

import bpy
from bpy.app.handlers import persistent

from .. import clock, ui, versions
from ..errors import JGHandFailure
from ..hand import seen_hands, stand_ins
from ..ops import REGISTERED, Reporting, missing, seen_frames
from . import camera, composite, rendering
from .ops import has_standard, use_standard

# what draws all but the hands: Blender's Solid shading
REST_ENGINE = "BLENDER_WORKBENCH"
# a view without a camera has twice the sensor of one (Blender: CAMERA_PARAM_ZOOM_INIT_PERSP, DEFAULT_SENSOR_WIDTH), mm
_VIEW_SENSOR_MM = 72.0
# how often it is looked whether the render is over
_LOOK_S = 0.2
# Blender's errors of a render whose output cannot be written
_WRITING = re.compile(r"cannot save|cannot create|cannot open|could not open|writ(e|ing)\b|directory", re.IGNORECASE)


@dataclass
class _Movie:
    """A preview that is made. Scenes are known by their session_uid: references do not outlive the render.

    scene_uid, hands_uid: the copy, and the scene of its hands
    camera: name of a camera that was made for it, "" for none
    ended: "complete" or "cancel", as Blender said; "" before
    """

    scene_uid: int
    hands_uid: int
    camera: str
    ended: str = ""


_now: _Movie | None = None


class PreviewMovie(Reporting, bpy.types.Operator):
    bl_idname = "jghand.preview_movie"
    bl_label = "Preview Movie"
    bl_description = (
        "Render the frame range into the scene's output as a playblast with hands, which Blender's own one leaves out: "
        "from this view, or its camera, in its size, hands at viewport quality and all else in Solid "
        "shading whatever the scene's engine. No setting of the scene is changed. Esc cancels"
    )
    bl_options = REGISTERED

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if _now is not None or bpy.app.is_job_running("RENDER"):
            return missing(cls, "Blender is rendering already")
        if not seen_hands.sources_at_any_frame(context.view_layer):
            return missing(cls, "There is no hand in this scene that is rendered")
        if context.scene.camera is None and _view_of(context) is None:
            return missing(cls, "The scene has no camera")
        return True

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Beside Blender's other work, where there is a window."""
        self._is_aside = context.window is not None and not bpy.app.background
        return self.execute(context)

    def run(self, context: bpy.types.Context) -> None:
        global _now
        _now = _begin(context)
        try:
            copy = _scene(_now.scene_uid)
            assert copy is not None  # `_begin` made it
            if getattr(self, "_is_aside", False):
                _render_aside(context, copy)
                bpy.app.timers.register(_look, first_interval=_LOOK_S, persistent=True)
                return
            bpy.ops.render.render(animation=True, scene=copy.name)
        except BaseException as error:
            _end()
            if isinstance(error, RuntimeError) and _WRITING.search(str(error)):
                raise JGHandFailure("cannot_write", str(error).strip()) from error
            raise
        failed = rendering.said_of_failed_hands()
        self.tell(f"Wrote {_end()}.", doubts=[failed] if failed else [])


def _render_aside(context: bpy.types.Context, copy: bpy.types.Scene) -> None:
    """Starts Blender's render of an animation. The window that it would open shows the scene's own last image; who
    makes a preview looks at the viewport, and at Blender's progress bar."""
    view = context.preferences.view
    before, view.render_display_type = view.render_display_type, "NONE"
    try:
        bpy.ops.render.render("INVOKE_DEFAULT", animation=True, scene=copy.name)
    finally:
        view.render_display_type = before


@clock.guarded(None)
def _look() -> float | None:
    """For the timer: whether the render is over. Then what was made for it goes, and the movie is offered."""
    if bpy.app.is_job_running("RENDER"):
        return _LOOK_S
    ended = _now.ended if _now is not None else ""
    written, failed = _end(), rendering.said_of_failed_hands()
    if ended == "complete":
        text = f"Wrote the preview: {written}."
        ways = (("render.play_rendered_anim", "PLAY"),)
        ui.show_later(f"{text} {failed}".strip(), icon="ERROR" if failed else "INFO", operators=ways)
    return None


# ---- the copy --------------------------------------------------------------------------------------------------------


def _begin(context: bpy.types.Context) -> _Movie:
    """Makes the copy and the scene of its hands. JGHandFailure: no_hand, no_camera."""
    scene, layer = context.scene, context.view_layer
    copy = scene.copy()
    copy.name = f"{scene.name} Preview"
    movie = _Movie(copy.session_uid, 0, "")
    try:
        composite.forget(copy)
        copy[stand_ins.WITHOUT] = True  # Workbench would show them
        view = _view_of(context)
        if view is not None:
            movie.camera = _add_camera(copy, view).name
        _set_up(copy, scene, context)
        for each in copy.view_layers:
            each.use = each.name == layer.name
        with context.temp_override(scene=copy):  # of which new nodes count as users, one too many in Blender
            movie.hands_uid = composite.combine(copy, copy.view_layers[layer.name]).session_uid
    except BaseException:
        _remove(movie)
        raise
    return movie


def _set_up(copy: bpy.types.Scene, scene: bpy.types.Scene, context: bpy.types.Context) -> None:
    """What a playblast has: Solid shading as the view has it, the view's size, no blur, no view transform of light."""
    render, frames = copy.render, seen_frames(scene)
    copy.frame_start, copy.frame_end = frames[0], frames[-1]
    camera.set_picture_size(render, *_size(scene, context))
    render.pixel_aspect_x, render.pixel_aspect_y = scene.render.pixel_aspect_x, scene.render.pixel_aspect_y
    render.engine = REST_ENGINE
    render.use_border = render.use_motion_blur = render.use_multiview = render.use_sequencer = False
    render.use_freestyle = False
    copy.display.render_aa = "FXAA"
    space = context.space_data
    if isinstance(space, bpy.types.SpaceView3D) and space.shading.type == "SOLID":
        _copy_settings(space.shading, copy.display.shading)
    if has_standard(copy.view_settings):
        use_standard(copy.view_settings)
    copy.jghand.render_preset, copy.jghand.light = scene.jghand.viewport_preset, "CAPTURE"


def _copy_settings(source: Any, target: Any) -> None:
    """Every setting that can be written; a studio light before what depends on it."""
    for name in ("light", *(each.identifier for each in source.bl_rna.properties if not each.is_readonly)):
        setattr(target, name, getattr(source, name))


def _size(scene: bpy.types.Scene, context: bpy.types.Context) -> tuple[int, int]:
    """Width and height of the movie in pixels: of the scene's shape, no larger than the view; even, as codecs want."""
    width, height = camera.picture_size(scene.render)
    regions = [region for region in context.area.regions if region.type == "WINDOW"] if context.area else []
    region = max(regions, key=lambda each: each.width * each.height, default=None)
    scale = min(1.0, region.width / width, region.height / height) if region is not None and region.width > 1 else 1.0
    return max(2, 2 * round(width * scale / 2)), max(2, 2 * round(height * scale / 2))


def _view_of(context: bpy.types.Context) -> bpy.types.SpaceView3D | None:
    """The 3D view that the movie is seen from; None where a camera sees it."""
    space = context.space_data
    if not isinstance(space, bpy.types.SpaceView3D) or space.region_3d is None:
        return None
    return None if space.region_3d.view_perspective == "CAMERA" else space


def _add_camera(copy: bpy.types.Scene, space: bpy.types.SpaceView3D) -> bpy.types.Object:
    """A camera of the copy that sees as a 3D view does."""
    view = space.region_3d
    data = bpy.data.cameras.new("JGHand Preview")
    data.sensor_width = data.sensor_height = _VIEW_SENSOR_MM
    data.lens, data.clip_start, data.clip_end = space.lens, space.clip_start, space.clip_end
    made = bpy.data.objects.new("JGHand Preview", data)
    made.matrix_world = view.view_matrix.inverted()
    if view.view_perspective == "ORTHO":  # such a view has things behind it too
        data.type, data.ortho_scale = "ORTHO", view.view_distance * _VIEW_SENSOR_MM / space.lens
        made.matrix_world.translation += made.matrix_world.col[2].to_3d() * space.clip_end / 2
    copy.collection.objects.link(made)
    copy.timeline_markers.clear()  # which choose cameras
    copy.camera = made
    return made


# ---- the end ---------------------------------------------------------------------------------------------------------


def _end() -> str:
    """Takes away what was made for the movie; returns what was written, and where."""
    global _now
    movie, _now = _now, None
    scene = _scene(movie.scene_uid) if movie is not None else None
    if movie is None or scene is None:  # another file was opened
        return ""
    path = bpy.path.abspath(scene.render.frame_path(frame=scene.frame_start))
    images = len(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
    is_one = scene.render.is_movie_format or images == 1
    _remove(movie)
    return path if is_one else f"{images} images in {os.path.dirname(path)}"


def _remove(movie: _Movie) -> None:
    copy, hands = _scene(movie.scene_uid), _scene(movie.hands_uid)
    if copy is not None:
        versions.remove_compositor_tree(copy)
    for scene in (hands, copy):
        if scene is not None:
            bpy.data.scenes.remove(scene)
    made = bpy.data.objects.get(movie.camera)
    if made is not None:
        bpy.data.cameras.remove(made.data)  # and its object


def _scene(uid: int) -> bpy.types.Scene | None:
    return next((scene for scene in bpy.data.scenes if scene.session_uid == uid), None)


@persistent
def on_complete(scene: bpy.types.Scene, *_: Any) -> None:
    if _now is not None and scene.session_uid == _now.scene_uid:
        _now.ended = "complete"


def _draw_in_menu(menu: bpy.types.Menu, _context: bpy.types.Context) -> None:
    menu.layout.operator_context = "INVOKE_DEFAULT"
    menu.layout.operator(PreviewMovie.bl_idname, icon="RENDER_ANIMATION")


CLASSES = (PreviewMovie,)
# at its end: into the middle of a menu nothing can be put
MENUS = ((bpy.types.VIEW3D_MT_view, _draw_in_menu),)
APP_HANDLERS = (("render_complete", on_complete),)
