# SPDX-License-Identifier: GPL-3.0-or-later
"""One armature per hand: building it, finding it, and reading its 21 joints.

A bone's **head** is the joint of the bone's name. The rest pose is an open, relaxed hand, as an animator expects: when
it is made for a motion it has that motion's median bone lengths, so that the keys are rotations and the hand can be
posed by hand afterwards without changing its size. Fingers hang unconnected on each other, because a connected bone
ignores the location keys that changing bone lengths need; their location is locked against stray grabs instead.
Source: BLENDER 6.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Vector

from .. import versions
from ..core import posing
from ..core.joints import FOREARM, HANDEDNESSES, NAMES, OTHER, PARENTS, TAILS, TIPS, WRIST
from ..core.view import HandInSpace
from ..errors import JGHandFailure

# a fingertip's joint lies at the skin, within 2 mm on the shipped avatars; its bone marks the place, as short as single
# precision still gives it a direction
TIP_BONE_M = 0.001
# where a hand is that no instance shows: at its own place
UNPLACED = np.eye(4)
# det of the normalized axes of an object: below it, its scale is (nearly) zero in some direction
SCALE_MIN = 1e-6

# a left hand in its own space is a right one with x turned round
_MIRROR = np.diag([-1.0, 1.0, 1.0])

# custom property of the armature object: which hand it is; an armature that has it is a hand
HANDEDNESS_PROPERTY = "jghand_handedness"
# custom properties of a foreign armature, one bone map per hand, and of an empty that stands for 21 objects (`sources`)
MAP_PROPERTIES = {side: f"jghand_bone_map_{side}" for side in HANDEDNESSES}
OBJECT_PROPERTIES = {name: f"jghand_joint_{name}" for name in NAMES}
# and of the mesh that throws a hand's shadow (`stand_ins`): which hand's
STAND_IN = "jghand_stand_in"


def build_armature(
    context: bpy.types.Context, name: str, joints_m: np.ndarray, handedness: str, *, forearm: bool = False
) -> bpy.types.Object:
    """A new armature in the context's scene with these (21, 3) joints at rest, meters in the object's space.

    `posing.rest_joints_m` gives joints to start from. Object transforms are identity; the scene's unit is honored.
    forearm: with a bone for it, see `add_forearm`.
    """
    matrices = posing.rest_matrices(np.asarray(joints_m), handedness)
    unit_m = context.scene.unit_settings.scale_length
    armature = bpy.data.armatures.new(name)
    armature.display_type = "STICK"  # thicker bones hide the hand that is drawn on them
    hand = bpy.data.objects.new(name, armature)
    hand[HANDEDNESS_PROPERTY] = handedness
    hand.id_properties_ui(HANDEDNESS_PROPERTY).update(description="Which hand this armature is: right or left")
    hand.show_in_front = True
    context.scene.collection.objects.link(hand)
    with edit_mode(context, hand):
        _add_bones(armature, matrices, unit_m)
    for place, bone in enumerate(armature.bones):
        bone.use_deform = place not in TIPS
    for bone_name, parent in zip(NAMES, PARENTS, strict=True):
        bone = hand.pose.bones[bone_name]
        bone.rotation_mode = "QUATERNION"
        bone.lock_location = (parent > WRIST,) * 3
    if forearm:
        add_forearm(context, hand)
    return hand


def has_forearm_bone(hand: bpy.types.Object) -> bool:
    """Whether the wrist of our armature can be posed against its forearm."""
    return FOREARM in hand.data.bones


def add_forearm(context: bpy.types.Context, hand: bpy.types.Object) -> None:
    """Gives our armature a bone from the elbow to the wrist, which hangs on it from now on: turned, the wrist bends.
    It hangs on what the wrist hung on.

    At rest, and so in every pose before, nothing moves. Raises JGHandFailure: not_a_hand.
    """
    matrix = posing.forearm_rest(rest_matrices_of(hand), handedness_of(hand))
    with edit_mode(context, hand):
        bones = hand.data.edit_bones
        bone, wrist = bones.new(FOREARM), bones[NAMES[WRIST]]
        bone.head, bone.tail = Vector(matrix[:3, 3]), wrist.head
        bone.align_roll(Vector(matrix[:3, 2]))
        bone.parent = wrist.parent
        wrist.parent, wrist.use_connect = bone, False
    hand.pose.bones[FOREARM].rotation_mode = "QUATERNION"
    hand.pose.bones[NAMES[WRIST]].lock_location = (True,) * 3


def name_in_files(thing: bpy.types.Object) -> tuple[str, str]:
    """What an object is known by: its name, and the file that it is linked from, "" for the opened one."""
    return thing.name, thing.library.filepath if thing.library is not None else ""


def called(hand: bpy.types.Object, side: str, shown_by: bpy.types.Object) -> frozenset[tuple[str, ...]]:
    """What light linking may call the hand of a side of an object: the object, the hand's stand-in, and what instances
    it, or the object itself."""
    name = name_in_files(hand)
    return frozenset([name, (*name, side), name_in_files(shown_by)])


def name_in_links(thing: bpy.types.Object) -> tuple[str, ...]:
    """The same of what a collection of light linking has: stand-ins are called by their hands, and made anew."""
    is_of_hand = STAND_IN in thing and thing.parent is not None
    return (*name_in_files(thing.parent), thing[STAND_IN]) if is_of_hand else name_in_files(thing)


def hands_at_any_frame(view_layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    """The hands of a view layer that take part in renders now or, being animated so, at another frame, by name."""
    return rendered_at_any_frame(view_layer, is_any_hand)


def rendered_at_any_frame(
    view_layer: bpy.types.ViewLayer, wanted: Callable[[bpy.types.Object], bool]
) -> list[bpy.types.Object]:
    """The same for other objects than hands."""
    things = {  # names are no keys: a linked hand may have the name of one of this file
        thing.session_uid: thing
        for collection in _rendered_collections(view_layer.layer_collection)
        for thing in collection.objects
        if wanted(thing) and (not thing.hide_render or _is_animated(thing, "hide_render"))
    }
    return sorted(things.values(), key=lambda thing: (thing.name, thing.library is not None, thing.session_uid))


def is_hand(thing: bpy.types.Object) -> bool:
    return thing.type == "ARMATURE" and HANDEDNESS_PROPERTY in thing


def is_foreign(thing: bpy.types.Object) -> bool:
    """Whether an object is a foreign armature with a bone map, or stands for 21 objects."""
    if not thing.keys():  # most objects have none, and are many
        return False
    marks = MAP_PROPERTIES.values() if thing.type == "ARMATURE" else OBJECT_PROPERTIES.values()
    return not is_hand(thing) and any(mark in thing for mark in marks)


def is_any_hand(thing: bpy.types.Object) -> bool:
    return is_hand(thing) or is_foreign(thing)


def parts_of(thing: bpy.types.Object) -> list[bpy.types.Object]:
    """What has to be evaluated for a hand: the object itself, and the objects that it stands for."""
    joints = [thing.get(mark) for mark in OBJECT_PROPERTIES.values()]
    return [thing, *(joint for joint in joints if joint is not None)]


def evaluated_object(thing: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bpy.types.Object:
    """The evaluated object. One that Blender did not evaluate would show a stale pose: JGHandFailure (hidden)."""
    evaluated = thing.evaluated_get(depsgraph)
    if not evaluated.is_evaluated:
        raise JGHandFailure("hidden", thing.name)
    return evaluated


def handedness_of(hand: bpy.types.Object) -> str:
    """ "right" or "left"; JGHandFailure (not_a_hand) for an armature that does not say."""
    handedness = hand.get(HANDEDNESS_PROPERTY)
    if handedness not in HANDEDNESSES:
        raise JGHandFailure("not_a_hand", f"{hand.name}: {HANDEDNESS_PROPERTY} is {handedness!r}")
    return handedness


def shown_handedness(hand: bpy.types.Object) -> str:
    """The side of the hand that is seen: the other one where the object is mirrored. JGHandFailure (not_a_hand)."""
    side = handedness_of(hand)
    return OTHER[side] if hand.matrix_world.to_3x3().determinant() < 0 else side


def read_hand(hand: bpy.types.Object, depsgraph: bpy.types.Depsgraph, placed: np.ndarray = UNPLACED) -> HandInSpace:
    """The 21 joints of the *evaluated* armature (constraints, drivers and IK included), in meters.

    Hand space is the object's place and rotation without its scale: M = R S by polar decomposition; scale and shear
    act on the joints, never on what is drawn. A mirrored right hand is a left one, and the other way round.
    placed: (4, 4) what M is multiplied with from the left, where an instance shows the hand.
    Raises JGHandFailure: not_a_hand, zero_scale, hidden.
    """
    evaluated, handedness = evaluated_object(hand, depsgraph), handedness_of(hand)
    world, heads = placed @ np.array(evaluated.matrix_world), _heads(evaluated)
    seen = in_hand_space(world, heads, handedness, evaluated.name, depsgraph.scene)
    return replace(seen, forearm_turn=_forearm_turn(evaluated, heads, handedness))


def heads_and_turn(hand: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[np.ndarray, np.ndarray | None]:
    """(21, 3) evaluated bone heads of our armature in its own space and unit, standard order, and `_forearm_turn`."""
    evaluated = evaluated_object(hand, depsgraph)
    heads = _heads(evaluated)
    return heads, _forearm_turn(evaluated, heads, handedness_of(hand))


def in_hand_space(
    world: np.ndarray, joints: np.ndarray, handedness: str, name: str, scene: bpy.types.Scene
) -> HandInSpace:
    """(21, 3) joints in the space and unit of the object of this name, whose (4, 4) matrix is `world`, as a hand; as
    the other one where that mirrors it. Raises JGHandFailure (zero_scale)."""
    unit_m = scene.unit_settings.scale_length
    linear = world[:3, :3]
    check_scale(linear, name)
    mirrored = np.linalg.det(linear) < 0
    handedness = OTHER[handedness] if mirrored else handedness
    rotation = posing.polar_rotation(linear @ _MIRROR if mirrored else linear)
    world_from_hand = np.eye(4)
    world_from_hand[:3, :3], world_from_hand[:3, 3] = rotation, unit_m * world[:3, 3]
    return HandInSpace(handedness, unit_m * joints @ (rotation.T @ linear).T, world_from_hand)


def at_frame(scene: bpy.types.Scene, frame: float) -> bpy.types.Depsgraph:
    """Moves the scene to a frame, whole or not, and returns what Blender evaluated there."""
    whole = int(np.floor(frame))
    scene.frame_set(whole, subframe=frame - whole)
    return bpy.context.evaluated_depsgraph_get()


def _is_animated(thing: bpy.types.Object, data_path: str) -> bool:
    drivers = thing.animation_data.drivers if thing.animation_data else ()
    return any(curve.data_path == data_path for curve in (*versions.fcurves(thing), *drivers))


def _rendered_collections(layer: bpy.types.LayerCollection) -> Iterator[bpy.types.Collection]:
    """The collections below `layer` that are neither excluded nor disabled in renders."""
    if layer.exclude or layer.collection.hide_render:
        return
    yield layer.collection
    for child in layer.children:
        yield from _rendered_collections(child)


def _heads(evaluated: bpy.types.Object) -> np.ndarray:
    """(21, 3) bone heads in the armature's space and unit, standard order, whatever other bones there are."""
    if evaluated.pose is None:
        raise JGHandFailure("not_a_hand", f"{evaluated.name} is no armature")
    bones = evaluated.pose.bones
    places = [bones.find(name) for name in NAMES]
    missing = [name for name, place in zip(NAMES, places, strict=True) if place < 0]
    if missing:
        raise JGHandFailure("not_a_hand", f"{evaluated.name} has no bone {', '.join(missing)}")
    heads = np.empty((len(bones), 3), np.float32)
    bones.foreach_get("head", heads.ravel())
    return heads[places].astype(np.float64)


def _forearm_turn(evaluated: bpy.types.Object, heads: np.ndarray, handedness: str) -> np.ndarray | None:
    """(4,) how the evaluated forearm of our armature is turned, see `posing.forearm_rotations`: without a bone of its
    own as the wrist's bone. None for a palm without a plane, which has no axes to say it in."""
    if not posing.has_palm(heads[None]).all():
        return None
    bone = FOREARM if has_forearm_bone(evaluated) else NAMES[WRIST]
    forearm = _turned_from_rest(evaluated.pose.bones[bone])
    palm = posing.palm_rotations(heads[None], rest_matrices_of(evaluated), handedness)[0]
    return posing.forearm_turns(heads[None], handedness, (forearm @ palm.T)[None])[0]


def _turned_from_rest(bone: bpy.types.PoseBone) -> np.ndarray:
    """(3, 3) rotation of a bone from its rest pose, in the armature's space, without scale."""
    linear = np.array(bone.matrix, np.float64)[:3, :3] @ np.array(bone.bone.matrix_local, np.float64)[:3, :3].T
    return posing.polar_rotation(linear)


def check_scale(linear: np.ndarray, name: str) -> None:
    """Refuses an object whose (3, 3) axes are (nearly) flat in some direction. JGHandFailure: zero_scale."""
    size = np.linalg.norm(linear, axis=0)
    if size.min() <= 0 or abs(np.linalg.det(linear / size)) < SCALE_MIN or size.min() < SCALE_MIN:
        raise JGHandFailure("zero_scale", name)


def _add_bones(armature: bpy.types.Armature, matrices: np.ndarray, unit_m: float) -> None:
    heads = matrices[:, :3, 3] / unit_m
    for place, name in enumerate(NAMES):
        bone = armature.edit_bones.new(name)
        tail = TAILS[place]
        along = matrices[place, :3, 1]
        bone.head = Vector(heads[place])
        bone.tail = Vector(heads[tail] if tail >= 0 else heads[place] + along * TIP_BONE_M / unit_m)
        bone.align_roll(Vector(matrices[place, :3, 2]))
        bone.use_connect = False
        if PARENTS[place] >= 0:
            bone.parent = armature.edit_bones[NAMES[PARENTS[place]]]


@contextlib.contextmanager
def edit_mode(context: bpy.types.Context, thing: bpy.types.Object) -> Iterator[None]:
    """Edit mode of one object; what was active before is active again afterwards, in the mode that it was in."""
    layer = context.view_layer
    before = layer.objects.active
    mode = before.mode if before is not None else "OBJECT"
    if mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    layer.objects.active = thing
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        yield
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
        layer.objects.active = before
        if mode != "OBJECT":
            bpy.ops.object.mode_set(mode=mode)


def rest_matrices_of(hand: bpy.types.Object) -> np.ndarray:
    """(21, 4, 4) rest matrices as Blender keeps them, in the armature's space and unit, standard order."""
    bones = hand.data.bones
    if any(name not in bones for name in NAMES):
        raise JGHandFailure("not_a_hand", f"{hand.name} has not all 21 bones")
    return np.array([np.array(bones[name].matrix_local) for name in NAMES], dtype=np.float64)
