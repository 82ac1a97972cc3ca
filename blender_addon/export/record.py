# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands over a range of frames, as Blender evaluates them: constraints, drivers, controls and IK included."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import bpy
import numpy as np

from ..errors import JGHandFailure
from ..hand import sources
from ..hand.seen_hands import avatar_of
from ..render import scene
from .recording import Recording, file_names


def record_steps(
    context: bpy.types.Context, things: Sequence[bpy.types.Object], frames: range, into: list[Recording]
) -> Iterator[float]:
    """Goes through the frames and yields the part that is done; at the end one recording per hand is in `into`.

    things: objects that are hands, a foreign rig counts up to two. The scene's frame is put back at the end, also when
    this is closed half-way. JGHandFailure: no_hand, and what `sources.read_hands` and `scene.evaluated_at` raise.
    """
    if not things or not len(frames):
        raise JGHandFailure("no_hand")
    now = context.scene
    before = now.frame_current, now.frame_subframe
    read: list[list[np.ndarray]] = []
    try:
        for place, frame in enumerate(frames):
            depsgraph = scene.evaluated_at(now, frame, things)
            hands = [hand for thing in things for hand in sources.read_hands(thing, depsgraph)]
            read.append([hand.joints_world_m for hand in hands])
            yield (place + 1) / len(frames)
    finally:
        now.frame_set(before[0], subframe=before[1])
    fps = now.render.fps / now.render.fps_base
    for place, (thing, handedness, name) in enumerate(named_hands(context, things)):
        joints_m = np.stack([frame[place] for frame in read])
        into.append(Recording(name, handedness, avatar_of(thing), joints_m, frames[0], fps, thing.name))


def named_hands(
    context: bpy.types.Context, things: Sequence[bpy.types.Object]
) -> list[tuple[bpy.types.Object, str, str]]:
    """The hands of these objects, a foreign rig up to two: (object, handedness, stem of its files)."""
    depsgraph = context.evaluated_depsgraph_get()
    found = [(thing, hand.handedness) for thing in things for hand in sources.read_hands(thing, depsgraph)]
    owners = [thing for thing, _ in found]
    names = file_names([f"{thing.name}_{side}" if owners.count(thing) > 1 else thing.name for thing, side in found])
    return [(thing, side, name) for (thing, side), name in zip(found, names, strict=True)]


def joints_now(context: bpy.types.Context, thing: bpy.types.Object) -> dict[str, np.ndarray]:
    """(21, 3) joints in the world, meters, by handedness, of the frame that is shown."""
    hands = sources.read_hands(thing, context.evaluated_depsgraph_get())
    return {hand.handedness: hand.joints_world_m for hand in hands}
