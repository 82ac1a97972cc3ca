"""The fine surface of a hand under its skin, posed: smooth, and moved by what the maps' heights have that is coarse."""

from __future__ import annotations

import numpy as np

from jghand_engine.captures.making.rig import FIRST_JOINTS, Identity
from jghand_engine.captures.skin.canvas import MM
from jghand_engine.captures.skin.maps import SkinMaps
from jghand_engine.captures.skin.noise import gauss, smoothstep
from jghand_engine.hand.joints import PARENTS
from jghand_engine.hand.rotations import unit
from jghand_engine.template.subdivision import Subdivision
from jghand_engine.template.surface import vertex_normals
from jghand_engine.template.texture import sample_bilinear

# the joints that bend skin, level order: all that have a bone on both sides
BENDING = np.arange(1, 16)
# bend over which the skin of a joint goes from straight to bent, degrees
BEND_DEG = (8.0, 70.0)
# the thumb's first two joints are bent in the canonical hand: so much of it is none, degrees
THUMB_JOINTS, THUMB_REST_DEG = (1, 6), 25.0
# how far a joint bends the skin of its finger, mm; a first joint that of the hand as well, over this and this strongly
REACH_MM, REACH_ON_HAND_MM, ON_HAND = 7.0, 9.0, 0.35
# what skin far from all joints counts as, against weights of 1 at a joint: straight
STRAIGHT = 0.02


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
        self._near = _nearness(identity, fine.matrix)
        self._rest_deg = np.zeros(len(BENDING))
        thumb = np.isin(BENDING, THUMB_JOINTS)
        self._rest_deg[thumb] = np.minimum(bends_deg(identity.joints_m[None])[0, thumb], THUMB_REST_DEG)

    def bent(self, joints_m: np.ndarray) -> np.ndarray:
        """Posed joints (P, 21, 3), level order -> (P, V) 0..1, how bent the joint near each vertex is."""
        amount = smoothstep(*BEND_DEG, bends_deg(joints_m) - self._rest_deg)
        return (amount @ self._near.T / (self._near.sum(1) + STRAIGHT)).astype(np.float32)

    def posed(self, vertices_m: np.ndarray, bent: np.ndarray) -> np.ndarray:
        """The coarse mesh posed (v, 3), and one row of `bent` -> (V, 3)."""
        smooth_m = self._matrix @ vertices_m
        of = self._heights_m
        height_m = of["static"] + (1 - bent) * of["straight"] + bent * of["bent"] + (1 + bent / 2) * of["fold"]
        return smooth_m + height_m[:, None] * vertex_normals(smooth_m, self.faces)


def bends_deg(joints_m: np.ndarray) -> np.ndarray:
    """(P, 21, 3) level order -> (P, 15) angles between the two bones at BENDING."""
    before = unit(joints_m[:, BENDING] - joints_m[:, np.array(PARENTS)[BENDING]])
    after = unit(joints_m[:, BENDING + 5] - joints_m[:, BENDING])
    return np.degrees(np.arccos(np.clip((before * after).sum(-1), -1, 1)))


def _nearness(identity: Identity, matrix) -> np.ndarray:
    """(V, 15) how much each joint of BENDING says about each vertex."""
    rest, weights = matrix @ identity.vertices_m, matrix @ identity.weights25
    fingers = np.stack([weights[:, first : first + 4].sum(1) for first in FIRST_JOINTS], 1)
    distance_mm = np.linalg.norm(rest[:, None] - identity.joints_m[BENDING], axis=-1) / MM
    share = np.tile(fingers, 3)
    share[:, :5] = np.maximum(share[:, :5], ON_HAND * gauss(distance_mm[:, :5], REACH_ON_HAND_MM))
    return gauss(distance_mm, REACH_MM) * share
