"""Pictures of the surface of hands that are taken from lamps. The kernel asks them at every Gaussian what of the lamp's
light reaches the skin above it (native/lamp_depth.h): edges of shadows are those of the surface then, not of capsules.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import Blocks
from jghand_engine.avatar.cast_task import anchor_blocks
from jghand_engine.avatar.detail import Detail
from jghand_engine.avatar.scene_light import Lamp
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native.binding import aligned_zeros
from jghand_engine.native.scene_light_task import LAMP_TAPS, Above, LampDepth, LampKind
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import NativeDetail
from jghand_engine.render.hand_facts import box_corners
from jghand_engine.render.shadow import vogel_disc

# pixels along a side, 0.8 mm each of a hand with its forearm: Gaussians are 1 mm apart, more pixels show no more
SIDE_PX = 512
# parallel rays begin so far before the hands, meters: what stands still farther away is left out
PARALLEL_FROM_M = 1.0
# radii of the ball around the hands, between which a lamp that comes nearer loses its picture: it sees less of them
APART_LEAST, APART_WHOLE = 1.3, 1.6
# Gaussians that look for their vertex together: 60 MB
NEAREST_TOGETHER = 2048
# square of an area, m4, as a divisor
AREA2_MIN = 1e-20

# rows of vertices and shares, (blocks, 3, 16)
_Above = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Ball:
    """middle_m: (3,) · radius_m: of what lies around some hands"""

    middle_m: np.ndarray
    radius_m: float

    def apart(self, lamp: Lamp) -> float:
        """How far a lamp is from the middle, in radii; infinity of a sun."""
        if lamp.kind is LampKind.SUN:
            return math.inf
        return math.dist(lamp.place_m, self.middle_m) / max(self.radius_m, float(np.finfo(np.float32).tiny))

    def seen_from(self, lamp: Lamp) -> Camera:
        """What a lamp sees of it that stands outside, SIDE_PX wide."""
        place_m, is_sun = np.asarray(lamp.place_m, np.float64), lamp.kind is LampKind.SUN
        way_m = place_m / np.linalg.norm(place_m) if is_sun else place_m - self.middle_m
        if is_sun:
            way_m *= PARALLEL_FROM_M + self.radius_m
        # rays that graze the ball
        tangent = self.radius_m if is_sun else 1 / math.sqrt(self.apart(lamp) ** 2 - 1)
        up, focal_px = np.eye(3)[np.abs(way_m).argmin()], SIDE_PX / (2 * tangent)
        eye_m = self.middle_m + way_m
        camera = Camera.looking_at(eye_m, self.middle_m, up, width=SIDE_PX, height=SIDE_PX, focal_px=focal_px)
        return replace(camera, orthographic=is_sun)


class LampPictures:
    """Takes the pictures for hands whose surfaces `detail` draws, all of them."""

    def __init__(self, detail: NativeDetail, avatars: Sequence[HandAvatar]) -> None:
        self._detail, self._avatars = detail, avatars
        self._boxes = [box_corners(avatar) for avatar in avatars]
        self._disc = aligned_zeros((2, LAMP_TAPS))
        self._disc[...] = vogel_disc(LAMP_TAPS).T
        # per hand, once it is asked for
        self._above: dict[int, tuple[_Above, _Above]] = {}
        # what the last ones point to
        self._taken: list[np.ndarray] = []

    def take(
        self,
        lamps: Sequence[Lamp],
        weights: Sequence[float],
        bones: Sequence[Bones],
        origin_m: np.ndarray,
        seen: Sequence[bool],
    ) -> list[dict[int, LampDepth]]:
        """Per hand what the kernel needs of each lamp that has a weight, by the lamp's number; it points to arrays that
        stand until the next call. The pose is that in which `detail` has the hands.

        weights:  (lamps,) 0..1, how much a picture counts beside capsules
        bones:    per hand
        origin_m: (3,) of the positions, in the frame of the lamps
        seen:     per hand whether it is lit; the others only stand before lamps
        """
        self._taken = []
        found: list[dict[int, LampDepth]] = [{} for _ in bones]
        if not any(weights):
            return found
        lit = [hand for hand, is_seen in enumerate(seen) if is_seen]
        ball = self._ball([bones[hand] for hand in lit], [self._boxes[hand] for hand in lit])
        for number, (lamp, weight) in enumerate(zip(lamps, weights, strict=True)):
            part = weight * min(max((ball.apart(lamp) - APART_LEAST) / (APART_WHOLE - APART_LEAST), 0.0), 1.0)
            if part == 0:
                continue
            camera = ball.seen_from(lamp)
            from_origin = camera.camera_from_world.copy()
            from_origin[:3, 3] += from_origin[:3, :3] @ origin_m
            near, vertices = self._detail.surfaces(replace(camera, camera_from_world=from_origin))
            self._taken += [near, *vertices]
            for hand in lit:
                skin, anchors = self._above_hand(hand)
                found[hand][number] = LampDepth(
                    near=near.ctypes.data,
                    disc=self._disc.ctypes.data,
                    vertex=vertices[hand].ctypes.data,
                    skin=Above(*(array.ctypes.data for array in skin)),
                    anchors=Above(*(array.ctypes.data for array in anchors)),
                    axes=tuple(from_origin[:3, :3].ravel().tolist()),
                    focal=camera.fx,
                    part=part,
                    scale=bones[hand].scale,
                    size=SIDE_PX,
                    orthographic=camera.orthographic,
                    rows=vertices[hand].shape[1],
                )
        return found

    @staticmethod
    def _ball(bones: Sequence[Bones], boxes: Sequence[tuple[np.ndarray, np.ndarray]]) -> Ball:
        """Around the skin of some hands, in the frame of the joints."""
        corners_m = [
            (one.maps[moving] @ box_m).swapaxes(0, 1).reshape(3, -1) + one.root_m[:, None]
            for one, (moving, box_m) in zip(bones, boxes, strict=True)
        ]
        every_m = np.concatenate(corners_m, 1)
        middle_m = (every_m.min(1) + every_m.max(1)) / 2
        return Ball(middle_m, math.sqrt(np.square(every_m - middle_m[:, None]).sum(0).max()))

    def _above_hand(self, hand: int) -> tuple[_Above, _Above]:
        """`LampDepth`'s skin and anchors of a hand that a scene can light."""
        if hand not in self._above:
            avatar = self._avatars[hand]
            assert avatar.detail is not None
            assert avatar.learned is not None
            assert avatar.learned.cast is not None
            anchors, of_vertices = avatar.learned.cast.anchors, self._detail.rows_of_vertices(hand)
            vertex, share = skin_above(avatar.detail, avatar.position_m)
            of_anchors = skin_above(avatar.detail, anchors.position_m)
            self._above[hand] = (
                _blocked(Blocks.of(avatar.position_m), of_vertices[vertex], share),
                _blocked(anchor_blocks(anchors.position_m, anchors.normal), of_vertices[of_anchors[0]], of_anchors[1]),
            )
        return self._above[hand]


def _blocked(blocks: Blocks, corner: np.ndarray, share: np.ndarray) -> _Above:
    return blocks.blocked(corner, np.int32), blocks.blocked(share)


def skin_above(detail: Detail, position_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the vertices (N, 3) of the surface around canonical places (N, 3), meters, and the shares of each: of
    the faces at the nearest vertex the one that is nearest."""
    vertices_m, places_m = detail.position_m.astype(np.float32), position_m.astype(np.float32)
    square = np.square(vertices_m).sum(1)
    parts = np.array_split(places_m, 1 + len(places_m) // NEAREST_TOGETHER)
    nearest = np.concatenate([(square - 2 * part @ vertices_m.T).argmin(1) for part in parts])
    # faces by vertex: each stands three times in `order`
    at = detail.faces.ravel()
    order, begin = at.argsort(kind="stable"), np.searchsorted(np.sort(at), np.arange(len(vertices_m) + 1))
    place = begin[nearest, None] + np.arange(np.diff(begin).max())
    face = order[np.minimum(place, len(order) - 1)] // 3
    corners_m = vertices_m[detail.faces[face]]
    first_m, sides_m = corners_m[..., 0, :], corners_m[..., 1:, :] - corners_m[..., :1, :]
    along = np.einsum("nfkc,nfc->nfk", sides_m, places_m[:, None] - first_m)
    metric = np.einsum("nfkc,nflc->nfkl", sides_m, sides_m)
    area2 = np.maximum(metric[..., 0, 0] * metric[..., 1, 1] - metric[..., 0, 1] ** 2, AREA2_MIN)
    second = (metric[..., 1, 1] * along[..., 0] - metric[..., 0, 1] * along[..., 1]) / area2
    third = (metric[..., 0, 0] * along[..., 1] - metric[..., 0, 1] * along[..., 0]) / area2
    share = np.maximum(np.stack([1 - second - third, second, third], -1), 0)
    share /= share.sum(-1, keepdims=True)
    apart2 = np.square(np.einsum("nfk,nfkc->nfc", share, corners_m) - places_m[:, None]).sum(-1)
    best = np.where(place < begin[nearest + 1, None], apart2, np.inf).argmin(1)
    rows = np.arange(len(places_m))
    return detail.faces[face[rows, best]], share[rows, best]
