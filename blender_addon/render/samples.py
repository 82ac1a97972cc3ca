# SPDX-License-Identifier: GPL-3.0-or-later
"""The moments of a rendered picture: the hands and the camera at one frame, or at sub-frames while the shutter is open.

Blender evaluates no sub-frames for an engine that is not its own; the engine asks for each. Source: BLENDER 5 and 8.2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import bpy
import numpy as np

from .. import versions
from ..core.view import HandInSpace, Moment, Part, picture_of
from ..errors import JGHandFailure
from ..hand import armature, seen_hands
from . import camera

# where in the open time of the shutter its frame lies
_FRAME_AT = {"START": 0.0, "CENTER": 0.5, "END": 1.0}


@dataclass(frozen=True)
class Frame:
    # gives the evaluated camera
    eye: Callable[[], bpy.types.Object]
    # of the whole picture, pixels, and the part of it that is drawn
    size: tuple[int, int]
    part: Part


def read_moments(depsgraph: bpy.types.Depsgraph, frame: Frame, frame_set: Callable[[int, float], None]) -> list[Moment]:
    """Everything that a picture shows, in the order of time.

    frame_set: moves the scene, and evaluates `depsgraph`, to a frame and a part of the way to the next. The scene is
    where it was afterwards. Raises JGHandFailure: what `camera.pinhole` and `sources.read_hands` do, no_hand, hidden;
    scripts_blocked: of a file whose scripts are blocked only the drivers that are needed matter.
    """
    there = seen_hands.evaluated_sources(depsgraph)
    if not (there or _hands_elsewhere(depsgraph)):
        raise JGHandFailure("no_hand")
    things = [thing for thing in there if not thing.hide_render]
    known: seen_hands.Known = {}
    hands = [hand for thing in things for hand, _ in seen_hands.hands_shown(thing, known, for_render=True)]
    parts = (part for thing in (*things, *hands, frame.eye()) for part in armature.parts_of(thing))
    if bpy.app.autoexec_fail and any(map(_has_scripts, parts)):
        raise JGHandFailure("scripts_blocked", bpy.app.autoexec_fail_message)
    times = shutter_times(depsgraph.scene_eval)
    names = [armature.name_in_files(thing) for thing in things]
    if len(times) == 1:
        return [_moment(names, frame, depsgraph)]
    whole, subframe = depsgraph.scene.frame_current, depsgraph.scene.frame_subframe
    moments = []
    try:
        for time, weight in times:
            at = whole + subframe + time
            frame_set(int(np.floor(at)), float(at - np.floor(at)))
            moments.append(replace(_moment(names, frame, depsgraph), weight=weight))
    finally:
        frame_set(whole, subframe)
    # one that is mirrored, or comes and goes, while the shutter is open cannot be averaged: the hands of the middle
    middle = _sides(moments[len(moments) // 2])
    moments = [moment for moment in moments if _sides(moment) == middle]
    return moments if len({_numbers(moment) for moment in moments}) > 1 else moments[:1]


def _has_scripts(thing: bpy.types.Object) -> bool:
    """Whether an object or its data has drivers that only Python can compute."""
    return any(
        curve.driver.type == "SCRIPTED" and not curve.driver.is_simple_expression and not curve.mute
        for owner in ((thing, thing.data) if thing.data else (thing,))
        for curve in (owner.animation_data.drivers if owner.animation_data else ())
    )


def shutter_times(current: bpy.types.Scene) -> list[tuple[float, float]]:
    """When the scene is looked at for one frame: frames after it, and how open the shutter is then."""
    render = current.render
    if not render.use_motion_blur or render.motion_blur_shutter <= 0:
        return [(0.0, 1.0)]
    count = current.jghand.motion_samples
    places = (np.arange(count) + 0.5) / count
    curve = render.motion_blur_shutter_curve
    curve.update()
    openness = [max(0.0, curve.evaluate(curve.curves[0], place)) for place in places]
    if not sum(openness) > 0:  # a curve that never opens
        openness = [1.0] * count
    times = render.motion_blur_shutter * (places - _FRAME_AT[render.motion_blur_position])
    return list(zip(times.tolist(), openness, strict=True))


def _hands_elsewhere(depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether another view layer of the scene shows hands: then one without any is no mistake.

    Of another layer a render knows what the file says, and nothing else; it is asked where nothing else can tell.
    """
    layers = depsgraph.scene.view_layers
    return len(layers) > 1 and any(seen_hands.sources_at_any_frame(layer) for layer in layers)


def _moment(names: list[tuple[str, str]], frame: Frame, depsgraph: bpy.types.Depsgraph) -> Moment:
    """The hands of these names, those of instances too, and the camera. What Blender evaluated is looked for at each
    moment: at another frame it may be another object."""
    found = {armature.name_in_files(thing): thing for thing in seen_hands.evaluated_sources(depsgraph)}
    gone = [each[0] for each in names if each not in found]
    if gone:
        raise JGHandFailure("hidden", ", ".join(gone))
    hands = _hands_of(map(found.__getitem__, names), depsgraph)
    whole = camera.pinhole(frame.eye(), depsgraph, frame.size)
    return Moment(picture_of(whole, frame.part, frame.part.pixels), hands)


def hands_at(depsgraph: bpy.types.Depsgraph) -> list[HandInSpace]:
    """The hands of a render, at the moment that was evaluated. Raises JGHandFailure as `sources.read_hands`."""
    return _hands_of((thing for thing in seen_hands.evaluated_sources(depsgraph) if not thing.hide_render), depsgraph)


def hands_to_render(depsgraph: bpy.types.Depsgraph) -> list[HandInSpace]:
    """The same of a depsgraph of views, on the main thread: it has hands that are disabled in renders, and lacks those
    that are disabled in viewports. JGHandFailure (hidden), too."""
    wanted = {armature.name_in_files(thing): thing for thing in seen_hands.sources_at_any_frame(depsgraph.view_layer)}
    there = {armature.name_in_files(thing): thing for thing in seen_hands.evaluated_sources(depsgraph)}
    gone = [name for name, thing in wanted.items() if name not in there and not thing.hide_render]
    if gone:
        raise JGHandFailure("hidden", ", ".join(name for name, _ in gone))
    return _hands_of((thing for name, thing in there.items() if name in wanted and not thing.hide_render), depsgraph)


def _hands_of(things: Iterable[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> list[HandInSpace]:
    known: seen_hands.Known = {}
    hands: list[HandInSpace] = []
    for thing in things:
        for hand, placed in seen_hands.hands_shown(thing, known, for_render=True):
            hands += seen_hands.read_shown(hand, depsgraph, placed, thing)
    return hands


def _sides(moment: Moment) -> list[tuple[str, str, bool]]:
    return [(hand.handedness, hand.avatar, hand.forearm) for hand in moment.hands]


def _numbers(moment: Moment) -> tuple[object, ...]:
    """The same for moments at which nothing moves."""
    view = moment.view
    lens = view.fx, view.fy, view.cx, view.cy, view.aperture_m, view.focus_m, view.camera_from_world.tobytes()
    return (*lens, *(hand.pose_bytes for hand in moment.hands))


def background(world: bpy.types.World | None) -> tuple[float, float, float]:
    """The world's color, scene-linear: that of its background node, with the strength, where the node has one color;
    else the color that the viewport shows. Black without a world."""
    if world is None:
        return (0.0, 0.0, 0.0)
    node = _background_node(world)
    if node is None or any(socket.is_linked for socket in node.inputs if socket.enabled):
        return tuple(world.color)
    strength = node.inputs["Strength"].default_value
    red, green, blue, _ = node.inputs["Color"].default_value
    return (strength * red, strength * green, strength * blue)


def _background_node(world: bpy.types.World) -> bpy.types.Node | None:
    """The background that goes straight into the output that is used."""
    tree = versions.world_tree(world)
    output = tree.get_output_node("ALL") if tree is not None else None
    if output is None or not output.inputs["Surface"].links:
        return None
    node = output.inputs["Surface"].links[0].from_node
    return node if node.type == "BACKGROUND" else None
