"""Correctives as the kernel of trained skin takes them (native/learned.h): what a pose changes there is small, and
found here in NumPy; what that does to every Gaussian is the kernel's.

What the network's first layer makes of a Gaussian's place never changes, so it is computed once, in double precision.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import Blocks, set_pointers
from jghand_engine.avatar.correctives import (
    SHADE_MAX,
    Correctives,
    LinearCorrectives,
    PoseFeatures,
    PoseNetwork,
    positional_encoding,
    products,
)
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.native.binding import aligned_zeros
from jghand_engine.native.learned_tasks import HIDDEN_MAX, NETWORK_TILE, CorrectiveKind, LearnedTask
from jghand_engine.native.tasks import LANES


class CorrectiveStep(Protocol):
    """Fills in a task what its pose's correctives are found from. It must live as long as the task."""

    def prepare(self, task: LearnedTask, angles_rad: np.ndarray) -> None:
        """angles_rad: (37,) of the next pose."""
        ...


def corrective_step(
    correctives: Correctives | None, avatar: HandAvatar, blocks: Blocks, task: LearnedTask
) -> CorrectiveStep:
    """For the avatar's Gaussians, which are in `blocks`."""
    if correctives is None:
        return NoStep()
    if isinstance(correctives, LinearCorrectives):
        return LinearStep(correctives, avatar, blocks, task)
    return NetworkStep(correctives, avatar, blocks, task)


class NoStep:
    """Nothing but the bones moves the skin."""

    def prepare(self, task: LearnedTask, angles_rad: np.ndarray) -> None:
        task.correctives = CorrectiveKind.NONE


class LinearStep:
    """The linear tier. arrays: fields of the task by name · first, second: see `products`"""

    def __init__(self, linear: LinearCorrectives, avatar: HandAvatar, blocks: Blocks, task: LearnedTask) -> None:
        self.features = PoseFeatures(linear.angles)
        self.mean, self.projection = linear.mean.astype(np.float64), linear.projection.astype(np.float64)
        self.first, self.second = products(linear.projection.shape[1], linear.basis)
        # slices of a forearm have the angles of the palm, which counts whole beside them
        numbers = aligned_zeros((avatar.map_count, linear.basis))
        self._numbers = numbers[:JOINT_COUNT]
        directions = linear.direction.reshape(len(linear.direction), -1)
        self.arrays = {
            "direction": blocks.blocked(directions, np.int8),
            "constant": blocks.blocked(np.concatenate([linear.constant, linear.scale], 1)),
            "numbers": numbers,
        }
        task.correctives, task.basis = CorrectiveKind.LINEAR, linear.basis
        set_pointers(task, self.arrays)

    def prepare(self, task: LearnedTask, angles_rad: np.ndarray) -> None:
        simple = (self.features(angles_rad) - self.mean) @ self.projection
        count = min(simple.shape[1], self._numbers.shape[1])
        self._numbers[:, :count] = simple[:, :count]
        self._numbers[:, count:] = simple[:, self.first] * simple[:, self.second]


class NetworkStep:
    """The network. arrays: fields of the task by name · angles_in: (channels, hidden) weights of
    the first layer from a bone's features"""

    def __init__(self, net: PoseNetwork, avatar: HandAvatar, blocks: Blocks, task: LearnedTask) -> None:
        if net.shape.hidden > HIDDEN_MAX:
            raise InputError("width of the pose's network", wanted=f"at most {HIDDEN_MAX}", came=str(net.shape.hidden))
        self.features = PoseFeatures(net.angles)
        weights = {name: value.astype(np.float64) for name, value in net.weights.items()}
        hidden = -(-net.shape.hidden // NETWORK_TILE) * NETWORK_TILE
        extra = hidden - net.shape.hidden  # units that are always 0
        encoding = positional_encoding(avatar.uvd, net.shape.octaves).astype(np.float64)
        places = encoding @ weights["encoding_in.weight"].T + weights["encoding_in.bias"]
        # as the kernel takes it, before it is copied into blocks: the copies are the peak of the renderer's memory
        places = places.astype(np.float32)
        self.angles_in = np.pad(weights["angles_in.weight"], ((0, extra), (0, 0))).T
        middle = np.pad(weights["middle.weight"], ((0, extra), (0, extra)))
        out = np.zeros((hidden, 6))
        out[: net.shape.hidden, : len(weights["out.weight"])] = weights["out.weight"].T
        features = aligned_zeros((avatar.map_count, hidden))
        self._bones = features[:JOINT_COUNT]
        self.arrays = {
            "places": blocks.blocked(np.pad(places, ((0, 0), (0, extra)))),
            "features": features,
            "middle": _aligned(middle.reshape(-1, NETWORK_TILE, hidden).transpose(0, 2, 1)),
            "middle_bias": _aligned(np.pad(weights["middle.bias"], (0, extra))),
            "out": _aligned(out),
        }
        # what the network says of a pose is kept: a hand that moves as a whole takes it again
        self.arrays["given"] = aligned_zeros((blocks.count, 6, LANES))
        set_pointers(task, self.arrays)
        task.hidden = hidden
        # without a shade its outputs are 0
        task.out_bias = tuple(np.pad(weights["out.bias"], (0, 6 - len(weights["out.bias"]))))
        task.reach = (net.shape.reach_m, SHADE_MAX)

    def prepare(self, task: LearnedTask, angles_rad: np.ndarray) -> None:
        task.correctives = CorrectiveKind.NETWORK
        self._bones[...] = self.features(angles_rad) @ self.angles_in


def _aligned(values: np.ndarray) -> np.ndarray:
    out = aligned_zeros(values.shape)
    out[...] = values
    return out
