# SPDX-License-Identifier: GPL-3.0-or-later
"""Where panels are, in which order, and the pieces they are drawn of."""

from __future__ import annotations

import blf
import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..bridge import armature, seen_hands
from ..core import panel_text
from ..core.panel_text import Line

# the order of the tab; room is left between them
HAND, BONES, POSE, MOTION, VIEW, RENDER, QUALITY, OUTPUT, TRAIN, ADVANCED = range(0, 100, 10)
CLOSED = {"DEFAULT_CLOSED"}
# Blender's own, which labels have
_FONT = 0
# pixels, at the interface's scale of one, that a panel keeps free at its sides, and that an icon takes
_MARGIN_PX, _ICON_PX = 76, 20
# a sidebar without a window
_WIDTH_PX = 240


class Sidebar:
    """A panel of the tab."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "JGHand"
    # section of the help page that its question mark opens
    help_section = ""

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        """A question mark at the right of the header."""
        if self.help_section:
            button = self.layout.operator("jghand.open_help", text="", icon="QUESTION", emboss=False)
            button.section = self.help_section


def active(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object where it is a hand, ours or not."""
    thing = context.object
    return thing if thing is not None and armature.is_any_hand(thing) else None


def hands_of(context: bpy.types.Context) -> list[bpy.types.Object]:
    """All hands of the view layer, by name."""
    return [thing for thing in seen_hands.hands_of(context.scene, context.view_layer) if armature.is_any_hand(thing)]


def any_hand(context: bpy.types.Context) -> bool:
    """Whether there is a hand: without one, the tab shows nothing but how to add one."""
    return active(context) is not None or bool(hands_of(context))


def has_operator(name: str) -> bool:
    """Whether an operator is registered."""
    family, _, action = name.partition(".")
    return hasattr(bpy.types, f"{family.upper()}_OT_{action}")


def paragraph(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, *, icon: str = "NONE") -> None:
    """Text that is longer than the sidebar is wide."""
    column = layout.column(align=True)
    column.scale_y = 0.8
    scale = context.preferences.system.ui_scale
    width = context.region.width if context.region is not None and context.region.width > 1 else _WIDTH_PX * scale
    room = width - (_MARGIN_PX + (_ICON_PX if icon != "NONE" else 0)) * scale
    blf.size(_FONT, context.preferences.ui_styles[0].widget.points * scale)
    for line in panel_text.wrapped(iface_(text), room, lambda line: blf.dimensions(_FONT, line)[0]):
        column.label(text=line, icon=icon, translate=False)
        icon = "BLANK1" if icon != "NONE" else icon


def explained(layout: bpy.types.UILayout, line: Line, *, icon: str = "NONE") -> None:
    """A line with its small print as tooltip."""
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
