# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion files."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import ui
from ..export.panel import draw_job
from ..renderer import job_watch
from ..ui import Sidebar
from . import armature


class MotionPanel(Sidebar, bpy.types.Panel):
    """Motion."""

    bl_idname = "VIEW3D_PT_jghand_motion"
    bl_label = "Motion"
    bl_order = ui.MOTION
    bl_options = ui.CLOSED

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return ui.any_hand(context)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        draw_job(layout, context, job_watch.IMPORT)
        layout.operator("jghand.import_motion", icon="IMPORT")
        layout.operator("jghand.track_video", icon="FILE_MOVIE")
        ui.paragraph(layout, context, "Or drop an .npz, .json, .csv or .bvh motion into the viewport.")
        hand = context.object
        action = hand.animation_data.action if hand is not None and hand.animation_data else None
        if action is not None and armature.is_any_hand(hand):
            first, last = action.frame_range
            text = iface_("{name}: frames {first} to {last}")
            ui.paragraph(
                layout, context, text.format(name=action.name, first=round(first), last=round(last)), icon="ACTION"
            )


CLASSES = (MotionPanel,)
