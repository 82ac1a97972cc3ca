"""The canonical hand surface as plain arrays. It knows no files."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.hand.skeleton import Skeleton


@dataclass(frozen=True)
class HandTemplate:
    """A closed, skinned, UV-mapped right hand in its canonical frame.

    Frame: wrist at the origin, +y wrist to middle MCP, +x to the index side, +z out of the palm; meters.

    identifier:      name and version of the surface, stored with every avatar made from it
    vertices_m:      (V, 3) float64
    faces:           (F, 3) int64, counter-clockwise seen from outside; the first `skin_face_count` are skin, the rest
                     closes the wrist, or the forearm
    face_uv:         (F, 3, 2) float64, one UV per face corner; texture row = 1 - v
    skin_face_count: number of skin faces
    forearm_face_count: how many of these, the last ones, are the forearm's; 0: the hand ends at the wrist
    joints_m:        (21, 3) float64, level order
    bone_weights:    (V, 21) float64, rows sum to 1; column i is the bone that *ends* at joint i (B_i), column 0 the
                     palm's B_0 (METHOD 2.7)
    """

    identifier: str
    vertices_m: np.ndarray
    faces: np.ndarray
    face_uv: np.ndarray
    skin_face_count: int
    joints_m: np.ndarray
    bone_weights: np.ndarray
    forearm_face_count: int = 0

    @property
    def is_forearm(self) -> np.ndarray:
        """(F,) whether a face is of the forearm's skin."""
        number = np.arange(len(self.faces))
        return (number >= self.skin_face_count - self.forearm_face_count) & (number < self.skin_face_count)

    @property
    def has_points(self) -> np.ndarray:
        """(F,) whether Gaussians lie under a face: not where a forearm is cut, which nobody is shown."""
        number = np.arange(len(self.faces))
        return (number < self.skin_face_count) | (self.forearm_face_count == 0)


def posed_vertices(template: HandTemplate, skeleton: Skeleton, joints_m: np.ndarray) -> np.ndarray:
    """(V, 3) float64 vertices by linear blend skinning, in the world of joints_m (21, 3), meters.

    template: the right hand, whichever hand is posed
    skeleton: of the template's joints and the hand's handedness
    """
    return skinned(template.vertices_m, template.bone_weights, skeleton, joints_m)


def skinned(
    vertices_m: np.ndarray,
    weights: np.ndarray,
    skeleton: Skeleton,
    joints_m: np.ndarray,
    forearm: np.ndarray | None = None,
) -> np.ndarray:
    """The same of any shape (V, 3), canonical as the skeleton is. weights: (V, 21) of its bones, or of all its maps
    (`HandAvatar.map_weights`), with which a forearm turns · forearm: how, as `HandPose` has it"""
    bones = skeleton.bones(joints_m, np.float64, forearm=forearm)
    maps = np.einsum("vb,bij->vij", weights, bones.linear_offset[: weights.shape[1]])
    relative_m = vertices_m - skeleton.canonical_root_m
    return np.einsum("vij,vj->vi", maps[..., :3], relative_m) + maps[..., 3] + bones.root_m


def mirrored(template: HandTemplate) -> HandTemplate:
    """The other hand: x -> -x, corners of faces and of UVs reversed so that faces still look outwards.

    Exact: mirroring twice gives the same bits. Textures, weights and joint order stay as they are. The result is for
    drawing and export; the engine itself drives left hands with mirrored joints on the right hand's surface.
    """
    flip = np.array([-1.0, 1.0, 1.0])
    return replace(
        template,
        vertices_m=template.vertices_m * flip,
        joints_m=template.joints_m * flip,
        faces=template.faces[:, ::-1].copy(),
        face_uv=template.face_uv[:, ::-1].copy(),
    )
