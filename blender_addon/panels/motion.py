# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion files."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..bridge import armature, job_watch
from ..bridge.classes import register_classes, unregister_classes
from . import common
from .common import Sidebar
from .output import draw_job


class MotionPanel(Sidebar, bpy.types.Panel):
    """Motion."""

    bl_idname = "VIEW3D_PT_jghand_motion"
    bl_label = "Motion"
    bl_order = common.MOTION
    bl_options = common.CLOSED
    help_section = "motion"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return common.any_hand(context)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        draw_job(layout, context, job_watch.IMPORT)
        layout.operator("jghand.import_motion", icon="IMPORT")
        layout.operator("jghand.track_video", icon="FILE_MOVIE")
        common.paragraph(layout, context, "Or drop an .npz, .json, .csv or .bvh motion into the viewport.")
        hand = context.object
        action = hand.animation_data.action if hand is not None and hand.animation_data else None
        if action is not None and armature.is_any_hand(hand):
            first, last = action.frame_range
            text = iface_("{name}: frames {first} to {last}")
            common.paragraph(
                layout, context, text.format(name=action.name, first=round(first), last=round(last)), icon="ACTION"
            )


def register() -> None:
    """Adds the panel."""
    register_classes((MotionPanel,))


def unregister() -> None:
    """Takes it away."""
    unregister_classes((MotionPanel,))
