# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of hands: the list and the active one, the bones of a foreign rig, poses and finger controls, motions."""

from __future__ import annotations

import bpy

from .. import ui
from ..core import panel_text
from ..core.controls import CURL_BACK_DEG, CURL_FULL_DEG, FINGER_CONTROLS, HAND_CONTROL, SPREAD_FULL_DEG
from ..core.joints import FINGERS, NAMES
from ..core.poses import ALL_POSES, LETTER, POSE
from ..errors import JGHandFailure
from ..render import ENGINE, scene_light
from ..renderer import runtime
from ..renderer.panel import draw_failure, draw_job, draw_status
from ..ui import Sidebar
from ..viewport import views
from . import armature, avatar_files, controls, poses, properties, sources
from .seen_hands import avatar_of

# the controls that curl and spread
CONTROLLED = (HAND_CONTROL, *FINGER_CONTROLS)
# warnings of the last image that are listed: a bent hand has a dozen, and would push the poses out of the tab
_WARNINGS = 2


# what the fields of the finger controls do
_TURNS = {
    "Curl": f"{CURL_FULL_DEG:.0f}° closes the finger, down to -{CURL_BACK_DEG:.0f}° bends it back; of the hand: a fist",
    "Spread": f"{SPREAD_FULL_DEG:.0f}° spreads a finger away from the middle finger, -{SPREAD_FULL_DEG:.0f}° moves it "
    "towards it; the middle finger goes to the thumb, and back; of the hand: all fingers",
}


class HandPanel(Sidebar, bpy.types.Panel):
    bl_idname = "VIEW3D_PT_jghand_hand"
    bl_label = "Hand"
    bl_order = ui.HAND

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        there = ui.any_hand(context)
        status = runtime.link().status
        if status.state == "failed" or (there and (status.state != "ready" or status.doing)):
            draw_status(layout, context)
        if not there:  # one sentence and one button
            ui.paragraph(layout, context, "Add a hand: an armature to pose, with a photorealistic hand on it.")
            _draw_add(layout, context, icon="VIEW_PAN", scale_y=1.4)
            _draw_existing(layout, context)
            return
        _draw_hands(layout, context, ui.hands_of(context))
        _draw_problems(layout, context, status.failure)
        hint = _shading_hint(context)
        if hint:
            ui.paragraph(layout, context, hint, icon="INFO")
        hand = ui.active(context)
        if hand is not None:
            ui.settings(layout).prop(hand.jghand, "avatar", placeholder="Built-in")
        _draw_add(layout, context, icon="ADD")
        _draw_existing(layout, context)


def _shading_hint(context: bpy.types.Context) -> str:
    """What a view shows that has no hands, or not as they are."""
    transform = context.scene.view_settings.view_transform
    shading = getattr(context.space_data, "shading", None)
    if shading is not None and shading.type == "WIREFRAME":
        return "Wireframe shows no hands: they are in Solid, Material Preview and Rendered"
    if shading is not None and shading.type == "RENDERED" and context.scene.render.engine != ENGINE:
        return 'Rendered shading shows hands after "Use JGHand Engine" only; Material Preview shows them with the scene'
    is_lit = shading is not None and shading.type == "MATERIAL" and scene_light.is_chosen(context.scene)
    if is_lit and transform != "Standard":  # Blender draws overlays after its view transform
        return f"Material Preview shows hands without the view transform {transform}; renders and Rendered have it"
    return ""


def _draw_add(layout: bpy.types.UILayout, context: bpy.types.Context, *, icon: str, scale_y: float = 1.0) -> None:
    """Add Hand below the picture of the hand that it adds, where there is more than one."""
    choice = context.window_manager.jghand
    if len(properties.hand_items()) > 1:
        layout.template_icon_view(choice, "hand", show_labels=True, scale=4.0, scale_popup=6.0)
        layout.label(text=bpy.types.UILayout.enum_item_name(choice, "hand", choice.hand), translate=False)
    row = layout.row()
    row.scale_y = scale_y
    row.operator_menu_enum("jghand.add_hand", "handedness", text="Add Hand", icon=icon).avatar = choice.hand


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
        draw_failure(layout.box(), context, failure, name)
    report = runtime.reports.get(runtime.VIEWPORT)
    warnings = panel_text.warnings(report) if report is not None else ()
    for line in panel_text.folded(warnings, _WARNINGS):
        ui.explained(layout, line, icon="ERROR")


def _icon(hand: bpy.types.Object) -> str:
    if armature.is_hand(hand):
        return "VIEW_PAN"
    return "ARMATURE_DATA" if hand.type == "ARMATURE" else "EMPTY_DATA"


class CardPanel(Sidebar, bpy.types.Panel):
    bl_idname = "VIEW3D_PT_jghand_card"
    bl_label = "Avatar Details"
    bl_parent_id = HandPanel.bl_idname
    bl_options = ui.CLOSED

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return ui.active(context) is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, hand = self.layout, context.object
        if avatar_files.has_forearm(avatar_of(hand)):
            layout.prop(hand.jghand, "forearm")
            if armature.is_hand(hand) and not armature.has_forearm_bone(hand):
                layout.operator("jghand.add_forearm_bone")
        layout.operator("jghand.load_avatar", icon="FILE_FOLDER")
        layout.operator("jghand.install_hands", icon="IMPORT")
        try:
            card = avatar_files.card_of(avatar_of(hand))
        except JGHandFailure as failure:
            draw_failure(layout, context, failure)
            return
        for name, value in card.lines():
            ui.paragraph(layout, context, f"{name}: {value}")


# rows that the list shows before it scrolls
_ROWS = 8


class JointList(bpy.types.UIList):
    """A row per joint: its name and its bone; where that is missing, a search for one."""

    bl_idname = "JGHAND_UL_joints"

    def draw_item(self, _context, layout, _data, item, _icon, _active_data, _active_property):
        rig = item.id_data
        row = layout.split(factor=0.28)
        row.label(text=item.name, translate=False)
        if item.bone in rig.data.bones:
            row = row.split(factor=0.8)
            bone_map = sources.shown_map(rig)
            names = [source.bone for source in bone_map.sources if source is not None] if bone_map is not None else []
            row.label(text=panel_text.shortened(item.bone, names), icon="BONE_DATA", translate=False)
            end = row.row()
            end.active = False
            end.label(text="tail" if item.end == "tail" else "")
        else:
            row.alert = True
            row.prop_search(item, "bone", rig.data, "bones", text="", icon="ERROR")


class BonesPanel(Sidebar, bpy.types.Panel):
    bl_idname = "VIEW3D_PT_jghand_bones"
    bl_label = "Bones"
    bl_order = ui.BONES

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        thing = ui.active(context)
        return thing is not None and armature.is_foreign(thing)

    def draw(self, context: bpy.types.Context) -> None:
        thing = context.object
        if thing.type == "ARMATURE":
            _draw_map(self.layout, context, thing)
        else:
            _draw_objects(self.layout, context, thing)


def _draw_map(layout: bpy.types.UILayout, context: bpy.types.Context, rig: bpy.types.Object) -> None:
    settings = rig.jghand
    layout.row().prop(settings, "map_hand", expand=True)
    bone_map = sources.shown_map(rig)
    if bone_map is None:
        ui.paragraph(layout, context, "This armature is not used for this hand.")
        layout.operator("jghand.use_armature", text="Find Bones", icon="VIEWZOOM").handedness = settings.map_hand
        return
    for line in panel_text.map_lines(bone_map.sources, rig.data.bones.keys()):
        ui.paragraph(layout, context, line.text, icon="CHECKMARK" if line.good else "ERROR")
    layout.template_list("JGHAND_UL_joints", "", settings, "joints", settings, "active_joint", rows=_ROWS)
    _draw_joint(layout, rig)
    row = layout.row(align=True)
    row.operator("jghand.fill_bone_map", icon="FILE_REFRESH")
    row.operator("jghand.forget", text="", icon="X").handedness = settings.map_hand


def _draw_joint(layout: bpy.types.UILayout, rig: bpy.types.Object) -> None:
    """The joint that is selected in the list."""
    settings = rig.jghand
    if not 0 <= settings.active_joint < len(settings.joints):
        return
    joint = settings.joints[settings.active_joint]
    column = layout.column(align=True)
    column.prop_search(joint, "bone", rig.data, "bones", text="", icon="BONE_DATA")
    column.row(align=True).prop(joint, "end", expand=True)


def _draw_objects(layout: bpy.types.UILayout, context: bpy.types.Context, holder: bpy.types.Object) -> None:
    gone = [name for name in NAMES if holder.get(armature.OBJECT_PROPERTIES[name]) is None]
    if gone:
        text = f"The objects of these joints are gone: {', '.join(gone)}"
        ui.paragraph(layout, context, text, icon="ERROR")
    else:
        ui.paragraph(layout, context, "All 21 joints have an object", icon="CHECKMARK")
    column = layout.column(align=True)
    column.use_property_split = True
    column.use_property_decorate = False
    for name in NAMES:
        if armature.OBJECT_PROPERTIES[name] in holder:
            column.prop(holder, f'["{armature.OBJECT_PROPERTIES[name]}"]', text=name, translate=False)
    layout.operator("jghand.forget", icon="X")


class PoseMenu(bpy.types.Menu):
    """The common poses, the letters behind them. A key that is pressed searches all of them."""

    bl_idname = "VIEW3D_MT_jghand_pose"
    bl_label = "Apply Pose"
    bl_options = {"SEARCH_ON_KEY_PRESS"}  # noqa: RUF012 - so does Blender declare them

    def draw(self, _context: bpy.types.Context) -> None:
        _draw_poses(self.layout, POSE)
        self.layout.separator()
        self.layout.menu(LetterMenu.bl_idname)


class LetterMenu(bpy.types.Menu):
    bl_idname = "VIEW3D_MT_jghand_letter"
    bl_label = "Letters of Sign Language (ASL)"

    def draw(self, _context: bpy.types.Context) -> None:
        _draw_poses(self.layout, LETTER)


def _draw_poses(layout: bpy.types.UILayout, kind: str) -> None:
    for pose in ALL_POSES:
        if pose.kind == kind:
            layout.operator("jghand.apply_pose", text=pose.label, translate=False).pose = pose.name


class PosePanel(Sidebar, bpy.types.Panel):
    bl_idname = "VIEW3D_PT_jghand_pose"
    bl_label = "Pose"
    bl_order = ui.POSE

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and armature.is_hand(context.object)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        library = "jghand.show_pose_shelf" if poses.library() else "jghand.make_pose_assets"
        layout.operator(library, icon="ASSET_MANAGER")
        row = layout.row(align=True)
        row.menu(PoseMenu.bl_idname, icon="ARMATURE_DATA")
        row.operator("jghand.flip_pose", text="Mirror", icon="MOD_MIRROR")
        row.operator("jghand.reset_pose", text="", icon="LOOP_BACK")


class ControlsPanel(Sidebar, bpy.types.Panel):
    bl_idname = "VIEW3D_PT_jghand_controls"
    bl_label = "Finger Controls"
    bl_parent_id = PosePanel.bl_idname

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
        for label, name in zip(("", "Hand", *map(str.capitalize, FINGERS)), ("", *CONTROLLED), strict=True):
            row = column.split(factor=0.25, align=True)
            row.label(text=label)
            row = row.row(align=True)
            for index, head in ((0, "Curl"), (2, "Spread")):
                if name:
                    row.prop(hand.pose.bones[name], "rotation_euler", index=index, text="")
                else:
                    ui.explained(row.column(), panel_text.Line(head, tip=_TURNS[head]))


class PinsPanel(Sidebar, bpy.types.Panel):
    """Pinned fingertips and joint limits, and ways to be rid of the controls."""

    bl_idname = "VIEW3D_PT_jghand_pins"
    bl_label = "Pins and Limits"
    bl_parent_id = PosePanel.bl_idname
    bl_options = ui.CLOSED

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return PosePanel.poll(context) and controls.has_controls(context.object)

    def draw(self, context: bpy.types.Context) -> None:
        layout, hand = self.layout, context.object
        column = layout.column(align=True)
        column.active = not controls.controls_are_muted(hand)
        for place, finger in enumerate(FINGERS):
            rule = controls.tip_rule(hand, place)
            held = rule.influence > 0
            row = column.row(align=True)
            icon = "PINNED" if held else "UNPINNED"
            button = row.operator("jghand.hold_tip", text=finger.capitalize(), icon=icon, depress=held)
            button.finger, button.hold = finger, not held
            if held:
                row.prop(rule, "influence", text="Tip IK", slider=True)
        used = controls.joint_limits_are_used(hand)
        layout.operator("jghand.joint_limits", depress=used, icon="LOCKED" if used else "UNLOCKED")
        layout.operator("jghand.bake_controls", icon="ACTION")
        layout.operator("jghand.remove_controls", icon="X")


class MotionPanel(ui.HandSidebar, bpy.types.Panel):
    bl_idname = "VIEW3D_PT_jghand_motion"
    bl_label = "Import Motion"
    bl_order = ui.MOTION
    bl_options = ui.CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        draw_job(layout, context, runtime.IMPORT)
        layout.operator("jghand.import_motion", icon="IMPORT")
        layout.operator("jghand.track_video", icon="FILE_MOVIE")
        ui.paragraph(layout, context, "Or drop an .npz, .json, .csv or .bvh motion into the viewport.")
        hand = context.object
        action = hand.animation_data.action if hand is not None and hand.animation_data else None
        if action is not None and armature.is_any_hand(hand):
            first, last = action.frame_range
            text = f"{action.name}: frames {round(first)} to {round(last)}"
            ui.paragraph(layout, context, text, icon="ACTION")


CLASSES = (
    *(HandPanel, CardPanel, JointList, BonesPanel, PoseMenu, LetterMenu, PosePanel, ControlsPanel),
    *(PinsPanel, MotionPanel),
)
