"""How far the parts of one hand's skin are from one another: of neighboring fingers, of fingers and palm, of the thumb.

Distances are millimeters between the vertices of a smooth mesh and the other part's skin at its nearest vertex;
negative inside it. SKIN, Poses closed by skin.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from jghand_engine.captures.making.rig import FIRST_JOINTS, Identity
from jghand_engine.hand.kinematics import NEIGHBORS
from jghand_engine.template.subdivision import Subdivision
from jghand_engine.template.surface import unit

MM = 1e-3
# subdivisions of the mesh that is measured: vertices 2 mm apart
LEVELS = 1
# weight of a part's joints from which a vertex is one of that part's own, and of all fingers up to which it is palm
OWN, PALM = 0.9, 0.3
# the same of the thumb: its skin near the MCP is the hand's as well
OWN_THUMB = 0.6
# skin is on the inner side of other skin at most so far from it; farther it is the other side of a thin part
DEEPEST_MM = 8.0
# skin beside a vertex by up to this is over it: the mesh goes on there, and its own plane says how far
SPACING_MM = 2.0
# what counts of a part's vertices: of a flank its nearest quarter, of a tip the nearest hundredth, so that one vertex
# does not decide
FLANK_PART, TIP_PART = 0.25, 0.01
FINGERS = (1, 2, 3, 4)


class HandSkin:
    """The parts of a hand's skin, as vertex numbers of a smooth mesh.

    faces: (F, 3) · first, ends: (V, 5) weights of each finger's first moving bone, and of the others
    """

    def __init__(self, faces: np.ndarray, first: np.ndarray, ends: np.ndarray) -> None:
        self.faces, whole = faces, first + ends
        self.palm = np.flatnonzero(whole.sum(1) < PALM)
        self.fingers = [np.flatnonzero(weight > OWN) for weight in whole.T]
        own = (OWN_THUMB, OWN, OWN, OWN, OWN)
        self.ends = [np.flatnonzero(weight > least) for weight, least in zip(ends.T, own, strict=True)]

    def gaps(self, vertices_m: np.ndarray) -> SkinGaps:
        """Of the posed mesh (V, 3)."""
        return SkinGaps(self, vertices_m)


class IdentitySkin(HandSkin):
    """The skin of an identity."""

    def __init__(self, identity: Identity) -> None:
        fine = Subdivision.of(identity.faces, identity.face_uv, LEVELS)
        self.matrix = fine.matrix
        bones = (fine.matrix @ identity.weights25)[:, np.add.outer(FIRST_JOINTS, range(4))]
        super().__init__(fine.faces, bones[..., 0], bones[..., 1:].sum(-1))

    def gaps(self, vertices_m: np.ndarray) -> SkinGaps:
        """Of the identity's posed mesh (V, 3)."""
        return super().gaps(self.matrix @ vertices_m)


class SkinGaps:
    """Distances, mm, of one pose. A finger's end are its last two phalanges."""

    def __init__(self, skin: HandSkin, vertices_m: np.ndarray) -> None:
        self._skin, self._mm = skin, vertices_m / MM
        self._trees: dict[int, KDTree] = {}

    def neighbors(self, pairs: Sequence[tuple[int, int]] = NEIGHBORS) -> np.ndarray:
        """(pairs,) the first finger's end from the other finger, mean of its nearest quarter."""
        return np.array([self._flank(finger, other) for finger, other in pairs])

    def palm(self, fingers: Sequence[int] = FINGERS) -> np.ndarray:
        """(fingers,) the finger's end from the palm, where it is nearest."""
        parts = self._skin
        return np.array([_nearest(self._signed(parts.ends[finger], -1, parts.palm)) for finger in fingers])

    def thumb(self, fingers: Sequence[int] = FINGERS) -> np.ndarray:
        """(fingers,) the thumb's end from the finger, where it is nearest."""
        parts = self._skin
        return np.array([_nearest(self._signed(parts.ends[0], finger, parts.fingers[finger])) for finger in fingers])

    def _flank(self, finger: int, other: int) -> float:
        signed = np.sort(self._signed(self._skin.ends[finger], other, self._skin.fingers[other]))
        return float(signed[: int(FLANK_PART * len(signed))].mean())

    def _signed(self, vertices: np.ndarray, other: int, others: np.ndarray) -> np.ndarray:
        """(N,) distances of vertices (N,) from the part whose number is `other` and whose vertices are `others`."""
        if other not in self._trees:
            self._trees[other] = KDTree(self._mm[others])
        distance, nearest = self._trees[other].query(self._mm[vertices])
        nearest = others[nearest]
        height = ((self._mm[vertices] - self._mm[nearest]) * self._normals[nearest]).sum(1)
        beside = np.sqrt(np.maximum(distance**2 - height**2, 0))
        distance = np.hypot(height, np.maximum(beside - SPACING_MM, 0))
        return np.where((height < 0) & (distance < DEEPEST_MM), -distance, distance)

    @cached_property
    def _normals(self) -> np.ndarray:
        """(V, 3) unit."""
        a, b, c = (self._mm[self._skin.faces[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        corner, count = self._skin.faces.T.reshape(-1), len(self._mm)
        return unit(np.stack([np.bincount(corner, np.tile(axis, 3), count) for axis in normals.T], 1))


def _nearest(signed_mm: np.ndarray) -> float:
    return float(np.quantile(signed_mm, TIP_PART))
