# SPDX-License-Identifier: GPL-3.0-or-later
"""Which hands a 3D view shows, read as Blender evaluated them for it.

Finding the hands of a view layer, and what instances some, means looking at all of its objects, so what was found is
kept until something is added, removed or undone. Kept are names with the `session_uid` that the object of that name
had: one that was renamed, or replaced, is looked for anew.
"""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from .. import clock, folders
from ..core.view import BUILTIN_AVATAR, SHIPPED_AVATARS, HandInSpace
from ..errors import JGHandFailure
from . import avatar_files, instances, sources

# the folder of this user's hands, and where hands lie that came with JGHand: in the engine that the extension carries,
# or in the one that it lies beside in a checkout
HANDS = "hands"
_PACKAGE = Path(__file__).resolve().parents[1]
_CARRIED = tuple(
    folder / "jghand_engine" / "assets" / HANDS for folder in (_PACKAGE / "engine" / "common", _PACKAGE.parent)
)

# (session_uid of the scene, name of the view layer) -> (name, session_uid) of every hand and what instances some
_found: dict[tuple[int, str], list[tuple[str, int]]] = {}
# what was found of collections that are instanced
_collections: instances.Known = {}


def forget() -> None:
    _found.clear()
    _collections.clear()


def notice(depsgraph: bpy.types.Depsgraph) -> None:
    """Something was changed in Blender: where that can have made or removed a hand, look anew."""
    known = {uid for found in _found.values() for _, uid in found}
    for update in depsgraph.updates:
        thing = update.id
        if isinstance(thing, bpy.types.Scene | bpy.types.Collection):
            break
        if isinstance(thing, bpy.types.Object):
            original = thing.original
            if instances.shows_hands(original, _collections) != (original.session_uid in known):
                break
    else:
        return
    forget()


def hands_in(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, space: bpy.types.SpaceView3D, *, switched_on_only: bool
) -> list[bpy.types.Object]:
    """What a 3D view shows of hands and of what instances some: visible, in its local view and collections; in Solid
    and Material Preview (`switched_on_only`) those alone that are to be shown there."""
    return [
        thing
        for thing in hands_of(scene, layer)
        if _is_visible(thing, layer, space) and (thing.jghand.show_in_viewport or not switched_on_only)
    ]


def read(
    things: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph, *, switched_on_only: bool = False
) -> tuple[list[HandInSpace], list[tuple[str, JGHandFailure]]]:
    """The hands of these objects, with their avatars, and for those that cannot be read their name and why."""
    hands, failures = [], []
    for thing in things:
        for hand, placed in instances.hands_shown(thing.evaluated_get(depsgraph), _collections, for_render=False):
            if switched_on_only and not hand.jghand.show_in_viewport:
                continue
            try:
                hands += read_shown(hand, depsgraph, placed)
            except JGHandFailure as failure:
                failures.append((hand.name, failure))
    return hands, failures


def read_shown(hand: bpy.types.Object, depsgraph: bpy.types.Depsgraph, placed: np.ndarray) -> list[HandInSpace]:
    """The hands of one of `instances.hands_shown`, with their avatar. Raises JGHandFailure as `sources.read_hands`."""
    avatar = avatar_of(hand)
    forearm = hand.jghand.forearm and avatar_files.has_forearm(avatar)
    shown = {"avatar": avatar, "name": hand.name, "forearm": forearm}
    return [replace(each, **shown) for each in sources.read_hands(hand, depsgraph, placed)]


def avatar_of(thing: bpy.types.Object) -> str:
    """The avatar of a hand's object: an absolute path, also of a hand that it has by its name, or the name of one that
    comes with the renderer."""
    text = thing.jghand.avatar
    return named(text) if avatar_files.is_name(text) else folders.absolute(thing, "avatar") or BUILTIN_AVATAR


def named(name: str) -> str:
    """The avatar of a name, as `avatar_of`: its file lies where a pack would put it when there is none."""
    if name in SHIPPED_AVATARS:
        return name
    files = [folder / f"{name}{avatar_files.SUFFIX}" for folder in hand_folders()]
    return str(next((file for file in files if file.is_file()), files[-1]))


def hand_folders() -> tuple[Path, ...]:
    """Where hands lie that have a name: those that came with JGHand, then those of this user."""
    return (*_CARRIED, folders.user_folder(HANDS, make=False))


def hands_of(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    """The hands of a view layer and what instances some, by name; panels ask at every redraw, also of scenes with
    thousands of objects."""
    key = (scene.session_uid, layer.name)
    if key in _found:
        things = [layer.objects.get(name) for name, _ in _found[key]]
        if all(
            thing is not None and thing.session_uid == uid for thing, (_, uid) in zip(things, _found[key], strict=True)
        ):
            return [thing for thing in things if thing is not None]
    # an object that was deleted a moment ago is None here
    things = [thing for thing in layer.objects if thing is not None and instances.shows_hands(thing, _collections)]
    things.sort(key=lambda thing: thing.name)
    _found[key] = [(thing.name, thing.session_uid) for thing in things]
    if things and threading.current_thread() is threading.main_thread():
        clock.hasten(0.0)  # from now on somebody has to look whether pictures came
    return things


def _is_visible(thing: bpy.types.Object, layer: bpy.types.ViewLayer, space: bpy.types.SpaceView3D) -> bool:
    """Whether a view shows an object; one whose kind alone is switched off there counts as shown: who hides bones
    wants to see the hand."""
    if thing.visible_get(view_layer=layer, viewport=space):
        return True
    kind_hidden = thing.type == "ARMATURE" and not space.show_object_viewport_armature
    kind_hidden = kind_hidden or (thing.type == "EMPTY" and not space.show_object_viewport_empty)
    if not kind_hidden or space.use_local_collections or not thing.visible_get(view_layer=layer):
        return False
    return space.local_view is None or thing.local_view_get(space)
