"""Two transforms to compare ours with: a naive one, and one after the description of HALO. They are no choices for use.

Both are written from the description in METHOD 2.2 and 6.2, not from anybody's code, and have the interface of
`JointTransform`, so that an avatar can be trained with them (the ablation "w/o trans").
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import ScaleMode, Swing, Transform
from jghand_engine.learn import rotations as rot
from jghand_engine.learn.frames import CanonicalTensors, ComponentFrames, swing_of
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.tensors import HandTensors


def transform_called(
    kind: Transform,
    canonical_joints_m: np.ndarray,
    *,
    handedness: Handedness,
    swing: str = Swing.MINIMAL,
    scale_mode: ScaleMode = "axial",
) -> JointTransform:
    """The transform `kind`; the rest as `JointTransform` takes it. A HALO-like one has no use for the scale mode."""
    transform = HaloLikeTransform if kind is Transform.HALO_LIKE else JointTransform
    return transform(canonical_joints_m, handedness=handedness, swing=swing, scale_mode=scale_mode)


def transform_of(avatar: HandAvatar | HandTensors) -> JointTransform:
    """The transform that an avatar was made for."""
    info = avatar.info
    return transform_called(
        info.transform,
        np.asarray(avatar.canonical_joints_m),
        handedness=avatar.handedness,
        swing=info.swing,
        scale_mode=info.scale_mode,
    )


class HaloLikeTransform(JointTransform):
    """The canonical skeleton in the angles of the given joints: its own bone lengths, one rotation for the whole palm.

    The palm moves as one rigid piece by its frame S_0, each phalanx by its angles in the frame of its parent, and bones
    follow one another along the chain. Wrong by what the hand's lengths and palm differ from the canonical hand's.
    HALO itself maps posed to canonical and keeps the posed lengths, and its chain is exact only for a straight
    canonical hand; this form is exact for every hand of canonical proportions.
    """

    def maps(
        self, joints: Tensor, frames: ComponentFrames, canonical: CanonicalTensors
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See JointTransform.maps; the bones meet on the chain instead of on the joints."""
        palm = rot.mat_mul(frames.S0, canonical.S0.transpose(0, 1))
        levels = [rot.mat_mul(palm, canonical.S[:, :, :5])]
        for first in (0, 5, 10):
            here = slice(first, first + 5)
            levels.append(rot.mat_mul(levels[-1], swing_of(frames.u[:, here], canonical, here, self.swing)[0]))
        turn = rot.mat_mul(torch.cat(levels, 2), canonical.S.transpose(0, 1))
        placed = [torch.zeros_like(joints[:, :1]), rot.mat_vec(palm, canonical.joints_m[:, 1:6])]
        for first in (5, 10, 15):
            bone = canonical.joints_m[:, first + 1 : first + 6] - canonical.joints_m[:, first - 4 : first + 1]
            placed.append(placed[-1] + rot.mat_vec(turn[:, :, first : first + 5], bone))
        return torch.cat([palm, turn], 2), torch.cat(placed, 1), torch.ones_like(frames.size)


class NaiveTransform(JointTransform):
    """Every bone by itself: the smallest rotation from its canonical direction to the posed one, start on start.

    A direction says nothing of the twist about it, so the skin tears where the hand as a whole has turned; the lengths
    are the canonical hand's, so the end of a bone misses its joint.
    """

    def maps(
        self, joints: Tensor, frames: ComponentFrames, canonical: CanonicalTensors
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See JointTransform.maps."""
        palm = rot.mat_mul(frames.S0, canonical.S0.transpose(0, 1))
        # at its pole (a bone turned back to front) any half turn about an axis across the bone will do
        flips = rot.half_turn(canonical.S[:, 1])
        turn = rot.minimal_rotation(canonical.direction, frames.direction, flips)
        return torch.cat([palm, turn], 2), joints, torch.ones_like(frames.size)
