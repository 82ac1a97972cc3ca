# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses of our hands and their library; finger controls: adding, removing, baking and muting them, pins, limits."""

from __future__ import annotations

from collections.abc import Generator

import bpy

from .. import ops as common
from .. import versions
from ..core import poses
from ..core.view import SHIPPED_AVATARS
from ..ops import REGISTERED, InTurns, Reporting, missing, poll_bones, poll_controls, poll_hand, poll_hands
from . import armature, avatar_files, controls
from . import poses as hand_poses
from .controls import Touched
from .properties import FINGER_ITEMS, POSES
from .seen_hands import avatar_of


class _Posing(Reporting):
    """Poses the chosen hands one by one, and keys them where Blender keys by itself or where it is asked for."""

    use_keys: bpy.props.BoolProperty(
        name="Insert Keys",
        description="Key the fingers at this frame. Blender's Auto Keying does so in any case",
    )

    poll = classmethod(poll_hands)

    def hands(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """Which are posed: where bones of some are selected in pose mode, those hands alone."""
        chosen = common.chosen_hands(context)
        return [hand for hand in chosen if hand.mode == "POSE" and versions.selected_bones(hand)] or chosen

    def pose_one(self, context: bpy.types.Context, hand: bpy.types.Object) -> list[Touched]:
        """Poses one of them. Returns what it changed."""
        raise NotImplementedError

    def run(self, context: bpy.types.Context) -> None:
        posed, bent = False, []
        for hand in self.hands(context):
            touched = self.pose_one(context, hand)
            if touched and (self.use_keys or common.keys_itself(context)):
                hand_poses.key(touched, context.scene.frame_current_final)
                if hand.mode != "POSE":
                    versions.select_bones(hand)
            hand.update_tag()
            posed = posed or bool(touched)
            bent += hand_poses.still_acting(hand, touched)
        if not posed:
            self.warn("No finger bone is selected: nothing was posed.")
        if bent:
            names = ", ".join(dict.fromkeys(bent))
            self.warn(f"Finger controls still bend what was posed: reset or mute {names}.")


class ApplyPose(_Posing, bpy.types.Operator):
    bl_idname = "jghand.apply_pose"
    bl_label = "Apply Pose"
    bl_description = (
        "Give this pose to the fingers of the selected hands, in pose mode to the selected bones alone, where any is. "
        "Controls that move these bones alone go to neutral, pinned tips of whole fingers are released, the wrist stays"
    )

    pose: bpy.props.EnumProperty(name="Pose", description="The pose", items=POSES)
    part: bpy.props.FloatProperty(
        name="Blend",
        description="How far from the current pose to this one",
        subtype="FACTOR",
        default=1.0,
        min=0.0,
        max=1.0,
        options={"SKIP_SAVE"},
    )

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        said = next((text for name, _, text, *_ in POSES if name == properties.pose), "")
        return f"{said}.\n{cls.bl_description}" if said else cls.bl_description

    def pose_one(self, _context: bpy.types.Context, hand: bpy.types.Object) -> list[Touched]:
        rest, fist = armature.rest_matrices_of(hand), avatar_files.fist_of(avatar_of(hand))
        pose = poses.pose_on(self.pose, rest, armature.handedness_of(hand), fist)
        return hand_poses.take_pose(hand, pose, self.part, hand_poses.chosen_part(hand))


class FlipPose(_Posing, bpy.types.Operator):
    bl_idname = "jghand.flip_pose"
    bl_label = "Mirror to Other Hand"
    bl_description = (
        "Give this hand's pose, mirrored, to the other selected hands, or to the one other hand of the scene. "
        "A hand of the same side gets it as it is"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not poll_hand(cls, context):
            return False
        return bool(_others(context)) or missing(cls, "Select the hand that is to take the pose, or add one")

    def hands(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        return _others(context)

    def pose_one(self, context: bpy.types.Context, hand: bpy.types.Object) -> list[Touched]:
        return hand_poses.copy_pose(context.object, hand)

    def run(self, context: bpy.types.Context) -> None:
        super().run(context)
        self.tell(f"Posed {', '.join(hand.name for hand in self.hands(context))}.")


class ResetPose(_Posing, bpy.types.Operator):
    bl_idname = "jghand.reset_pose"
    bl_label = "Reset Pose"
    bl_description = (
        "Put the fingers and controls of the selected hands back to rest, in pose mode the selected bones alone, where "
        "any is; the wrist stays"
    )

    def pose_one(self, _context: bpy.types.Context, hand: bpy.types.Object) -> list[Touched]:
        return hand_poses.reset_pose(hand, hand_poses.chosen_part(hand))


class InstallPoseLibrary(Reporting, bpy.types.Operator):
    bl_idname = "jghand.make_pose_assets"
    bl_label = "Install Pose Library"
    bl_description = (
        "Add JGHand's hand poses to your asset libraries, so that Blender's asset shelf shows them. They fit the "
        "built-in hand; Apply Pose closes fists and pinches on any hand"
    )
    bl_options = REGISTERED

    def run(self, context: bpy.types.Context) -> None:
        name = hand_poses.use_library()
        context.preferences.is_dirty = True  # so that Blender saves it with the other preferences
        self.tell(f"The asset library {name} has the hand poses.")


class ShowPoseShelf(Reporting, bpy.types.Operator):
    bl_idname = "jghand.show_pose_shelf"
    bl_label = "Show Pose Library"
    bl_description = (
        "Go to pose mode and show the asset shelf of poses below the view: click a pose to apply it, drag to blend it. "
        "Without a selection all bones are posed"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not poll_hand(cls, context):
            return False
        return hand_poses.library() is not None or missing(cls, 'Press "Install Pose Library" first')

    def run(self, context: bpy.types.Context) -> None:
        if context.mode != "POSE":
            bpy.ops.object.mode_set(mode="POSE")
        hand_poses.show_shelf()
        if avatar_of(context.object) not in SHIPPED_AVATARS:
            self.tell('These poses fit the built-in hand: "Apply Pose" closes fists and pinches on this one.')


def _others(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The selected hands besides the active one; without any, the one other hand that can be seen."""
    source = context.object
    others = [hand for hand in common.chosen_hands(context) if hand is not source]
    if not others:
        there = [
            thing
            for thing in context.view_layer.objects
            if armature.is_hand(thing) and thing is not source and thing.visible_get(view_layer=context.view_layer)
        ]
        others = there if len(there) == 1 else []
    return [hand for hand in others if hand.is_editable]


class AddControls(Reporting, bpy.types.Operator):
    bl_idname = "jghand.add_controls"
    bl_label = "Add Finger Controls"
    bl_description = (
        "Add controls for curl and spread of each finger, for fist and splay, pinned tips, and joint limits. "
        "They act on top of the keys and need no script"
    )

    poll = classmethod(poll_bones)

    def run(self, context: bpy.types.Context) -> None:
        hands = common.chosen_hands(context)
        for hand in hands:  # all or none
            controls.check_editable(context, hand)
        for hand in hands:
            controls.add_controls(context, hand, avatar_files.fist_of(avatar_of(hand)))


class RemoveControls(Reporting, bpy.types.Operator):
    bl_idname = "jghand.remove_controls"
    bl_label = "Remove Finger Controls"
    bl_description = "Remove the controls. The hand falls back to the keys of its bones; bake instead to keep the pose"

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
    bl_idname = "jghand.bake_controls"
    bl_label = "Bake Finger Controls"
    bl_description = (
        "Key the visible pose at every frame on the bones of the selected hands, in new actions, and remove the "
        "controls. Earlier actions stay in the file"
    )

    working = "Baking finger controls"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return poll_bones(cls, context) and poll_controls(cls, context)

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        yield from controls.bake_steps(context, _controlled(context), common.seen_frames(context.scene))

    def finished(self, context: bpy.types.Context) -> None:
        frames = common.seen_frames(context.scene)
        self.tell(f"Frames {frames[0]} to {frames[-1]} are keyed on the bones, in a new action.")


class _Toggle(Reporting):
    """Switches something of the active hand's controls off, or on again."""

    poll = classmethod(poll_controls)

    def toggle(self, hand: bpy.types.Object) -> None:
        raise NotImplementedError

    def run(self, context: bpy.types.Context) -> None:
        self.toggle(context.object)
        context.object.update_tag()


class MuteControls(_Toggle, bpy.types.Operator):
    bl_idname = "jghand.mute_controls"
    bl_label = "Mute Finger Controls"
    bl_description = "Switch all finger controls off or on. Off, the hand shows its keys alone"

    def toggle(self, hand: bpy.types.Object) -> None:
        controls.mute_controls(hand, not controls.controls_are_muted(hand))


class JointLimits(_Toggle, bpy.types.Operator):
    bl_idname = "jghand.joint_limits"
    bl_label = "Joint Limits"
    bl_description = "Keep all joints within the range of a real hand. Pinned tips keep their limits"

    def toggle(self, hand: bpy.types.Object) -> None:
        controls.use_joint_limits(hand, not controls.joint_limits_are_used(hand))


class HoldTip(Reporting, bpy.types.Operator):
    bl_idname = "jghand.hold_tip"
    bl_label = "Pin Fingertip"
    bl_description = (
        "Keep this fingertip where it is while the hand moves, and show the control that leads it; or release it. "
        "Auto Keying keys it"
    )

    finger: bpy.props.EnumProperty(name="Finger", description="Whose tip", items=FINGER_ITEMS)
    hold: bpy.props.BoolProperty(name="Pin", description="Pin the tip, or release it", default=True)

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
            hand_poses.key(touched, context.scene.frame_current_final)
        hand.update_tag()


def _controlled(context: bpy.types.Context) -> list[bpy.types.Object]:
    return [hand for hand in common.chosen_hands(context) if controls.has_controls(hand)]


CLASSES = (
    *(ApplyPose, FlipPose, ResetPose, InstallPoseLibrary, ShowPoseShelf),
    *(AddControls, RemoveControls, BakeControls, MuteControls, JointLimits, HoldTip),
)
