"""The last part of a fit: outlines, to a fraction of a pixel, by Gauss-Newton steps.

Drawn Gaussians lead a fit near the outline, but Adam's few steps do not end on it. Here the surface at which pictures
end is laid onto the masks itself: where it turns away from the camera, before nothing but background, it has to lie
where the mask ends. How far it is from there, along the normal, is linear in small changes of poses, bones and shape. A
pose has numbers of its own, which drop out of what all pictures say of the hand (Schur's complement): a finger that is
a little aside in one picture does not make it thicker.

Everything is before the camera: x right, y down, z forward, meters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import gaussian_filter, map_coordinates

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.native.library import load as load_native
from jghand_engine.own.masks import hand_size_px, wrist_side
from jghand_engine.own.shape import shape_basis
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import DetailedHand, SurfaceHits
from jghand_engine.render.fine_faces import sides_behind
from jghand_engine.template.surface import vertex_normals
from jghand_engine.track.track import MOTION_FROM_CAMERA

# an outline is sought so far to both sides, part of the hand's length, in steps of so many pixels, in a mask that is
# this soft, pixels: its own steps are as wide as a pixel
REACH_PART, STEP_PX, MASK_SOFT_PX = 0.02, 0.25, 0.7
# so far within the surface's outline there is hand, and beyond it none: else another finger is behind, pixels
CLEAR_PX = 2.0
# what a mask says of a point, meters, each as so much of one that has nothing to do with the others; errors beyond the
# third count less and less
NOISE_M, INDEPENDENT, ROBUST_M = 0.0003, 0.2, 0.001
# how far outlines are likely to take each shape, in its units
SHAPE_SPREAD = 0.2
# steps of a fit
STEPS = 4
# joints are moved by this to see where the skin goes, meters
DIFFERENCE_M = 1e-5
# the smallest texture: no color of the surface is looked at
_PLAIN = np.full((4, 4, 3), 128, np.uint8)


@dataclass(frozen=True)
class Outline:
    """Points of one picture at which the surface's outline is not that of the mask.

    away_m:    (P,) how far the skin would have to go outwards, as seen
    by_joints: (P, 63) how far it goes as each number of the joints grows · by_shape: (P, SHAPE_COUNT)
    weight:    (P,) inverse of the variance, per square meter
    """

    away_m: np.ndarray
    by_joints: np.ndarray
    by_shape: np.ndarray
    weight: np.ndarray


class OutlineSurface:
    """The surface at which pictures of a hand end, in a shape (SHAPE_COUNT,), at first in one that is likely.

    prior: a hand that has one, in its own shape · is_known: whether the shape stays
    basis: (SHAPE_COUNT, V, 3) how far each shape that may change carries the canonical vertices, meters; (0, V, 3)
    """

    def __init__(self, prior: HandAvatar, shape: np.ndarray, *, is_known: bool = False) -> None:
        self._prior, info = prior.for_hand(Handedness.RIGHT), prior.info
        assert self._prior.detail is not None
        self._detail = replace(self._prior.detail, texture=_PLAIN, relief=None)
        self._skeleton = self._prior.skeleton()
        self._transform = JointTransform(
            prior.canonical_joints_m, handedness=Handedness.RIGHT, swing=info.swing, scale_mode=info.scale_mode
        )
        faces, behind = self._detail.faces, sides_behind(self._detail.faces)
        # of each side that two faces share, its ends and the faces
        self._sides = np.stack([faces, np.roll(faces, -1, 1)], -1).reshape(-1, 2)[behind >= 0]
        self._faces = np.stack([np.arange(len(behind)), behind], -1)[behind >= 0] // 3
        self._shapes = shape_basis(self._prior, self._detail.position_m).astype(np.float64)
        self.basis = self._shapes[:0] if is_known else self._shapes
        self.likely = shape
        self.in_shape(shape)

    def in_shape(self, shape: np.ndarray) -> None:
        """From here on it has so much (SHAPE_COUNT,) of each shape."""
        self.shape = shape
        place_m = self._detail.position_m + np.einsum("k,kvc->vc", shape, self._shapes)
        detail = replace(self._detail, position_m=place_m.astype(np.float32))
        self._hand = DetailedHand.of(replace(self._prior, detail=detail), 1.0)
        self._hits = SurfaceHits(load_native("auto"), self._hand)

    def outline(self, joints_m: np.ndarray, camera: Camera, mask: np.ndarray) -> Outline:
        """Of one picture, with joints (21, 3) and a mask (H, W) of the hand."""
        bones = self._skeleton.bones(joints_m * MOTION_FROM_CAMERA)
        posed_m = self._hand.posed_m(bones) * MOTION_FROM_CAMERA
        corner = posed_m[self._detail.faces]
        front = (np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) * corner[:, 0]).sum(1) < 0
        ends = self._sides[front[self._faces[:, 0]] & ~front[self._faces[:, 1]]]
        place_m = posed_m[ends].mean(1)
        outwards = vertex_normals(posed_m, self._detail.faces)[ends].mean(1)
        ray = place_m[:, :2] / place_m[:, 2:]
        way = outwards[:, :2] - outwards[:, 2:] * ray
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
        at_px = camera.project(place_m)[0]
        turned = replace(camera, camera_from_world=np.diag([*MOTION_FROM_CAMERA, 1.0]))
        covered = np.isfinite(self._hits(bones, turned)[1]).astype(np.float32)
        joints_px = camera.project(joints_m)[0][None]
        reach_px = REACH_PART * float(hand_size_px(joints_px)[0])
        # both as pictures of pixels: what a corner loses by that, or a fold of the outline, is the same
        edges_px, found = zip(*(_to_the_edge(each, at_px, way, reach_px) for each in (mask, covered)), strict=True)
        side = wrist_side(joints_px, camera.width, camera.height)[0].astype(np.float32)
        ends_there = (_at(covered, at_px + CLEAR_PX * way) < 0.5) & (_at(covered, at_px - CLEAR_PX * way) > 0.5)
        of_hand = np.all([_at(side, at_px + step * way) > 0.5 for step in (-reach_px, 0, reach_px)], 0)
        inside = ((at_px > reach_px) & (at_px < np.array([camera.width, camera.height]) - reach_px)).all(1)
        counts = found[0] & found[1] & ends_there & of_hand & inside
        ends, place_m, ray, way = ends[counts], place_m[counts], ray[counts], way[counts]
        away_m = (edges_px[0] - edges_px[1])[counts] * place_m[:, 2] / camera.fx
        moved_by_joints, linear = self._slopes(joints_m, ends, place_m)
        moved_by_shape = np.einsum("pij,kpj->kpi", linear, self.basis[:, ends].mean(2))
        along = np.concatenate([way, -(way * ray).sum(1, keepdims=True)], 1)
        weight = INDEPENDENT / NOISE_M**2 / (1 + (away_m / ROBUST_M) ** 2)
        by_joints, by_shape = (np.einsum("kpc,pc->pk", each, along) for each in (moved_by_joints, moved_by_shape))
        return Outline(away_m, by_joints, by_shape, weight)

    def _slopes(self, joints_m: np.ndarray, ends: np.ndarray, place_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(63, P, 3) how far points (P, 3) in the middles of sides (P, 2) go with each number of the joints, and
        (P, 3, 3) what a change of the canonical hand becomes there."""
        differences = np.concatenate([np.zeros((1, 63)), DIFFERENCE_M * np.eye(63)]).reshape(-1, 21, 3)
        bones = self._transform.bones(torch.from_numpy(joints_m + differences))
        weights = self._detail.bone_weights[ends].mean(1).astype(np.float64)
        linear = np.einsum("pb,fbij->fpij", weights, bones.linear.numpy())
        offset = np.einsum("pb,fbi->fpi", weights, bones.offset_m.numpy()) + bones.root_m.numpy()[:, None]
        canonical = np.linalg.solve(linear[0], (place_m - offset[0])[..., None])[..., 0]
        moved = np.einsum("fpij,pj->fpi", linear, canonical) + offset
        return (moved[1:] - moved[0]) / DIFFERENCE_M, linear[0]


@dataclass(frozen=True)
class Sought:
    """Numbers that a step changes, K of every picture or of the hand: slopes (F, 63, K) of the joints' numbers by them,
    off (F, K) or (K,) from where they are likely, with this spread (K,)."""

    slopes: np.ndarray
    off: np.ndarray
    spread: np.ndarray


def outline_step(
    surface: OutlineSurface, joints_m: np.ndarray, camera: Camera, masks: np.ndarray, of_poses: Sought, of_hand: Sought
) -> tuple[np.ndarray, np.ndarray]:
    """By how much the numbers of the pictures (F, K) are to grow, and those of the hand, first of its shape, then
    others. joints_m: (F, 21, 3) as they stand · masks: (F, H, W) of the hand"""
    count = len(surface.basis)
    held = np.concatenate([np.full(count, SHAPE_SPREAD), of_hand.spread]) ** -2.0
    off = np.concatenate([(surface.shape - surface.likely)[:count], of_hand.off])
    matrix, right = np.diag(held), -held * off
    held = of_poses.spread**-2.0
    poses = []
    for number, (joints, mask) in enumerate(zip(joints_m, masks, strict=True)):
        found = surface.outline(joints, camera, mask)
        pose = found.by_joints @ of_poses.slopes[number]
        hand = np.concatenate([found.by_shape, found.by_joints @ of_hand.slopes[number]], 1)
        pose_weighted, hand_weighted = (each.T * found.weight for each in (pose, hand))
        own, both = pose_weighted @ pose + np.diag(held), pose_weighted @ hand
        pull = pose_weighted @ found.away_m - held * of_poses.off[number]
        # of what the hand would explain a pose takes its part
        matrix += hand_weighted @ hand - both.T @ np.linalg.solve(own, both)
        right += hand_weighted @ found.away_m - both.T @ np.linalg.solve(own, pull)
        poses.append((own, both, pull))
    grown = np.linalg.solve(matrix, right)
    return np.stack([np.linalg.solve(own, pull - both @ grown) for own, both, pull in poses]), grown


def shape_of_outlines(
    prior: HandAvatar, shape: np.ndarray, joints_m: np.ndarray, camera: Camera, masks: np.ndarray
) -> np.ndarray:
    """(SHAPE_COUNT,) the shape of a hand whose joints (F, 21, 3) are known, from one that is near.
    masks: (F, H, W) of the hand"""
    surface, count = OutlineSurface(prior, shape), len(joints_m)
    slopes, none = np.zeros((count, 63, 0)), np.zeros(0)
    for _ in range(STEPS):
        known = Sought(slopes, np.zeros((count, 0)), none), Sought(slopes, none, none)
        surface.in_shape(surface.shape + outline_step(surface, joints_m, camera, masks, *known)[1])
    return surface.shape


def _to_the_edge(
    mask: np.ndarray, at_px: np.ndarray, way: np.ndarray, reach_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """(P,) how many pixels from places (P, 2) along ways (P, 2) a mask ends, where that is nearest, and (P,) bool
    whether it does."""
    steps = np.arange(-reach_px, reach_px, STEP_PX)
    soft = gaussian_filter(mask.astype(np.float32), MASK_SOFT_PX)
    value = np.stack([_at(soft, at_px + step * way) for step in steps], 1)
    before, after = value[:, :-1], value[:, 1:]
    ends = (before >= 0.5) & (after < 0.5)
    there = steps[:-1] + STEP_PX * (before - 0.5) / np.where(ends, before - after, 1)
    nearest = np.abs(np.where(ends, there, np.inf)).argmin(1)
    return there[np.arange(len(there)), nearest], np.asarray(ends.any(1))


def _at(picture: np.ndarray, at_px: np.ndarray) -> np.ndarray:
    """(P,) of a picture (H, W) at places (P, 2), in which a pixel's middle is at a half."""
    return map_coordinates(picture, [at_px[:, 1] - 0.5, at_px[:, 0] - 0.5], order=1, mode="nearest")
