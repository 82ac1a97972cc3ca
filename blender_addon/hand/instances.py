# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands that an instance of their collection shows, however deep it lies, linked from another file or not.

Blender lists every instance of a scene (`depsgraph.object_instances`), at 0.6 us each: 60 ms per redraw of a meadow.
Here only collections with hands are looked into, by Blender's own rules; a test compares the two. What other things
instance (particles, geometry nodes, vertices and faces) shows no hands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import bpy
import numpy as np
from mathutils import Matrix

from . import armature

# a collection -> whether hands, or what else is wanted, are in it, or what instances some. An evaluated one has no
# session_uid of its own, and one that was renamed is another
Known = dict[tuple[int, str], bool]
# how deep Blender looks into instances of instances
DEPTH_MAX = 8


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
