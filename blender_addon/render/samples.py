# SPDX-License-Identifier: GPL-3.0-or-later
"""The moments of a rendered picture: the hands and the camera at one frame, or at sub-frames while the shutter is open.

Blender evaluates no sub-frames for an engine that is not its own; the engine asks for each. Source: BLENDER 5 and 8.2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..core.cropping import Part, picture_of
from ..core.view import HandInSpace, Moment
from ..errors import JGHandFailure
from ..hand import armature, seen_hands, sources
from . import camera, scene

# where in the open time of the shutter its frame lies
_FRAME_AT = {"START": 0.0, "CENTER": 0.5, "END": 1.0}


@dataclass(frozen=True)
class Frame:
    """What of a view is drawn. eye: gives the evaluated camera · size: of the whole picture, pixels · part: of it that
    is drawn"""

    eye: Callable[[], bpy.types.Object]
    size: tuple[int, int]
    part: Part


def read_moments(depsgraph: bpy.types.Depsgraph, frame: Frame, frame_set: Callable[[int, float], None]) -> list[Moment]:
    """Everything that a picture shows, in the order of time.

    frame_set: moves the scene, and evaluates `depsgraph`, to a frame and a part of the way to the next. The scene is
    where it was afterwards. Raises JGHandFailure: what `camera.pinhole` and `sources.read_hands` do, no_hand,
    scripts_blocked, broken_driver, hidden.
    """
    there = armature.evaluated_hands(depsgraph)
    if not (there or _hands_elsewhere(depsgraph)):
        instanced = "; ".join(scene.instanced_hands(depsgraph.view_layer_eval.objects))
        raise JGHandFailure("no_hand", f"not rendered: {instanced}" if instanced else "")
    things = [hand for hand in there if not hand.hide_render]
    scene.check_drivers((*things, frame.eye()), depsgraph)
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
    return moments if _moves(moments) else moments[:1]


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
    return len(layers) > 1 and any(armature.hands_at_any_frame(layer) for layer in layers)


def _moment(names: list[tuple[str, str]], frame: Frame, depsgraph: bpy.types.Depsgraph) -> Moment:
    """The hands of these names, and the camera. What Blender evaluated is looked for at each moment: at another frame
    it may be another object."""
    found = {armature.name_in_files(thing): thing for thing in armature.evaluated_hands(depsgraph)}
    gone = [each[0] for each in names if each not in found]
    if gone:
        raise JGHandFailure("hidden", ", ".join(gone))
    hands: list[HandInSpace] = []
    for thing in map(found.__getitem__, names):
        avatar = seen_hands.avatar_of(thing)
        hands += [replace(hand, avatar=avatar) for hand in sources.read_hands(thing, depsgraph)]
    whole = camera.pinhole(frame.eye(), depsgraph, frame.size)
    return Moment(picture_of(whole, frame.part, frame.part.pixels), hands)


def _moves(moments: list[Moment]) -> bool:
    """Whether anything is not the same at all moments."""
    first = moments[0]
    return any(_numbers(moment) != _numbers(first) for moment in moments[1:])


def _numbers(moment: Moment) -> list[object]:
    view = moment.view
    numbers: list[object] = [view.fx, view.fy, view.cx, view.cy, view.aperture_m, view.focus_m]
    numbers.append(view.camera_from_world.tobytes())
    return numbers + [part.tobytes() for hand in moment.hands for part in (hand.joints_m, hand.world_from_hand)]
