# SPDX-License-Identifier: GPL-3.0-or-later
"""What the interface is made of: the tab's panels and their pieces, messages at the pointer, icons, redrawing, undo."""

from __future__ import annotations

import sys
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, TypeVar

import blf
import bpy
import bpy.utils.previews

from . import clock
from .core import panel_text
from .core.panel_text import Line
from .hand import armature, seen_hands

# the order of the tab; room is left between them
HAND, BONES, POSE, RENDER, MOTION, BAKE, EXPORT, TRAIN = range(0, 80, 10)
CLOSED = {"DEFAULT_CLOSED"}
# Blender's own, which labels have
_FONT = 0
# pixels, at the interface's scale of one, that a panel keeps free at its sides, and that an icon takes
_MARGIN_PX, _ICON_PX = 76, 20
# letters of a line of a menu that says something: the window of a picture is often small
POPUP_LETTERS = 48
# a sidebar without a window
_WIDTH_PX = 240


_Found = TypeVar("_Found")
_Key = tuple[Callable[..., Any], int, tuple[Hashable, ...]]
# What was looked up on a timer, for panels are drawn at every frame of playback, and what was asked for since: values
# alone; a look is given names and numbers, never what belongs to Blender's data.
_kept: dict[_Key, Any] = {}
_wanted: set[_Key] = set()
# how often it is looked up, while panels ask, seconds
_LOOK_S = 0.5


class Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "JGHand"


class HandSidebar(Sidebar):
    """One that shows where there is a hand."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return any_hand(context)


def active(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object where it is a hand, ours or not."""
    thing = context.object
    return thing if thing is not None and armature.is_any_hand(thing) else None


def hands_of(context: bpy.types.Context) -> list[bpy.types.Object]:
    """All hands of the view layer, by name, without those that instances show."""
    return [thing for thing in seen_hands.hands_of(context.scene, context.view_layer) if armature.is_any_hand(thing)]


def any_hand(context: bpy.types.Context) -> bool:
    """Whether there is a hand, or an instance of one: else the tab shows nothing but how to add one."""
    return active(context) is not None or bool(seen_hands.hands_of(context.scene, context.view_layer))


def settings(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """The column that properties stand in, with their names at the left."""
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = False
    return column


def paragraph(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, *, icon: str = "NONE") -> None:
    column = layout.column(align=True)
    column.scale_y = 0.8
    scale = context.preferences.system.ui_scale
    width = context.region.width if context.region is not None and context.region.width > 1 else _WIDTH_PX * scale
    room = width - (_MARGIN_PX + (_ICON_PX if icon != "NONE" else 0)) * scale
    blf.size(_FONT, context.preferences.ui_styles[0].widget.points * scale)
    for line in panel_text.wrapped(text, room, lambda line: blf.dimensions(_FONT, line)[0]):
        column.label(text=line, icon=icon, translate=False)
        icon = "BLANK1" if icon != "NONE" else icon


def popup_text(text: str) -> str:
    """What a report is to say, in lines that a pop-up does not cut where its window ends; the status bar puts them one
    after another. Without a window as it is."""
    return text if bpy.app.background else " \n".join(panel_text.wrapped(text, POPUP_LETTERS))


def explained(layout: bpy.types.UILayout, line: Line, *, icon: str = "NONE") -> None:
    row = layout.row()
    row.alignment = "LEFT"
    if not line.tip:
        row.label(text=line.text, icon=icon, translate=False)
        return
    row.operator("jghand.explain", text=line.text, icon=icon, emboss=False, translate=False).text = line.tip


def figure(layout: bpy.types.UILayout, line: Line) -> None:
    """A line with its value at the right, as a bar of its part of the whole."""
    row = layout.split(factor=0.45)
    explained(row, line)
    if line.part > 0:
        row.progress(factor=line.part, text=line.value, translate=False)
    else:
        value = row.row()
        value.active = False
        value.label(text=line.value, translate=False)


# where panels of ours stand: the sidebar, render settings, the preferences
PANELS = ("VIEW_3D", "PROPERTIES", "PREFERENCES")


def areas(*kinds: str) -> Iterator[tuple[bpy.types.Window, bpy.types.Area]]:
    """Those of these types, in every window; without any: 3D views and their sidebars."""
    for window in bpy.context.window_manager.windows:
        yield from ((window, area) for area in window.screen.areas if area.type in (kinds or ("VIEW_3D",)))


def redraw(*kinds: str) -> None:
    for _, area in areas(*kinds):
        area.tag_redraw()


# what is shown when the timer comes to it: a sentence, its icon, its operators
later: tuple[str, str, tuple[tuple[str, str], ...]] | None = None


def show_later(text: str, *, icon: str = "INFO", operators: Iterable[tuple[str, str]] = ()) -> None:
    """`show_message` from any thread, once the main one is free; "" for nothing any more. Without a window a line on
    stderr."""
    global later
    if text and bpy.app.background:
        print(f"JGHand: {text}", file=sys.stderr, flush=True)
    else:
        later = (text, icon, tuple(operators)) if text else None


def show_what_waits() -> None:
    """Shows it; for the timer."""
    global later
    waiting, later = later, None
    if waiting is not None:
        show_message(waiting[0], icon=waiting[1], operators=waiting[2])


def show_message(text: str, *, icon: str, operators: Iterable[tuple[str, str]] = ()) -> None:
    """Shows a sentence and operators (their names and icons), where there is a window. Only on the main thread."""
    windows = bpy.context.window_manager.windows
    if bpy.app.background or not windows:
        return
    lines, buttons = panel_text.wrapped(text, POPUP_LETTERS), tuple(operators)

    def draw(menu: bpy.types.Menu, _context: bpy.types.Context) -> None:
        # not as the title, which is cut where the window ends: that of a picture is small
        column = menu.layout.column(align=True)
        for line in lines:
            column.label(text=line, translate=False)
        if buttons:
            menu.layout.separator()
        for name, its_icon in buttons:
            menu.layout.operator(name, icon=its_icon)

    with bpy.context.temp_override(window=windows[-1]):  # the newest: that of the picture, if it has one
        bpy.context.window_manager.popup_menu(draw, title="JGHand", icon=icon)


@contextmanager
def in_a_window(scene_uid: int | None = None) -> Iterator[bpy.types.Context]:
    """A context with a window, which timers have none of; one that shows the scene with this session_uid, where there
    is one. Blender without windows has its own context."""
    windows = list(bpy.context.window_manager.windows)
    if bpy.context.window is not None:
        windows.insert(0, bpy.context.window)
    fitting = [window for window in windows if scene_uid is None or window.scene.session_uid == scene_uid]
    with bpy.context.temp_override(window=fitting[0]) if fitting else nullcontext():
        yield bpy.context


@contextmanager
def one_step(message: str) -> Iterator[bpy.types.Context]:
    """The context to change things in; what was changed is one step of undo."""
    with in_a_window() as context:
        yield context
        if not bpy.app.background and bpy.ops.ed.undo_push.poll():
            bpy.ops.ed.undo_push(message=message)


# ---- what panels show of disks and of evaluated scenes ---------------------------------------------------------------


def kept(context: bpy.types.Context, look: Callable[..., _Found], *about: Hashable) -> _Found | None:
    """What `look(context, *about)` found last for this scene, None before the first time; asks for a new look. Without
    a window, where timers never fire, it looks at once."""
    if bpy.app.background:
        return look(context, *about)
    key = (look, context.scene.session_uid, about)
    _wanted.add(key)
    if not bpy.app.timers.is_registered(_look_up):
        bpy.app.timers.register(_look_up, first_interval=_LOOK_S if key in _kept else 0.0)
    return _kept.get(key)


@clock.guarded(None)
def _look_up() -> None:
    """One look at all that was asked for since the last one; what nobody asks for any more is forgotten, and what
    cannot be looked at is not known. Panels that show something new are drawn, and ask again."""
    asked = set(_wanted)
    _wanted.clear()
    before = dict(_kept)
    _kept.clear()
    for key in asked:
        look, scene_uid, about = key
        with in_a_window(scene_uid) as context:
            if context.scene.session_uid == scene_uid:
                try:
                    _kept[key] = look(context, *about)
                except Exception as error:  # the other looks go on
                    clock.tell_once(error)
    if _kept != before:
        redraw()
