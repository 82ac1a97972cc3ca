"""The linear tier of correctives, distilled from the exact one: what it does on many poses, by least squares.

A network that reads the mixed features of the bones near a Gaussian is, around the poses it knows, nearly linear in
them. So every Gaussian gets its own linear map from a few combinations of these features to its correction. As many
directions of whole corrections, from their singular value decomposition, leave more than twice the error: fingers move
independently, and what is shared has to span all of their combinations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.correctives import LinearCorrectives
from jghand_engine.learn.pose_features import Angles
from jghand_engine.learn.pose_net import PoseNet, numbers_of
from jghand_engine.learn.tensors import HandTensors

# poses that are made up: wobble of flexion, abduction and palm angles, degrees; how far beyond the known range,
# degrees: as far as the angles of a hand between two learned poses go
DISTIL_WOBBLE_DEG = (8.0, 3.0)
DISTIL_WOBBLE_PALM_DEG = 2.0
DISTIL_BEYOND_DEG = 5.0
# penalty on directions, per pose, for numbers of variance 1; variance of a component over the largest below which it is
# noise; Gaussians at once: bounds the memory to some 400 MB
DISTIL_RIDGE = 1e-4
DISTIL_VARIANCE_MIN = 1e-6
DISTIL_GAUSSIANS_AT_ONCE = 2048

INT8_MAX = 127


def poses_near(known: Tensor, count: int, seed: int) -> Tensor:
    """(count, 37) poses near `known` (P, 37): fingers of different ones, between two of them, with some wobble, but not
    farther than DISTIL_BEYOND_DEG from the range of angles that they span. count: 0 and up."""
    g = torch.Generator().manual_seed(seed)
    beyond = math.radians(DISTIL_BEYOND_DEG)
    low, high = known.amin(0) - beyond, known.amax(0) + beyond
    finger = torch.arange(15) % 5
    # the joint's finger for each of the 37 angles; the palm's are of the sixth
    owner = torch.cat([finger.repeat_interleave(2), torch.full((7,), 5)])
    wobble_deg = torch.tensor([*DISTIL_WOBBLE_DEG] * 15 + [DISTIL_WOBBLE_PALM_DEG] * 7)
    poses = []
    for _ in range(count):
        source = torch.randint(len(known), (6,), generator=g)
        if torch.rand((), generator=g) < 0.5:
            source[:] = source[0]
        mixed = known[source[owner], torch.arange(37)]
        other = known[torch.randint(len(known), (), generator=g)]
        between = torch.lerp(mixed, other, 0.5 * torch.rand((), generator=g))
        moved = between + torch.deg2rad(wobble_deg) * torch.randn(37, generator=g)
        poses.append(torch.minimum(torch.maximum(moved, low), high))
    return torch.stack(poses) if poses else known.new_zeros((0, 37))


def distill(
    avatar: HandAvatar, poses: Tensor, bases: Sequence[int], *, tick: Callable[[float], None] = lambda _: None
) -> dict[int, LinearCorrectives]:
    """The linear tiers of sizes `bases`, fitted to the network of a trained avatar on poses (M, 37). tick: called with
    the part that is done."""
    learned = HandTensors.of(avatar).learned
    assert learned is not None
    net = learned.correctives
    assert isinstance(net, PoseNet)
    with torch.no_grad():
        features = torch.stack([net.angles(Angles.of(pose)) for pose in poses])
        mean, projection = _components(features, net.bone_weights)
        # the numbers of a smaller basis are the first ones of a larger
        numbers = torch.stack([numbers_of(each, mean, projection, max(bases)) for each in features])
        found: dict[int, list[tuple[Tensor, Tensor, Tensor]]] = {basis: [] for basis in bases}
        total = len(net.bone_weights)
        for start in range(0, total, DISTIL_GAUSSIANS_AT_ONCE):
            rows = slice(start, start + DISTIL_GAUSSIANS_AT_ONCE)
            part = net.part(rows)
            corrections = [part(Angles.of(pose)) for pose in poses]
            wanted = torch.stack([torch.cat([one.offset_m, one.shade], -1) for one in corrections], 1)
            fit = _Fit(torch.einsum("ni,mik->nmk", part.bone_weights, numbers), wanted)
            for basis in bases:
                found[basis].append(fit.solved(basis))
            tick(min(rows.stop, total) / total)
        tiers = {}
        for basis, parts in found.items():
            constant, direction, scale = map(torch.cat, zip(*parts, strict=True))
            fitted = (values.numpy() for values in (mean, projection[:, :basis], constant, direction, scale))
            tiers[basis] = LinearCorrectives(net.angles.plain(), *fitted)
        return tiers


def _components(features: Tensor, bone_weights: Tensor) -> tuple[Tensor, Tensor]:
    """Mean (C,) and principal directions (C, C), scaled to unit variance, of features (M, 21, C) of the bones, each
    counting as much as it moves skin."""
    weight = bone_weights.sum(0) / bone_weights.sum()
    mean = torch.einsum("i,mic->c", weight, features) / len(features)
    centered = (features - mean).double()
    covariance = torch.einsum("i,mic,mid->cd", weight.double(), centered, centered) / len(features)
    variance, direction = torch.linalg.eigh(covariance)
    variance, direction = variance.flip(0), direction.flip(1)
    spread = variance.clamp_min(DISTIL_VARIANCE_MIN * float(variance[0].clamp_min(1e-30))).sqrt()
    return mean, (direction / spread).float()


class _Fit:
    """Least squares of n Gaussians whose numbers are mixed (n, M, K) and who should give wanted (n, M, 6)."""

    def __init__(self, mixed: Tensor, wanted: Tensor) -> None:
        self._middle, self._level = (values.mean(1, keepdim=True).double() for values in (mixed, wanted))
        z, y = mixed.double() - self._middle, wanted.double() - self._level
        self._square, self._goal = z.transpose(1, 2) @ z, z.transpose(1, 2) @ y
        # Gaussians that some number does not reach have no use for its direction
        self._square.diagonal(dim1=1, dim2=2).add_(DISTIL_RIDGE * mixed.shape[1])

    def solved(self, basis: int) -> tuple[Tensor, Tensor, Tensor]:
        """constant, direction and scale for the first `basis` numbers, as in `LinearCorrectives`."""
        solution = torch.linalg.solve(self._square[:, :basis, :basis], self._goal[:, :basis])
        largest = solution.reshape(*solution.shape[:2], 2, 3).abs().amax((1, 3))
        scale = (largest / INT8_MAX).clamp_min(torch.finfo(torch.float32).tiny).float()
        steps = scale.double().repeat_interleave(3, 1)[:, None]
        direction = (solution / steps).round().clamp(-INT8_MAX, INT8_MAX)
        constant = (self._level - self._middle[..., :basis] @ (direction * steps))[:, 0]
        return constant.half().float(), direction.to(torch.int8), scale
