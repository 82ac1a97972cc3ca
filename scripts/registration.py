"""The surface of a hand's detail where a person's skin is: at rest, and in every pose by its correctives.

Pictures of half a millimeter per pixel say where a silhouette is, not where on it a wrinkle lies: what a training finds
is off by a millimeter along the skin. Of a person whose skin is computed the surface of every pose is known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from other_person import Somebody, person_detail
from scipy import sparse
from scipy.sparse.linalg import factorized
from scipy.spatial import KDTree

from jghand_engine.avatar.avatar import FOREARM_WAY, HandAvatar
from jghand_engine.avatar.detail_correctives import NUMBERS, DetailCorrectives, angle_numbers
from jghand_engine.avatar.posing import Posing
from jghand_engine.avatar.skin_task import BLEND_DET_MIN
from jghand_engine.captures.making.poses import varied_poses
from jghand_engine.captures.making.rig import RiggedHand
from jghand_engine.captures.skin.surface import SkinSurface
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.shapes import pose_names
from jghand_engine.learn.fist import with_fist
from jghand_engine.render.detail import DetailedHand
from jghand_engine.template.reshape import pulled_back
from jghand_engine.template.subdivision import Subdivision
from jghand_engine.template.surface import directed_edges, vertex_normals

# poses that the correctives are fitted to, as a capture varies them, and with which seed: none of a capture's. Twice as
# many find the same
POSES, SEED = 200, 1
# the mesh that captures show
LEVELS = 3
# penalty on directions, per pose and square radian: ten times more or less is worse on other poses
RIDGE = 3e-5
# vertices at once: bounds the memory to 100 MB
AT_ONCE = 512
STEPS = 127
# so much of the skin Gaussians are to cover: a color is known from 1/64 on (native/detail.cpp); so many around it do
# the nearest one grows, as if it covered this in its middle at least, to this size at most, meters: it would be a blot
REACH_ALPHA, REACH_NEIGHBORS, REACH_OPACITY, REACH_SIGMA_M = 0.04, 12, 0.3, 0.0015


def with_maps(avatar: HandAvatar, person: Somebody) -> HandAvatar:
    """The avatar with the detail of its person's maps on that person's skin, the fist that this wants, and Gaussians
    that reach that skin; one without detail as it is."""
    if avatar.detail is None:
        return avatar
    avatar = registered(avatar, person)
    return reaching_skin(with_fist(replace(avatar, detail=person_detail(avatar, person))))


def reaching_skin(avatar: HandAvatar) -> HandAvatar:
    """The avatar, with a detail, whose Gaussians are so large that the skin has a color at its outline, too, in all
    named poses: a picture ends where it knows no color."""
    hand, posing, skeleton = DetailedHand.of(avatar, 1.0), Posing(avatar), avatar.skeleton()
    ends, sigma_m = directed_edges(hand.detail.faces), avatar.sigma_m.astype(np.float64)
    for name in pose_names():
        joints_m = named_pose(name, avatar.rest_joints_m, handedness=Handedness.RIGHT, fist=avatar.fist)
        posed, skin_m = posing(joints_m), hand.posed_m(skeleton.bones(joints_m))
        place_m = np.concatenate([skin_m, skin_m[ends].mean(1)])
        grown = posed.sigma_m / avatar.sigma_m
        apart_m, near = map(np.asarray, KDTree(posed.position_m).query(place_m, k=REACH_NEIGHBORS))
        covers = avatar.opacity[near] * np.exp(-0.5 * (apart_m / (sigma_m * grown)[near]) ** 2)
        few = covers.sum(1) < REACH_ALPHA
        apart_m, near = apart_m[few, 0], near[few, 0]
        wanted_m = apart_m / np.sqrt(2 * np.log(avatar.opacity[near].clip(REACH_OPACITY) / REACH_ALPHA)) / grown[near]
        np.maximum.at(sigma_m, near, wanted_m.clip(max=REACH_SIGMA_M))
    return replace(avatar, sigma_m=sigma_m.astype(np.float32))


def registered(avatar: HandAvatar, one: Somebody) -> HandAvatar:
    """The avatar with the surface of its detail on the skin of a person whom its joints are those of, where pictures of
    it end then.

    InputError for an avatar without detail, or one whose surface is not that of the person's mesh.
    """
    detail, hand = avatar.detail, RiggedHand(one.identity)
    if detail is None:
        raise InputError(f"avatar {avatar.info.name}", wanted="one with detail", came="one without")
    mesh = Subdivision.of(one.identity.faces, one.identity.face_uv, 1)
    if len(detail.position_m) > mesh.faces.max() + 1 or not np.array_equal(
        detail.faces, mesh.faces[: len(detail.faces)]
    ):
        raise InputError(f"detail of {avatar.info.name}", wanted=f"the mesh of {one.identity.name}", came="another")
    surface, close = SkinSurface(one.identity, LEVELS, one.maps), _closest(mesh.faces)
    posed = hand.pose(varied_poses(hand, POSES, SEED).angles_deg)
    skeleton, forearm = avatar.for_hand(Handedness.RIGHT).skeleton(), hand.forearm(posed)
    weights = avatar.map_weights(detail.position_m, detail.bone_weights).astype(np.float64)
    rest_m, turn, angles_rad = [], [], []
    poses = zip(hand.skin(posed), posed.joints_m, surface.bent(posed.joints_m), forearm, strict=True)
    for vertices_m, joints_m, bent, turn_of_forearm in poses:
        skin_m = close(surface.posed(vertices_m, bent))[: len(weights)]
        bones = skeleton.bones(joints_m, np.float64, forearm=turn_of_forearm)
        rest_m.append(pulled_back(skeleton, skin_m, weights, bones))
        linear = np.einsum("vb,bij->vij", weights, bones.linear_offset[..., :3])
        # by how much the kernel scales an offset less than skinning does a place
        turn.append(np.cbrt(np.maximum(np.abs(np.linalg.det(linear)) / bones.scale**3, BLEND_DET_MIN)))
        angles_rad.append(bones.angles_rad)
    mean_m = np.mean(rest_m, 0)
    wanted_m = (np.stack(rest_m) - mean_m) * np.stack(turn)[..., None]
    changes = angle_numbers(np.stack(angles_rad)) - angle_numbers(avatar.canonical_angles_rad)
    constant_m, correctives = _fit(changes, detail.bone_weights, wanted_m)
    place_m = (mean_m + constant_m).astype(np.float32)
    outwards = vertex_normals(detail.position_m.astype(np.float64), detail.faces)
    on_hand = (detail.position_m - avatar.canonical_joints_m[0]) @ FOREARM_WAY < 0
    sunk_m = ((detail.position_m - place_m) * outwards).sum(1)[np.unique(detail.faces[on_hand[detail.faces].all(1)])]
    depth_m = max(detail.depth_m - float(np.median(sunk_m)), 0.0)
    detail = replace(detail, position_m=place_m, correctives=correctives, depth_m=depth_m, ends_hand=True)
    return replace(avatar, detail=detail)


def _closest(faces: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """From a finer surface's vertices (V, 3), those of a coarser mesh first and then the middles of its edges, to those
    of the mesh that is nearest to it by least squares, at vertices and middles of edges. Between vertices that lie on
    round skin the mesh would cut it short by a tenth of a millimeter, and outlines with it."""
    count, edges = int(faces.max()) + 1, np.unique(np.sort(directed_edges(faces), axis=1), axis=0)
    rows = np.repeat(np.arange(len(edges)), 2)
    middles = sparse.coo_array((np.full(edges.size, 0.5), (rows, edges.reshape(-1))), (len(edges), count))
    places = sparse.csc_array(sparse.vstack([sparse.eye_array(count), middles]))
    solve = factorized(sparse.csc_array(places.T @ places))

    def close(fine_m: np.ndarray) -> np.ndarray:
        wanted = places.T @ fine_m[: count + len(edges)]
        return np.stack([solve(column) for column in wanted.T], 1)

    return close


def _fit(changes: np.ndarray, weights: np.ndarray, wanted_m: np.ndarray) -> tuple[np.ndarray, DetailCorrectives]:
    """By least squares of changes (P, 21, NUMBERS), weights (V, 21) and offsets (P, V, 3): constants (V, 3), meters,
    and the correctives."""
    constant_m, direction = np.zeros(wanted_m.shape[1:]), np.zeros((len(weights), NUMBERS, 3), np.int8)
    scale_m = np.zeros(len(weights), np.float32)
    for start in range(0, len(weights), AT_ONCE):
        rows = slice(start, start + AT_ONCE)
        mixed, offset_m = np.einsum("vb,pbk->vpk", weights[rows], changes), wanted_m[:, rows].swapaxes(0, 1)
        middle, level_m = mixed.mean(1, keepdims=True), offset_m.mean(1, keepdims=True)
        square = (mixed - middle).swapaxes(1, 2) @ (mixed - middle) + RIDGE * len(changes) * np.eye(NUMBERS)
        found_m = np.linalg.solve(square, (mixed - middle).swapaxes(1, 2) @ (offset_m - level_m))
        scale_m[rows] = np.abs(found_m).max((1, 2)) / STEPS
        step_m = np.maximum(scale_m[rows], np.finfo(np.float32).tiny).astype(np.float64)[:, None, None]
        direction[rows] = np.rint(found_m / step_m)
        constant_m[rows] = (level_m - middle @ (direction[rows] * step_m))[:, 0]
    return constant_m, DetailCorrectives(direction, scale_m)
