"""An avatar in another shape: what it has in its canonical hand moves with a surface that lies there.

The canonical joints stay, so that everything that is measured from them does: bones, angles, flesh, where the wrist and
the forearm end. Lengths of bones, and the hand's size with its thickness, come with the joints that drive it; the
surface has what is left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.avatar.avatar import SIGMA_MAX_M, SIGMA_MIN_M, HandAvatar
from jghand_engine.avatar.learned import Anchors
from jghand_engine.hand.kinematics import NO_FIST
from jghand_engine.hand.rotations import unit
from jghand_engine.hand.skeleton import Bones, Skeleton
from jghand_engine.template.closest import ClosestPoints, Surface
from jghand_engine.template.surface import face_normals

# edges of a face whose area is below this are no directions, square meters: slivers of the wrist's cap
AREA_MIN_M2 = 1e-12


def pulled_back(skeleton: Skeleton, posed_m: np.ndarray, bone_weights: np.ndarray, bones: Bones) -> np.ndarray:
    """(V, 3) canonical places that skinning carries to `posed_m` (V, 3) in the pose of the skeleton's `bones`, float64:
    the inverse of `mesh.skinned`. bone_weights: (V, 21), or of all maps"""
    maps = np.einsum("vb,bij->vij", bone_weights, bones.linear_offset[: bone_weights.shape[1]])
    relative = posed_m - bones.root_m - maps[..., 3]
    return np.linalg.solve(maps[..., :3], relative[..., None])[..., 0] + skeleton.canonical_root_m


def reshaped(avatar: HandAvatar, faces: np.ndarray, before_m: np.ndarray, after_m: np.ndarray) -> HandAvatar:
    """The avatar as if the surface that its skin lies on had changed: what is beside a point of it stays so, turned and
    stretched as it is there.

    faces:             (F, 3) of a closed surface in the avatar's canonical hand, such as its template's, as fine as the
                       change is
    before_m, after_m: (V, 3) meters; a surface that does not change changes no bit
    Gaussians that are ellipsoids keep the turn of their axes. The fist that its skin wanted is forgotten.
    """
    change = _Change.of(Surface(before_m, faces), faces, before_m, after_m)
    position_m, stretch = change.places(avatar.position_m)
    # by how much lengths grow, on average over directions
    growth = np.cbrt(np.abs(np.linalg.det(np.eye(3) + stretch)))
    sigma_m = (avatar.sigma_m * growth).clip(SIGMA_MIN_M, SIGMA_MAX_M).astype(np.float32)
    learned, detail = avatar.learned, avatar.detail
    if learned is not None:
        learned = replace(learned, normal=_turned(learned.normal, stretch))
        if learned.cast is not None:
            learned = learned.with_anchors(_moved(learned.cast.anchors, change), avatar.canonical_joints_m)
    if detail is not None:
        detail = replace(detail, position_m=change.places(detail.position_m)[0])
    return replace(avatar, position_m=position_m, sigma_m=sigma_m, learned=learned, detail=detail, fist=NO_FIST)


def places_after(points_m: np.ndarray, faces: np.ndarray, before_m: np.ndarray, after_m: np.ndarray) -> np.ndarray:
    """(K, N, 3) float32 where `reshaped` carries points (N, 3) by each of K changes. after_m: (K, V, 3)"""
    surface = Surface(before_m, faces)
    near = surface.closest(points_m.astype(np.float64))
    changes = (_Change.of(surface, faces, before_m, one) for one in after_m)
    return np.stack([change.places_at(points_m, near)[0] for change in changes])


@dataclass(frozen=True)
class _Change:
    """surface: before · faces: (F, 3) · offset_m: (V, 3) · stretch: (V, 3, 3), less the identity"""

    surface: Surface
    faces: np.ndarray
    offset_m: np.ndarray
    stretch: np.ndarray

    @classmethod
    def of(cls, surface: Surface, faces: np.ndarray, before_m: np.ndarray, after_m: np.ndarray) -> _Change:
        offset_m = np.asarray(after_m, np.float64) - before_m
        stretch = _stretch(faces, np.asarray(before_m, np.float64), offset_m)
        return cls(surface, faces, offset_m, stretch)

    def places(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (N, 3) -> (N, 3) float32 where they are now, and (N, 3, 3) how what is there is stretched, less the
        identity."""
        return self.places_at(points_m, self.surface.closest(points_m.astype(np.float64)))

    def places_at(self, points_m: np.ndarray, near: ClosestPoints) -> tuple[np.ndarray, np.ndarray]:
        """The same of points whose nearest ones of the surface are known."""
        points = points_m.astype(np.float64)
        corners, shares = self.faces[near.face], near.barycentric
        offset_m = np.einsum("nk,nkc->nc", shares, self.offset_m[corners])
        stretch = np.einsum("nk,nkij->nij", shares, self.stretch[corners])
        moved = points + offset_m + np.einsum("nij,nj->ni", stretch, points - near.point_m)
        return moved.astype(np.float32), stretch


def _stretch(faces: np.ndarray, before_m: np.ndarray, offset_m: np.ndarray) -> np.ndarray:
    """(V, 3, 3) the linear map of the change at each vertex, less the identity: the mean of its faces by their area.

    A face turns and stretches as its edges do; across it what is below the skin grows as the root of its area.
    """
    after_m = before_m + offset_m
    sides, moves = (m[faces[:, 1:]] - m[faces[:, :1]] for m in (before_m, offset_m))
    area, new_area = (np.linalg.norm(np.cross(*np.moveaxis(m, 1, 0)), axis=1) for m in (sides, sides + moves))
    good = (area > AREA_MIN_M2) & (new_area > AREA_MIN_M2)
    faces, sides, moves, area = faces[good], sides[good], moves[good], area[good]
    normal = face_normals(before_m, faces)
    thicker = np.sqrt(new_area[good] / area)[:, None] * face_normals(after_m, faces) - normal
    # rows are directions: change = direction @ map^T
    directions = np.concatenate([sides, normal[:, None]], 1)
    changes = np.concatenate([moves, thicker[:, None]], 1)
    maps = np.linalg.solve(directions, changes).swapaxes(1, 2)
    total, weight = np.zeros((len(before_m), 3, 3)), np.zeros(len(before_m))
    for corner in range(3):
        np.add.at(total, faces[:, corner], area[:, None, None] * maps)
        np.add.at(weight, faces[:, corner], area)
    return total / np.maximum(weight, AREA_MIN_M2)[:, None, None]


def _turned(normal: np.ndarray, stretch: np.ndarray) -> np.ndarray:
    """(N, 3) float32 normals of the stretched skin. Where nothing is stretched they keep their bits."""
    inverse = np.linalg.inv(np.eye(3) + stretch)
    turned = unit(np.einsum("nji,nj->ni", inverse, normal.astype(np.float64))).astype(np.float32)
    is_stretched = np.abs(stretch).max((1, 2), keepdims=True)[..., 0] > 0
    return np.where(is_stretched, turned, normal)


def _moved(anchors: Anchors, change: _Change) -> Anchors:
    position_m, stretch = change.places(anchors.position_m)
    return replace(anchors, position_m=position_m, normal=_turned(anchors.normal, stretch))
