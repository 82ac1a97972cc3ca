"""Degenerate hands: every singularity of the transform, by name. METHOD 2.10."""

from __future__ import annotations

import math
from functools import cache

import torch
from hand import sampled_hands as hands
from torch import Tensor

from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.skeleton import JointTransform

F64 = torch.float64


def _base() -> Tensor:
    return hands.sample(1, seed=3, palm_m=0.003, bone=0.1, shift_m=0.0, turned=False)[0]


def _straight_finger(finger: int, signs: tuple[int, int, int] = (1, 1, 1)) -> Tensor:
    """A finger in line with its metacarpal; a sign of -1 folds the bone back."""
    joints = _base()
    along = joints[1 + finger] / joints[1 + finger].norm()
    place = joints[1 + finger]
    for k, length in enumerate((0.04, 0.03, 0.02)):
        place = place + signs[k] * along * length
        joints[6 + 5 * k + finger] = place
    return joints


def _abducted(finger: int, beside_rad: float = 0.0) -> Tensor:
    """A finger along the flexion axis of its metacarpal: the pole of the euler swing, or a little beside it."""
    joints = _base()
    S = JointTransform(hands.canonical_np(), handedness=Handedness.RIGHT).frames(joints).S[finger]
    along = S[:, 1] * math.cos(beside_rad) + S[:, 2] * math.sin(beside_rad)
    for k in range(3):
        joints[6 + 5 * k + finger] = joints[1 + finger] + along * 0.03 * (k + 1)
    return joints


def _moved(**places: Tensor) -> Tensor:
    joints = _base()
    for name, place in places.items():
        joints[int(name[1:])] = place
    return joints


@cache
def hard_hands() -> dict[str, Tensor]:
    """Name -> (21, 3) float64 joints, meters unless the name says otherwise."""
    base = _base()
    line = torch.tensor([0.0, 0.09, 0.0], dtype=F64)
    cases = {
        "generic": base,
        "all fingers straight": hands.flat(),
        "index collinear with its metacarpal": _straight_finger(1),
        "index folded back at PIP": _straight_finger(1, (1, -1, -1)),
        "index folded back at MCP": _straight_finger(1, (-1, -1, -1)),
        "abduction 90 deg": _abducted(2),
        "abduction 90 deg + 1e-6": _abducted(2, 1e-6),
        "abduction 90 deg + 2e-3": _abducted(2, 2e-3),
        "ring and pinky metacarpals collinear": _moved(j5=base[4] * 0.9),
        "all metacarpals collinear": _moved(**{f"j{i}": line * (1 + 0.01 * i) for i in range(1, 6)}),
        "index and middle MCP crossed": _moved(j2=base[3], j3=base[2]),
        "zero bone, PIP at DIP": _moved(j12=base[7]),
        "zero bone, tip at DIP": _moved(j17=base[12]),
        "middle MCP at the wrist": _moved(j3=base[0]),
        "all MCP at the wrist": _moved(**{f"j{i}": base[0] for i in range(1, 6)}),
        "all joints coincide": torch.full((21, 3), 0.3, dtype=F64),
        "all joints on a line": torch.outer(torch.arange(21, dtype=F64), torch.tensor([0.01, 0.0, 0.0], dtype=F64)),
        "10 m away": base + 10.0,
        "1 km away": base + 1000.0,
        "left hand": hands.mirrored(base),
        "turned by pi": base * torch.tensor([-1.0, -1.0, 1.0], dtype=F64),
        "turned by pi about x": base * torch.tensor([1.0, -1.0, -1.0], dtype=F64),
    }
    for scale in (1e3, 1e6, 1e-6, 1e-12, 1e12):
        cases[f"units x {scale:g}"] = base * scale
    return cases


def size_of(joints: Tensor) -> float:
    return max((joints - joints[:1]).abs().max().item(), 1e-30)
