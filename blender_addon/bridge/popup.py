# SPDX-License-Identifier: GPL-3.0-or-later
"""A word to the artist that no operator can say: a small menu at the pointer, with what can be done about it."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from ..core import limits, panel_text


def show(text: str, *, icon: str, operators: Iterable[tuple[str, str]] = ()) -> None:
    """Shows a sentence and operators (their names and icons), where there is a window. Only on the main thread."""
    windows = bpy.context.window_manager.windows
    if bpy.app.background or not windows:
        return
    lines, buttons = panel_text.wrapped(text, limits.POPUP_LETTERS), tuple(operators)

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
