"""Close-ups of a capture: each shows one part of the hand in one pose, from where that skin is seen.

A camera that stands still would lose it: from an open hand to a fist a finger tip goes 10 cm and turns over. So a
close-up is aimed anew in every pose, as a camera of its own. Parts take turns: palm, knuckles, finger tips, nails.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from jghand_engine.captures.making.cameras import ROLL_DEG, PlannedCamera, aimed
from jghand_engine.captures.making.rig import Identity
from jghand_engine.captures.skin.canvas import MM, Texels
from jghand_engine.hand.rotations import unit
from jghand_engine.template.surface import vertex_normals

# edge of the square image, and what it shows where it is aimed: 0.18 mm per pixel, as of a hand that fills 1080 lines
CLOSE_PX, CLOSE_FIELD_M = 384, 0.070
# rays per pixel, at least: of fewer the denoiser makes brush strokes of pores and ridges (DATA 4). And so many times
# those of the whole hand: a capture that is made again with more has less noise in close-ups, too
CLOSE_SAMPLES, CLOSE_SAMPLES_TIMES = 32, 2
# distance, meters: near enough for perspective to matter, and for its lens to be a usual one
CLOSE_M = (0.40, 0.65)
# the eye is at most so far from the skin's normal, degrees; skin within so many meters must be seen from there, this
# part of it, and of so many tries the best is taken where none is good
CLOSE_TURN_DEG, PATCH_M, PATCH_SEEN, TRIES = 45.0, 0.010, 0.9, 12
# rays begin so far above the skin that they do not meet it, meters
OFF_SKIN_M = 0.001
# texels by which the parts are found
_PART_TEXELS = 256
# level-order joints whose backs are knuckles, and how far around them, mm
_KNUCKLES, _KNUCKLE_MM = (2, 3, 4, 5, 7, 8, 9, 10), 12.0


def plan_close_ups(
    identity: Identity, vertices_m: np.ndarray, count: int, seed: int, samples: int
) -> list[PlannedCamera]:
    """`count` cameras for each pose of the identity's mesh (P, V, 3), meters, pose by pose. samples: of whole views"""
    if not count:
        return []
    parts, cameras, samples = _parts(identity), [], max(CLOSE_SAMPLES, CLOSE_SAMPLES_TIMES * samples)
    for pose, vertices in enumerate(vertices_m):
        normals, corners = vertex_normals(vertices, identity.faces), vertices[identity.faces]
        for slot in range(count):
            rng = np.random.default_rng((seed, 3, pose, slot))
            part = parts[(pose * count + slot) % len(parts)]
            eye, target = _best_view(rng, part, vertices, normals, corners)
            camera = aimed(eye, target, np.radians(rng.uniform(-1, 1) * ROLL_DEG), (CLOSE_PX, CLOSE_PX))
            focal = CLOSE_PX * float(np.linalg.norm(eye - target)) / CLOSE_FIELD_M
            cameras.append(PlannedCamera(replace(camera, fx=focal, fy=focal), pose, samples))
    return cameras


def _parts(identity: Identity) -> list[np.ndarray]:
    """Numbers of the vertices of each part that close-ups are aimed at."""
    texels = Texels.of(identity, _PART_TEXELS)
    joints, out_of_palm = identity.joints_m / MM, texels.normal[:, 2]
    end, nail = texels.shares[:, :, 2] > 0.6, texels.nail > 0.6
    away = np.stack([unit(texels.normal[nail & end[:, finger]].mean(0)) for finger in range(5)])
    pulp = (end & (texels.normal @ away.T < -0.5)).any(1)
    palm = (texels.shares.sum((1, 2)) < 0.3) & (out_of_palm > 0.7) & (texels.point[:, 1] > 0.2 * joints[3, 1])
    near = KDTree(joints[list(_KNUCKLES)]).query(texels.point)[0] < _KNUCKLE_MM
    vertex = np.asarray(KDTree(identity.vertices_m / MM).query(texels.point)[1])
    return [np.unique(vertex[on]) for on in (palm, near & (out_of_palm < -0.5), pulp, nail)]


def _best_view(
    rng: np.random.Generator, part: np.ndarray, vertices: np.ndarray, normals: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Eye and target (3,) of a view of some vertex of the part, from where the skin around it is seen."""
    best, most = (np.zeros(3), np.zeros(3)), -1.0
    for _ in range(TRIES):
        away_m = np.linalg.norm(vertices - vertices[rng.choice(part)], axis=1)
        patch = part[np.flatnonzero(away_m[part] < PATCH_M)]
        # a tip in the middle of the image would leave half of it empty
        target = vertices[away_m < CLOSE_FIELD_M / 2].mean(0)
        facing = unit(normals[patch].mean(0))
        # evenly over the cap of directions around it
        cosine = rng.uniform(np.cos(np.radians(CLOSE_TURN_DEG)), 1)
        side = unit(np.cross(facing, rng.standard_normal(3)))
        eye = target + rng.uniform(*CLOSE_M) * (cosine * facing + np.sqrt(1 - cosine**2) * side)
        seen = _sees(eye, vertices[patch] + OFF_SKIN_M * normals[patch], corners).mean()
        if seen > most:
            best, most = (eye, target), seen
        if seen >= PATCH_SEEN:
            break
    return best


def _sees(eye: np.ndarray, points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N,) whether nothing of the triangles (F, 3, 3) is between the eye (3,) and the points (N, 3)."""
    ray = points - eye
    # Moeller and Trumbore 1997; products of a triangle and the eye alone stand together
    first, second, start = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], eye - corners[:, 0]
    volume = ray @ np.cross(first, second).T
    volume = np.where(volume == 0, np.finfo(float).tiny, volume)
    u, v = ray @ np.cross(start, second).T / volume, ray @ np.cross(first, start).T / volume
    along = -np.sum(start * np.cross(first, second), axis=1) / volume
    return ~((u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0) & (along < 1)).any(1)
