"""The fine surface of a hand under its skin, posed: smooth, and moved by what the maps' heights have that is coarse."""

from __future__ import annotations

import numpy as np

from jghand_engine.avatar.relief import Bend
from jghand_engine.captures.making.rig import FIRST_JOINTS, Identity
from jghand_engine.captures.skin.canvas import MM
from jghand_engine.captures.skin.maps import SkinMaps
from jghand_engine.template.subdivision import Subdivision
from jghand_engine.template.surface import vertex_normals
from jghand_engine.template.texture import sample_bilinear


class SkinSurface:
    """faces (F, 3) and face_uv (F, 3, 2) of an identity's mesh after `levels` of Loop's subdivision: 3 give edges of
    0.6 mm."""

    def __init__(self, identity: Identity, levels: int, maps: SkinMaps) -> None:
        fine = Subdivision.of(identity.faces, identity.face_uv, levels)
        self.faces, self.face_uv, self._matrix = fine.faces, fine.face_uv, fine.matrix
        cap = fine.faces[identity.skin_face_count * 4**levels :]
        is_skin = np.ones(len(fine.corner))
        is_skin[cap] = 0
        uv = fine.face_uv.reshape(-1, 2)[fine.corner]
        self._heights_m = {
            name: MM * is_skin * sample_bilinear(height[..., None], uv)[:, 0] for name, height in maps.coarse.items()
        }
        weights = fine.matrix @ identity.weights25
        fingers = np.stack([weights[:, first : first + 4].sum(1) for first in FIRST_JOINTS], 1)
        self._bend = Bend(fine.matrix @ identity.vertices_m, fingers, identity.joints_m)

    def bent(self, joints_m: np.ndarray) -> np.ndarray:
        """Posed joints (P, 21, 3), level order -> (P, V) 0..1, how bent the joint near each vertex is."""
        return (self._bend.of_joints(joints_m) @ self._bend.near.T).astype(np.float32)

    def smooth(self, vertices_m: np.ndarray) -> np.ndarray:
        """The coarse mesh posed (v, 3) -> (V, 3), not moved by any height."""
        return self._matrix @ vertices_m

    def posed(self, vertices_m: np.ndarray, bent: np.ndarray) -> np.ndarray:
        """The coarse mesh posed (v, 3), and one row of `bent` -> (V, 3)."""
        smooth_m = self.smooth(vertices_m)
        of = self._heights_m
        height_m = of["static"] + (1 - bent) * of["straight"] + bent * of["bent"] + (1 + bent / 2) * of["fold"]
        return smooth_m + height_m[:, None] * vertex_normals(smooth_m, self.faces)
