# SPDX-License-Identifier: GPL-3.0-or-later
"""The bones of a foreign rig, or the objects of a hand of objects: which one is which joint."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import ui
from ..core import panel_text
from ..core.joints import NAMES
from ..ui import Sidebar
from . import armature, bone_list

# rows that the list shows before it scrolls
_ROWS = 8


class JointList(bpy.types.UIList):
    """A row per joint: its name and its bone; where that is missing, a search for one."""

    bl_idname = "JGHAND_UL_joints"

    def draw_item(self, _context, layout, _data, item, _icon, _active_data, _active_property):
        """One row."""
        rig = item.id_data
        row = layout.split(factor=0.28)
        row.label(text=item.name, translate=False)
        if item.bone in rig.data.bones:
            row = row.split(factor=0.8)
            bone_map = bone_list.shown_map(rig)
            names = [source.bone for source in bone_map.sources if source is not None] if bone_map is not None else []
            row.label(text=panel_text.shortened(item.bone, names), icon="BONE_DATA", translate=False)
            end = row.row()
            end.active = False
            end.label(text="tail" if item.end == "tail" else "")
        else:
            row.alert = True
            row.prop_search(item, "bone", rig.data, "bones", text="", icon="ERROR")


class BonesPanel(Sidebar, bpy.types.Panel):
    """Bones."""

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
    bone_map = bone_list.shown_map(rig)
    if bone_map is None:
        ui.paragraph(layout, context, "This armature is not used for this hand.")
        layout.operator("jghand.use_armature", text="Find Bones", icon="VIEWZOOM").handedness = settings.map_hand
        return
    for line in panel_text.map_lines(bone_map.sources, rig.data.bones.keys(), iface_):
        ui.paragraph(layout, context, line.text, icon="CHECKMARK" if line.good else "ERROR")
    if not bone_list.is_prepared(rig):
        layout.operator("jghand.edit_bone_map", icon="GREASEPENCIL")
        return
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
        text = iface_("The objects of these joints are gone: {names}").format(names=", ".join(gone))
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


CLASSES = (JointList, BonesPanel)
