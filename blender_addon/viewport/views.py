# SPDX-License-Identifier: GPL-3.0-or-later
"""The 3D views that show hands: what each wants, what it asked the engine for, and the picture it has.

Everything is asked anew whenever Blender draws a view: no reference to Blender's data is kept between two draws, so
undo, duplicating, appending and opening files need no care. A view is known by the address of its region, which is
only ever compared. When and what is asked is decided by core/pacing.py. Source: BLENDER 5 and 7.1.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import bpy
import gpu
import numpy as np

from .. import clock, ui
from ..core import pacing
from ..core.pacing import Activity, DrawMoment, Pace, ViewSettings, Want
from ..core.panel_text import HANDS
from ..core.view import HandInSpace, Moment, Part, SceneLight, part_with, picture_of, picture_request
from ..errors import JGHandFailure
from ..hand import avatar_files, seen_hands
from ..render import ENGINE, rendering, scene_light
from ..render.camera import ViewCamera, view_camera
from ..render.samples import background
from ..renderer import runtime
from ..renderer.link import Answer
from . import drawing as gpu_picture

# how often the timer looks while a request is open, and at the least while its answer is due
OPEN_TICK_S, SHORTEST_TICK_S = 0.05, 0.005

# kinds of views: a draw handler in Solid and Material Preview, the render engine in Rendered
SOLID, RENDERED = "viewport", "rendered"
_SHADINGS = ("SOLID", "MATERIAL")
# of the engine: colors of the capture, or scene-linear ones
_OUTPUTS, _LIT_OUTPUTS = ("rgba_u8", "depth"), ("rgba_f32", "depth")


@dataclass(frozen=True)
class Place:
    """Where a picture belongs: a part of the view, how far its camera stood back, meters, and its hands by name."""

    part: Part
    room_m: float
    hands: tuple[str, ...]


@dataclass
class View:
    """One region (its address) and one kind of drawing. part: that can show the hands, None when they are out of sight
    · places: of the pictures that were asked for, by tag · came: the newest picture, not yet textures · taken: the
    newest answer that was looked at · unreadable: hands by name, and why · undrawn: why the last draw failed · drawn:
    whether it showed one · has_depth: whether Blender left the depth of the scene"""

    region: int
    kind: str
    camera: ViewCamera | None = None
    hands: list[HandInSpace] = field(default_factory=list)
    light: SceneLight | None = None
    part: Part | None = None
    settings: ViewSettings = field(default_factory=ViewSettings)
    pace: Pace = field(default_factory=Pace)
    places: dict[str, Place] = field(default_factory=dict)
    came: tuple[np.ndarray, np.ndarray] | None = None
    picture: gpu_picture.GpuPicture | None = None
    place: Place | None = None
    taken: Answer | None = None
    failure: JGHandFailure | None = None
    unreadable: list[tuple[str, JGHandFailure]] = field(default_factory=list)
    undrawn: JGHandFailure | None = None
    round_trip_s: float = 0.0
    drawn: bool = False
    has_depth: bool = True

    @property
    def slot(self) -> str:
        """The view's place at the link."""
        return f"{self.kind}:{self.region:x}"


_views: dict[tuple[int, str], View] = {}
# when Blender came to the present frame, on the clock of time.monotonic()
_step_s = 0.0
# ends when Blender's event loop comes round
turn = pacing.Turn()


def now_s() -> float:
    """The clock of everything here."""
    return time.monotonic()


def begin_step() -> None:
    """Blender came to another frame: what views wait for is counted from here."""
    global _step_s
    _step_s = now_s()


def draws(space: bpy.types.SpaceView3D, scene: bpy.types.Scene, kind: str) -> bool:
    """Whether a 3D view of a scene draws views of this kind now."""
    if kind == RENDERED:
        return space.shading.type == "RENDERED" and scene.render.engine == ENGINE
    return space.shading.type in _SHADINGS and scene.jghand.show_in_viewport


def moment_of(scene: bpy.types.Scene) -> DrawMoment:
    activity = Activity.POSING
    for window in bpy.context.window_manager.windows:
        if window.screen.is_scrubbing:
            activity = Activity.SCRUBBING
        elif window.screen.is_animation_playing:
            activity = Activity.PLAYING
    render = scene.render
    frame_s = render.fps_base / render.fps
    status = runtime.link().status
    return DrawMoment(now_s(), activity, frame_s, _step_s, status.state == "ready", bool(status.doing))


def settings_of(scene: bpy.types.Scene) -> ViewSettings:
    chosen = scene.jghand
    return ViewSettings(
        preset=chosen.viewport_preset,
        sharp_preset=chosen.render_preset if chosen.sharpen_when_still else None,
        budget_ms=chosen.viewport_budget_ms if chosen.use_viewport_budget else None,
    )


# ---- drawing ---------------------------------------------------------------------------------------------------------


def draw(context: bpy.types.Context, depsgraph: Callable[[], bpy.types.Depsgraph], kind: str) -> None:
    """Draws the hands into the view that Blender draws now, while a render has the engine those that it has.

    What Blender calls to draw must not raise: it would be said at every redraw, and what comes after it may be lost. A
    view that fails begins anew with the next redraw; the panel says why.
    """
    key = (context.region.as_pointer(), kind)
    try:
        if rendering.now():
            show_again(context, kind)
        else:
            show(context, depsgraph(), kind)
    except Exception as error:
        clock.tell_once(error)
        known = isinstance(error, JGHandFailure)
        failure = error if known else JGHandFailure("internal", f"{type(error).__name__}: {error}")
        if key in _views:
            remove(_views[key])
        _views[key] = View(*key, undrawn=failure)
        gpu_picture.renew()


def show(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph, kind: str) -> None:
    """Draws the hands into the view that Blender draws now; asks for a new picture where that is needed."""
    region = context.region
    things = seen_hands.hands_in(context.scene, context.view_layer, context.space_data, switched_on_only=kind == SOLID)
    view = _views.get((region.as_pointer(), kind))
    if not things:
        if view is not None:
            remove(view)
        return
    if view is None:
        view = _views[region.as_pointer(), kind] = View(region.as_pointer(), kind)
    view.settings, space = settings_of(context.scene), context.space_data
    # EEVEE leaves none where no overlay wants it
    view.has_depth = space.shading.type == "SOLID" or space.overlay.show_overlays
    view.camera = view_camera(region, context.region_data, context.scene.unit_settings.scale_length)
    view.hands, view.unreadable = seen_hands.read(things, depsgraph, switched_on_only=kind == SOLID)
    view.part = part_with(view.camera.whole, view.hands)
    if view.part is None:
        _rest(view)
        return
    light = scene_light.in_view(depsgraph, context.space_data, things)
    view.light = scene_light.shaded_in_view(light, view.hands, depsgraph, view.slot)
    moment = moment_of(context.scene)
    turn.draws(view.slot)
    look(view, moment, drawing=True)
    view.drawn = pacing.may_show(view.pace, moment)
    if view.drawn:
        with _by_the_driver():
            if kind == SOLID:
                gpu_picture.keep_bones_visible(things, context)
            _draw(view)
        view.undrawn = None


def show_again(context: bpy.types.Context, kind: str) -> None:
    """Draws the picture that a view has, if it is of the view's side and not yet of a pose long ago; reads nothing and
    asks for nothing."""
    view = _views.get((context.region.as_pointer(), kind))
    if view is None:
        return
    view.camera = view_camera(context.region, context.region_data, context.scene.unit_settings.scale_length)
    same_side = view.pace.shown is not None and pacing.digest(view.camera.parts) == view.pace.shown.want.camera
    view.drawn = same_side and rendering.lasts_s() <= pacing.STALE_S
    if view.drawn:
        with _by_the_driver():
            _draw(view)


@contextlib.contextmanager
def _by_the_driver() -> Iterator[None]:
    """What fails here fails for the graphics driver: JGHandFailure (no_graphics)."""
    try:
        yield
    except Exception as error:
        raise JGHandFailure("no_graphics", f"{type(error).__name__}: {error}") from error


def _rest(view: View) -> None:
    """No hand is in sight: nothing is drawn, nothing awaited, and a hand that comes back is asked for anew."""
    view.drawn = False
    if view.pace.asks:
        view.pace = pacing.forgotten(view.pace)
        runtime.link().drop(view.slot)


def _draw(view: View) -> None:
    if view.came is not None:
        gpu_picture.discard(view.picture)
        view.picture = gpu_picture.GpuPicture(*view.came)
        view.came = None
    if view.picture is None or view.place is None or view.camera is None:
        return
    whole = view.camera.whole
    view.picture.draw(
        view.place.part,
        (whole.width, whole.height),
        view.camera.clip_of_depth(view.place.room_m),
        behind_scene=view.kind == SOLID and view.has_depth,
    )


class ViewportEngine:
    """What a `bpy.types.RenderEngine` needs to show hands in Rendered shading: inherit from both.

    What `view_draw` writes is scene-linear, and the scene's view transform is applied to it: under Standard the view
    shows the renderer's numbers, under AgX it does not. Source: BLENDER 7.2 and 7.3.
    """

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Something changed in the scene. Every draw looks for itself what there is to show."""

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Draws one 3D view: the world's color, unless the film is transparent, and the hands before it."""
        scene = depsgraph.scene_eval
        if not scene.render.film_transparent:
            gpu.state.active_framebuffer_get().clear(color=(*background(scene.world), 1.0))
        draw(context, lambda: depsgraph, RENDERED)


# ---- asking ----------------------------------------------------------------------------------------------------------


def look(view: View, moment: DrawMoment, *, drawing: bool) -> None:
    """Takes what came, asks for what is needed, and while drawing waits for it as long as that is allowed."""
    take(view, moment)
    if view.camera is None or view.part is None:
        return
    view.pace, decision = pacing.step(view.pace, _want(view), moment, view.settings)
    if decision.ask is not None:
        _ask(view, decision.ask)
    if not drawing:
        return
    if decision.wait_for is not None:
        until_s = moment.now_s + decision.wait_s
        left_s = turn.left_s(until_s, now_s())  # asking took its time, too, and so did other views
        answer = runtime.link().wait(view.slot, decision.wait_for, left_s)
        if answer is None and now_s() >= until_s:
            view.pace = pacing.gave_up_waiting(view.pace)
        take(view, moment)
    if view.pace.shown is None or view.pace.shown.want != view.pace.want:
        view.pace = pacing.missed(view.pace, moment)


def read_again(
    view: View, things: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D
) -> None:
    """Reads the hands of a view that is not drawn yet, from where it looked last, and their light."""
    view.hands, view.unreadable = seen_hands.read(things, depsgraph, switched_on_only=view.kind == SOLID)
    light = scene_light.in_view(depsgraph, space, things)
    view.light = scene_light.shaded_in_view(light, view.hands, depsgraph, view.slot)
    view.part = part_with(view.camera.whole, view.hands) if view.camera is not None else None


def take(view: View, moment: DrawMoment) -> bool:
    """Takes the newest answer; True when the view has something else to show or to say."""
    answer = runtime.link().answer(view.slot)
    if answer is None or answer is view.taken:
        return False
    view.taken = answer
    view.round_trip_s = answer.round_trip_ms / 1e3
    kind = answer.failure.kind if answer.failure is not None else None
    tag = str(answer.tag)
    view.pace, accepted = pacing.answered(view.pace, tag, kind, view.round_trip_s, moment)
    before, view.failure = view.failure, answer.failure
    if accepted and answer.message is not None:
        arrays = answer.message.arrays
        colors = arrays["rgba_f32"] if "rgba_f32" in arrays else arrays["rgba_u8"]
        view.came = np.asarray(colors.view()), np.asarray(arrays["depth"].view())
        view.place = view.places.get(tag)
        names = view.place.hands if view.place is not None else ()
        for report in answer.message.header.get("reports", [])[:1]:
            runtime.reports[runtime.VIEWPORT] = {**report, HANDS: names}
    return accepted or view.failure is not before


def _want(view: View) -> Want:
    assert view.camera is not None  # `look` has checked it
    assert view.part is not None
    parts: list[bytes | str] = [repr(view.settings), "" if view.light is None else view.light.key]
    for hand in view.hands:
        parts += [hand.avatar, avatar_files.stamp(hand.avatar), f"{hand.handedness} {hand.forearm}", hand.pose_bytes]
    return Want(pacing.digest(parts), pacing.digest(view.camera.parts), view.part.pixels)


def _ask(view: View, ask: pacing.Ask) -> None:
    assert view.camera is not None
    assert view.part is not None
    whole, room_m = view.camera.in_front_of(view.hands)
    pinhole = picture_of(whole, view.part, ask.quality.pixels_max)
    header, arrays = picture_request(
        [Moment(pinhole, view.hands)],
        outputs=_OUTPUTS if view.light is None else _LIT_OUTPUTS,
        preset=ask.quality.preset,
        budget_ms=ask.quality.budget_ms,
        light=view.light,
    )
    kept = {each.tag for each in view.pace.asks}
    view.places = {tag: place for tag, place in view.places.items() if tag in kept}
    view.places[ask.tag] = Place(view.part, room_m, tuple(hand.name for hand in view.hands))
    runtime.link().ask(view.slot, header, arrays, ask.tag, droppable=ask.droppable)
    clock.hasten(next_look_s(view))


def is_due(view: View) -> bool:
    """Whether a view should get a better picture now, though nothing changed in Blender; or the file of an avatar
    did."""
    if view.camera is None or view.part is None:
        return False
    return pacing.due_s(view.pace, view.settings) <= now_s() or _want(view) != view.pace.want


def next_look_s(view: View) -> float:
    """In how many seconds a view should be looked at again: when a better picture is due, and while an answer is
    awaited when the last one had come by then, and less and less often afterwards; inf when nothing is to come."""
    if view.camera is None or view.part is None:
        return math.inf
    wait_s = pacing.due_s(view.pace, view.settings) - now_s()
    if pacing.is_open(view.pace):
        left_s = view.round_trip_s - (now_s() - view.pace.asks[-1].asked_s)
        wait_s = min(wait_s, abs(left_s), OPEN_TICK_S)
    return max(wait_s, SHORTEST_TICK_S)


# ---- all views -------------------------------------------------------------------------------------------------------


def all_views() -> list[View]:
    return list(_views.values())


def remove(view: View) -> None:
    """Forgets a view: it is gone, or has no hand any more."""
    _views.pop((view.region, view.kind), None)
    gpu_picture.discard(view.picture)
    runtime.link().drop(view.slot)


def clear() -> None:
    """Forgets every view, as when another file was opened: the next draw begins anew."""
    for view in all_views():
        remove(view)
    seen_hands.forget()
    scene_light.forget()


def forget_failures() -> None:
    """Lets every view ask again for what failed, or for what an engine that is gone was asked for."""
    for view in all_views():
        view.pace, view.failure = pacing.forgotten(view.pace), None


def open_regions() -> Iterator[tuple[bpy.types.Window, bpy.types.Area, bpy.types.Region]]:
    for window, area in ui.areas():
        yield from ((window, area, region) for region in area.regions if region.type == "WINDOW")


# ---- what panels show ------------------------------------------------------------------------------------------------


def late_frames() -> int:
    """How many frames of this or the last playback were drawn without their picture, in the view where it was most."""
    return max((view.pace.late for view in _views.values()), default=0)


def problems() -> list[tuple[str, JGHandFailure]]:
    """Why hands, by the name of their object, or whole views ("") do not show: each only once."""
    found: dict[tuple[str, str], tuple[str, JGHandFailure]] = {}
    for view in _views.values():
        if view.undrawn is not None:
            found["", view.undrawn.kind] = ("", view.undrawn)
        for name, failure in view.unreadable:
            found[name, failure.kind] = (name, failure)
        if view.failure is not None and view.pace.failure() is not None:
            found["", view.failure.kind] = ("", view.failure)
    return list(found.values())
