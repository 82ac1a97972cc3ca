"""The transform in the paper's factors T P K' F' R F K, corrected, and with each of its misprints. METHOD 2.2, 2.3.

Only for tests: it shows that the closed form of the engine is this chain. Uniform scale; batch first.
"""

from __future__ import annotations

import torch
from hand.sampled_hands import STARTS
from torch import Tensor

from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import Swing
from jghand_engine.learn.skeleton import JointTransform

MISPRINTS = ("g_as_printed", "g_not_recursive", "f_uses_parent_g", "one_global_p")
_PARENTS = STARTS[1:]


def _transposed(matrix: Tensor) -> Tensor:
    return matrix.transpose(-1, -2)


def _affine(n: int, linear: Tensor | None = None, offset: Tensor | None = None) -> Tensor:
    result = torch.eye(4, dtype=torch.float64).repeat(n, 20, 1, 1)
    if linear is not None:
        result[..., :3, :3] = linear
    if offset is not None:
        result[..., :3, 3] = offset
    return result


def factored(transform: JointTransform, canonical_m: Tensor, joints_m: Tensor, variant: str = "corrected") -> Tensor:
    """(N, 20, 4, 4) maps of bones 1..20 that act on root-centered canonical points; right hands, meters."""
    n = len(joints_m)
    rest = JointTransform(canonical_m.numpy(), handedness=Handedness.RIGHT, swing=Swing.EULER).frames(canonical_m)
    posed = transform.frames(joints_m)
    centered = canonical_m - canonical_m[:1]
    eye5 = torch.eye(3, dtype=torch.float64).repeat(n, 5, 1, 1)
    parent = torch.arange(-5, 15).clamp_min(0)

    K = _affine(n, torch.eye(3) / rest.length[:, None, None], -centered[_PARENTS] / rest.length[:, None])
    # R_i = Q(u_i) Q(u_i^c)^T; Q follows from the frames: S_i = S_p Q
    F = torch.cat([eye5, _transposed(rest.S[parent[5:]]).expand(n, 15, 3, 3)], 1)
    rest_Q = _transposed(rest.S[parent[5:]]) @ rest.S[5:]
    posed_Q = _transposed(posed.S[:, parent[5:]]) @ posed.S[:, 5:]
    R = torch.cat([eye5, posed_Q @ _transposed(rest_Q)], 1)

    G = torch.eye(3, dtype=torch.float64).repeat(n, 20, 1, 1)
    for i in range(5, 20):
        p = i - 5
        turn = _transposed(F[:, p]) @ R[:, p] @ F[:, p]
        if variant == "g_as_printed":
            G[:, i] = F[:, p] @ R[:, p] @ _transposed(F[:, p])
        else:
            G[:, i] = turn if variant == "g_not_recursive" else G[:, p] @ turn
    F_back = (G[:, parent] if variant == "f_uses_parent_g" else G) @ _transposed(F)

    bone = (F_back @ R @ F @ rest.direction[..., None]).squeeze(-1) * posed.length[..., None]
    start = torch.zeros(n, 20, 3, dtype=torch.float64)
    for i in range(5, 20):
        start[:, i] = start[:, i - 5] + bone[:, i - 5]
    K_back = _affine(n, posed.length[..., None, None] * torch.eye(3), start)
    if variant == "one_global_p":
        P = (posed.S0 @ _transposed(rest.S0))[:, None].expand(n, 20, 3, 3)
    else:
        P = (posed.S[:, :5] @ _transposed(rest.S[:5])).repeat(1, 4, 1, 1)
    T = _affine(n, offset=joints_m[:, :1])
    return T @ _affine(n, P) @ K_back @ _affine(n, F_back) @ _affine(n, R) @ _affine(n, F) @ K
