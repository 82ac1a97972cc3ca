# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses of our hands, and their finger controls."""

from __future__ import annotations

import bpy

from .. import ui
from ..core.controls import FINGER_CONTROLS, HAND_CONTROL
from ..core.joints import FINGERS
from ..ui import Sidebar
from . import armature, controls, pose_library


class PosePanel(Sidebar, bpy.types.Panel):
    """Pose."""

    bl_idname = "VIEW3D_PT_jghand_pose"
    bl_label = "Pose"
    bl_order = ui.POSE

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and armature.is_hand(context.object)

    def draw(self, context: bpy.types.Context) -> None:
        chosen = context.window_manager.jghand
        library = "jghand.show_pose_shelf" if pose_library.is_used() else "jghand.make_pose_assets"
        self.layout.operator(library, icon="ASSET_MANAGER")
        row = self.layout.row(align=True)
        row.prop(chosen, "pose", text="")
        row.operator("jghand.apply_pose", text="Apply").pose = chosen.pose
        row = self.layout.row(align=True)
        row.operator("jghand.flip_pose", text="Mirror to Other Hand", icon="MOD_MIRROR")
        row.operator("jghand.reset_pose", text="", icon="LOOP_BACK")


class ControlsPanel(Sidebar, bpy.types.Panel):
    """Finger controls."""

    bl_idname = "VIEW3D_PT_jghand_controls"
    bl_label = "Finger Controls"
    bl_parent_id = PosePanel.bl_idname

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return PosePanel.poll(context)

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """The whole layer off and on, in the header."""
        if controls.has_controls(context.object):
            muted = controls.controls_are_muted(context.object)
            icon = "HIDE_ON" if muted else "HIDE_OFF"
            self.layout.operator("jghand.mute_controls", text="", icon=icon, emboss=False)

    def draw(self, context: bpy.types.Context) -> None:
        layout, hand = self.layout, context.object
        if not controls.has_controls(hand):
            layout.operator("jghand.add_controls", icon="ADD")
            return
        column = layout.column(align=True)
        column.active = not controls.controls_are_muted(hand)
        _draw_heads(column)
        _draw_control(column, hand, HAND_CONTROL, "Hand", None)
        column.separator()
        for place, (finger, name) in enumerate(zip(FINGERS, FINGER_CONTROLS, strict=True)):
            _draw_control(column, hand, name, finger.capitalize(), place)
        used = controls.joint_limits_are_used(hand)
        layout.operator("jghand.joint_limits", depress=used, icon="LOCKED" if used else "UNLOCKED")
        row = layout.row(align=True)
        row.operator("jghand.bake_controls", text="Bake", icon="ACTION")
        row.operator("jghand.remove_controls", text="Remove", icon="X")
        ui.paragraph(
            layout, context, "Rolling a bone about itself moves no joint, and so changes nothing in the picture."
        )


def _draw_heads(column: bpy.types.UILayout) -> None:
    row = column.split(factor=0.22, align=True)
    row.label(text="")
    row = row.row(align=True)
    for text in ("Curl", "Spread"):
        row.label(text=text)
    row.label(text="", icon="BLANK1")


def _draw_control(
    column: bpy.types.UILayout, hand: bpy.types.Object, name: str, label: str, finger: int | None
) -> None:
    """A control's two turns, which can be keyed here, and whether the tip is held and how much."""
    bone = hand.pose.bones[name]
    row = column.split(factor=0.22, align=True)
    row.label(text=label)
    row = row.row(align=True)
    row.prop(bone, "rotation_euler", index=0, text="")
    row.prop(bone, "rotation_euler", index=2, text="")
    if finger is None:
        row.label(text="", icon="BLANK1")
        return
    rule = controls.tip_rule(hand, finger)
    held = rule.influence > 0
    button = row.operator("jghand.hold_tip", text="", icon="PINNED" if held else "UNPINNED", depress=held)
    button.finger, button.hold = FINGERS[finger], not held
    if held:
        column.prop(rule, "influence", text="Tip IK", slider=True)


CLASSES = (PosePanel, ControlsPanel)
