"""The skin that closes a hand where it ends, for eyes behind it: a dome across the forearm, or the wrist.

Skin that faces away is not drawn, so an open end would show what lies before the hand, through it. From the side a hand
fades out there, and nobody sees a cap: it comes into sight as the eye gets behind it, and the fade narrows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.avatar.detail import NO_RATIO, Detail
from jghand_engine.hand.rotations import unit

# Gaussians of a cap, 2 mm apart on a forearm, and how many faces along its sides, two of which make a square
GAUSSIANS, SQUARES = 600, 14
# of Gaussians: sigma over the way between neighbors, by which their sum is even to a hundredth
SIGMA_PART = 0.7
# how far its edge is before that of the skin, meters, and its radius over that of the skin, there or nearer to the end,
# which is less: it lies below it
WITHIN_M, BELOW = 0.012, 0.985
# how far around its middle the skin's radius is a mean, radians
AROUND_RAD = 0.07
# how far it bulges, over its mean radius: so that light changes evenly from the skin to its middle
BULGE = 0.7
# skin so near to the plane of its edge goes on as it, meters
EDGE_M = 0.006
# cosines between the ways from its middle to the eye and out of the hand, over which it comes into sight: from farther
# aside nobody sees deeper into the end than skin is drawn from both sides (`hidden_from`)
SEEN_FROM, SEEN_WHOLLY = 0.68, 0.78
# ... where nothing but Gaussians shows where a hand ends
SEEN_BARE = (0.0, 0.1)


@dataclass(frozen=True)
class EndCap:
    """What poses say of a cap.

    rows:    of the avatar's Gaussians, which are its own
    weights: (maps,) of what moves it
    rest_m:  (3,) canonical, its middle, from the wrist, meters
    way:     (3,) canonical, out of the hand
    seen_at: cosines of the eye over which it comes into sight
    """

    rows: slice
    weights: np.ndarray
    rest_m: np.ndarray
    way: np.ndarray
    seen_at: tuple[float, float] = (SEEN_FROM, SEEN_WHOLLY)

    def seen(self, linear_offset: np.ndarray, shift_m: np.ndarray, eye_m: np.ndarray) -> float:
        """0..1, how much of it an eye at (3,) sees. linear_offset: (maps, 3, 4) of a pose · shift_m: (3,) its wrist"""
        moves = np.tensordot(self.weights, linear_offset, 1)
        middle_m, way = moves @ (*self.rest_m, 1.0) + shift_m, moves[:, :3] @ self.way
        return float(rising(unit(way) @ unit(eye_m - middle_m), *self.seen_at))


def rising(along: np.ndarray, none: float, whole: float) -> np.ndarray:
    """0 at `none` and before it, 1 at `whole`, smoothly between."""
    part = ((along - none) / (whole - none)).clip(0, 1)
    return part * part * (3 - 2 * part)


class Dome:
    """Half an ellipsoid over the outline of skin (V, 3), meters, in a plane.

    way: (3,) unit, out of the hand and the plane · end_m: where the skin ends along it
    """

    def __init__(self, skin_m: np.ndarray, way: np.ndarray, end_m: float) -> None:
        self.way, self._along_m = way, end_m - WITHIN_M
        across = unit(np.cross(way, [0.0, 0.0, 1.0]))
        self._axes = np.stack([across, np.cross(way, across)])
        skin_m = skin_m.astype(np.float64)
        self._middle_m = skin_m[self.edge(skin_m)].mean(0)
        self._middle_m += (self._along_m - self._middle_m @ way) * way
        self._outlines = [self._outline(skin_m[self.edge(skin_m, beyond_m)]) for beyond_m in (0.0, WITHIN_M / 2)]
        self._mean_m = float(self._outlines[0][1].mean())

    def apart_m(self, position_m: np.ndarray, beyond_m: float = 0.0) -> np.ndarray:
        """(N,) how far places (N, 3), meters, are from its plane, or one so far out of the hand."""
        return np.abs(position_m @ self.way - self._along_m - beyond_m)

    def edge(self, position_m: np.ndarray, beyond_m: float = 0.0) -> np.ndarray:
        """Numbers of those that are near it."""
        return np.flatnonzero(self.apart_m(position_m, beyond_m) < EDGE_M)

    def _outline(self, skin_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angles and radii (V,), meters, of places (V, 3)."""
        flat_m = (skin_m - self._middle_m) @ self._axes.T
        return np.arctan2(flat_m[:, 1], flat_m[:, 0]), np.linalg.norm(flat_m, axis=1)

    def _radius_m(self, angle_rad: np.ndarray) -> np.ndarray:
        radii_m = []
        for of_skin_rad, radius_m in self._outlines:
            near = np.exp((np.cos(angle_rad[:, None] - of_skin_rad) - 1) / AROUND_RAD**2)
            radii_m.append((near @ radius_m) / near.sum(1))
        return BELOW * np.minimum(*radii_m)

    def at(self, part: np.ndarray, angle_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (N, 3), meters, and unit normals (N, 3) at parts (N,) of the radius and angles around the middle."""
        radius_m = self._radius_m(angle_rad)
        radial = np.stack([np.cos(angle_rad), np.sin(angle_rad)], -1) @ self._axes
        height, bulge_m = np.sqrt(np.maximum(1 - part**2, 0)), BULGE * self._mean_m
        place_m = self._middle_m + (part * radius_m)[:, None] * radial + (height * bulge_m)[:, None] * self.way
        return place_m, unit((part / radius_m)[:, None] * radial + (height / bulge_m)[:, None] * self.way)

    def gaussians(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Places and normals of skin, as even as on a sphere, and sigma, meters."""
        height = 1 - (np.arange(GAUSSIANS) + 0.5) / GAUSSIANS
        golden_rad = np.pi * (3 - np.sqrt(5))
        place_m, normal = self.at(np.sqrt(1 - height**2), np.arange(GAUSSIANS) * golden_rad)
        return place_m, normal, SIGMA_PART * self._mean_m * float(np.sqrt(np.pi * (1 + BULGE**2) / GAUSSIANS))

    def faces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices (V, 3), meters; how high (V,) they are, 0 at the edge to 1; (F, 3) faces, counterclockwise from
        outside. A square that is laid on a disc (Shirley and Chiu 1997): no vertex has more than six faces."""
        side = np.arange(SQUARES + 1)
        y, x = (each.ravel() for each in np.meshgrid(2 * side / SQUARES - 1, 2 * side / SQUARES - 1, indexing="ij"))
        is_wide, part = np.abs(x) > np.abs(y), np.maximum(np.abs(x), np.abs(y))
        longer, shorter = np.where(is_wide, x, y), np.where(is_wide, y, x)
        turn_rad = np.pi / 4 * np.divide(shorter, longer, out=np.zeros_like(x), where=longer != 0)
        angle_rad = np.where(is_wide, turn_rad, np.pi / 2 - turn_rad) + np.where(longer < 0, np.pi, 0)
        place_m, _ = self.at(np.sin(part * np.pi / 2), angle_rad)
        first = (side[:-1, None] * (SQUARES + 1) + side[:-1]).ravel()
        corners = first, first + 1, first + SQUARES + 2, first + SQUARES + 1
        faces = np.concatenate([np.stack([corners[0], corners[k], corners[k + 1]], -1) for k in (1, 2)])
        return place_m, np.cos(part * np.pi / 2), faces


def with_cap(detail: Detail, dome: Dome) -> Detail:
    """The surface of a hand and the faces of its cap, which have one texel that changes next to nothing."""
    place_m, height, faces = dome.faces()
    count, edge = len(detail.position_m), dome.edge(detail.position_m)
    nearest = edge[np.square(place_m[:, None] - detail.position_m[edge]).sum(-1).argmin(1)]
    vertices, uv = np.append(np.arange(count), nearest), detail.face_uv.reshape(-1, 2)
    column, row = ((at * detail.size).astype(int).clip(0, detail.size - 1) for at in (uv[:, 0], 1 - uv[:, 1]))
    plain = np.abs(detail.texture[row, column].astype(int) - NO_RATIO).max(-1).argmin()
    return replace(
        detail,
        position_m=np.concatenate([detail.position_m, place_m.astype(np.float32)]),
        bone_weights=detail.bone_weights[vertices],
        faces=np.concatenate([detail.faces, (faces + count).astype(np.int32)]),
        face_uv=np.concatenate([detail.face_uv, np.tile(uv[plain], (len(faces), 3, 1))]),
        correctives=None if detail.correctives is None else detail.correctives.of(vertices),
        # see native/detail_surface.h
        whole=np.append(detail.shown, -1 - height).astype(np.float32),
    )
