# SPDX-License-Identifier: GPL-3.0-or-later
"""What keeps the views up to date between two draws: Blender's handlers, in one table, and the timer.

A view asks for its picture when Blender draws it (`views`). Here is what no draw tells: an answer came, a better
picture is due, the frame changed (so that the engine works while Blender still prepares to draw), a file was opened.
While Blender renders hands nothing is done: the engine belongs to the render. Source: BLENDER 5 and 7.1.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import bpy
from bpy.app.handlers import persistent

from .. import clock, ui
from ..core import pacing
from ..hand import controls, seen_hands, stand_ins
from ..render import exact_light, handover, lamps, probe, rendering, scene_light, scene_shadows, worlds
from ..renderer import runtime
from . import drawing, views

# how often, at most, panels are drawn again for figures that change with every picture
PANEL_TICK_S = 0.5

# the draw handler
_handle: Any = None
_status: tuple[object, ...] = ()
# what the panels say of hands that do not show: names and kinds
_problems: list[tuple[str, str]] = []
_panels_drawn_s = 0.0


# ---- the timer -------------------------------------------------------------------------------------------------------


def tick() -> float:
    """Looks once; returns after how many seconds to look again."""
    views.turn.end()
    exact_light.tend()
    if rendering.check():
        if rendering.lasts_s() > pacing.STALE_S:  # what they show is of long ago
            _redraw({view.region for view in views.all_views() if view.drawn})
        return clock.IDLE_TICK_S
    ui.show_what_waits()
    _follow_status()
    _follow_problems()
    if not handover.is_blender_busy():
        stand_ins.tend()
        if scene_light.tend():
            _redraw({view.region for view in views.all_views()})
    shown = views.all_views()
    if not shown:
        return clock.IDLE_TICK_S
    return min(_look_after(shown), clock.IDLE_TICK_S)


def _look_after(shown: list[views.View]) -> float:
    """Takes what came for each view, asks for what is due; returns after how many seconds something is next."""
    regions = {region.as_pointer(): (window, area, region) for window, area, region in views.open_regions()}
    soonest_s = clock.IDLE_TICK_S
    for view in shown:
        if view.region not in regions:
            views.remove(view)
            continue
        window, area, region = regions[view.region]
        if not views.draws(area.spaces.active, window.scene, view.kind):
            views.remove(view)
            continue
        moment = views.moment_of(window.scene)
        if views.take(view, moment):
            region.tag_redraw()
            _redraw_panels(soon=False)
        elif view.drawn and not pacing.may_show(view.pace, moment):  # no newer picture came in time
            region.tag_redraw()
        if views.is_due(view):
            views.look(view, moment, drawing=False)
        soonest_s = min(soonest_s, views.next_look_s(view))
    return soonest_s


def _redraw(wanted: set[int]) -> None:
    if wanted:
        for _, _, region in views.open_regions():
            if region.as_pointer() in wanted:
                region.tag_redraw()


def _follow_status() -> None:
    """Notices when the engine starts, ends or fails: panels say so, and views may ask again."""
    global _status
    status = runtime.link().status
    now = (status.state, status.failure, status.doing)
    if now != _status:
        came_up = status.state == "ready" and _status[:1] not in (("ready",), ("slow",))
        _status = now
        if came_up:
            views.forget_failures()
        for _, _, region in views.open_regions():
            region.tag_redraw()
        _redraw_panels(soon=True)
    elif status.state in ("starting", "slow", "stopping") or status.busy:
        _redraw_panels(soon=False)
    elif status.state == "failed" and views.all_views():
        runtime.link().start(by_user=False)  # where that may help, and not at once


def _follow_problems() -> None:
    """Notices when a hand begins or ceases not to show: that may come from no click that draws a panel."""
    global _problems
    now = [(name, failure.kind) for name, failure in views.problems()]
    if now != _problems:
        _problems = now
        _redraw_panels(soon=True)


def _redraw_panels(*, soon: bool) -> None:
    """Lets the sidebars of 3D views be drawn again; figures that change all the time not too often."""
    global _panels_drawn_s
    now_s = views.now_s()
    if not soon and now_s - _panels_drawn_s < PANEL_TICK_S:
        return
    _panels_drawn_s = now_s
    for _, area, _ in views.open_regions():
        for region in area.regions:
            if region.type == "UI":
                region.tag_redraw()


# ---- Solid and Material Preview: after the scene, tested against its depth -------------------------------------------


def draw_overlay() -> None:
    """Blender calls it for every 3D view that it draws."""
    drawing.free_unwanted()  # also where nothing is drawn any more
    context = bpy.context
    if views.draws(context.space_data, context.scene, views.SOLID):
        views.draw(context, context.evaluated_depsgraph_get, views.SOLID)


def add_drawing() -> None:
    """Begins to draw; once, however often it is called."""
    global _handle
    if _handle is None:
        _handle = bpy.types.SpaceView3D.draw_handler_add(draw_overlay, (), "WINDOW", "POST_VIEW")


def remove_drawing() -> None:
    global _handle
    if _handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handle, "WINDOW")
        _handle = None


# ---- handlers --------------------------------------------------------------------------------------------------------


@persistent
def on_frame_change(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Another frame is evaluated: views that stand still ask for it before Blender draws."""
    if rendering.now() or not _on_main_thread() or depsgraph is None or depsgraph.mode != "VIEWPORT":
        return
    lamps.notice(depsgraph)
    scene_shadows.notice(depsgraph)
    worlds.notice(depsgraph)
    views.begin_step()
    resting = [view for view in views.all_views() if pacing.camera_rests(view.pace)]
    if not resting:
        return
    moment = views.moment_of(scene)
    regions = {region.as_pointer(): (window, area) for window, area, region in views.open_regions()}
    for view in resting:
        window, area = regions.get(view.region, (None, None))
        if window is None or window.scene != scene or window.view_layer.name != depsgraph.view_layer.name:
            continue
        if not views.draws(area.spaces.active, scene, view.kind):
            continue
        space, solid = area.spaces.active, view.kind == views.SOLID
        things = seen_hands.hands_in(scene, window.view_layer, space, switched_on_only=solid)
        if things:
            views.read_again(view, things, depsgraph, space)
            views.look(view, moment, drawing=False)


@persistent
def on_change(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Something was edited: whether that made or removed a hand, or changed lamps. Blender draws the views itself."""
    if not rendering.now() and _on_main_thread() and depsgraph is not None and not probe.is_own(depsgraph.scene):
        controls.notice(depsgraph)
        seen_hands.notice(depsgraph)
        stand_ins.notice(depsgraph)
        lamps.notice(depsgraph)
        scene_shadows.notice(depsgraph)
        worlds.notice(depsgraph)


@persistent
def on_undo(*_: Any) -> None:
    if _on_main_thread():
        seen_hands.forget()
        stand_ins.expect()
        exact_light.expect()
        lamps.forget()
        scene_shadows.expect()


@persistent
def on_load(*_: Any) -> None:
    """Another file: its views begin anew. The engine goes on."""
    rendering.end()
    views.clear()
    ui.show_later("")


@persistent
def on_render_begin(scene: bpy.types.Scene, *_: Any) -> None:
    """A render begins; where it draws hands, the views leave the engine to it."""
    if rendering.needs_engine(scene):
        rendering.begin()


@persistent
def on_render_end(*_: Any) -> None:
    """A render is over; the views ask for what they need when they are drawn. Edits meanwhile were not noticed."""
    rendering.end()
    seen_hands.forget()
    lamps.forget()
    scene_shadows.expect()


# what follows views, only with a window: list of bpy.app.handlers, function
HANDLERS: tuple[tuple[str, Callable[..., None]], ...] = (
    ("frame_change_post", on_frame_change),
    ("depsgraph_update_post", on_change),
    ("undo_pre", stand_ins.before_undo),
    ("redo_pre", stand_ins.before_undo),
    ("undo_post", on_undo),
    ("redo_post", on_undo),
    ("load_post", on_load),
    ("render_init", on_render_begin),
    ("render_complete", on_render_end),
    ("render_cancel", on_render_end),
)


def install() -> None:
    """Adds handlers, the timer and the draw handler; what is there already is not added twice."""
    for name, function in HANDLERS:
        functions = getattr(bpy.app.handlers, name)
        if function not in functions:
            functions.append(function)
    if not clock.runs():  # it begins with the first hand that is seen
        clock.use(tick)
    add_drawing()


def remove() -> None:
    global _status
    remove_drawing()
    clock.stop()
    for name, function in HANDLERS:
        functions = getattr(bpy.app.handlers, name)
        if function in functions:
            functions.remove(function)
    rendering.end()
    _status = ()


def register() -> None:
    """Follows Blender's views, where there are any: without a window timers never fire and nothing is drawn."""
    if not bpy.app.background:
        install()


def unregister() -> None:
    remove()
    views.clear()
    drawing.forget()


def _on_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
