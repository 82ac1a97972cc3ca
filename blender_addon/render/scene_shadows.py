# SPDX-License-Identifier: GPL-3.0-or-later
"""The shadows that a scene throws on hands: what its things leave of each lamp, at points of the skin, by rays.

A thing is asked only where it can lie between hand and lamp, and by rays that meet its box. Where things stand is read
once per edit, triangles once per evaluation, for all instances, into trees that are kept by their content; what was
found for a lamp is kept as long as hand, lamp and things stay. What throws a shadow is opaque here: glass and leaves
that are cut out by their alpha shade as a whole.
"""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree
from mathutils.kdtree import KDTree

from ..core import stand_in
from ..core.view import BLOCKERS, EVERYTHING, LIGHT_FROM_WORLD, is_picked
from ..hand import armature

# a lamp whose half angle has a larger sine, as the hand sees it, throws soft shadows: rays go to its strata, 2 x 2, and
# 4 x 4 where points around are not all in light or shade. What is between is the mean of so many points around: rays
# alone are off by 0.07 there, that by 0.03
_SOFT_SINE, _SIDES, _AROUND = 0.01, (2, 4), 8
# a ray begins so far above the skin: what lies on it must not shade it by the coarseness of the surface
LIFT_M = 2.5e-3
# part of the way to a lamp that is looked along: a lamp's own shade, at its surface, is not between
_WAY = 0.999
# how far a sun's shadow is looked for, meters
_FAR_M = 1000.0
# cosine of skin and light below which no light falls on it, however round the corner is: one ray will do
_FACING_MIN = -0.3
# what is kept beyond what was used last: lights found, triangles in trees (about 300 bytes each), and scenes
_FOUND, _TRIANGLES, _SCENES = 256, 4_000_000, 4
# what has triangles
SOLID = {"MESH", "CURVE", "SURFACE", "FONT", "META"}


@dataclass(frozen=True)
class _Shape:
    """Triangles in their own space.

    digest: of them
    tree:   None where there are none
    box:    (2, 3) around them
    size:   how many
    """

    digest: bytes
    tree: BVHTree | None
    box: np.ndarray
    size: int


@dataclass(frozen=True)
class _Standing:
    """What may throw shadows in an evaluated scene, N with each instance.

    edits:    when it was read
    meshes:   N evaluated meshes, see `_mesh_of`
    names:    N of the objects that have them, in files
    matrices: (N, 4, 4) to the axes of the lamps, meters
    middles:  (N, 3) and
    radii:    (N,) of a ball around each, in the axes of the lamps, meters
    shapes:   digests of the meshes that were read so far
    """

    edits: int
    meshes: list[tuple[int, int]]
    names: list[tuple[str, str]]
    matrices: np.ndarray
    middles: np.ndarray
    radii: np.ndarray
    shapes: dict[tuple[int, int], bytes] = field(default_factory=dict)


# something that may stand in the light: its triangles, and (4, 4) to the axes of the lamps, meters
_Thing = tuple[_Shape, np.ndarray]
# by scene and view layer; by digest, the last used at the end, as what was found for lamps
_standing: dict[Hashable, _Standing] = {}
_shapes: OrderedDict[bytes, _Shape] = OrderedDict()
_found: OrderedDict[Hashable, np.ndarray] = OrderedDict()
# how often something was edited that may throw a shadow: as long as this stays, so does that
edits = 0


@cache
def beside_on_hands() -> np.ndarray:
    """`beside` of `stand_in.points_on` hands, in any pose: of one at rest."""
    return beside(stand_in.points_m())


def beside(points: np.ndarray) -> np.ndarray:
    """(N, K) which points are nearest to each of (N, 3), itself among them."""
    tree = KDTree(len(points))
    for index, place in enumerate(points.tolist()):
        tree.insert(place, index)
    tree.balance()
    return np.array([[index for _, index, _ in tree.find_n(place, _AROUND)] for place in points.tolist()])


def left_of_lamps(
    points_m: np.ndarray,
    normals: np.ndarray,
    near: np.ndarray,
    lamps: Sequence[Mapping[str, Any]],
    depsgraph: bpy.types.Depsgraph,
) -> np.ndarray:
    """(lamps, N) uint8, what the scene leaves of each lamp at each point: 255 all of it. Points that face away count as
    well, without the hand between: a forearm, which has none, reads those of the wrist, on whichever side.

    points_m, normals: (N, 3) of the skin, in the axes of the lamps, meters
    near:              `beside` of them
    lamps:             of `SceneLight`
    """
    left = np.full((len(lamps), len(points_m)), 255, np.uint8)
    wanted = [place for place, lamp in enumerate(lamps) if lamp.get("has_shadow", True)]
    if not wanted or not len(points_m):
        return left
    standing = _standing_in(depsgraph)
    between = {place: _between(points_m, lamps[place], standing) for place in wanted}
    _read({standing.meshes[row] for rows in between.values() for row in rows}, standing, depsgraph)
    skin = hashlib.blake2b(points_m.tobytes() + normals.tobytes()).digest()
    # of points that are turned as each, for all lamps
    weight = np.maximum((normals[near] * normals[:, None]).sum(-1), 0.0) ** 2
    for place, rows in between.items():
        things = [
            (_shapes[digest], standing.matrices[row])
            for row in rows
            if (digest := standing.shapes.get(standing.meshes[row])) is not None and _shapes[digest].tree is not None
        ]
        if things:
            key = (skin, repr(lamps[place]), *((shape.digest, matrix.tobytes()) for shape, matrix in things))
            if key not in _found:
                _found[key] = _look(points_m, normals, lamps[place], things, near, weight)
                if len(_found) > _FOUND:
                    _found.popitem(last=False)
            _found.move_to_end(key)
            left[place] = _found[key]
    return left


def notice(depsgraph: bpy.types.Depsgraph) -> None:
    """Something was changed in Blender, or another frame is evaluated."""
    if any(_may_shade(update.id) for update in depsgraph.updates):
        expect()


def expect() -> None:
    global edits
    edits += 1


def _may_shade(thing: bpy.types.ID) -> bool:
    if not isinstance(thing, bpy.types.Object):
        kinds = bpy.types.Mesh | bpy.types.Curve | bpy.types.MetaBall | bpy.types.Volume | bpy.types.GeometryNodeTree
        return isinstance(thing, kinds | bpy.types.Scene | bpy.types.Collection)
    # volumes throw none, but who looks for what is before hands goes by these edits too
    return (thing.type in SOLID | {"VOLUME"} and armature.STAND_IN not in thing) or thing.is_instancer


def forget() -> None:
    """Gives the memory of trees and shadows back."""
    _standing.clear()
    _shapes.clear()
    _found.clear()
    expect()


# ---- what may stand in the light -------------------------------------------------------------------------------------


def _solids(depsgraph: bpy.types.Depsgraph) -> Iterator[tuple[bpy.types.Object, bpy.types.DepsgraphObjectInstance]]:
    """What throws shadows, each instance too; Blender gives curves, texts and balls as meshes beside themselves. Of an
    instance nothing is there after its turn."""
    for each in depsgraph.object_instances:
        thing = each.object
        if thing.type == "MESH" and thing.visible_shadow and each.show_self and armature.STAND_IN not in thing:
            yield thing, each


def _mesh_of(thing: bpy.types.Object) -> tuple[int, int]:
    """What an evaluated mesh is known by: its address, and the number that it gets anew at each evaluation; where
    Blender gives it none, it is another after each edit."""
    return thing.data.session_uid or -edits - 1, thing.data.as_pointer()


def _standing_in(depsgraph: bpy.types.Depsgraph) -> _Standing:
    """Where things stand; a render reads it each time, as edits are not told of there."""
    key = (depsgraph.scene.session_uid, depsgraph.view_layer.name)
    last = _standing.get(key) if depsgraph.mode == "VIEWPORT" else None
    if last is not None and last.edits == edits:
        return last
    meshes, names, places = [], [], []
    boxes: dict[tuple[int, int], np.ndarray] = {}
    for thing, each in _solids(depsgraph):
        mesh = _mesh_of(thing)
        meshes.append(mesh)
        names.append(armature.name_in_files(thing))
        places.append([tuple(row) for row in each.matrix_world])
        if mesh not in boxes:
            corners = np.array([tuple(corner) for corner in thing.bound_box])
            boxes[mesh] = np.stack([corners.min(0), corners.max(0)])
    light_from_world = LIGHT_FROM_WORLD.copy()
    light_from_world[:3] *= depsgraph.scene_eval.unit_settings.scale_length
    matrices = light_from_world @ np.array(places).reshape(-1, 4, 4)
    box = np.array([boxes[mesh] for mesh in meshes]).reshape(-1, 2, 3)
    turns = matrices[:, :3, :3]
    middles = (turns @ box.mean(1)[:, :, None])[..., 0] + matrices[:, :3, 3]
    radii = np.linalg.norm((np.abs(turns) @ (box[:, 1] - box[:, 0])[:, :, None])[..., 0], axis=-1) / 2
    known = {mesh: last.shapes[mesh] for mesh in boxes if mesh in last.shapes} if last is not None else {}
    standing = _Standing(edits, meshes, names, matrices, middles, radii, known)
    if depsgraph.mode == "VIEWPORT":
        if len(_standing) >= _SCENES:
            _standing.clear()
        _standing[key] = standing
    return standing


def _read(meshes: set[tuple[int, int]], standing: _Standing, depsgraph: bpy.types.Depsgraph) -> None:
    missing = {mesh for mesh in meshes if standing.shapes.get(mesh) not in _shapes}
    for thing, _ in _solids(depsgraph) if missing else ():
        mesh = _mesh_of(thing)
        if mesh in missing:
            standing.shapes[mesh] = _shape_of(thing)
            missing.discard(mesh)
            if not missing:
                break
    used = {standing.shapes[mesh] for mesh in meshes if mesh in standing.shapes}
    for digest in used:
        _shapes.move_to_end(digest)
    size = sum(shape.size for shape in _shapes.values())
    while size > _TRIANGLES and len(_shapes) > len(used):
        size -= _shapes.popitem(last=False)[1].size


def _shape_of(thing: bpy.types.Object) -> bytes:
    """Reads the triangles of an evaluated object; what they are known by."""
    mesh = thing.to_mesh()
    try:
        places = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.vertices.foreach_get("co", places.ravel())
        mesh.calc_loop_triangles()
        triangles = np.empty((len(mesh.loop_triangles), 3), np.int32)
        mesh.loop_triangles.foreach_get("vertices", triangles.ravel())
    finally:
        thing.to_mesh_clear()
    digest = hashlib.blake2b(places.tobytes() + triangles.tobytes()).digest()
    if digest not in _shapes:
        tree, box = None, np.zeros((2, 3))
        if len(triangles):
            tree = BVHTree.FromPolygons(places.tolist(), triangles.tolist(), all_triangles=True)
            box = np.stack([places.min(0), places.max(0)]).astype(np.float64)
        _shapes[digest] = _Shape(digest, tree, box, len(triangles))
    return digest


def _between(points: np.ndarray, lamp: Mapping[str, Any], standing: _Standing) -> list[int]:
    """The rows of what can lie between points and a lamp: whose ball meets the hull of the balls around both, which is
    made of balls from one to the other."""
    start = (points.min(0) + points.max(0)) / 2
    radius = float(np.linalg.norm(points - start, axis=-1).max()) + LIFT_M
    if lamp["kind"] == "sun":
        axis, length = _unit(lamp["place_m"]), _FAR_M
        slope = math.tan(lamp.get("angle_rad", 0.0) / 2)
    else:
        way = np.asarray(lamp["place_m"]) - start
        length = max(float(np.linalg.norm(way)), 1e-9)
        axis, slope = way / length, (_radius(lamp) - radius) / length
    off = standing.middles - start
    along = off @ axis
    aside = np.linalg.norm(off - along[:, None] * axis, axis=-1) + 1e-9
    # where on the axis the ball that comes nearest has its middle; a hull with a wide slope is its larger ball
    nearest = np.clip(along + aside * slope / math.sqrt(max(1 - slope * slope, 1e-30)), 0.0, length)
    apart = np.hypot(along - nearest, aside) - (radius + slope * nearest)
    rows = np.flatnonzero(apart <= standing.radii).tolist()
    blockers = lamp.get(BLOCKERS, EVERYTHING)
    return [row for row in rows if is_picked([standing.names[row]], blockers)]


def _radius(lamp: Mapping[str, Any]) -> float:
    return float(np.hypot(*lamp["size_m"])) / 2 if lamp["kind"] == "area" else lamp.get("radius_m", 0.0)


# ---- rays ------------------------------------------------------------------------------------------------------------


def _look(
    points: np.ndarray,
    normals: np.ndarray,
    lamp: Mapping[str, Any],
    things: Sequence[_Thing],
    near: np.ndarray,
    weight: np.ndarray,
) -> np.ndarray:
    """(N,) uint8, what things leave of a lamp. near, weight: (N, K) which points are around each, and their weights"""
    towards, sine = _towards(points, lamp)
    facing = np.flatnonzero((normals * towards).sum(-1) > np.minimum(_FACING_MIN, -sine))
    starts = points + LIFT_M * normals
    shaded = _shaded(np.arange(len(points)), starts, lamp, things, 1)
    if np.max(sine, initial=0.0) > _SOFT_SINE:
        shaded[facing] = _shaded(facing, starts[facing], lamp, things, _SIDES[0])
        mean = _mean(shaded, near, weight)
        rows = facing[(mean[facing] > 0) & (mean[facing] < 1)]
        if len(rows):
            shaded[rows] = _shaded(rows, starts[rows], lamp, things, _SIDES[1])
            shaded = np.where((shaded > 0) & (shaded < 1), _mean(shaded, near, weight), shaded)
    shaded = _continued(shaded, starts, things, near, weight)
    return np.rint(255 * (1 - shaded)).astype(np.uint8)


def _continued(
    shaded: np.ndarray, starts: np.ndarray, things: Sequence[_Thing], near: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """(N,) with rays that start in a thing, or behind a plane, as those around that start before it in more light: the
    engine's skin between has a part of both, and what is seen of it lies before the thing."""
    is_lighter = shaded[near] < shaded[:, None]
    rows = np.flatnonzero(is_lighter.any(1))
    beside = near[rows]
    own = np.repeat(starts[rows], near.shape[1], 0)
    leaves = _are_hit(own, starts[beside.ravel()] - own, things, from_behind=True)
    share = weight[rows] * is_lighter[rows] * leaves.reshape(beside.shape)
    found = share.sum(1) > 0
    shaded = shaded.copy()
    shaded[rows[found]] = _mean(shaded, beside[found], share[found])
    return shaded


def _shaded(
    points: np.ndarray, starts: np.ndarray, lamp: Mapping[str, Any], things: Sequence[_Thing], side: int
) -> np.ndarray:
    """(N,) part of side^2 rays to a lamp that meet things. points: (N,) numbers of what they start from"""
    hits = np.zeros(len(points))
    for ray in range(side * side):
        ends = _ends(starts, lamp, _stratum(points, ray, side))
        hits += _are_hit(starts, (ends - starts) * _WAY, things)
    return hits / side**2


def _mean(values: np.ndarray, near: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(N,) weighted means of what is near."""
    return (values[near] * weight).sum(1) / np.maximum(weight.sum(1), 1e-9)


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


def _are_hit(
    starts: np.ndarray, ways: np.ndarray, things: Sequence[_Thing], *, from_behind: bool = False
) -> np.ndarray:
    """(N,) whether a thing is met on the way from each point. from_behind: on its way out of it"""
    hit = np.zeros(len(starts), bool)
    for shape, matrix in things:
        if shape.tree is None or not np.linalg.det(matrix[:3, :3]):
            continue
        back = np.linalg.inv(matrix)
        rows = np.flatnonzero(~hit)
        origins = starts[rows] @ back[:3, :3].T + back[:3, 3]
        along = ways[rows] @ back[:3, :3].T
        near = np.flatnonzero(meet_box(origins, along, shape.box))
        rows, origins, along = rows[near], origins[near], along[near]
        lengths = np.linalg.norm(along, axis=-1)
        cast = shape.tree.ray_cast
        normals = [
            cast(origin, way, length)[1]
            for origin, way, length in zip(origins.tolist(), along.tolist(), lengths.tolist(), strict=True)
        ]
        outwards = np.array([normal or (0, 0, 0) for normal in normals]).reshape(-1, 3)
        hit[rows] = (outwards * along).sum(-1) > 0 if from_behind else outwards.any(-1)
    return hit


def meet_box(origins: np.ndarray, ways: np.ndarray, box: np.ndarray) -> np.ndarray:
    """(N,) whether the way from each point comes through a box, with a margin for numbers of 32 bits."""
    margin = 1e-5 * np.abs(box).max() + 1e-9
    one_over = 1 / np.where(np.abs(ways) < 1e-30, 1e-30, ways)
    low, high = (box[0] - margin - origins) * one_over, (box[1] + margin - origins) * one_over
    enters, leaves = np.minimum(low, high).max(-1), np.maximum(low, high).min(-1)
    return (enters <= leaves) & (leaves >= 0) & (enters <= 1)


def _unit(vector: Any) -> np.ndarray:
    vector = np.asarray(vector, np.float64)
    return vector / np.linalg.norm(vector)
