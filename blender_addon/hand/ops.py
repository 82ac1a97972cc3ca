# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in the scene: adding one of ours, making somebody else's rig or 21 objects one, selecting and forgetting; and
the avatar that is drawn on them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from bpy_extras.io_utils import ImportHelper
from mathutils import Vector

from .. import folders, versions
from .. import ops as common
from ..core import bone_maps, posing
from ..core.bone_maps import BoneMap
from ..core.joints import FOREARM, HANDEDNESSES, NAMES, RIGHT
from ..core.view import BUILTIN_AVATAR
from ..errors import JGHandFailure
from ..ops import REGISTERED, UNDOABLE_PLUMBING, Reporting, missing
from ..render import scene_light
from ..render.camera import add_framing_camera
from . import armature, avatar_files, controls, seen_hands, sources, stand_ins
from .properties import HANDS, hand_items
from .seen_hands import named

# det of an object's axes below which it is flat and can hide nothing that is inside of it
FLAT_DETERMINANT = 1e-12
# where a hand stands already, another one is added so far to the right: two hands wide, meters
BESIDE_M = 0.25
# how large the empty that stands for a hand of objects is drawn, meters
HOLDER_SHAPE_M = 0.02

_EITHER = (("BOTH", "Both", "Every hand that is found", "NONE", -1), *HANDS)


def _sides(handedness: str) -> tuple[str, ...]:
    """Those that one of _EITHER means."""
    return HANDEDNESSES if handedness == "BOTH" else (handedness,)


class AddHand(Reporting, bpy.types.Operator):
    bl_idname = "jghand.add_hand"
    bl_label = "Add Hand"
    bl_description = (
        "Add an armature with finger controls and a photorealistic hand on it, at the 3D cursor or beside a hand that "
        "stands there"
    )

    handedness: bpy.props.EnumProperty(name="Hand", description="Which hand", items=HANDS)
    avatar: bpy.props.EnumProperty(name="Avatar", description="Whose hand", items=hand_items)
    use_controls: bpy.props.BoolProperty(
        name="Finger Controls",
        description="Add controls for curl and spread of each finger, for pinned tips, and joint limits",
        default=True,
    )

    poll = classmethod(common.poll_scene)

    def run(self, context: bpy.types.Context) -> None:
        common.object_mode(context)
        others = [
            thing.matrix_world.translation.copy() for thing in context.view_layer.objects if armature.is_any_hand(thing)
        ]
        name = f"{self.handedness.capitalize()} Hand"
        avatar = named(self.avatar)
        own = avatar_files.card_of(avatar).joints_m
        joints = posing.rest_joints_m(self.handedness, None if own is None else np.array([own]))
        hand = armature.build_armature(context, name, joints, self.handedness)
        hand.jghand.avatar = "" if self.avatar == BUILTIN_AVATAR else self.avatar
        if avatar_files.has_forearm(avatar):
            armature.add_forearm(context, hand)
        common.link_to_active_collection(context, hand)
        hand.location = context.scene.cursor.location
        apart = BESIDE_M / context.scene.unit_settings.scale_length
        for _ in others:
            if not any((other - hand.location).length < apart / 2 for other in others):
                break
            hand.location.x += apart
        # upright, its palm to the front view: so do the hands stand whose pictures an avatar's light was learned from
        hand.rotation_euler = (math.pi / 2, 0.0, 0.0)
        if self.use_controls:
            controls.add_controls(context, hand, avatar_files.fist_of(avatar))
        versions.select_bones(hand)
        common.make_active(context, hand)
        scene_light.follow(context.scene, [hand])
        stand_ins.update()
        context.view_layer.update()
        more = " and keeps lamps from it" if scene_light.is_chosen(context.scene) else ""
        around = next(_meshes_around(context, hand.location), None)
        hidden = f"It is inside {around.name}, which hides it in the viewport{more}." if around is not None else ""
        self.tell(f"Added {hand.name}.", doubts=[hidden] if hidden else [])


class AddForearmBone(Reporting, bpy.types.Operator):
    bl_idname = "jghand.add_forearm_bone"
    bl_label = "Add Forearm Bone"
    bl_description = "Add a bone from the elbow to the wrist, which then bends and twists when one of them is turned"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        hand = common.active_hand(context)
        if hand is None:
            return missing(cls, "Select a hand")
        return not armature.has_forearm_bone(hand) or missing(cls, "This hand has one already")

    def run(self, context: bpy.types.Context) -> None:
        hand = context.object
        controls.check_editable(context, hand)
        controls.own_bones(hand)
        armature.add_forearm(context, hand)
        stand_ins.update()
        self.tell(f"Added {FOREARM}.")


class UseArmature(Reporting, bpy.types.Operator):
    bl_idname = "jghand.use_armature"
    bl_label = "Use Existing Armature"
    bl_description = (
        "Draw hands on this armature: its bones are recognized by their names, of Rigify, Mixamo, VRM, MakeHuman, "
        "Unreal, Auto-Rig Pro and others. Bones, keys and constraints stay as they are"
    )

    handedness: bpy.props.EnumProperty(
        name="Hand", description="Which hands to look for", items=_EITHER, default="BOTH"
    )
    answer: bpy.props.IntProperty(
        name="Set of Bones",
        description="Which, where several sets of bones may be a hand",
        default=1,
        min=1,
        soft_max=4,
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        rig = context.object
        if rig is None or rig.type != "ARMATURE":
            return missing(cls, "Select an armature")
        if armature.is_hand(rig):
            return missing(cls, "This armature is a JGHand hand already")
        return common.poll_change(cls, context, rig)

    def run(self, context: bpy.types.Context) -> None:
        rig = context.object
        found = [sources.recognize(rig, side) for side in _sides(self.handedness)]
        maps = [one.candidates[: self.answer][-1] for one in found if one.candidates]
        doubts = [one.sentences[0] for one in found if len(one.candidates) > 1]
        if doubts:
            used = min(self.answer, max(len(one.candidates) for one in found))
            doubts.append(f"Number {used} is used: the redo panel has the others.")
        nothing = not maps
        if nothing:
            side = RIGHT if self.handedness == "BOTH" else self.handedness
            maps = [bone_maps.by_hand(side, [None] * len(NAMES))]
        for bone_map in maps:
            sources.store_map(rig, bone_map)
        sources.prepare(rig)
        rig.jghand.map_hand = maps[0].handedness
        scene_light.follow(context.scene, [rig])
        if nothing:
            self.warn("No bones of a hand were recognized: choose them in the list.")
        elif doubts or not all(bone_map.complete for bone_map in maps):
            self.warn(*doubts, *(text for bone_map in maps for text in bone_map.missing))
        else:
            known = [one for one in found if one.candidates]
            self.tell(*(text for one in known for text in (f"{one.handedness.capitalize()}:", *one.sentences)))


class UseObjects(Reporting, bpy.types.Operator):
    bl_idname = "jghand.use_objects"
    bl_label = "Use Selected Objects"
    bl_description = (
        "Draw a hand on 21 selected objects, one per joint, recognized by their names (such as right_index_finger_mcp "
        "or left_index1). An empty is added that stands for the hand"
    )

    handedness: bpy.props.EnumProperty(
        name="Hand", description="Which hands to look for", items=_EITHER, default="BOTH"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            return missing(cls, "Go to object mode first")
        count = len(context.view_layer.objects.selected)
        if count < len(NAMES):
            return missing(cls, f"Select 21 objects, one per joint: {count} are selected")
        return True

    def run(self, context: bpy.types.Context) -> None:
        things = list(context.view_layer.objects.selected)
        found = [sources.recognize_objects(things, side) for side in _sides(self.handedness)]
        maps = [one.bone_map for one in found if one.bone_map is not None and one.bone_map.complete]
        if not maps:
            near = next((one for one in found if one.candidates), found[0])
            raise JGHandFailure("bad_bone_map", " ".join(near.sentences))
        holders = [self._holder(context, bone_map, things) for bone_map in maps]
        common.make_active(context, holders[0])
        scene_light.follow(context.scene, holders)
        names = ", ".join(holder.name for holder in holders)
        self.tell(f"Added {names}: it holds the hand's settings; the objects move it.")

    def _holder(
        self, context: bpy.types.Context, bone_map: BoneMap, things: list[bpy.types.Object]
    ) -> bpy.types.Object:
        joints = sources.objects_of(bone_map, things)
        holder = bpy.data.objects.new(f"{bone_map.handedness.capitalize()} Hand (objects)", None)
        holder.empty_display_type = "SPHERE"
        holder.empty_display_size = HOLDER_SHAPE_M / context.scene.unit_settings.scale_length
        context.scene.collection.objects.link(holder)
        common.link_to_active_collection(context, holder)
        holder.location = joints[0].matrix_world.translation
        sources.store_objects(holder, joints, bone_map.handedness)
        return holder


def _poll_rig(operator: type, context: bpy.types.Context) -> bool:
    rig = context.object
    if rig is None or rig.type != "ARMATURE" or not armature.is_foreign(rig):
        return missing(operator, "Select an armature that is used as a hand")
    return common.poll_change(operator, context, rig)


class FillBoneMap(Reporting, bpy.types.Operator):
    bl_idname = "jghand.fill_bone_map"
    bl_label = "Find Bones Again"
    bl_description = "Look for this hand's bones by their names again"

    only_missing: bpy.props.BoolProperty(
        name="Only Missing",
        description="Keep the bones that were chosen and are there, and look for the others only",
        default=True,
    )

    poll = classmethod(_poll_rig)

    def run(self, context: bpy.types.Context) -> None:
        rig = context.object
        side = rig.jghand.map_hand
        found = sources.recognize(rig, side)
        before = sources.shown_map(rig)
        if not found.candidates:
            raise JGHandFailure("bad_bone_map", " ".join(found.sentences))
        known_before = set(before.sources) if before is not None else set()
        nearest = max(found.candidates, key=lambda candidate: len(known_before & set(candidate.sources)))
        chosen = before.sources if before is not None and self.only_missing else [None] * len(NAMES)
        known = rig.data.bones
        kept = [old if old is not None and old.bone in known else None for old in chosen]
        filled = [old or new for old, new in zip(kept, nearest.sources, strict=True)]
        bone_map = bone_maps.by_hand(side, filled)
        sources.store_map(rig, bone_map)
        sources.prepare(rig)
        count = sum(old is None and new is not None for old, new in zip(kept, filled, strict=True))
        self.tell(f"{count} of 21 bones found by name.", doubts=bone_map.missing)


class Forget(Reporting, bpy.types.Operator):
    bl_idname = "jghand.forget"
    bl_label = "Remove Hand Binding"
    bl_description = "Draw no hand on this object. Bones, objects and keys stay; the bone map is deleted"

    handedness: bpy.props.EnumProperty(
        name="Hand", description="Which hand is no longer drawn", items=_EITHER, default="BOTH"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        thing = context.object
        if thing is not None and armature.is_hand(thing):
            return missing(cls, "This armature was made for a hand: delete it instead")
        if thing is None or not armature.is_foreign(thing):
            return missing(cls, "Select an armature or an empty that is used as a hand")
        return common.poll_change(cls, context, thing)

    def run(self, context: bpy.types.Context) -> None:
        thing = context.object
        if self.handedness == "BOTH" or thing.type != "ARMATURE":
            sources.forget(thing)
        else:
            sources.forget_map(thing, self.handedness)
        thing.update_tag()


class SelectHand(Reporting, bpy.types.Operator):
    bl_idname = "jghand.select_hand"
    bl_label = "Select Hand"
    bl_description = "Make this hand the active object"
    bl_options = UNDOABLE_PLUMBING

    uid: bpy.props.IntProperty(name="Object", options={"SKIP_SAVE", "HIDDEN"})

    def run(self, context: bpy.types.Context) -> None:
        hand = next((thing for thing in context.view_layer.objects if thing.session_uid == self.uid), None)
        if hand is None:
            raise JGHandFailure("not_a_hand", "it is not in this view layer any more")
        posing_now = context.mode == "POSE"
        common.object_mode(context)
        if not hand.visible_get(view_layer=context.view_layer):
            raise JGHandFailure("hidden", hand.name)
        common.make_active(context, hand)
        if posing_now and hand.type == "ARMATURE":
            bpy.ops.object.mode_set(mode="POSE")


class LoadAvatar(Reporting, bpy.types.Operator):
    bl_idname = "jghand.load_avatar"
    bl_label = "Load Avatar"
    bl_description = "Choose the avatar file that is drawn on the selected hands"

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    relative_path: bpy.props.BoolProperty(
        name="Relative Path",
        description="Keep the path as seen from the opened file, so that both can be moved together",
        options={"SKIP_SAVE"},
    )
    filter_glob: bpy.props.StringProperty(default="*.jghand", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not _any_hands(context):
            return missing(cls, "Select a hand")
        if not _editable_hands(context):
            return missing(cls, "This hand is linked from another file: make it local, or an override, first")
        return True

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if not self.properties.is_property_set("relative_path"):
            self.relative_path = context.preferences.filepaths.use_relative_paths
        if self.filepath:
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def run(self, context: bpy.types.Context) -> None:
        path = Path(bpy.path.abspath(self.filepath))
        if path.is_file() and path.suffix != avatar_files.SUFFIX:
            raise JGHandFailure("bad_avatar", f"{path} does not end with {avatar_files.SUFFIX}")
        avatar_files.read_card(path)  # of a file that cannot be read the hands keep their avatar
        kept = folders.relative(str(path)) if self.relative_path and context.blend_data.filepath else self.filepath
        hands = _editable_hands(context)
        for thing in hands:
            thing.jghand.avatar = kept
            thing.update_tag()
        scene_light.follow(context.scene, hands)
        if len(hands) < len(_any_hands(context)):
            self.warn("Hands that are linked from another file keep their avatar.")


class InstallHands(Reporting, ImportHelper, bpy.types.Operator):
    bl_idname = "jghand.install_hands"
    bl_label = "Install Hands"
    bl_description = "Choose a zip of hands: they are offered by Add Hand from then on, in every file"
    bl_options = REGISTERED

    filename_ext = ".zip"
    filter_glob: bpy.props.StringProperty(default="*.zip", options={"HIDDEN"})

    def run(self, _context: bpy.types.Context) -> None:
        path = Path(bpy.path.abspath(self.filepath))
        if not path.is_file():
            raise JGHandFailure("bad_pack", str(path))
        names, broken = avatar_files.unpack(path, folders.user_folder(seen_hands.HANDS))
        doubts = [f"Damaged, and left out: {', '.join(broken)}. Get the zip again."] if broken else []
        self.tell(f"Installed hands: {', '.join(names) or '0'}.", doubts=doubts)


class DropAvatar(bpy.types.FileHandler):
    bl_idname = "JGHAND_FH_avatar"
    bl_label = "JGHand Avatar"
    bl_import_operator = LoadAvatar.bl_idname
    bl_file_extensions = ".jghand"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Onto a 3D view with a selected hand."""
        return context.area is not None and context.area.type == "VIEW_3D" and bool(_any_hands(context))


def _any_hands(context: bpy.types.Context) -> list[bpy.types.Object]:
    return common.chosen_hands(context, armature.is_any_hand)


def _editable_hands(context: bpy.types.Context) -> list[bpy.types.Object]:
    return [thing for thing in _any_hands(context) if thing.is_editable]


def add_camera(context: bpy.types.Context, hand: bpy.types.Object) -> bpy.types.Object:
    """A camera that shows where a hand is now; it becomes the scene's."""
    (seen, *_) = sources.read_hands(hand, context.evaluated_depsgraph_get())
    camera = add_framing_camera(context, "CamPalm", seen.joints_world_m[None], seen.handedness)
    camera.name = camera.data.name = "Hand Camera"
    common.link_to_active_collection(context, camera)
    context.scene.camera = camera
    return camera


def _meshes_around(context: bpy.types.Context, place: Vector) -> Iterator[bpy.types.Object]:
    """Visible solid things whose box holds a place."""
    for thing in context.view_layer.objects:
        if (
            thing.type != "MESH"
            or stand_ins.MARK in thing
            or not thing.visible_get(view_layer=context.view_layer)
            or not thing.data.polygons
        ):
            continue
        if abs(thing.matrix_world.determinant()) < FLAT_DETERMINANT:
            continue
        local = np.array(thing.matrix_world.inverted() @ place)
        corners = np.array(thing.bound_box)
        if (corners.min(0) < local).all() and (local < corners.max(0)).all():
            yield thing


CLASSES = (
    *(AddHand, AddForearmBone, UseArmature, UseObjects, FillBoneMap, Forget, SelectHand),
    *(LoadAvatar, InstallHands, DropAvatar),
)


def _add_menu(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    for side, label, *_ in HANDS:
        self.layout.operator("jghand.add_hand", text=f"JGHand {label} Hand", icon="VIEW_PAN").handedness = side


MENUS = ((bpy.types.VIEW3D_MT_armature_add, _add_menu),)
