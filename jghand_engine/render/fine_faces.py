"""The faces of a surface parted into four each, for hands that are so large in a picture that outlines show corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# vertices around the middle of a side; of native/detail_surface.h
AROUND_SIDE = 8
# how much they count: the two ends of the side, the two corners across it, and the four across the sides beside it.
# Source: Dyn, Levin, Gregory, A butterfly subdivision scheme for surface interpolation with tension control, 1990, with
# their tension of 1/16
SHARES = np.array([1 / 2, 1 / 2, 1 / 8, 1 / 8, *[-1 / 16] * 4])
# one of the four that is missing is taken to lie where the face beside, as a parallelogram, would have it: then the
# first four, each of one side, change by so much
MISSING = np.array([[1, -1, -1, 0], [-1, 1, -1, 0], [-1, 1, 0, -1], [1, -1, 0, -1]]) / 16
# where the surface ends: the two ends, and the next along that border; on one curve through the four
SHARES_AT_BORDER = np.array([9 / 16, 9 / 16, 0, 0, -1 / 16, -1 / 16, 0, 0])


@dataclass(frozen=True)
class FineFaces:
    """faces:  (4 F, 3) vertices; those in the middles of sides are numbered behind the surface's own
    face_uv:   (4 F, 3, 2), linear within each coarse face
    around:    (S, 8) the surface's vertices around each of those in the middle, in the order of SHARES
    share:     (S, 8) how much each counts
    """

    faces: np.ndarray
    face_uv: np.ndarray
    around: np.ndarray
    share: np.ndarray

    @classmethod
    def of(cls, faces: np.ndarray, face_uv: np.ndarray, vertex_count: int) -> FineFaces:
        """faces (F, 3), face_uv (F, 3, 2)."""
        own, back = np.arange(faces.size), sides_behind(faces)
        # a side between two faces is numbered by the first of them
        first, number = np.unique(np.where(back < 0, own, np.minimum(back, own)), return_inverse=True)
        ends = np.stack([faces, np.roll(faces, -1, 1)], -1).reshape(-1, 2)
        corner = np.roll(faces, -2, 1).ravel()
        # -1 where none is
        across = np.where(back < 0, -1, corner[back]).reshape(-1, 3)
        beside = np.stack([np.roll(across, -1, 1), np.roll(across, -2, 1)], -1).reshape(-1, 2)
        second = back[first]
        around = np.column_stack([ends[first], corner[first], corner[second], beside[first], beside[second]])
        share, missing = np.tile(SHARES, (len(around), 1)), around[:, 4:] < 0
        share[:, :4] += missing @ MISSING
        share[:, 4:][missing] = 0
        border, (after, before) = second < 0, np.zeros((2, vertex_count), faces.dtype)
        start, end = ends[first[border]].T
        after[start], before[end] = end, start
        around[border, 4:6] = np.column_stack([before[start], after[end]])
        share[border] = SHARES_AT_BORDER
        around = np.where(share == 0, around[:, :1], around)
        middle_uv = (face_uv + np.roll(face_uv, -1, 1)) / 2
        return cls(
            parted_in_four(faces, vertex_count + number.reshape(faces.shape)),
            parted_in_four(face_uv, middle_uv),
            around,
            share,
        )

    def with_middles(self, values: np.ndarray) -> np.ndarray:
        """(V + S, ...) of values (V, ...) at the surface's own vertices, behind them those in the middles of sides."""
        middles = np.einsum("sk,sk...->s...", self.share, values[self.around])
        return np.concatenate([values, middles])


def opposite_vertices(faces: np.ndarray) -> np.ndarray:
    """(F, 3) of faces (F, 3): the vertex across the side from each corner to the next; that corner where none is."""
    back = sides_behind(faces)
    return np.where(back < 0, faces.ravel(), np.roll(faces, -2, 1).ravel()[back]).reshape(-1, 3)


def sides_behind(faces: np.ndarray) -> np.ndarray:
    """(3 F,) of faces (F, 3): the side of another face that is the one from each corner to the next, the other way
    round; -1 where there is none. Sides are numbered as the corners that they start from."""
    start, end = faces.astype(np.int64), np.roll(faces, -1, 1)
    base = int(faces.max(initial=0)) + 1
    side, back = (start * base + end).ravel(), (end * base + start).ravel()
    order = np.argsort(side)
    found = order[np.searchsorted(side, back, sorter=order).clip(max=len(side) - 1)]
    return np.where(side[found] == back, found, -1)


def parted_in_four(corners: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """(4F, 3, ...) of values (F, 3, ...) at the corners of faces, and in the middles of the edges that leave them: the
    three outside, then the one inside."""
    (a, b, c), (ab, bc, ca) = np.moveaxis(corners, 1, 0), np.moveaxis(middles, 1, 0)
    four = [np.stack(three, 1) for three in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
    return np.stack(four, 1).reshape(-1, *corners.shape[1:])
