# SPDX-License-Identifier: GPL-3.0-or-later
"""Finger controls on our armature: curl, spread, fist, splay, tips that are held in place, and joint limits.

All of it is bones and constraints in front of the 21 bones: no driver, no Python, so a file with controls needs no
permission to run scripts, and renders alike on every machine. The 21 bones keep their keys; the controls turn them
further (`AFTER` their own rotation), so a neutral control changes nothing, and taking the layer away changes no key.
Keys on the controls themselves stay in the action and work again when the controls are added again.

Evaluation order of a bone: its keys, splay and fist, the finger's own spread and curl, the joint limits; then the tip's
inverse kinematics for the whole finger, which has limits as properties of its own.
"""

from __future__ import annotations

from collections.abc import Container, Generator, Iterable, Iterator, Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Quaternion, Vector

from ..core import controls, kinematics, poses
from ..core.controls import (
    CONTROLS,
    FINGER_CONTROLS,
    HAND_CONTROL,
    LIMIT,
    OF_FINGER,
    OF_HAND,
    RULES,
    TIP,
    TIP_CONTROLS,
    JointRange,
)
from ..core.joints import FINGERS, NAMES, WRIST
from ..errors import JGHandFailure
from . import armature, motion

# turns of the solver for a tip that is held somewhere; Blender's own number, enough for three bones
IK_ITERATIONS = 500
# of bones about themselves and of hinges sideways, up to Blender's 0.99: a finger bends rather than turns so
SOLVER_STIFFNESS = 0.9
# how much farther sideways than its joint limit a hinge goes: the solver takes limits for the axes of an ellipse, on
# which a finger that is bent to its end would be straight
SOLVER_PLAY = 2.5
# length of the controls' bones, which show shapes instead, meters
CONTROL_BONE_M = 0.005
# how large the shapes of the controls are drawn, meters: radius of a ring around a finger, of a ball at a tip; half the
# width and depth of the bracelet around the palm, and its way from the wrist
FINGER_SHAPE_M, TIP_SHAPE_M, HAND_SHAPE_M = 0.014, 0.006, (0.062, 0.03, 0.05)

COLLECTION = "JGHand Controls"
# the tips' controls, hidden until one is held: they stay where they are while the fingers move
TIP_COLLECTION = "JGHand Tips"
# the constraint that keeps a control itself in its range
RANGE = "JGHand Range"
# what single precision leaves of the other axis where a control is turned in the view: 0.00013 degrees were seen, which
# is more than Blender's field hides
_ROUNDING_RAD = 1e-5
# what was changed and may be keyed: a bone or a constraint, and its property
Touched = tuple[bpy.types.bpy_struct, str]


def has_controls(hand: bpy.types.Object) -> bool:
    return hand.type == "ARMATURE" and all(name in hand.data.bones for name in CONTROLS)


def add_controls(context: bpy.types.Context, hand: bpy.types.Object, fist: kinematics.Fist) -> None:
    """Gives our armature the control layer; one that is there is made anew and keeps its values.

    Joint limits are on, no tip is held. fist: of its avatar. Raises JGHandFailure: not_a_hand, not_editable.
    """
    handedness = armature.handedness_of(hand)
    rest = armature.rest_matrices_of(hand)
    check_editable(context, hand)
    own_bones(hand)
    unit_m = context.scene.unit_settings.scale_length
    _remove_rules(hand)
    with armature.edit_mode(context, hand):
        _make_bones(hand.data, controls.control_matrices(rest, handedness), unit_m)
    _collect_bones(hand.data)
    _dress_controls(hand, rest, unit_m)
    use_fist(hand, fist)
    _make_limits(hand, controls.joint_ranges(rest, handedness))


def may_use_fist(hand: bpy.types.Object) -> bool:
    """Whether `use_fist` suits what is there: not a linked hand, nor rules of an older version, whose order differs."""
    return has_controls(hand) and bones_are_own(hand) and {*RULES} <= {rule.name for rule in rules_of(hand)}


def use_fist(hand: bpy.types.Object, of_avatar: kinematics.Fist) -> None:
    """A full curl of all fingers is the fist of an avatar; all else of the controls stays as it is."""
    handedness = armature.handedness_of(hand)
    rest = armature.rest_matrices_of(hand)
    fist = poses.pose_on("fist", rest, handedness, of_avatar)
    for finger, control in enumerate(FINGER_CONTROLS):
        spread = controls.spread_sign(finger, handedness) * np.radians(controls.SPREAD_FULL_DEG)
        leaders = ((HAND_CONTROL, controls.SPLAY_PARTS[finger] * spread, OF_HAND), (control, spread, OF_FINGER))
        first, *_ = controls.moving_bones(finger)
        for name in controls.moving_bones(finger):
            bone, turn = hand.pose.bones[name], Quaternion(fist.turns[name]).to_euler("XYZ")
            for leader, spread_to, (of_spread, of_curl, of_palm) in leaders:
                if name == first:
                    _follow(hand, bone, of_spread, leader, "Z", (0.0, 0.0, spread_to))
                _follow(hand, bone, of_curl, leader, "X", turn, goes_back=name == first)
                if name in fist.knuckles:
                    way = float(np.linalg.norm(rest[NAMES.index(name), :3, 3] - rest[WRIST, :3, 3]))
                    _follow(hand, bone, of_palm, leader, "X", way * Vector(fist.knuckles[name]), moves=True)


def remove_controls(context: bpy.types.Context, hand: bpy.types.Object) -> None:
    """Takes the control layer away. The 21 bones and every key stay. Raises JGHandFailure: not_editable.

    The hand falls back to the keys of its 21 bones; `bake_steps` keeps what is seen instead.
    """
    check_editable(context, hand)
    own_bones(hand)
    _remove_rules(hand)
    with armature.edit_mode(context, hand):
        for name in CONTROLS:
            if name in hand.data.edit_bones:
                hand.data.edit_bones.remove(hand.data.edit_bones[name])
    for name in (COLLECTION, TIP_COLLECTION):
        if name in hand.data.collections:
            hand.data.collections.remove(hand.data.collections[name])


def bake_steps(
    context: bpy.types.Context, hands: Sequence[bpy.types.Object], frames: Sequence[int]
) -> Generator[float, None, None]:
    """Keys what is seen at every frame on the 21 bones of hands, in new actions, and takes their control layers away.

    In steps, each with the part of the frames that is read; whoever stops half-way changes nothing. Raises
    JGHandFailure: not_editable, constrained (something else than the controls moves the bones), and what reading a hand
    raises; before anything is changed.
    """
    for hand in hands:
        check_editable(context, hand)
        motion.check_free(hand, but=RULES)
    scene, before = context.scene, context.scene.frame_current_final
    unit_m = scene.unit_settings.scale_length
    joints, turns = [], []
    try:
        for frame in frames:
            depsgraph = armature.at_frame(scene, frame)
            heads, turned = zip(*(armature.heads_and_turn(hand, depsgraph) for hand in hands), strict=True)
            joints.append([unit_m * each for each in heads])
            turns.append(turned)
            yield len(joints) / len(frames)
    finally:
        armature.at_frame(scene, before)
    for hand, moves, turned in zip(hands, np.stack(joints, axis=1), zip(*turns, strict=True), strict=True):
        remove_controls(context, hand)
        known = [turn for turn in turned if turn is not None]
        motion.key_motion(hand, moves, scene, frames, turns=np.array(known) if len(known) == len(frames) else None)


def mute_controls(hand: bpy.types.Object, muted: bool) -> None:
    """Switches the effect of the whole layer off or on; a motion can be keyed while it is off."""
    for rule in rules_of(hand):
        rule.mute = muted


def controls_are_muted(hand: bpy.types.Object) -> bool:
    return all(rule.mute for rule in rules_of(hand))


def joint_limits_are_used(hand: bpy.types.Object) -> bool:
    """Whether any joint has its limits, or will have them when a muted layer is on again."""
    muted = controls_are_muted(hand)
    return any(rule.name == LIMIT and rule.influence > 0 and (muted or not rule.mute) for rule in rules_of(hand))


def use_joint_limits(hand: bpy.types.Object, used: bool) -> None:
    """Switches the anatomical limits of the 15 moving bones on or off, by their influence: to mute is the whole
    layer's; tips keep them in any case."""
    muted = controls_are_muted(hand)
    for rule in rules_of(hand):
        if rule.name == LIMIT:
            rule.influence, rule.mute = float(used), muted


def hold_tip(hand: bpy.types.Object, finger: str, part: float = 1.0) -> list[Touched]:
    """Lets a finger reach for its tip control, wholly (1), partly, or not (0); the control moves to the tip first.

    Returns what it changed.
    """
    rule = tip_rule(hand, FINGERS.index(finger))
    touched: list[Touched] = [(rule, "influence")]
    if part > 0:
        put_tip_controls(hand, [finger])
        touched.append((hand.pose.bones[TIP_CONTROLS[FINGERS.index(finger)]], "location"))
    rule.influence = part
    show_held_tips(hand)
    return touched


def tip_rule(hand: bpy.types.Object, finger: int) -> bpy.types.KinematicConstraint:
    """The constraint that holds a finger's tip; its influence is what is animated. JGHandFailure (not_a_hand)."""
    bone = controls.moving_bones(finger)[-1]
    rule = hand.pose.bones[bone].constraints.get(TIP) if bone in hand.pose.bones else None
    if rule is None:
        raise JGHandFailure("not_a_hand", f"{hand.name} has no finger controls")
    return rule


def put_tip_controls(hand: bpy.types.Object, fingers: Sequence[str] = FINGERS) -> None:
    """Moves the tip controls to where the tips are now, so that holding them does not make a finger jump."""
    evaluated = armature.evaluated_object(hand, bpy.context.evaluated_depsgraph_get())
    for finger in fingers:
        name = TIP_CONTROLS[FINGERS.index(finger)]
        at_rest = hand.data.bones[name].matrix_local
        head = evaluated.pose.bones[f"{finger}4"].head
        hand.pose.bones[name].location = at_rest.inverted() @ Vector(head)


def show_held_tips(hand: bpy.types.Object) -> None:
    """Shows the tips' controls when a tip is held, and hides them when none is."""
    held = any(tip_rule(hand, finger).influence > 0 for finger in range(len(FINGERS)))
    hand.data.collections[TIP_COLLECTION].is_visible = held


def reset_controls(hand: bpy.types.Object, names: Container[str] = CONTROLS) -> list[Touched]:
    """Controls, all or those of these names, to their neutral place; the hand then shows the keys of its 21 bones.
    Returns what it changed."""
    rules = [tip_rule(hand, finger) for finger, name in enumerate(TIP_CONTROLS) if name in names]
    for rule in rules:
        rule.influence = 0.0
    show_held_tips(hand)
    bones = [(hand.pose.bones[name], controls.channel(name)) for name in CONTROLS if name in names]
    for bone, channel in bones:
        setattr(bone, channel, (0.0, 0.0, 0.0))
    return [*((rule, "influence") for rule in rules), *bones]


def bones_are_own(hand: bpy.types.Object) -> bool:
    """Whether bones and constraints of a hand can be added and removed: not those that another file has, which an
    override does not change."""
    return hand.is_editable and hand.data.is_editable and not (hand.override_library or hand.data.override_library)


def check_editable(context: bpy.types.Context, hand: bpy.types.Object) -> None:
    """Refuses what Blender cannot edit. JGHandFailure: not_a_hand, not_editable."""
    if not isinstance(hand.data, bpy.types.Armature):
        raise JGHandFailure("not_a_hand", hand.name)
    if not bones_are_own(hand) or all(hand != thing for thing in context.view_layer.objects):
        raise JGHandFailure("not_editable", hand.name)
    if not hand.visible_get(view_layer=context.view_layer):
        raise JGHandFailure("not_editable", hand.name)


def own_bones(hand: bpy.types.Object) -> None:
    """Bones that are shared with other objects become the hand's own."""
    if hand.data.users > 1:
        hand.data = hand.data.copy()


def notice(depsgraph: bpy.types.Depsgraph) -> None:
    """Something was changed in Blender: an axis of a control that rounding alone has turned is put back, so that its
    field shows 0."""
    if any(screen.is_animation_playing for screen in bpy.data.screens):
        return  # keys put it back again
    for update in depsgraph.updates:
        if not isinstance(update.id, bpy.types.Object) or not has_controls(hand := update.id.original):
            continue
        for name in (HAND_CONTROL, *FINGER_CONTROLS):
            bone = hand.pose.bones[name]
            for axis, angle in enumerate(bone.rotation_euler):
                if 0 < abs(angle) < _ROUNDING_RAD:
                    bone.rotation_euler[axis] = 0.0


def rules_of(hand: bpy.types.Object) -> Iterator[bpy.types.Constraint]:
    for name in NAMES:
        if name in hand.pose.bones:
            yield from (rule for rule in hand.pose.bones[name].constraints if rule.name in RULES)


def _remove_rules(hand: bpy.types.Object) -> None:
    for bone in hand.pose.bones:
        ours = [rule for rule in bone.constraints if rule.name in RULES and bone.name in NAMES]
        for rule in ours:
            bone.constraints.remove(rule)
        if ours:
            _set_solver_range(bone, None)


def _make_bones(data: bpy.types.Armature, matrices: dict[str, np.ndarray], unit_m: float) -> None:
    """The control bones, short ones; those of tips hang on nothing, so that a held tip stays when the hand moves."""
    for name, matrix in matrices.items():
        bone = data.edit_bones.get(name) or data.edit_bones.new(name)
        head, along = Vector(matrix[:3, 3]), Vector(matrix[:3, 1])
        bone.head, bone.tail = head, head + along * (CONTROL_BONE_M / unit_m)
        bone.align_roll(Vector(matrix[:3, 2]))
        bone.use_connect = bone.use_deform = False
        bone.parent = None if name in TIP_CONTROLS else data.edit_bones[NAMES[WRIST]]


def _collect_bones(data: bpy.types.Armature) -> None:
    """The controls in bone collections of their own, which can be hidden, in colors of their kind."""
    for name in (COLLECTION, TIP_COLLECTION):
        if name not in data.collections:
            data.collections.new(name).is_visible = name == COLLECTION
    for name in CONTROLS:
        data.collections[TIP_COLLECTION if name in TIP_CONTROLS else COLLECTION].assign(data.bones[name])
        data.bones[name].color.palette = PALETTES[_kind(name)]


def _kind(name: str) -> str:
    return "hand" if name == HAND_CONTROL else "finger" if name in FINGER_CONTROLS else "tip"


def _dress_controls(hand: bpy.types.Object, rest: np.ndarray, unit_m: float) -> None:
    """Shapes, and locks on what does nothing."""
    for name in CONTROLS:
        bone = hand.pose.bones[name]
        kind = _kind(name)
        bone.rotation_mode = "XYZ"
        bone.lock_location = (kind != "tip",) * 3
        bone.lock_rotation = (kind == "tip", True, kind == "tip")
        bone.lock_scale = (True,) * 3
        bone.custom_shape = shape(kind)
        bone.use_custom_shape_bone_size = False
        bone.custom_shape_scale_xyz = (1.0 / unit_m,) * 3
        finger = next((place for place, control in enumerate(FINGER_CONTROLS) if control == name), None)
        if finger is not None:
            along = hand.data.bones[name].matrix_local.to_3x3().inverted() @ Vector(
                rest[2 + 4 * finger, :3, 3] - rest[1 + 4 * finger, :3, 3]
            )
            bone.custom_shape_translation = along / 2
        if kind != "tip":
            _keep_in_range(bone)


def _keep_in_range(bone: bpy.types.PoseBone) -> None:
    back, full, spread = np.radians((controls.CURL_BACK_DEG, controls.CURL_FULL_DEG, controls.SPREAD_FULL_DEG))
    _limit(bone, RANGE, (-back, full), (0.0, 0.0), (-spread, spread)).use_transform_limit = True


def _make_limits(hand: bpy.types.Object, ranges: Iterable[JointRange]) -> None:
    """And the tips' inverse kinematics, the last of all."""
    for span in ranges:
        bone = hand.pose.bones[span.bone]
        _limit(bone, LIMIT, span.x, span.y, span.z)
        _set_solver_range(bone, span)
    for finger in range(len(FINGERS)):
        rule = hand.pose.bones[controls.moving_bones(finger)[-1]].constraints.new("IK")
        rule.name, rule.target, rule.subtarget = TIP, hand, TIP_CONTROLS[finger]
        rule.chain_count, rule.iterations, rule.use_stretch = 3, IK_ITERATIONS, False
        rule.influence = 0.0


def _follow(
    hand: bpy.types.Object,
    bone: bpy.types.PoseBone,
    name: str,
    control: str,
    axis: str,
    most: Iterable[float],
    *,
    moves: bool = False,
    goes_back: bool = False,
) -> None:
    """Where a control turns about its axis ("X", curl, or "Z", spread) a bone turns, after its own rotation, or moves.

    most: three Euler angles, or the way, at the control's full turn; the map is one line through zero. A spread goes
    both ways, a curl back where the bone `goes_back`; else the map begins at zero.
    """
    back, full, spread = np.radians((controls.CURL_BACK_DEG, controls.CURL_FULL_DEG, controls.SPREAD_FULL_DEG))
    low, high = (-spread, spread) if axis == "Z" else (-back if goes_back else 0.0, full)
    rule: Any = bone.constraints.get(name) or bone.constraints.new("TRANSFORM")
    rule.name, rule.target, rule.subtarget = name, hand, control
    rule.owner_space = rule.target_space = "LOCAL"
    rule.map_from, rule.map_to = "ROTATION", "LOCATION" if moves else "ROTATION"
    rule.from_rotation_mode = rule.to_euler_order = "XYZ"
    rule.mix_mode_rot = "AFTER"
    rule.map_to_x_from = rule.map_to_y_from = rule.map_to_z_from = axis
    setattr(rule, f"from_min_{axis.lower()}_rot", low)
    setattr(rule, f"from_max_{axis.lower()}_rot", high)
    ending = "" if moves else "_rot"
    for to, value in zip("xyz", most, strict=True):
        setattr(rule, f"to_min_{to}{ending}", value * low / high)
        setattr(rule, f"to_max_{to}{ending}", value)


def _limit(bone: bpy.types.PoseBone, name: str, *spans: tuple[float, float]) -> Any:
    """The constraint of this name, made where there is none, that keeps turns about x, y and z within these."""
    rule: Any = bone.constraints.get(name) or bone.constraints.new("LIMIT_ROTATION")
    rule.name, rule.owner_space, rule.euler_order = name, "LOCAL", "XYZ"
    rule.use_limit_x = rule.use_limit_y = rule.use_limit_z = True
    (rule.min_x, rule.max_x), (rule.min_y, rule.max_y), (rule.min_z, rule.max_z) = spans
    return rule


def _set_solver_range(bone: bpy.types.PoseBone, span: JointRange | None) -> None:
    """The joint limits for inverse kinematics, of hinges sideways SOLVER_PLAY times as wide; None: as Blender makes a
    bone. No axis is locked, also of an older layer: the solver would begin without the turn about it that a pose or a
    curl has, and a finger that is held would jump."""
    is_hinge = span is not None and span.hinge
    spans = (span.x, span.y, span.z) if span is not None else ((-np.pi, np.pi),) * 3
    bone.lock_ik_y = bone.lock_ik_z = False
    bone.ik_stiffness_y = 0.0 if span is None else SOLVER_STIFFNESS
    bone.ik_stiffness_z = SOLVER_STIFFNESS if is_hinge else 0.0
    for axis, (low, high) in zip("xyz", spans, strict=True):
        play = SOLVER_PLAY if is_hinge and axis == "z" else 1.0
        setattr(bone, f"use_ik_limit_{axis}", span is not None)
        setattr(bone, f"ik_min_{axis}", play * low)
        setattr(bone, f"ik_max_{axis}", play * high)


# Blender's bone color sets
PALETTES = {"hand": "THEME04", "finger": "THEME09", "tip": "THEME01"}
_NAMES = {kind: f"JGHand {kind} control" for kind in PALETTES}
_CORNERS = 32


def shape(kind: str) -> bpy.types.Object:
    """The object drawn for a control of a kind, "hand", "finger" or "tip", meters; made when there is none."""
    known = bpy.data.objects.get(_NAMES[kind])
    if known is not None and known.type == "MESH" and known.library is None:
        return known
    mesh = bpy.data.meshes.new(_NAMES[kind])
    points, edges = _wires(kind)
    mesh.from_pydata(points, edges, [])
    return bpy.data.objects.new(_NAMES[kind], mesh)


def _wires(kind: str) -> tuple[list[tuple[float, float, float]], list[tuple[int, int]]]:
    if kind == "finger":  # a ring that the finger goes through
        return _rings([((1, 0, 0), (0, 0, 1))], FINGER_SHAPE_M)
    if kind == "tip":
        axes = np.eye(3)
        return _rings([(axes[0], axes[1]), (axes[1], axes[2]), (axes[2], axes[0])], TIP_SHAPE_M)
    # a bracelet around the palm, flat as the palm is, half way to the knuckles
    wide, deep, along = HAND_SHAPE_M
    points, edges = _rings([((wide, 0, 0), (0, 0, deep))], 1.0)
    return [(x, y + along, z) for x, y, z in points], edges


def _rings(planes: list, radius: float) -> tuple[list[tuple[float, float, float]], list[tuple[int, int]]]:
    angle = np.linspace(0, 2 * np.pi, _CORNERS, endpoint=False)
    points, edges = [], []
    for first, second in planes:
        start = len(points)
        ring = radius * (np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second))
        points += [tuple(map(float, point)) for point in ring]
        edges += [(start + at, start + (at + 1) % _CORNERS) for at in range(_CORNERS)]
    return points, edges
