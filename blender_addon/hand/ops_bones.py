# SPDX-License-Identifier: GPL-3.0-or-later
"""The bone map of a foreign rig: showing it as a list, and filling it again from the names of the bones."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..core import bone_maps
from ..core.joints import NAMES
from ..errors import JGHandFailure
from ..ops import UNDOABLE, UNDOABLE_PLUMBING, Reporting, missing
from . import armature, sources


def _poll_rig(operator: type, context: bpy.types.Context) -> bool:
    rig = context.object
    if rig is None or rig.type != "ARMATURE" or not armature.is_foreign(rig):
        return missing(operator, "Select an armature that is used as a hand")
    if context.mode == "EDIT_ARMATURE":
        return missing(operator, "Leave edit mode first")
    if not rig.is_editable:
        return missing(operator, "This armature is linked from another file: make it local, or an override, first")
    return True


class EditBoneMap(Reporting, bpy.types.Operator):
    """Operator: the rows of a map that was stored without them."""

    bl_idname = "jghand.edit_bone_map"
    bl_label = "Edit Bone Map"
    bl_description = "Show the bone of every joint in a list"
    bl_options = UNDOABLE_PLUMBING

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll_rig(cls, context)

    def run(self, context: bpy.types.Context) -> None:
        sources.prepare(context.object)


class FillBoneMap(Reporting, bpy.types.Operator):
    """Operator: the names of the bones are looked at again."""

    bl_idname = "jghand.fill_bone_map"
    bl_label = "Find Bones Again"
    bl_description = "Look for this hand's bones by their names again"
    bl_options = UNDOABLE

    only_missing: bpy.props.BoolProperty(
        name="Only Missing",
        description="Keep the bones that were chosen and are there, and look for the others only",
        default=True,
    )  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll_rig(cls, context)

    def run(self, context: bpy.types.Context) -> None:
        rig = context.object
        side = rig.jghand.map_hand
        found = sources.recognize(rig, side)
        before = sources.shown_map(rig)
        if found.bone_map is None:
            raise JGHandFailure("bad_bone_map", " ".join(found.sentences))
        chosen = before.sources if before is not None and self.only_missing else [None] * len(NAMES)
        known = rig.data.bones
        kept = [old if old is not None and old.bone in known else None for old in chosen]
        filled = [old or new for old, new in zip(kept, found.bone_map.sources, strict=True)]
        bone_map = bone_maps.by_hand(side, filled)
        sources.store_map(rig, bone_map)
        sources.prepare(rig)
        rig.update_tag()
        count = sum(old is None and new is not None for old, new in zip(kept, filled, strict=True))
        told = rpt_("{count} of 21 bones found by name.").format(count=count)
        if bone_map.complete:
            self.tell(told)
        else:
            self.warn(told, *bone_map.missing)


CLASSES = (EditBoneMap, FillBoneMap)
