# SPDX-License-Identifier: GPL-3.0-or-later
"""Which hands a scene has: those that a 3D view shows, read as Blender evaluated them for it, and those that an
instance of their collection shows, however deep it lies, linked from another file or not.

Finding the hands of a view layer, and what instances some, means looking at all of its objects, so what was found is
kept until something is added, removed or undone. Kept are names with the `session_uid` that the object of that name
had: one that was renamed, or replaced, is looked for anew.

Blender lists every instance of a scene (`depsgraph.object_instances`), at 0.6 us each: 60 ms per redraw of a meadow.
Here only collections with hands are looked into, by Blender's own rules; a test compares the two. What other things
instance (particles, geometry nodes, vertices and faces) shows no hands.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from .. import clock, folders
from ..core.view import BUILTIN_AVATAR, SHIPPED_AVATARS, HandInSpace
from ..errors import JGHandFailure
from . import armature, avatar_files, sources

# the folder of this user's hands, and where hands lie that came with JGHand: in the engine that the extension carries,
# or in the one that it lies beside in a checkout
HANDS = "hands"
_PACKAGE = Path(__file__).resolve().parents[1]
_CARRIED = tuple(
    folder / "jghand_engine" / "assets" / HANDS for folder in (_PACKAGE / "engine" / "common", _PACKAGE.parent)
)

# a collection -> whether hands, or what else is wanted, are in it, or what instances some. An evaluated one has no
# session_uid of its own, and one that was renamed is another
Known = dict[tuple[int, str], bool]
# how deep Blender looks into instances of instances
DEPTH_MAX = 8

# (session_uid of the scene, name of the view layer) -> (name, session_uid) of every hand and what instances some
_found: dict[tuple[int, str], list[tuple[str, int]]] = {}
# what was found of collections that are instanced
_collections: Known = {}


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
            if shows_hands(original, _collections) != (original.session_uid in known):
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
        for hand, placed in hands_shown(thing.evaluated_get(depsgraph), _collections, for_render=False):
            if switched_on_only and not hand.jghand.show_in_viewport:
                continue
            try:
                hands += read_shown(hand, depsgraph, placed, thing)
            except JGHandFailure as failure:
                failures.append((hand.name, failure))
    return hands, failures


def read_shown(
    hand: bpy.types.Object, depsgraph: bpy.types.Depsgraph, placed: np.ndarray, shown_by: bpy.types.Object
) -> list[HandInSpace]:
    """The hands of one of `hands_shown`, with their avatar. shown_by: the object that shows it. Raises JGHandFailure as
    `sources.read_hands`."""
    avatar = avatar_of(hand)
    forearm = hand.jghand.forearm and avatar_files.has_forearm(avatar)
    shown = {"avatar": avatar, "name": hand.name, "forearm": forearm}
    return [
        replace(each, **shown, called=armature.called(hand, each.handedness, shown_by))
        for each in sources.read_hands(hand, depsgraph, placed)
    ]


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
    things = [thing for thing in layer.objects if thing is not None and shows_hands(thing, _collections)]
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


# ---- hands of instances ----------------------------------------------------------------------------------------------


def shows_hands(thing: bpy.types.Object, known: Known) -> bool:
    """Whether an object is a hand or instances some. known: what was found of collections, for the next object."""
    return shows(thing, armature.is_any_hand, known)


def shows(thing: bpy.types.Object, wanted: Callable[[bpy.types.Object], bool], known: Known) -> bool:
    """Whether an object is wanted or instances what is. known: as of `shows_hands`, for this wish alone."""
    if wanted(thing):
        return True
    collection = thing.instance_collection if thing.instance_type == "COLLECTION" else None
    if collection is None:
        return False
    key = (collection.session_uid, collection.name_full)
    if key not in known:
        known[key] = False  # Blender lets no collection instance itself; should one, this ends
        known[key] = any(shows(part, wanted, known) for part in collection.all_objects)
    return known[key]


def hands_below(thing: bpy.types.Object, depth: int = 0) -> Iterator[bpy.types.Object]:
    """The hands of the file that an object is or instances, however deep they lie, whether shown or not."""
    if armature.is_any_hand(thing):
        yield thing
    collection = thing.instance_collection if thing.instance_type == "COLLECTION" else None
    for part in collection.all_objects if collection is not None and depth < DEPTH_MAX else ():
        yield from hands_below(part, depth + 1)


def hands_shown(
    thing: bpy.types.Object, known: Known, *, for_render: bool, placed: Matrix | None = None, depth: int = 0
) -> Iterator[tuple[bpy.types.Object, np.ndarray]]:
    """The hands of an *evaluated* object, as Blender evaluated them: itself, and those of the collection that it
    instances; and (4, 4) what the place of each in the world is multiplied with. known: of `shows_hands`, of
    evaluated objects for renders and of the file's for views. for_render: those that are rendered, not those that views
    show."""
    if armature.is_any_hand(thing):
        yield thing, armature.UNPLACED if placed is None else np.array(placed)
    collection = thing.instance_collection if thing.instance_type == "COLLECTION" else None
    if collection is None or depth == DEPTH_MAX:
        return
    here = (placed or Matrix()) @ thing.matrix_world @ Matrix.Translation(-collection.instance_offset)
    for part in dict.fromkeys(_visible(collection, for_render)):
        if part != thing and shows_hands(part if for_render else part.original, known):
            yield from hands_shown(part, known, for_render=for_render, placed=here, depth=depth + 1)


def _visible(collection: bpy.types.Collection, for_render: bool) -> Iterator[bpy.types.Object]:
    """The objects in a collection and those in it that Blender instances."""
    hidden = "hide_render" if for_render else "hide_viewport"
    if not getattr(collection, hidden):
        yield from (thing for thing in collection.objects if not getattr(thing, hidden))
        for child in collection.children:
            yield from _visible(child, for_render)


def evaluated_sources(depsgraph: bpy.types.Depsgraph) -> list[bpy.types.Object]:
    """The hands that Blender evaluated for a render and what instances some, by name, as it evaluated them: those that
    take part in it at the frame of the depsgraph, and those whose visibility is animated.

    A render has a thread of its own and data of its own, in which what is not rendered is not there; of the file's data
    nothing is read here, for meanwhile the artist may delete objects.
    """
    known: Known = {}
    things = [thing for thing in depsgraph.view_layer_eval.objects if thing is not None and shows_hands(thing, known)]
    return sorted(things, key=armature.name_in_files)


def sources_at_any_frame(view_layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    """The hands of a view layer and what instances some, that take part in renders now or at another frame, by name."""
    known: Known = {}
    return armature.rendered_at_any_frame(view_layer, lambda thing: shows_hands(thing, known))
