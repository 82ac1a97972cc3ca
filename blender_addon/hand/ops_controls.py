# SPDX-License-Identifier: GPL-3.0-or-later
"""Finger controls of our hands: adding, removing, baking and muting them, held tips, joint limits."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from .. import ops as common
from ..ops import UNDOABLE, InTurns, Reporting, missing, poll_bones, poll_controls
from ..properties import FINGER_ITEMS
from . import controls, poses


class AddControls(Reporting, bpy.types.Operator):
    """Operator: the control layer."""

    bl_idname = "jghand.add_controls"
    bl_label = "Add Finger Controls"
    bl_description = (
        "Add controls for curl and spread of each finger, for fist and splay, pinned tips, and joint limits. "
        "They act on top of the keys and need no script"
    )
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return poll_bones(cls, context)

    def run(self, context: bpy.types.Context) -> None:
        hands = common.chosen_hands(context)
        for hand in hands:  # all or none
            controls.check_editable(context, hand)
        for hand in hands:
            controls.add_controls(context, hand)


class RemoveControls(Reporting, bpy.types.Operator):
    """Operator: the control layer goes, the keys stay."""

    bl_idname = "jghand.remove_controls"
    bl_label = "Remove Finger Controls"
    bl_description = "Remove the controls. The hand falls back to the keys of its bones; bake instead to keep the pose"
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return poll_bones(cls, context) and poll_controls(cls, context)

    def run(self, context: bpy.types.Context) -> None:
        hands = _controlled(context)
        for hand in hands:  # all or none
            controls.check_editable(context, hand)
        for hand in hands:
            controls.remove_controls(context, hand)


class BakeControls(InTurns, bpy.types.Operator):
    """Operator: what is seen becomes keys of the bones."""

    bl_idname = "jghand.bake_controls"
    bl_label = "Bake Finger Controls"
    bl_description = (
        "Key the visible pose at every frame on the bones of the selected hands, in new actions, and remove the "
        "controls. Earlier actions stay in the file"
    )
    bl_options = UNDOABLE

    working = "Baking finger controls"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return poll_bones(cls, context) and poll_controls(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[float]:
        """A step per frame."""
        yield from controls.bake_steps(context, _controlled(context), common.seen_frames(context.scene))

    def finished(self, context: bpy.types.Context) -> None:
        frames = common.seen_frames(context.scene)
        template = rpt_("Frames {first} to {last} are keyed on the bones, in a new action.")
        self.tell(template.format(first=frames[0], last=frames[-1]))


class _Toggle(Reporting):
    """Switches something of the active hand's controls off, or on again."""

    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return poll_controls(cls, context)

    def toggle(self, hand: bpy.types.Object) -> None:
        """Switches it."""
        raise NotImplementedError

    def run(self, context: bpy.types.Context) -> None:
        self.toggle(context.object)
        context.object.update_tag()


class MuteControls(_Toggle, bpy.types.Operator):
    """Operator: the effect of the whole layer off and on."""

    bl_idname = "jghand.mute_controls"
    bl_label = "Mute Finger Controls"
    bl_description = "Switch all finger controls off or on. Off, the hand shows its keys alone"

    def toggle(self, hand: bpy.types.Object) -> None:
        controls.mute_controls(hand, not controls.controls_are_muted(hand))


class JointLimits(_Toggle, bpy.types.Operator):
    """Operator: the anatomical limits off and on."""

    bl_idname = "jghand.joint_limits"
    bl_label = "Joint Limits"
    bl_description = "Keep all joints within the range of a real hand. Pinned tips keep their limits"

    def toggle(self, hand: bpy.types.Object) -> None:
        controls.use_joint_limits(hand, not controls.joint_limits_are_used(hand))


class HoldTip(Reporting, bpy.types.Operator):
    """Operator: a fingertip stays where it is."""

    bl_idname = "jghand.hold_tip"
    bl_label = "Pin Fingertip"
    bl_description = (
        "Keep this fingertip where it is while the hand moves, and show the control that leads it; or release it. "
        "Auto Keying keys it"
    )
    bl_options = UNDOABLE

    finger: bpy.props.EnumProperty(name="Finger", description="Whose tip", items=FINGER_ITEMS)  # type: ignore[valid-type]
    hold: bpy.props.BoolProperty(name="Pin", description="Pin the tip, or release it", default=True)  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not poll_controls(cls, context):
            return False
        if controls.controls_are_muted(context.object):
            return missing(cls, "The finger controls are muted")
        return True

    def run(self, context: bpy.types.Context) -> None:
        hand = context.object
        context.view_layer.update()
        touched = controls.hold_tip(hand, self.finger, 1.0 if self.hold else 0.0)
        if common.keys_itself(context):
            poses.key(touched, context.scene.frame_current_final)
        hand.update_tag()


def _controlled(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The selected hands that have controls."""
    return [hand for hand in common.chosen_hands(context) if controls.has_controls(hand)]


CLASSES = (
    AddControls,
    RemoveControls,
    BakeControls,
    MuteControls,
    JointLimits,
    HoldTip,
)
