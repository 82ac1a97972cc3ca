# SPDX-License-Identifier: GPL-3.0-or-later
"""The shadows that a scene throws on hands: what its things leave of each lamp, at points of the skin, by rays.

A thing is asked only where its box can lie between hand and lamp. Its triangles are looked up in a tree that is kept
until they change; what was found for a lamp is kept as long as hand, lamp and things stay. What throws a shadow is
opaque here: glass and leaves that are cut out by their alpha shade as a whole.
"""

from __future__ import annotations

import functools
import hashlib
import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

from ..core.view import LIGHT_FROM_WORLD
from ..hand import armature

# a lamp whose half angle has a larger sine, as the hand sees it, throws soft shadows: so many rays to its strata
_SOFT_SINE, _SIDE = 0.01, 2
# a ray begins so far above the skin: what lies on it must not shade it by the coarseness of the surface
LIFT_M = 2.5e-3
# part of the way to a lamp that is looked along: a lamp's own shade, at its surface, is not between
_WAY = 0.999
# how far a sun's shadow is looked for, meters
_FAR_M = 1000.0
# cosine of skin and light below which no light falls on it, however round the corner is
_FACING_MIN = -0.3
# trees of things, and what was found for lamps, that are kept
_TREES, _FOUND = 64, 256
# what has triangles
SOLID = {"MESH", "CURVE", "SURFACE", "FONT", "META"}

_Kept = TypeVar("_Kept")
_trees: OrderedDict[Hashable, BVHTree] = OrderedDict()
_found: OrderedDict[Hashable, np.ndarray] = OrderedDict()
# how often something was edited that may throw a shadow
_edits = 0


@dataclass(frozen=True)
class _Thing:
    """Something that may stand in the light.

    tree:   of its triangles in its own space
    digest: of the triangles
    matrix: (4, 4) to the axes of the lamps, meters
    """

    tree: BVHTree
    digest: bytes
    matrix: np.ndarray


def left_of_lamps(
    points_m: np.ndarray, normals: np.ndarray, lamps: Sequence[Mapping[str, Any]], depsgraph: bpy.types.Depsgraph
) -> np.ndarray:
    """(lamps, N) uint8, what the scene leaves of each lamp at each point: 255 all of it. Points that face away from a
    lamp have 255, too.

    points_m, normals: (N, 3) of the skin, in the axes of the lamps, meters
    lamps:             records, see the engine's `Lamp`
    """
    left = np.full((len(lamps), len(points_m)), 255, np.uint8)
    wanted = [place for place, lamp in enumerate(lamps) if lamp.get("has_shadow", True)]
    if not wanted or not len(points_m):
        return left
    hand = np.stack([points_m.min(0), points_m.max(0)])
    hulls = [_hull_of(hand, lamps[place]) for place in wanted]
    things: dict[int, list[_Thing]] = {place: [] for place in wanted}
    for thing, matrix, box in _solids(depsgraph):
        between = [place for place, hull in zip(wanted, hulls, strict=True) if _meet(box, hull)]
        if between:
            digest, tree = _tree_of(thing)
            for place in between:
                if tree is not None:
                    things[place].append(_Thing(tree, digest, matrix))
    skin = hashlib.blake2b(points_m.tobytes() + normals.tobytes()).digest()
    for place in wanted:
        standing = things[place]
        if standing:
            key = (skin, repr(lamps[place]), *((thing.digest, thing.matrix.tobytes()) for thing in standing))
            look = functools.partial(_look, points_m, normals, lamps[place], standing)
            left[place] = _kept(_found, _FOUND, key, look)
    return left


def edits() -> int:
    """As long as this stays, so does what may throw a shadow."""
    return _edits


def notice(depsgraph: bpy.types.Depsgraph) -> None:
    """Something was changed in Blender, or another frame is evaluated."""
    if any(_may_shade(update.id) for update in depsgraph.updates):
        expect()


def expect() -> None:
    """Everything may be another."""
    global _edits
    _edits += 1


def _may_shade(thing: bpy.types.ID) -> bool:
    if not isinstance(thing, bpy.types.Object):
        kinds = bpy.types.Mesh | bpy.types.Curve | bpy.types.MetaBall | bpy.types.GeometryNodeTree
        return isinstance(thing, kinds | bpy.types.Scene | bpy.types.Collection)
    return (thing.type in SOLID and armature.STAND_IN not in thing) or thing.is_instancer


def forget() -> None:
    """Gives the memory of trees and shadows back."""
    _trees.clear()
    _found.clear()
    expect()


def _kept(memory: OrderedDict[Hashable, _Kept], most: int, key: Hashable, make: Callable[[], _Kept]) -> _Kept:
    """What is known by this key, or is made now; what was wanted longest ago goes."""
    if key not in memory:
        memory[key] = make()
        if len(memory) > most:
            memory.popitem(last=False)
    memory.move_to_end(key)
    return memory[key]


# ---- what may stand in the light -------------------------------------------------------------------------------------


def _solids(depsgraph: bpy.types.Depsgraph) -> Iterator[tuple[bpy.types.Object, np.ndarray, np.ndarray]]:
    """What throws shadows, each instance too, its matrix and its box in the axes of the lamps, meters. Of an instance
    nothing is there after its turn."""
    light_from_world = LIGHT_FROM_WORLD.copy()
    light_from_world[:3] *= depsgraph.scene_eval.unit_settings.scale_length
    for each in depsgraph.object_instances:
        thing = each.object
        if thing.type not in SOLID or not thing.visible_shadow or not each.show_self or armature.STAND_IN in thing:
            continue
        matrix = light_from_world @ np.array(each.matrix_world)
        corners = np.array(thing.bound_box) @ matrix[:3, :3].T + matrix[:3, 3]
        yield thing, matrix, np.stack([corners.min(0), corners.max(0)])


def _tree_of(thing: bpy.types.Object) -> tuple[bytes, BVHTree | None]:
    """The triangles of an evaluated object, and what they are known by."""
    mesh = thing.to_mesh()
    try:
        if mesh is None or not mesh.polygons:
            return b"", None
        places = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.vertices.foreach_get("co", places.ravel())
        mesh.calc_loop_triangles()
        triangles = np.empty((len(mesh.loop_triangles), 3), np.int32)
        mesh.loop_triangles.foreach_get("vertices", triangles.ravel())
    finally:
        thing.to_mesh_clear()
    digest = hashlib.blake2b(places.tobytes() + triangles.tobytes()).digest()

    def build() -> BVHTree:
        return BVHTree.FromPolygons(places.tolist(), triangles.tolist(), all_triangles=True)

    return digest, _kept(_trees, _TREES, digest, build)


def _hull_of(hand: np.ndarray, lamp: Mapping[str, Any]) -> np.ndarray:
    """(2, 3) the box of a hand's box and a lamp; of a sun, which has no place, it has no end."""
    if lamp["kind"] == "sun":
        towards, widest = _unit(lamp["place_m"]), math.sin(lamp.get("angle_rad", 0.0) / 2)
        low, high = hand
        return np.stack([np.where(towards < widest, -np.inf, low), np.where(towards > -widest, np.inf, high)])
    place, size = np.asarray(lamp["place_m"]), _radius(lamp)
    return np.stack([np.minimum(hand[0], place - size), np.maximum(hand[1], place + size)])


def _meet(box: np.ndarray, hull: np.ndarray) -> bool:
    return bool((box[0] <= hull[1]).all() and (box[1] >= hull[0]).all())


def _radius(lamp: Mapping[str, Any]) -> float:
    """Of a ball around a lamp."""
    return float(np.hypot(*lamp["size_m"])) / 2 if lamp["kind"] == "area" else lamp.get("radius_m", 0.0)


# ---- rays ------------------------------------------------------------------------------------------------------------


def _look(points: np.ndarray, normals: np.ndarray, lamp: Mapping[str, Any], things: Sequence[_Thing]) -> np.ndarray:
    """(N,) uint8, what things leave of a lamp."""
    left = np.full(len(points), 255, np.uint8)
    towards, sine = _towards(points, lamp)
    facing = np.flatnonzero((normals * towards).sum(-1) > np.minimum(_FACING_MIN, -sine))
    starts = points[facing] + LIFT_M * normals[facing]
    side = _SIDE if np.max(sine, initial=0.0) > _SOFT_SINE else 1
    shaded = np.zeros(len(facing))
    for ray in range(side * side):
        ends = _ends(starts, lamp, _stratum(facing, ray, side))
        shaded += _are_hit(starts, (ends - starts) * _WAY, things)
    left[facing] = np.rint(255 * (1 - shaded / side**2))
    return left


def _towards(points: np.ndarray, lamp: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) unit towards the middle of a lamp, and (N,) the sine of its half angle."""
    if lamp["kind"] == "sun":
        return np.tile(_unit(lamp["place_m"]), (len(points), 1)), np.full(
            len(points), math.sin(lamp.get("angle_rad", 0.0) / 2)
        )
    way = np.asarray(lamp["place_m"]) - points
    length = np.maximum(np.linalg.norm(way, axis=-1), 1e-9)
    return way / length[:, None], np.minimum(_radius(lamp) / length, 1.0)


def _stratum(points: np.ndarray, ray: int, side: int) -> np.ndarray:
    """(N, 2) of the unit square, in the stratum of this ray: even over neighboring points, and the same every time.
    Source of the sequence: Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, 2018."""
    if side == 1:
        return np.full((len(points), 2), 0.5)
    within = (points[:, None] * [0.7548776662, 0.5698402910] + 0.5) % 1.0
    return (within + np.array([ray % side, ray // side])) / side


def _ends(starts: np.ndarray, lamp: Mapping[str, Any], at: np.ndarray) -> np.ndarray:
    """(N, 3) the points of a lamp that belong to `at` (N, 2) in the unit square."""
    is_area = lamp["kind"] == "area"
    if not is_area or lamp.get("is_ellipse", False):  # onto the disk
        radius, turn = np.sqrt(at[:, :1]), 2 * math.pi * at[:, 1]
        at = radius / 2 * np.stack([np.cos(turn), np.sin(turn)], -1)
    else:
        at = at - 0.5
    if is_area:
        first = _unit(lamp["side"])
        second = np.cross(_unit(lamp["axis"]), first)
        at = at * np.asarray(lamp["size_m"])
        return np.asarray(lamp["place_m"]) + at[:, :1] * first + at[:, 1:] * second
    if lamp["kind"] == "sun":
        towards = np.tile(_unit(lamp["place_m"]), (len(starts), 1))
        middle, radius = starts + towards * _FAR_M, _FAR_M * math.tan(lamp.get("angle_rad", 0.0) / 2)
    else:
        middle, radius = np.tile(np.asarray(lamp["place_m"], np.float64), (len(starts), 1)), lamp.get("radius_m", 0.0)
        towards = middle - starts
    first = np.cross(towards, np.eye(3)[np.abs(towards).argmin(-1)])
    first /= np.maximum(np.linalg.norm(first, axis=-1, keepdims=True), 1e-9)
    second = np.cross(first, towards / np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-9))
    return middle + 2 * radius * (at[:, :1] * first + at[:, 1:] * second)


def _are_hit(starts: np.ndarray, ways: np.ndarray, things: Sequence[_Thing]) -> np.ndarray:
    """(N,) whether a thing is met on the way from each point."""
    hit = np.zeros(len(starts), bool)
    for thing in things:
        if not np.linalg.det(thing.matrix[:3, :3]):
            continue
        back = np.linalg.inv(thing.matrix)
        rows = np.flatnonzero(~hit)
        origins = starts[rows] @ back[:3, :3].T + back[:3, 3]
        along = ways[rows] @ back[:3, :3].T
        lengths = np.linalg.norm(along, axis=-1)
        cast = thing.tree.ray_cast
        hit[rows] = [
            cast(origin, way, length)[0] is not None
            for origin, way, length in zip(origins.tolist(), along.tolist(), lengths.tolist(), strict=True)
        ]
    return hit


def _unit(vector: Any) -> np.ndarray:
    vector = np.asarray(vector, np.float64)
    return vector / np.linalg.norm(vector)
