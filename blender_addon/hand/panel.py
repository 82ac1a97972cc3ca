# SPDX-License-Identifier: GPL-3.0-or-later
"""The first panel: how the engine is, which hands there are, and how to get one."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import ui
from ..core import panel_text
from ..core.joints import NAMES
from ..errors import JGHandFailure
from ..renderer import runtime
from ..ui import Sidebar
from ..viewport import views
from . import armature


class HandPanel(Sidebar, bpy.types.Panel):
    """Hand."""

    bl_idname = "VIEW3D_PT_jghand_hand"
    bl_label = "Hand"
    bl_order = ui.HAND

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        hands = ui.hands_of(context)
        status = runtime.link().status
        if hands or status.state == "failed":
            draw_status(layout, context)
        if not hands:
            _draw_empty(layout, context)
            return
        _draw_hands(layout, context, hands)
        _draw_problems(layout, context, status.failure)
        hand = ui.active(context)
        if hand is not None:
            _draw_active(layout, hand)
        row = layout.row(align=True)
        row.operator_menu_enum("jghand.add_hand", "handedness", text="Add Hand", icon="ADD")
        _draw_existing(layout, context)


def draw_status(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The engine in one line; when something is wrong, the sentence, what to do, and buttons that do it."""
    report = runtime.last_report(runtime.VIEWPORT)
    frame_ms = report.get("total_ms") if report is not None else None
    status = panel_text.status_text(runtime.link().status, frame_ms, iface_)
    buttons = [button for button in status.buttons if ui.has_operator(button.operator)]
    if status.good:
        row = layout.split(factor=0.87)
        ui.explained(row, panel_text.Line(status.text, tip=status.detail))
        ends = row.row()
        ends.alignment = "RIGHT"
        for button in buttons:
            icon = "PLAY" if button.operator.endswith("start_engine") else "QUIT"
            ends.operator(button.operator, text="", icon=icon, emboss=False)
        return
    box = layout.box().column()
    ui.paragraph(box, context, status.text, icon="ERROR")
    if status.remedy:
        ui.paragraph(box, context, status.remedy, icon="BLANK1")
    if status.since or status.detail:
        ui.explained(box, panel_text.Line(status.since or iface_("Details"), tip=status.detail), icon="INFO")
    row = box.row(align=True)
    for button in buttons:
        row.operator(button.operator, text=button.label)


def _draw_empty(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """One sentence and one button."""
    ui.paragraph(layout, context, "Add a hand: an armature to pose, with a photorealistic hand on it.")
    row = layout.row()
    row.scale_y = 1.4
    row.operator_menu_enum("jghand.add_hand", "handedness", text="Add Hand", icon="VIEW_PAN")
    _draw_existing(layout, context)


def _draw_existing(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What can be made of what is selected."""
    thing = context.object
    if thing is not None and thing.type == "ARMATURE" and not armature.is_any_hand(thing):
        layout.operator("jghand.use_armature", icon="ARMATURE_DATA")
    elif len(context.view_layer.objects.selected) >= len(NAMES):
        layout.operator("jghand.use_objects", icon="EMPTY_DATA")


def _draw_hands(layout: bpy.types.UILayout, context: bpy.types.Context, hands: list[bpy.types.Object]) -> None:
    """A row per hand: select, show in the viewport, show in renders."""
    column = layout.column(align=True)
    for hand in hands:
        row = column.row(align=True)
        select = row.operator(
            "jghand.select_hand",
            text=hand.name,
            icon=_icon(hand),
            depress=hand == context.object,
            translate=False,
        )
        select.uid = hand.session_uid
        shown = hand.jghand.show_in_viewport
        row.prop(hand.jghand, "show_in_viewport", text="", icon="HIDE_OFF" if shown else "HIDE_ON", emboss=False)
        row.prop(hand, "hide_render", text="", emboss=False)


def _draw_problems(layout: bpy.types.UILayout, context: bpy.types.Context, told: JGHandFailure | None) -> None:
    """Why hands do not show, unless it is what the engine's own line tells already."""
    for name, failure in views.problems():
        if told is not None and failure.kind == told.kind:
            continue
        box = layout.box()
        sentence = iface_(failure.advice.sentence)
        ui.paragraph(box, context, f"{name}: {sentence}" if name else sentence, icon="ERROR")
        ui.paragraph(box, context, failure.advice.remedy, icon="BLANK1")
        if failure.detail not in ("", name):
            ui.explained(box, panel_text.Line(iface_("Details"), tip=failure.detail), icon="INFO")


def _draw_active(layout: bpy.types.UILayout, hand: bpy.types.Object) -> None:
    """The settings of the active hand."""
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = False
    column.prop(hand.jghand, "avatar", placeholder="Built-in")


def _icon(hand: bpy.types.Object) -> str:
    if armature.is_hand(hand):
        return "VIEW_PAN"
    return "ARMATURE_DATA" if hand.type == "ARMATURE" else "EMPTY_DATA"


CLASSES = (HandPanel,)
