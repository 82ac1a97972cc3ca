# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands that are no armature of ours: a foreign rig through its bone maps, or 21 objects, one per joint.

What a hand is made of is stored on an object, so that it is saved, duplicated, appended and undone with it: on the
foreign armature one bone map per hand, as text; on an empty 21 pointers to objects, which survive renaming.
Source: BLENDER 6.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from functools import lru_cache

import bpy
import numpy as np

from ..core import bone_maps
from ..core.bone_maps import BoneMap, JointSource, Recognition
from ..core.joints import NAMES
from ..core.view import HandInSpace
from ..errors import JGHandFailure
from . import armature


def recognize(rig: bpy.types.Object, handedness: str) -> Recognition:
    """The bones of one hand in an armature, by their names."""
    return bone_maps.recognize(rig.data.bones.keys(), handedness)


def recognize_objects(objects: Sequence[bpy.types.Object], handedness: str) -> Recognition:
    """The joints of one hand among objects, by their names; `objects_of` turns its map into objects."""
    return bone_maps.recognize([thing.name for thing in objects], handedness, tails=False)


def objects_of(bone_map: BoneMap, objects: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    """The 21 objects that a map of object names means, standard order. JGHandFailure: bad_bone_map."""
    known = {thing.name: thing for thing in objects}
    return [known[source.bone] for source in whole_sources(bone_map, known)]


def store_map(rig: bpy.types.Object, bone_map: BoneMap) -> None:
    """Makes a foreign armature a hand, or two, one call each; it may still miss joints."""
    name = armature.MAP_PROPERTIES[bone_map.handedness]
    rig[name] = bone_map.as_json()
    rig.id_properties_ui(name).update(description=f"Bones of the {bone_map.handedness} hand, as JGHand reads them")
    rig.update_tag()  # what renders read is what Blender evaluated


def store_objects(holder: bpy.types.Object, objects: Sequence[bpy.types.Object], handedness: str) -> None:
    """Makes an object (an empty) stand for a hand of 21 objects, standard order."""
    for name, thing in zip(NAMES, objects, strict=True):
        holder[armature.OBJECT_PROPERTIES[name]] = thing
    holder[armature.HANDEDNESS_PROPERTY] = handedness
    holder.update_tag()


def forget(thing: bpy.types.Object) -> None:
    """Makes a foreign armature, or an empty for 21 objects, no hand any more."""
    if armature.is_foreign(thing):
        names = [*armature.MAP_PROPERTIES.values(), *armature.OBJECT_PROPERTIES.values()]
        if thing.type != "ARMATURE":
            names.append(armature.HANDEDNESS_PROPERTY)
        for name in names:
            if name in thing:
                del thing[name]
        thing.update_tag()


def forget_map(rig: bpy.types.Object, handedness: str) -> None:
    rig.pop(armature.MAP_PROPERTIES[handedness], None)
    rig.update_tag()


def stored_maps(rig: bpy.types.Object) -> list[BoneMap]:
    """The bone maps of an armature, right before left. JGHandFailure: bad_bone_map."""
    return [bone_maps.from_json(str(rig[name])) for name in armature.MAP_PROPERTIES.values() if name in rig]


def read_hands(
    thing: bpy.types.Object, depsgraph: bpy.types.Depsgraph, placed: np.ndarray = armature.UNPLACED
) -> list[HandInSpace]:
    """Every hand that an object is or stands for: our armature one, a foreign one up to two, an empty one.

    placed: (4, 4) what its place in the world is multiplied with, where an instance shows it.
    Raises JGHandFailure: not_a_hand, zero_scale, hidden, bad_bone_map.
    """
    if armature.is_hand(thing):
        return [armature.read_hand(thing, depsgraph, placed)]
    if not armature.is_foreign(thing):
        raise JGHandFailure("not_a_hand", thing.name)
    if thing.type == "ARMATURE":
        return [read_mapped(thing, bone_map, depsgraph, placed) for bone_map in stored_maps(thing)]
    objects = [thing.get(armature.OBJECT_PROPERTIES[name]) for name in NAMES]
    gone = [name for name, joint in zip(NAMES, objects, strict=True) if joint is None]
    if gone:
        raise JGHandFailure("bad_bone_map", f"{thing.name}: the objects of {', '.join(gone)} were deleted")
    return [read_objects(objects, armature.handedness_of(thing), depsgraph, placed)]


def read_mapped(
    rig: bpy.types.Object,
    bone_map: BoneMap,
    depsgraph: bpy.types.Depsgraph,
    placed: np.ndarray = armature.UNPLACED,
) -> HandInSpace:
    """The 21 joints of the *evaluated* foreign armature (constraints, drivers and IK included), in meters.

    Raises JGHandFailure: zero_scale, hidden, bad_bone_map (a joint without a bone).
    """
    evaluated = armature.evaluated_object(rig, depsgraph)
    bones = evaluated.pose.bones
    sources = whole_sources(bone_map, bones)
    ends = {}
    for end in bone_maps.ENDS:
        ends[end] = np.empty((len(bones), 3), np.float32)
        bones.foreach_get(end, ends[end].ravel())
    joints = np.array([ends[source.end][bones.find(source.bone)] for source in sources], dtype=np.float64)
    world = placed @ np.array(evaluated.matrix_world)
    return armature.in_hand_space(world, joints, bone_map.handedness, evaluated.name, depsgraph.scene)


def read_objects(
    objects: Sequence[bpy.types.Object],
    handedness: str,
    depsgraph: bpy.types.Depsgraph,
    placed: np.ndarray = armature.UNPLACED,
) -> HandInSpace:
    """The hand whose 21 joints are the origins of objects, standard order; hand space lies at the wrist, unturned.

    Only places count: a joint's own rotation and scale mean nothing; an instance's turn and mirror the hand.
    Raises JGHandFailure: hidden, zero_scale.
    """
    places = [armature.evaluated_object(thing, depsgraph).matrix_world.translation for thing in objects]
    joints = np.array(places, dtype=np.float64)
    at_wrist = np.eye(4)
    at_wrist[:3, 3] = joints[0]
    return armature.in_hand_space(placed @ at_wrist, joints - joints[0], handedness, objects[0].name, depsgraph.scene)


def whole_sources(bone_map: BoneMap, known: Container[str]) -> list[JointSource]:
    """The 21 sources; refuses a map with a joint that has no source, or whose source is not there any more."""
    empty = [name for name, source in zip(NAMES, bone_map.sources, strict=True) if source is None]
    if empty:
        raise JGHandFailure("bad_bone_map", f"no bone for {', '.join(empty)}")
    sources = [source for source in bone_map.sources if source is not None]
    gone = [source.bone for source in sources if source.bone not in known]
    if gone:
        raise JGHandFailure("bad_bone_map", f"not there any more: {', '.join(gone)}")
    return sources


def prepare(rig: bpy.types.Object) -> None:
    """Makes the 21 rows; a list that is whole stays."""
    rows = rig.jghand.joints
    if [row.name for row in rows] != list(NAMES):
        rows.clear()
        for name in NAMES:
            rows.add().name = name


def shown_map(rig: bpy.types.Object) -> BoneMap | None:
    """The map that the rows show; None where the object has none for that hand, or one that nobody can read."""
    text = rig.get(armature.MAP_PROPERTIES[rig.jghand.map_hand])
    return _read(str(text)) if text is not None else None


def source_of(rig: bpy.types.Object, joint: str) -> JointSource:
    """The bone of a joint, with the name "" for none, and its end."""
    bone_map = shown_map(rig)
    source = bone_map.sources[NAMES.index(joint)] if bone_map is not None else None
    return source or JointSource("")


def set_source(rig: bpy.types.Object, joint: str, source: JointSource | None) -> None:
    """Gives a joint a bone, or takes it away."""
    before = shown_map(rig)
    sources: list[JointSource | None] = [None] * len(NAMES) if before is None else list(before.sources)
    sources[NAMES.index(joint)] = source
    store_map(rig, bone_maps.by_hand(rig.jghand.map_hand, sources))


@lru_cache(maxsize=16)
def _read(text: str) -> BoneMap | None:
    """The rows ask for it again and again while they are drawn."""
    try:
        return bone_maps.from_json(text)
    except JGHandFailure:
        return None
