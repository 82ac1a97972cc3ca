"""Where the Gaussians of an untrained hand lie: a thin shell under the skin, equally many for every bone.

Deeper Gaussians are hidden and wasted. The points of each bone are in farthest-point order and the bones take turns,
so that every prefix of the list is a coarser sample of the whole hand: a level of detail. METHOD 3.2 and 3.3. A
forearm, where the template has one, counts as one more bone, whose points are those under its own skin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.avatar import UVD_RANGE_M
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import BONE_COUNT, JOINT_COUNT, LEVEL_NAMES, PARENTS
from jghand_engine.template.closest import ClosestPoints, Surface
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.weights import segment_distance

# depth of the shell of Gaussians under the skin, meters; deeper ones are hidden
SHELL_DEPTH_M = 0.003
GAUSSIANS_PER_BONE = 3000
# a shell as deep as this is the whole hand: the middle of the thickest palm is less deep
SHELL_DEPTH_MAX_M = 0.030
# edge of the cells from which the shell is drawn, meters: speed only
SHELL_CELL_M = 0.003
# draws per wanted point after which a bone is taken to have no skin (built-in hand: at most 11)
SHELL_DRAWS_MAX = 1000
# the number of the forearm among the bones
FOREARM = JOINT_COUNT


@dataclass(frozen=True)
class ShellSample:
    """N = 20 * per_bone points under the skin of a template, 21 * per_bone of one with a forearm, every prefix of which
    covers the whole hand.

    position_m:  (N, 3) float64, canonical frame, meters
    bone:        (N,) int64, 1..20: the nearest bone, named by the joint it ends at (level order); FOREARM
    uvd:         (N, 3) float64, 0..1: texture coordinates of the closest skin, and the normalized signed distance
    normal:      (N, 3) float64, unit outward normal of the skin there
    face:        (N,) int64, closest face of the template
    barycentric: (N, 3) float64, of the closest point in that face
    """

    position_m: np.ndarray
    bone: np.ndarray
    uvd: np.ndarray
    normal: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray

    def __len__(self) -> int:
        return len(self.position_m)


def sample_shell(
    template: HandTemplate,
    *,
    per_bone: int = GAUSSIANS_PER_BONE,
    depth_m: float = SHELL_DEPTH_M,
    seed: int = 0,
    depth_of_points: bool = False,
) -> ShellSample:
    """Draws `per_bone` points per bone, uniformly in the shell of thickness `depth_m` under the closed surface.

    depth_of_points: the depth coordinate goes from the deepest point to the shallowest, as the paper has it
    The same arguments give the same points. Raises InputError when a bone has no skin.
    """
    surface = Surface(template.vertices_m, template.faces)
    points_m, drawn = _draw(template, surface, per_bone, depth_m, np.random.default_rng(seed))
    order = farthest_point_order(points_m)
    bones = len(points_m)
    ranked = (order + per_bone * np.arange(bones)[:, None]).T.ravel()
    ranked_m, near = points_m.reshape(-1, 3)[ranked], drawn.rows(ranked)
    signed_m = near.signed_m
    spread_m = (float(signed_m.min()), float(signed_m.max())) if depth_of_points else (-UVD_RANGE_M, UVD_RANGE_M)
    return ShellSample(
        position_m=ranked_m,
        bone=np.tile(np.arange(1, 1 + bones), per_bone),
        uvd=uvd_coordinates(template, near, spread_m),
        normal=surface.normals(near.face, near.barycentric),
        face=near.face,
        barycentric=near.barycentric,
    )


def uvd_coordinates(
    template: HandTemplate, near: ClosestPoints, spread_m: tuple[float, float] = (-UVD_RANGE_M, UVD_RANGE_M)
) -> np.ndarray:
    """(N, 3) coordinates in 0..1: UV of the closest point in *its* face, and the signed distance over `spread_m`.

    UVs belong to the corners of faces, so they are mixed inside the closest face, never between neighboring vertices.
    The range is fixed (UVD_RANGE_M either side) unless one is given: with that of the points at hand features would
    shift when points move. METHOD 3.3.
    """
    uv = np.einsum("nk,nkc->nc", near.barycentric, template.face_uv[near.face])
    depth = (near.signed_m - spread_m[0]) / max(spread_m[1] - spread_m[0], 1e-9)
    return np.clip(np.concatenate([uv, depth[:, None]], axis=1), 0, 1)


def bone_distances(points_m: np.ndarray, joints_m: np.ndarray) -> np.ndarray:
    """(N, 20) distances to the bones 1..20; column i - 1 is bone i."""
    bones = range(1, JOINT_COUNT)
    return np.stack([segment_distance(points_m, joints_m[PARENTS[bone]], joints_m[bone]) for bone in bones], axis=1)


def farthest_point_order(points_m: np.ndarray) -> np.ndarray:
    """Orders each of B groups of n points (B, n, 3) so that the next is always the one farthest from all before it.

    Returns (B, n) indices into the groups, beginning with 0.
    """
    groups, count, _ = points_m.shape
    order = np.zeros((groups, count), dtype=np.int64)
    gap = np.full((groups, count), np.inf)
    rows = np.arange(groups)
    x, y, z = (np.ascontiguousarray(points_m[..., axis]) for axis in range(3))
    for rank in range(1, count):
        last = order[:, rank - 1]
        squared = (x - x[rows, last, None]) ** 2
        squared += (y - y[rows, last, None]) ** 2
        squared += (z - z[rows, last, None]) ** 2
        np.minimum(gap, squared, out=gap)
        # a point that was taken must not come again, even where several points coincide
        gap[rows, last] = -1
        order[:, rank] = gap.argmax(axis=1)
    return order


def _draw(
    template: HandTemplate, surface: Surface, per_bone: int, depth_m: float, random: np.random.Generator
) -> tuple[np.ndarray, ClosestPoints]:
    """(bones, per_bone, 3) points, uniform in the part of the shell that belongs to each bone, by rejection; and, for
    bones * per_bone, what is closest to them."""
    cells_m, half_m = _shell_cells(template, surface, depth_m)
    reach = bone_distances(cells_m, template.joints_m)
    # distances change by at most the way gone: other cells cannot hold a point nearest to this bone
    possible = reach <= reach.min(axis=1, keepdims=True) + 2 * np.sqrt(3) * half_m
    if template.forearm_face_count:
        possible = np.column_stack([possible, _near_forearm(template, cells_m, half_m)])
    bones = possible.shape[1]
    cells_of_bone = [np.flatnonzero(possible[:, k]) for k in range(bones)]
    found: list[list[np.ndarray]] = [[] for _ in range(bones)]
    closest: list[list[ClosestPoints]] = [[] for _ in range(bones)]
    count, drawn = np.zeros(bones, dtype=int), np.zeros(bones, dtype=int)
    while (count < per_bone).any():
        wanted = np.where(count < per_bone, _draws(per_bone, count, drawn), 0)
        for k in np.flatnonzero(wanted):
            if len(cells_of_bone[k]) == 0 or drawn[k] > SHELL_DRAWS_MAX * per_bone:
                raise InputError(
                    f"template {template.identifier!r}",
                    wanted="skin around every bone",
                    came=f"none nearest to the bone that ends at {LEVEL_NAMES[k + 1]}",
                    remedy="Are the joints those of this mesh, in the right order?",
                )
            cell = random.choice(cells_of_bone[k], wanted[k])
            points_m = cells_m[cell] + random.uniform(-half_m, half_m, (wanted[k], 3))
            is_forearm = k == BONE_COUNT
            kept = points_m if is_forearm else points_m[_nearest_bone(points_m, template.joints_m, random) == k]
            near = surface.closest(kept)
            inside = (near.signed_m <= 0) & (near.signed_m >= -depth_m)
            inside &= template.has_points[near.face] & (template.is_forearm[near.face] == is_forearm)
            inside = np.flatnonzero(inside)
            kept = kept[inside]
            found[k].append(kept)
            closest[k].append(near.rows(inside))
            count[k] += len(kept)
            drawn[k] += wanted[k]
    first = np.arange(per_bone)
    near = ClosestPoints.joined([ClosestPoints.joined(parts).rows(first) for parts in closest])
    return np.stack([np.concatenate(parts)[:per_bone] for parts in found]), near


def _draws(per_bone: int, count: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """How many to draw next for each bone: what is missing over the rate of success so far, and a little more."""
    rate = np.where(drawn > 0, np.maximum(count, 1) / np.maximum(drawn, 1), 0.25)
    return (1.1 * (per_bone - count) / rate).astype(int).clip(16, 20 * per_bone + 16)


def _nearest_bone(points_m: np.ndarray, joints_m: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """(N,) bone number - 1. Behind the wrist all metacarpals are equally near: there chance decides, so that each of
    them gets its part of the stump."""
    distance = bone_distances(points_m, joints_m)
    tied = distance <= distance.min(axis=1, keepdims=True)
    return np.where(tied, random.random(distance.shape), -1).argmax(axis=1)


def _near_forearm(template: HandTemplate, cells_m: np.ndarray, half_m: float) -> np.ndarray:
    """(C,) whether a cell may hold a point that is closest to the forearm: those no higher than where it begins."""
    top_m = template.vertices_m[template.faces[template.is_forearm], 1].max()
    return cells_m[:, 1] <= top_m + half_m


def _shell_cells(template: HandTemplate, surface: Surface, depth_m: float) -> tuple[np.ndarray, float]:
    """Centers (C, 3) of the grid cells that may hold a part of the shell, and half their edge."""
    half_m = SHELL_CELL_M / 2
    diagonal_m = np.sqrt(3) * half_m
    low, high = template.vertices_m.min(axis=0), template.vertices_m.max(axis=0)
    axes = [np.arange(low[k] + half_m, high[k] + half_m, SHELL_CELL_M) for k in range(3)]
    centers = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    centers = centers[surface.rough(centers)[1] <= depth_m + diagonal_m + surface.piece_radius_m]
    signed = surface.closest(centers).signed_m
    return centers[(signed <= diagonal_m) & (signed >= -depth_m - diagonal_m)], half_m
