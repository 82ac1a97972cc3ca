# SPDX-License-Identifier: GPL-3.0-or-later
"""The bone maps of a foreign armature as a list that Blender can show: 21 rows that read and write the stored map.

A row holds nothing but its joint's name; bone and end are read from the map on the object and written there, so there
is one truth, which renders without a window use too. Which hand's map the rows show is the object's `map_hand`.
"""

from __future__ import annotations

from functools import lru_cache

import bpy

from ..core import bone_maps
from ..core.bone_maps import ENDS, HEAD, BoneMap, JointSource
from ..core.joints import NAMES
from ..errors import JGHandFailure
from . import armature, sources


def prepare(rig: bpy.types.Object) -> None:
    """Makes the 21 rows; a list that is whole stays."""
    rows = rig.jghand.joints
    if [row.name for row in rows] != list(NAMES):
        rows.clear()
        for name in NAMES:
            rows.add().name = name


def is_prepared(rig: bpy.types.Object) -> bool:
    """Whether the rows are there."""
    return len(rig.jghand.joints) == len(NAMES)


def shown_map(rig: bpy.types.Object) -> BoneMap | None:
    """The map that the rows show; None where the object has none for that hand, or one that nobody can read."""
    text = rig.get(armature.MAP_PROPERTIES[rig.jghand.map_hand])
    return _read(str(text)) if text is not None else None


def bone_of(rig: bpy.types.Object, joint: str) -> str:
    """The bone of a joint, "" for none."""
    source = _source(rig, joint)
    return source.bone if source is not None else ""


def set_bone(rig: bpy.types.Object, joint: str, bone: str) -> None:
    """Gives a joint a bone; "" takes it away."""
    _change(rig, joint, JointSource(bone, _end(rig, joint)) if bone else None)


def end_of(rig: bpy.types.Object, joint: str) -> int:
    """Which end of the bone, as a place in `bone_maps.ENDS`."""
    return ENDS.index(_end(rig, joint))


def set_end(rig: bpy.types.Object, joint: str, place: int) -> None:
    """Takes the other end of a joint's bone; without a bone nothing happens."""
    source = _source(rig, joint)
    if source is not None:
        _change(rig, joint, JointSource(source.bone, ENDS[place]))


def _end(rig: bpy.types.Object, joint: str) -> str:
    source = _source(rig, joint)
    return source.end if source is not None else HEAD


def _source(rig: bpy.types.Object, joint: str) -> JointSource | None:
    bone_map = shown_map(rig)
    return bone_map.sources[NAMES.index(joint)] if bone_map is not None and joint in NAMES else None


def _change(rig: bpy.types.Object, joint: str, source: JointSource | None) -> None:
    bone_map = shown_map(rig) or bone_maps.by_hand(rig.jghand.map_hand, [None] * len(NAMES))
    sources.store_map(rig, bone_map.with_source(joint, source))


@lru_cache(maxsize=16)
def _read(text: str) -> BoneMap | None:
    """The rows ask for it again and again while they are drawn."""
    try:
        return bone_maps.from_json(text)
    except JGHandFailure:
        return None
