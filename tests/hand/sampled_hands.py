"""Random hands for tests, by forward kinematics that shares no code with the package.

Right hand, meters, level order; wrist at the origin, fingers along +y, back of the hand +z, thumb at -x.
"""

from functools import cache

import numpy as np
import torch
from torch import Tensor

F64 = torch.float64
KNUCKLES = torch.tensor([[-25, 22, -8], [-26, 92, 2], [-2, 95, 5], [18, 88, 3], [36, 77, -3]], dtype=F64) * 1e-3
SEGMENTS = torch.tensor([[45, 33, 28], [42, 26, 22], [46, 30, 24], [42, 28, 24], [34, 20, 21]], dtype=F64) * 1e-3
_THUMB_ALONG = torch.tensor([-0.60, 0.72, -0.35], dtype=F64)
_THUMB_UP = torch.tensor([0.55, 0.2, 0.8], dtype=F64)
PARENTS = [-1, 0, 0, 0, 0, 0, *range(1, 16)]
# columns of the affine maps: which canonical joint each bone starts at
STARTS = [0, *PARENTS[1:]]


def _unit(vector: Tensor) -> Tensor:
    return vector / vector.norm(dim=-1, keepdim=True)


def _turn(axis: Tensor, angle: Tensor) -> Tensor:
    x, y, z = _unit(axis).unbind(-1)
    o = torch.zeros_like(x)
    K = torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(*x.shape, 3, 3)
    a = angle[..., None, None]
    return torch.eye(3, dtype=F64) + torch.sin(a) * K + (1 - torch.cos(a)) * (K @ K)


def hand(flexion: Tensor, abduction: Tensor, knuckles: Tensor | None = None, segments: Tensor | None = None) -> Tensor:
    """flexion (N, 5, 3), abduction (N, 5), radians -> joints (N, 21, 3)."""
    n = len(flexion)
    knuckles = KNUCKLES.expand(n, 5, 3) if knuckles is None else knuckles
    segments = SEGMENTS.expand(n, 5, 3) if segments is None else segments
    joints = torch.zeros(n, 21, 3, dtype=F64)
    joints[:, 1:6] = knuckles
    for finger in range(5):
        along = _unit(_THUMB_ALONG.expand(n, 3) if finger == 0 else knuckles[:, finger])
        up = _THUMB_UP.expand(n, 3) if finger == 0 else torch.tensor([0.0, 0.0, 1.0], dtype=F64).expand(n, 3)
        up = _unit(up - (up * along).sum(-1, keepdim=True) * along)
        side = torch.linalg.cross(along, up)
        turn, place = _turn(up, abduction[:, finger]), knuckles[:, finger]
        for k in range(3):
            turn = turn @ _turn(side, -flexion[:, finger, k])
            place = place + (turn @ along.unsqueeze(-1)).squeeze(-1) * segments[:, finger, k : k + 1]
            joints[:, 6 + 5 * k + finger] = place
    return joints


@cache
def canonical() -> Tensor:
    """A spread, slightly flexed hand (21, 3): a valid canonical pose."""
    flexion = torch.tensor([[[0.15, 0.2, 0.15]] + [[0.15, 0.25, 0.15]] * 4], dtype=F64)
    return hand(flexion, torch.tensor([[0.0, 0.12, 0.0, -0.08, -0.16]], dtype=F64))[0]


def canonical_np() -> np.ndarray:
    return canonical().numpy().copy()


def flat() -> Tensor:
    """All fingers straight (21, 3)."""
    return hand(torch.zeros(1, 5, 3, dtype=F64), torch.zeros(1, 5, dtype=F64))[0]


def random_rotations(n: int, generator: torch.Generator) -> Tensor:
    q = _unit(torch.randn(n, 4, dtype=F64, generator=generator))
    w, x, y, z = q.unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, -1).reshape(n, 3, 3)


def sample(
    n: int, seed: int = 0, palm_m: float = 0.006, bone: float = 0.3, shift_m: float = 1.0, turned: bool = True
) -> Tensor:
    """n anatomical poses (n, 21, 3): bone lengths +-`bone`, knuckles moved by N(0, palm_m), any rotation, any place
    within shift_m along each axis."""
    g = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, dtype=F64, generator=g)

    flexion = torch.stack([-0.3 + uniform(n, 5) * 1.9, uniform(n, 5) * 1.9, -0.1 + uniform(n, 5) * 1.4], -1)
    abduction = (uniform(n, 5) - 0.5) * 0.7
    knuckles = KNUCKLES * (1 + bone * (2 * uniform(n, 1, 1) - 1))
    knuckles = knuckles + palm_m * torch.randn(n, 5, 3, dtype=F64, generator=g)
    joints = hand(flexion, abduction, knuckles, SEGMENTS * (1 + bone * (2 * uniform(n, 5, 3) - 1)))
    if turned:
        joints = joints @ random_rotations(n, g).transpose(-1, -2)
    return joints + shift_m * (2 * uniform(n, 1, 3) - 1)


def mirrored(joints: Tensor) -> Tensor:
    return joints * torch.tensor([-1.0, 1.0, 1.0], dtype=joints.dtype)


def ends_moved(matrices: Tensor, canonical_m: Tensor) -> tuple[Tensor, Tensor]:
    """Where (N, 21, 3, 4) matrices carry the canonical joints: ends of bones (N, 21, 3), starts (N, 20, 3)."""
    linear, offset = matrices[..., :3], matrices[..., 3]

    def apply(part: slice, points: Tensor) -> Tensor:
        return (linear[:, part] * points.unsqueeze(-2)).sum(-1) + offset[:, part]

    return apply(slice(0, 21), canonical_m), apply(slice(1, 21), canonical_m[STARTS[1:]])


def joint_error_mm(matrices: Tensor, canonical_m: Tensor, joints_m: Tensor) -> float:
    """Largest distance, mm, of any end of any bone from where it should be."""
    ends, starts = ends_moved(matrices, canonical_m.to(matrices.dtype))
    target = torch.cat([joints_m, joints_m[:, STARTS[1:]]], 1)
    return ((torch.cat([ends, starts], 1) - target).double().norm(dim=-1).max() * 1e3).item()
