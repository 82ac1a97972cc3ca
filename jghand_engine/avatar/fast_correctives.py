"""Correctives as the kernel of trained skin takes them (native/learned.h): what a pose changes there is small, and
found here in NumPy; what that does to every Gaussian is the kernel's.

The exact tier and the cached one are the same here: what the first layer makes of a Gaussian's place never changes, so
it is computed once, in double precision.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch

from jghand_engine.avatar.correctives import Correctives, PoseNet
from jghand_engine.avatar.fast_skinning import Blocks, point
from jghand_engine.avatar.pose_features import AnglePlanes, Angles, finger_angles, palm_angles
from jghand_engine.avatar.tiers import CachedNet, LinearCorrectives
from jghand_engine.limits import SHADE_MAX
from jghand_engine.native.binding import aligned_zeros
from jghand_engine.native.learned_tasks import HIDDEN_MAX, NETWORK_TILE, CorrectiveKind, LearnedTask
from jghand_engine.native.tasks import LANES


class FastCorrectives(Protocol):
    """Fills in a task what its pose's correctives are found from. It must live as long as the task."""

    def prepare(self, task: LearnedTask, angles_rad: np.ndarray) -> None:
        """angles_rad: (37,) of the next pose."""
        ...


def fast_correctives(
    correctives: Correctives | None, blocks: Blocks, bone_weights: torch.Tensor, task: LearnedTask
) -> FastCorrectives:
    """For the Gaussians in `blocks` with `bone_weights` (N, 21).

    What the kernel does not know, such as wider networks, torch computes and the kernel adds.
    """
    net = correctives.net if isinstance(correctives, CachedNet) else correctives
    if net is None:
        return NoCorrectives()
    if isinstance(net, PoseNet) and net.shape.hidden <= HIDDEN_MAX and torch.equal(net.bone_weights, bone_weights):
        return FastNetwork(net, blocks, task)
    if isinstance(net, LinearCorrectives) and torch.equal(net.bone_weights, bone_weights):
        return FastLinear(net, blocks, task)
    return TorchCorrectives(net, blocks, task)


class NoCorrectives:
    """Nothing but the bones moves the skin."""

    def prepare(self, task: LearnedTask, angles_rad: np.ndarray) -> None:
        """See FastCorrectives."""
        task.correctives = CorrectiveKind.NONE


class TorchCorrectives:
    """Computed by torch for every pose."""

    def __init__(self, correctives: Correctives, blocks: Blocks, task: LearnedTask) -> None:
        self._correctives, self._blocks = correctives, blocks
        self._given = aligned_zeros((blocks.count, 6, LANES))
        task.correctives, task.given = CorrectiveKind.GIVEN, self._given.ctypes.data

    def prepare(self, task: LearnedTask, angles_rad: np.ndarray) -> None:
        """See FastCorrectives."""
        with torch.no_grad():
            correction = self._correctives(Angles.of(torch.from_numpy(angles_rad).float()))
        both = torch.cat([correction.offset_m, correction.shade], -1)
        self._given[...] = self._blocks.blocked(both.numpy())


class FastLinear:
    """The linear tier. arrays: fields of the task by name · first, second: see `_products`"""

    def __init__(self, linear: LinearCorrectives, blocks: Blocks, task: LearnedTask) -> None:
        self.features = FastFeatures(linear.angles)
        self.mean, self.projection = linear.mean.double().numpy(), linear.projection.double().numpy()
        first, second = _products(linear.projection.shape[1], linear.basis)
        self.first, self.second = first, second
        self._numbers = aligned_zeros((21, linear.basis))
        directions = linear.direction.reshape(len(linear.direction), -1).numpy()
        self.arrays = {
            "direction": blocks.blocked(directions, np.int8),
            "constant": blocks.blocked(torch.cat([linear.constant, linear.scale], 1).numpy()),
            "numbers": self._numbers,
        }
        task.correctives, task.basis = CorrectiveKind.LINEAR, linear.basis
        point(task, self.arrays)

    def prepare(self, task: LearnedTask, angles_rad: np.ndarray) -> None:
        """See FastCorrectives."""
        simple = (self.features(angles_rad) - self.mean) @ self.projection
        count = min(simple.shape[1], self._numbers.shape[1])
        self._numbers[:, :count] = simple[:, :count]
        self._numbers[:, count:] = simple[:, self.first] * simple[:, self.second]


class FastNetwork:
    """The network: exact and cached tier. arrays: fields of the task by name · angles_in: (channels, hidden) weights of
    the first layer from a bone's features"""

    def __init__(self, net: PoseNet, blocks: Blocks, task: LearnedTask) -> None:
        self.features = FastFeatures(net.angles)
        weights = {name: value.detach().double().numpy() for name, value in net.state_dict().items()}
        hidden = -(-net.shape.hidden // NETWORK_TILE) * NETWORK_TILE
        extra = hidden - net.shape.hidden  # units that are always 0
        places = net.encoding.double().numpy() @ weights["encoding_in.weight"].T + weights["encoding_in.bias"]
        self.angles_in = np.pad(weights["angles_in.weight"], ((0, extra), (0, 0))).T
        middle = np.pad(weights["middle.weight"], ((0, extra), (0, extra)))
        out = np.zeros((hidden, 6))
        out[: net.shape.hidden, : len(weights["out.weight"])] = weights["out.weight"].T
        self._bones = aligned_zeros((21, hidden))
        self.arrays = {
            "places": blocks.blocked(np.pad(places, ((0, 0), (0, extra)))),
            "features": self._bones,
            "middle": _aligned(middle.reshape(-1, NETWORK_TILE, hidden).transpose(0, 2, 1)),
            "middle_bias": _aligned(np.pad(weights["middle.bias"], (0, extra))),
            "out": _aligned(out),
        }
        # what the network says of a pose is kept: a hand that moves as a whole takes it again
        self.arrays["given"] = aligned_zeros((blocks.count, 6, LANES))
        point(task, self.arrays)
        task.hidden = hidden
        # without a shade its outputs are 0
        task.out_bias = tuple(np.pad(weights["out.bias"], (0, 6 - len(weights["out.bias"]))))
        task.reach = (net.shape.reach_m, SHADE_MAX)

    def prepare(self, task: LearnedTask, angles_rad: np.ndarray) -> None:
        """See FastCorrectives."""
        task.correctives = CorrectiveKind.NETWORK
        self._bones[...] = self.features(angles_rad) @ self.angles_in


class FastFeatures:
    """`AnglePlanes` of one pose in NumPy: tens of microseconds instead of a millisecond.

    texels: (16, rows, columns, channels) float64 · source: (20, 2) which of the 37 angles each metacarpal's and bone's
    plane is looked up at, offset + slope x angle · level1: see AnglePlanes
    """

    def __init__(self, planes: AnglePlanes) -> None:
        texels = planes.planes.detach().double().numpy()
        self.texels = np.ascontiguousarray(np.moveaxis(texels, 1, -1))  # (16, rows, columns, channels)
        self.level1 = planes.level1
        self._plane = np.array([0] * 5 + [*range(1, 16)])
        # normalizing is linear in every angle
        zero, one = (self._normalized(np.full(37, value)) for value in (0.0, 1.0))
        self.offset, self.slope = zero, one - zero
        self.source = self._places()

    @staticmethod
    def _normalized(angles_rad: np.ndarray) -> np.ndarray:
        """(20, 2) where the planes are looked up, -1..1."""
        angles = Angles.of(torch.from_numpy(angles_rad))
        return torch.cat([palm_angles(angles), finger_angles(angles)]).numpy()

    def _places(self) -> np.ndarray:
        """(20, 2) which of the 37 angles is looked up where."""
        found = np.stack([self._normalized(row) for row in np.eye(37)]) - self.offset
        return np.abs(found).argmax(0)

    def __call__(self, angles_rad: np.ndarray) -> np.ndarray:
        """(21, channels) float64 of the 37 angles of a pose."""
        at = angles_rad[self.source] * self.slope + self.offset
        if not self.level1:
            at[:5] = 0.0
        own = self._looked_up(at)
        features = np.empty((21, own.shape[1]))
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


def _products(simple: int, basis: int) -> tuple[list[int], list[int]]:
    """Which numbers are multiplied to get those beyond the first `simple`, as `tiers.numbers_of` has them."""
    pairs = [(first, second) for second in range(simple) for first in range(second + 1)]
    pairs = pairs[: max(basis - simple, 0)]
    return [first for first, _ in pairs], [second for _, second in pairs]


def _aligned(values: np.ndarray) -> np.ndarray:
    out = aligned_zeros(values.shape)
    out[...] = values
    return out
