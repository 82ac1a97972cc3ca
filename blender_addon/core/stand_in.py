# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface of a hand at any 21 joints: what throws its shadow in Cycles and EEVEE, and where the scene's shadow on
it is looked for.

It is the engine's template, whose file the build copies into the zip. Each vertex has weights of the bones that *begin*
at a joint, as armatures have them. Does not use bpy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from . import posing
from .joints import LEFT, RIGHT, TAILS, WRIST

_NAME = "hand_right.npz"
# where the skin is looked at for shadows: 3.5 mm from each other, like the engine's anchors
POINTS = 3000
# where light is baked: 1.8 mm from each other, less than a Gaussian of the skin is wide
FINE_POINTS = 12_000
# from where to where behind the wrist it bends, meters: the engine's
BEND_M = (-0.015, 0.035)
_MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Surface:
    """A closed hand.

    vertices: (V, 3), unit of the joints
    faces:    (F, 3), counter-clockwise seen from outside
    weights:  (V, 21) of the bone that begins at each joint, standard order; rows sum to 1
    """

    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray

    @property
    def normals(self) -> np.ndarray:
        """(V, 3) unit, outwards: faces count by their area."""
        corners = self.vertices[self.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        total = np.zeros_like(self.vertices)
        for corner in range(3):
            np.add.at(total, self.faces[:, corner], across)
        return total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-30)


def surface_at(joints: np.ndarray, handedness: str, *, forearm: bool = False) -> Surface:
    """The template's hand carried to (21, 3) joints of any pose, any unit: each bone is turned onto its new place and
    stretched along itself; across, all are as thick as the whole hand is large. forearm: with it.
    JGHandFailure: bad_joints."""
    joints = posing.checked_joints(np.asarray(joints)[None])
    template, rest = _template(handedness, forearm)
    axes, joints, own = posing.posed_axes(joints, rest, handedness)[0], joints[0], rest[:, :3, 3]
    tails = [tail if tail >= 0 else place for place, tail in enumerate(TAILS)]
    lengths, own_lengths = (np.linalg.norm(each[tails] - each, axis=-1) for each in (joints, own))
    stretch = np.full((len(joints), 3), lengths.sum() / own_lengths.sum())
    stretch[:, 1] = np.divide(lengths, own_lengths, out=stretch[:, 1], where=own_lengths > 0)
    maps = np.empty((len(joints), 3, 4))
    maps[:, :, :3] = axes * stretch[:, None] @ np.swapaxes(rest[:, :3, :3], -1, -2)
    maps[:, :, 3] = joints - np.einsum("jab,jb->ja", maps[:, :, :3], own)
    skin = (template.weights @ maps.reshape(len(joints), 12)).reshape(-1, 3, 4)
    return replace(template, vertices=np.einsum("vab,vb->va", skin[..., :3], template.vertices) + skin[..., 3])


def points_on(surface: Surface, count: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """(count, 3) places evenly on the surface of a hand, and the unit normals there."""
    corners, share = _points(count)
    normal = np.einsum("pk,pka->pa", share, surface.normals[corners])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
    return np.einsum("pk,pka->pa", share, surface.vertices[corners]), normal


def with_forearm_bone(weights: np.ndarray, handedness: str) -> np.ndarray:
    """(V, 21) weights of the hand with a forearm -> (V, 22): what followed the wrist goes over to the bone that this
    hangs on. Where it is bent, skin bends as the engine's; all of a twist is there, too."""
    surface, rest = _template(handedness, True)
    wrist = rest[WRIST, :3, 3]
    way = wrist - posing.forearm_rest(rest, handedness)[:3, 3]
    behind = (wrist - surface.vertices) @ way / np.linalg.norm(way)
    part = ((behind - BEND_M[0]) / (BEND_M[1] - BEND_M[0])).clip(0, 1)
    forearm = weights[:, WRIST] * part * part * (3 - 2 * part)
    return np.column_stack([weights[:, WRIST] - forearm, weights[:, 1:], forearm])


@cache
def points_m(count: int = POINTS) -> np.ndarray:
    """(count, 3) float32, the same on the right hand of the template, meters: by these the engine knows them."""
    corners, share = _points(count)
    return np.einsum("pk,pka->pa", share, _template(RIGHT)[0].vertices[corners]).astype("<f4")


@cache
def _points(count: int) -> tuple[np.ndarray, np.ndarray]:
    """(count, 3) the corners of the faces in which points lie, and their shares: faces by area, places in them by a
    sequence (Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, 2018)."""
    surface, _ = _template(RIGHT)
    corners = surface.vertices[surface.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1).cumsum()
    number = np.arange(count) + 0.5
    within = (number[:, None] * [0.7548776662, 0.5698402910]) % 1.0
    beyond = within.sum(1) > 1
    within[beyond] = 1 - within[beyond]
    face = np.searchsorted(area, number / count * area[-1])
    return surface.faces[face], np.concatenate([1 - within.sum(1, keepdims=True), within], 1)


@cache
def _template(handedness: str, forearm: bool = False) -> tuple[Surface, np.ndarray]:
    """The template's hand, meters, and its (21, 4, 4) rest matrices. JGHandFailure (not_a_hand): another handedness."""
    package = Path(__file__).parents[1]
    built = package / "assets" / _NAME
    path = built if built.is_file() else package.parent / "jghand_engine" / "assets" / _NAME
    with np.load(path, allow_pickle=False) as arrays:
        vertices, faces, weights, joints = (arrays[name] for name in ("vertices", "faces", "weights", "joints"))
        if forearm:  # in the place of the wrist's cap, whose weights it has
            skin, behind = len(arrays["base_index"]), arrays["forearm_vertices"]
            vertices, faces = vertices[:skin], faces[: arrays["n_skin_faces"]]
            vertices, faces = np.concatenate([vertices, behind]), np.concatenate([faces, arrays["forearm_faces"]])
            weights = np.concatenate([weights[:skin], np.repeat(weights[skin:], len(behind), 0)])
    vertices, weights, joints = (each.astype(np.float64) for each in (vertices, weights, joints))
    if handedness == LEFT:
        vertices, faces, joints = vertices * _MIRROR, faces[:, ::-1], joints * _MIRROR
    weights /= weights.sum(1, keepdims=True)
    return Surface(vertices, faces, weights), posing.rest_matrices(joints, handedness)
