# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface of a hand at rest for any 21 joints: what throws a hand's shadow in Cycles and EEVEE.

It is the engine's template, whose file the build copies into the zip. Each vertex has weights of the bones that *begin*
at a joint, as armatures have them. Does not use bpy.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from . import posing
from .joints import LEFT, PARENTS, TAILS

_NAME = "hand_right.npz"
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


def surface_at(joints: np.ndarray, handedness: str) -> Surface:
    """The template's hand carried to (21, 3) joints of a rest pose, any unit: each bone is turned onto its new place
    and stretched along itself; across, all are as thick as the whole hand is large. JGHandFailure: bad_joints."""
    joints = np.asarray(joints, np.float64)
    there = posing.rest_matrices(joints, handedness)
    vertices, faces, weights, own = _template()
    if handedness == LEFT:
        vertices, faces, own = vertices * _MIRROR, faces[:, ::-1], own * _MIRROR
    here = posing.rest_matrices(own, handedness)
    tails = [tail if tail >= 0 else place for place, tail in enumerate(TAILS)]
    lengths, own_lengths = (np.linalg.norm(each[tails] - each, axis=-1) for each in (joints, own))
    bones, own_bones = (np.linalg.norm(each[1:] - each[list(PARENTS[1:])], axis=-1) for each in (joints, own))
    size = bones.sum() / own_bones.sum()
    stretch = np.full((len(joints), 3), size)
    stretch[:, 1] = np.divide(lengths, own_lengths, out=stretch[:, 1], where=own_lengths > 0)
    linear = there[:, :3, :3] * stretch[:, None] @ np.swapaxes(here[:, :3, :3], -1, -2)
    moved = np.einsum("jab,vjb->vja", linear, vertices[:, None] - own) + joints
    return Surface(np.einsum("vj,vja->va", weights, moved), faces, weights)


@cache
def _template() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces, weights and joints of the right hand, meters."""
    package = Path(__file__).parents[1]
    built = package / "assets" / _NAME
    path = built if built.is_file() else package.parent / "jghand_engine" / "assets" / _NAME
    with np.load(path, allow_pickle=False) as arrays:
        vertices, faces, weights, joints = (arrays[name] for name in ("vertices", "faces", "weights", "joints"))
    weights = weights.astype(np.float64)
    return vertices.astype(np.float64), faces, weights / weights.sum(1, keepdims=True), joints.astype(np.float64)
