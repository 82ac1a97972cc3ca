"""HALO's transform, to compare ours with: no choice for use. And which transform an avatar was made for.

It is written from descriptions (METHOD 2.2, PAPER 3), not from anybody's code, and has the interface of
`JointTransform`, so that an avatar can be trained with it (the ablation "w/o trans").
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.avatar import HandAvatar, forearm_way
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import ScaleMode, Swing, Transform
from jghand_engine.learn import rotations as rot
from jghand_engine.learn.frames import CanonicalTensors, ComponentFrames
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.tensors import HandTensors


def transform_called(
    kind: Transform,
    canonical_joints_m: np.ndarray,
    *,
    handedness: Handedness,
    swing: str = Swing.MINIMAL,
    scale_mode: ScaleMode = "axial",
    forearm_way: np.ndarray | None = None,
) -> JointTransform:
    """The transform `kind`; the rest as `JointTransform` takes it. A HALO-like one has no use for the scale mode."""
    transform = HaloLikeTransform if kind is Transform.HALO_LIKE else JointTransform
    return transform(
        canonical_joints_m, handedness=handedness, swing=swing, scale_mode=scale_mode, forearm_way=forearm_way
    )


def transform_of(avatar: HandAvatar | HandTensors) -> JointTransform:
    """The transform that an avatar was made for."""
    info = avatar.info
    return transform_called(
        info.transform,
        np.asarray(avatar.canonical_joints_m),
        handedness=avatar.handedness,
        swing=info.swing,
        scale_mode=info.scale_mode,
        forearm_way=forearm_way(info.template),
    )


class HaloLikeTransform(JointTransform):
    """Skeleton-driven canonicalization as HALO does it (arXiv 2109.11399): to a canonical skeleton of the *posed* hand.

    That skeleton has the canonical directions and the given hand's bone lengths, each phalanx reaches it by a rigid
    motion, and the whole palm by one, with its frame S_0. HALO's network is told the lengths and shapes the surface by
    them; a surface that has lengths of its own, as a template has, is carried beside the joints by as much as the
    lengths along the finger differ, and the palm by what its bones turn in it. HALO's matrices are exact only for a
    straight canonical hand; these are for every one. tests/learn/test_baselines.py holds it to what the authors' code
    was measured to do (PAPER 3).
    """

    def maps(
        self, joints: Tensor, frames: ComponentFrames, canonical: CanonicalTensors
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See JointTransform.maps; phalanges start where the canonical surface, not its skeleton, is carried."""
        across = canonical.S.transpose(0, 1)
        palm = rot.mat_mul(frames.S0, canonical.S0.transpose(0, 1))
        turn = rot.mat_mul(frames.S[:, :, 5:], across[:, :, 5:])
        # how much farther along the canonical finger the canonical skeleton of the posed hand has its joints
        longer = (frames.relative_length * frames.size - canonical.length_m) * canonical.direction
        beyond = [longer[:, :5]]
        for first in (5, 10):
            beyond.append(beyond[-1] + longer[:, first : first + 5])
        placed = joints[:, 1:16] - rot.mat_vec(turn, torch.cat(beyond, 1))
        linear = torch.cat([palm.expand(-1, -1, 6, -1), turn], 2)
        return linear, torch.cat([joints[:, :1], placed, joints[:, 16:]], 1), torch.ones_like(frames.size)
