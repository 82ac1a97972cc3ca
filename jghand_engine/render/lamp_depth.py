"""Pictures of the surface of hands that are taken from lamps. Kernels ask them at every Gaussian what of the lamp's
light reaches the skin above it (native/lamp_depth.h), and at pixels (native/pixel_shadow.h): edges of shadows are those
of the surface then, not of capsules.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import Blocks, compact_order
from jghand_engine.avatar.cast_task import anchor_blocks
from jghand_engine.avatar.detail import Detail
from jghand_engine.avatar.scene_light import Lamp
from jghand_engine.native.binding import aligned_zeros
from jghand_engine.native.scene_light_task import LAMP_TAPS, NUMBER, Above, LampDepth, LampKind
from jghand_engine.native.threads import WorkerPool
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import NativeDetail
from jghand_engine.render.effect_plan import Sharp
from jghand_engine.render.hand_facts import Ball
from jghand_engine.render.shadow import vogel_disc

# pixels along a side, 0.4 mm each of a hand with its forearm, between which pixels of an image ask
SIDE_PX = 1024
# parallel rays begin so far before the hands, meters: what stands still farther away is left out
PARALLEL_FROM_M = 1.0
# radii of the ball from which on rays from a lamp are parallel: single precision measures depth worse from there
PARALLEL_RADII = 1000.0
# neighboring Gaussians that look for their vertices together
NEAREST_TOGETHER = 128
# that distances in single precision are good for
ROUNDING_M = 1e-6
# square of an area, m4, as a divisor
AREA2_MIN = 1e-20

# rows of vertices and shares, (blocks, 3, 16)
_Above = tuple[np.ndarray, np.ndarray]


def seen_from(lamp: Lamp, ball: Ball) -> Camera:
    """What a lamp that stands outside sees of a ball, SIDE_PX wide. Rays from far away are parallel."""
    way_m = np.array(lamp.place_m, np.float64) - (0 if lamp.kind is LampKind.SUN else ball.middle_m)
    distance_m = float(np.linalg.norm(way_m))
    is_parallel = lamp.kind is LampKind.SUN or distance_m > PARALLEL_RADII * ball.radius_m
    if is_parallel:
        way_m *= (PARALLEL_FROM_M + ball.radius_m) / distance_m
    # of rays that graze the ball
    tangent = ball.radius_m if is_parallel else 1 / math.sqrt((distance_m / ball.radius_m) ** 2 - 1)
    up, focal_px = np.eye(3)[np.abs(way_m).argmin()], SIDE_PX / (2 * tangent)
    eye_m = ball.middle_m + way_m
    camera = Camera.looking_at(eye_m, ball.middle_m, up, width=SIDE_PX, height=SIDE_PX, focal_px=focal_px)
    return replace(camera, orthographic=is_parallel)


def _radius2(lamp: Lamp, ball: Ball, *, is_parallel: bool) -> float:
    """Of what shines, m2; of parallel rays the squared sine of half its angle."""
    sun_sine, radius2 = (float(lamp.numbers[NUMBER[name]]) for name in ("sun_sine", "radius2"))
    if lamp.kind is LampKind.SUN:
        return sun_sine**2
    apart2 = float(np.square(lamp.place_m - ball.middle_m).sum())
    return radius2 / (apart2 + radius2) if is_parallel else radius2


class LampPictures:
    """Takes the pictures for hands whose surfaces `detail` draws, all of them."""

    def __init__(self, detail: NativeDetail, avatars: Sequence[HandAvatar]) -> None:
        self._detail, self._avatars = detail, avatars
        self._disc = aligned_zeros((2, LAMP_TAPS))
        self._disc[...] = vogel_disc(LAMP_TAPS).T
        # per hand, once it is asked for
        self._above: dict[int, tuple[_Above, _Above]] = {}
        # what the last ones point to; the memory of the first serves the next ones
        self._near: list[np.ndarray] = []
        self._vertices: list[np.ndarray] = []

    def take(
        self,
        lamps: Sequence[Lamp],
        sharp: Sequence[Sharp],
        scales: Sequence[float],
        origin_m: np.ndarray,
        pool: WorkerPool,
        layers: Sequence[int] = (),
    ) -> list[dict[int, LampDepth]]:
        """Per hand what the kernel needs of each lamp that has a weight, by the lamp's number; it points to arrays that
        stand until the next call. The pose is that in which `detail` has the hands.

        sharp:    per hand; each has pictures of its own, in which the others stand, too
        scales:   of the hands
        origin_m: (3,) of the positions, in the frame of the lamps
        layers:   numbers of the lamps whose light is drawn apart
        """
        self._vertices = []
        taken = [
            {
                number: self._picture(
                    hand,
                    lamps[number],
                    one.ball,
                    origin_m,
                    pool,
                    part=weight,
                    scale=scale,
                    layer=layers.index(number) if number in layers else -1,
                )
                for number, weight in enumerate(one.weights)
                if weight > 0
            }
            for hand, (one, scale) in enumerate(zip(sharp, scales, strict=True))
        ]
        # of lamps that are there no more
        del self._near[len(self._vertices) :]
        return taken

    def _picture(
        self,
        hand: int,
        lamp: Lamp,
        ball: Ball,
        origin_m: np.ndarray,
        pool: WorkerPool,
        *,
        part: float,
        scale: float,
        layer: int,
    ) -> LampDepth:
        camera = seen_from(lamp, ball).about(origin_m)
        if (place := len(self._vertices)) == len(self._near):
            self._near.append(np.empty((camera.height, camera.width), np.float32))
        near = self._near[place]
        vertices = self._detail.surfaces(camera, hand, pool, near).copy()
        self._vertices.append(vertices)
        skin, anchors = self._above_hand(hand)
        return LampDepth(
            near=near.ctypes.data,
            disc=self._disc.ctypes.data,
            vertex=vertices.ctypes.data,
            skin=Above(*(array.ctypes.data for array in skin)),
            anchors=Above(*(array.ctypes.data for array in anchors)),
            axes=tuple(camera.camera_from_world[:3, :3].ravel().tolist()),
            place=tuple(camera.camera_from_world[:3, 3].tolist()),
            focal=camera.fx,
            part=part,
            scale=scale,
            radius2=_radius2(lamp, ball, is_parallel=camera.orthographic),
            size=camera.width,
            orthographic=camera.orthographic,
            rows=vertices.shape[1],
            layer=layer,
        )

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
    places_m, order_of_places = position_m.astype(np.float32), compact_order(position_m)
    drawn = np.unique(detail.faces)
    vertices_m = detail.position_m[drawn].astype(np.float32)
    square_m2 = np.square(vertices_m).sum(1)
    # faces by vertex: each stands three times in `order`
    at = detail.faces.ravel()
    order, begin = at.argsort(kind="stable"), np.searchsorted(np.sort(at), np.arange(len(detail.position_m) + 1))
    of_nearest = np.arange(np.diff(begin).max())
    vertex, shares = np.empty((len(places_m), 3), np.int64), np.empty((len(places_m), 3), np.float32)
    for rows in np.array_split(order_of_places, 1 + len(places_m) // NEAREST_TOGETHER):
        part = places_m[rows]
        # vertices that can be the nearest of any place in the ball around these
        middle_m = part.mean(0)
        radius_m, from_middle_m = (np.linalg.norm(of - middle_m, axis=1) for of in (part, vertices_m))
        near = np.flatnonzero(from_middle_m <= from_middle_m.min() + 2 * radius_m.max(initial=0.0) + ROUNDING_M)
        from_places_m2 = square_m2[near] - 2 * part @ vertices_m[near].T
        nearest = drawn[near[from_places_m2.argmin(1)]]
        place = begin[nearest, None] + of_nearest
        face = detail.faces[order[np.minimum(place, len(order) - 1)] // 3]
        share, apart2_m2 = _on_faces(detail.position_m[face].astype(np.float32), part)
        best = np.where(place < begin[nearest + 1, None], apart2_m2, np.inf).argmin(1)
        of_part = np.arange(len(rows))
        vertex[rows], shares[rows] = face[of_part, best], share[of_part, best]
    return vertex, shares


def _on_faces(corners_m: np.ndarray, places_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares (N, F, 3) of the corners of faces (N, F, 3, 3), meters, in a point near each of places (N, 3), and the
    squares of how far that is (N, F)."""
    first_m, sides_m = corners_m[..., 0, :], corners_m[..., 1:, :] - corners_m[..., :1, :]
    along = np.einsum("nfkc,nfc->nfk", sides_m, places_m[:, None] - first_m)
    metric = np.einsum("nfkc,nflc->nfkl", sides_m, sides_m)
    area2 = np.maximum(metric[..., 0, 0] * metric[..., 1, 1] - metric[..., 0, 1] ** 2, AREA2_MIN)
    second = (metric[..., 1, 1] * along[..., 0] - metric[..., 0, 1] * along[..., 1]) / area2
    third = (metric[..., 0, 0] * along[..., 1] - metric[..., 0, 1] * along[..., 0]) / area2
    share = np.maximum(np.stack([1 - second - third, second, third], -1), 0)
    share /= share.sum(-1, keepdims=True)
    return share, np.square(np.einsum("nfk,nfkc->nfc", share, corners_m) - places_m[:, None]).sum(-1)
