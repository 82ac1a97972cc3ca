"""What the pose changes on the skin beyond skinning: an offset and a shade of every Gaussian, from the joint angles.

Either a small network says it (METHOD 4.1), which reads where a Gaussian sits (positional encoding of u, v, d) and the
angles of the joints near it (pose features, mixed by its skin weights), or a linear map that was distilled from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.kinematics import FRAME_RANGES_DEG

# strongest shade that a pose may add or take, as a logarithm: what the shadow and the light do not explain
SHADE_MAX = 0.5
# largest basis of the linear tier
BASIS_MAX = 64
# ranges of the angles between neighboring palm bones (theta^p) and palm planes (theta^n), degrees (METHOD 4.1)
PALM_NEIGHBOR_RANGES_DEG = ((0.0, 60.0), (0.0, 30.0), (0.0, 30.0), (0.0, 30.0))
PALM_PLANE_RANGES_DEG = ((-30.0, 60.0), (-20.0, 40.0), (-20.0, 40.0))

# planes of joint angles: that of the five metacarpals, then those of bones 6..20
PLANES = 16


class PerGaussian:
    """A frozen record. ROWS: arrays with a row for each Gaussian · PARTS: what is such a record itself, or None"""

    ROWS: ClassVar[tuple[str, ...]] = ()
    PARTS: ClassVar[tuple[str, ...]] = ()

    def prefix(self, count: int) -> Self:
        """The same for the first `count` Gaussians."""
        return self.rows(slice(count))

    def rows(self, which: np.ndarray | slice) -> Self:
        """The same for Gaussians by their numbers, in this order."""
        rows = {name: getattr(self, name)[which] for name in self.ROWS}
        parts = {name: part.rows(which) for name in self.PARTS if (part := getattr(self, name)) is not None}
        return replace(self, **rows, **parts)  # type: ignore[type-var]


@dataclass(frozen=True)
class PoseNetShape:
    """Sizes of the network.

    octaves:        of the encoding of u, v, d
    angle_channels: features of the angle planes
    angle_texels:   width and height of the angle planes
    hidden:         width of the two hidden layers
    level1:         whether metacarpals have features that depend on the pose; the paper keeps them constant, and the
                    angles of a rigid palm say more about errors of the joints than about the pose
    reach_m:        longest offset along an axis, meters
    shaded:         whether the shade is predicted too
    """

    octaves: tuple[int, int, int] = (6, 6, 4)
    angle_channels: int = 16
    angle_texels: int = 16
    hidden: int = 128
    level1: bool = False
    reach_m: float = 0.010
    shaded: bool = True

    def arrays(self) -> dict[str, tuple[int, ...]]:
        """Shape of every array of weights by its name."""
        waves, outputs = 2 * sum(self.octaves), 6 if self.shaded else 3
        return {
            "angles.planes": (PLANES, self.angle_channels, self.angle_texels, self.angle_texels),
            "encoding_in.weight": (self.hidden, waves),
            "encoding_in.bias": (self.hidden,),
            "angles_in.weight": (self.hidden, self.angle_channels),
            "middle.weight": (self.hidden, self.hidden),
            "middle.bias": (self.hidden,),
            "out.weight": (outputs, self.hidden),
            "out.bias": (outputs,),
        }


@dataclass(frozen=True)
class AnglePlanes:
    """Features of joint angles, looked up bilinearly.

    planes: (16, channels, texels, texels) float32; plane 0 is the metacarpals', 1..15 those of bones 6..20
    level1: whether the metacarpals have features that depend on the pose
    """

    planes: np.ndarray
    level1: bool


@dataclass(frozen=True)
class PoseNetwork(PerGaussian):
    """The network as plain numbers. It reads the avatar's uvd and bone weights, so that it holds nothing per Gaussian.

    weights: float32 by the names of `PoseNetShape.arrays`
    """

    shape: PoseNetShape
    weights: dict[str, np.ndarray]

    @property
    def angles(self) -> AnglePlanes:
        """Its angle planes."""
        return AnglePlanes(self.weights["angles.planes"], self.shape.level1)

    def longest_offset_m(self) -> float:
        """What no offset is longer than, in any pose."""
        return math.sqrt(3) * self.shape.reach_m


@dataclass(frozen=True)
class LinearCorrectives(PerGaussian):
    """correction = constant + sum_k c_k(x) direction_k,   c(x) = sum_i W_i(x) numbers(F_i)

    angles:     the network's planes, which give the features F_i of the bones
    mean:       (C,) float32
    projection: (C, P) float32: the first P numbers of a bone are (F_i - mean) @ projection; further ones are products
                of two of these, see `products`
    constant:   (N, 6) float32, of offset in meters and shade, each a float16
    direction:  (N, K, 6) int8, in units of scale
    scale:      (N, 2) float32, of offset and shade
    """

    ROWS = ("constant", "direction", "scale")

    angles: AnglePlanes
    mean: np.ndarray
    projection: np.ndarray
    constant: np.ndarray
    direction: np.ndarray
    scale: np.ndarray

    @property
    def basis(self) -> int:
        """K."""
        return self.direction.shape[1]

    def longest_offset_m(self) -> float:
        """What no offset is longer than, in any pose: features are means of the planes' texels."""
        texels = np.moveaxis(self.angles.planes, 1, -1).reshape(-1, len(self.mean))
        simple = np.abs((texels - self.mean) @ self.projection).max(0)[: self.basis]
        first, second = products(self.projection.shape[1], self.basis)
        numbers = np.concatenate([simple, simple[first] * simple[second]])
        directions = np.abs(self.direction[..., :3].astype(np.float32)) * np.abs(self.scale[:, :1, None])
        along_axes = np.abs(self.constant[:, :3]) + np.einsum("k,nkc->nc", numbers, directions)
        return float(np.linalg.norm(along_axes, axis=1).max())


Correctives = PoseNetwork | LinearCorrectives


def products(simple: int, basis: int) -> tuple[list[int], list[int]]:
    """Which numbers of a bone are multiplied to get those beyond the first `simple`: those of the first ones first."""
    pairs = [(first, second) for second in range(simple) for first in range(second + 1)]
    pairs = pairs[: max(basis - simple, 0)]
    return [first for first, _ in pairs], [second for _, second in pairs]


def largest_basis(shape: PoseNetShape) -> int:
    """The largest basis that the features of a network give: themselves, and products of two."""
    channels = shape.angle_channels
    return channels + channels * (channels + 1) // 2


def positional_encoding(uvd: np.ndarray, octaves: tuple[int, int, int]) -> np.ndarray:
    """(N, 2 sum(octaves)) float32 sine and cosine of 2^k pi times each coordinate, octave by octave; uvd (N, 3)."""
    waves = []
    for coordinate, count in zip(uvd.astype(np.float64).T, octaves, strict=True):
        for octave in range(count):
            phase = 2**octave * np.pi * coordinate
            waves += [np.sin(phase), np.cos(phase)]
    return np.stack(waves, -1).astype(np.float32)


class PoseFeatures:
    """Features of the bones of one pose, tens of microseconds (METHOD 4.1).

    One plane per bone 6..20 over its normalized (flexion, abduction); one for the five metacarpals over the angles
    between palm bones and palm planes. F_i = delta_i for the metacarpals and half the parent's plus half the own
    beyond, so that the angles near a joint weigh most: 1/2, 1/4, 1/8, 1/8 at the finger tips.

    texels: (16, rows, columns, channels) float64
    source: (20, 2) which of the 37 angles each metacarpal's and bone's plane is looked up at, as offset + slope x angle
    level1: see AnglePlanes
    """

    # bones 1..5 read the angle between palm bones and the one between palm planes at these places (METHOD 4.1)
    _NEIGHBOR_OF_FINGER = (0, 0, 1, 2, 3)
    _PLANE_OF_FINGER = (0, 0, 1, 2, 2)

    def __init__(self, angles: AnglePlanes) -> None:
        self.texels = np.ascontiguousarray(np.moveaxis(angles.planes.astype(np.float64), 1, -1))
        self.level1 = angles.level1
        self._plane = np.array([0] * 5 + [*range(1, PLANES)])
        palm = [[30 + p, 34 + n] for p, n in zip(self._NEIGHBOR_OF_FINGER, self._PLANE_OF_FINGER, strict=True)]
        self.source = np.concatenate([palm, np.arange(30).reshape(15, 2)])
        fingers = np.asarray(FRAME_RANGES_DEG, np.float64).reshape(30, 2)
        ranges_deg = np.concatenate([fingers, PALM_NEIGHBOR_RANGES_DEG, PALM_PLANE_RANGES_DEG])
        low, high = np.radians(ranges_deg[self.source]).transpose(2, 0, 1)
        # (angle - low) / (high - low) * 2 - 1: beyond the ends it goes on, the lookup clamps
        self.slope = 2 / (high - low)
        self.offset = -low * self.slope - 1

    def __call__(self, angles_rad: np.ndarray) -> np.ndarray:
        """(21, channels) float64 of the 37 angles of a pose; of the wrist the mean of the metacarpals'."""
        at = angles_rad[self.source] * self.slope + self.offset
        if not self.level1:
            at[:5] = 0.0
        own = self._looked_up(at)
        features = np.empty((JOINT_COUNT, own.shape[1]))
        features[0], features[1:6] = own[:5].mean(0), own[:5]
        for first in (6, 11, 16):
            features[first : first + 5] = 0.5 * (features[first - 5 : first] + own[first - 1 : first + 4])
        return features

    def _looked_up(self, at: np.ndarray) -> np.ndarray:
        """(20, channels) bilinear values at (20, 2), clamped to the planes."""
        last = self.texels.shape[1] - 1
        spot = np.clip((at + 1) * (0.5 * last), 0, last)
        low = np.minimum(spot.astype(np.intp), max(last - 1, 0))
        high = np.minimum(low + 1, last)
        (x, y), plane, texels = (spot - low).T[..., None], self._plane, self.texels
        (left, top), (right, bottom) = low.T, high.T
        above = texels[plane, top, left] * (1 - x) + texels[plane, top, right] * x
        below = texels[plane, bottom, left] * (1 - x) + texels[plane, bottom, right] * x
        return above * (1 - y) + below * y


class CorrectiveChange:
    """A bound on how far correctives differ between two poses, from their own weights. Lipschitz: rectifiers and tanh
    change no more than what goes in, matrices by their largest singular value or row, and a Gaussian reads a mean of
    what its bones say."""

    def __init__(self, net: Correctives | None) -> None:
        self._net, self._features = net, None if net is None else PoseFeatures(net.angles)
        # the angles that were asked about last, and what `_numbers` says of them
        self._known: tuple[np.ndarray, np.ndarray] | None = None
        if isinstance(net, PoseNetwork):
            into, middle, out = (net.weights[f"{name}.weight"] for name in ("angles_in", "middle", "out"))
            self._into = into.T.astype(np.float64)
            hidden = float(np.linalg.norm(middle, 2))
            self._slope_m = net.shape.reach_m * hidden * float(np.linalg.norm(out[:3], 2))
            self._shade_slope = SHADE_MAX * hidden * float(np.linalg.norm(out[3:], axis=1).max(initial=0.0))
        elif net is not None:
            self._into = net.projection.astype(np.float64)
            # (N, 6) of a step of one along every direction
            steps = np.sqrt(np.square(net.direction.astype(np.float32)).sum(1)) * net.scale.repeat(3, 1)
            self._slope_m = float(np.linalg.norm(steps[:, :3], axis=1).max(initial=0.0))
            self._shade_slope = float(steps[:, 3:].max(initial=0.0))

    def __call__(self, before_rad: np.ndarray, after_rad: np.ndarray) -> tuple[float, float]:
        """Of offsets, meters, and of any channel of the shade, between two poses of angles (37,)."""
        if self._features is None or np.array_equal(before_rad, after_rad):
            return 0.0, 0.0
        before = self._known
        if before is None or not np.array_equal(before[0], before_rad):
            before = before_rad, self._numbers(before_rad)
        self._known = after_rad.copy(), self._numbers(after_rad)
        change = self._known[1] - before[1]
        most = float(np.linalg.norm(change, axis=1).max())
        return self._slope_m * most, self._shade_slope * most

    def _numbers(self, angles_rad: np.ndarray) -> np.ndarray:
        """(21, K) what the bones say to the Gaussians."""
        assert self._features is not None
        features = self._features(angles_rad)
        if not isinstance(self._net, LinearCorrectives):
            return features @ self._into
        simple = (features - self._net.mean) @ self._into
        first, second = products(simple.shape[1], self._net.basis)
        return np.concatenate([simple[:, : self._net.basis], simple[:, first] * simple[:, second]], 1)
