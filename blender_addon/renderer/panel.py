# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's small print, closed unless somebody looks for it."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import ui
from ..render.panel_quality import draw_effects, draw_receipt, receipt_of
from ..ui import Sidebar
from . import runtime

# what the engine says of itself -> what stands before it
_FACTS = {"device": "Device", "engine_version": "Engine", "protocol": "Protocol", "pid": "Process"}
_ACTIONS = (
    ("jghand.restart_engine", "FILE_REFRESH"),
    ("jghand.show_log", "TEXT"),
)


class AdvancedPanel(Sidebar, bpy.types.Panel):
    """Advanced."""

    bl_idname = "VIEW3D_PT_jghand_advanced"
    bl_label = "Advanced"
    bl_order = ui.ADVANCED
    bl_options = ui.CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        facts = runtime.link().status.handshake or {}
        column = layout.column(align=True)
        for name, label in _FACTS.items():
            if name in facts:
                row = column.split(factor=0.4)
                row.label(text=label)
                row.label(text=str(facts[name]), translate=False)
        actions = layout.column(align=True)
        for name, icon in _ACTIONS:
            if ui.has_operator(name):
                actions.operator(name, icon=icon)
        actions.operator("jghand.open_preferences", icon="PREFERENCES")
        receipt = receipt_of(context, runtime.RENDER)
        if receipt is not None:
            layout.label(text=iface_("Last Rendered Frame"))
            draw_receipt(layout, context, receipt)
            draw_effects(layout, receipt)


CLASSES = (AdvancedPanel,)
