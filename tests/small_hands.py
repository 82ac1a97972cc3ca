"""Hands that are going to be learned, small enough for tests: canonical points, options, models, poses."""

import numpy as np
import torch
from small_avatars import small_tensors

from jghand_engine.avatar.avatar import AvatarInfo
from jghand_engine.avatar.correctives import PoseNetShape
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.learn.canonical_points import CanonicalPoints
from jghand_engine.learn.frames import HandFrames
from jghand_engine.learn.model import LearnedHand, ModelOptions
from jghand_engine.learn.skeleton import BoneTransforms, JointTransform
from jghand_engine.template.builtin import load_template

SMALL_NET = PoseNetShape(octaves=(2, 2, 1), angle_channels=4, angle_texels=5, hidden=12)
SMALL_MODEL = ModelOptions(gaussians=300, pose=SMALL_NET, plane_texels=12, depth_texels=4, hidden=10)
INFO = AvatarInfo("tiny", "", "none")


def small_points(count: int = 300, seed: int = 0) -> CanonicalPoints:
    """Points around the bones of the built-in hand, blended between neighboring bones, with random normals."""
    start, g = small_tensors(count, seed), torch.Generator().manual_seed(77 + seed)
    return CanonicalPoints(
        position_m=start.position_m,
        normal=torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=-1),
        uvd=start.uvd,
        bone_weights=start.bone_weights,
        sigma_m=0.001 + 0.0005 * torch.rand(count, generator=g),
        joints_m=start.canonical_joints_m,
        template="small",
    )


def stirred(module: torch.nn.Module, seed: int = 0, by: float = 0.3) -> None:
    """Moves every parameter a little, so that nothing is zero because it starts at zero."""
    g = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in module.parameters():
            parameter += by * torch.randn(parameter.shape, generator=g, dtype=parameter.dtype)


def small_hand(options: ModelOptions = SMALL_MODEL, *, seed: int = 0, moved: bool = True) -> LearnedHand:
    """moved: as if it had learned something."""
    hand = LearnedHand(small_points(options.gaussians), options, seed)
    if moved:
        stirred(hand)
    return hand


def joints_of(pose: str, handedness: Handedness = Handedness.RIGHT) -> np.ndarray:
    """(21, 3) joints of a named pose of the built-in hand, meters."""
    return named_pose(pose, load_template().joints_m, handedness=handedness)


def rotation(seed: int = 1) -> torch.Tensor:
    """(3, 3) float64, any."""
    q, _ = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)))
    return q * torch.linalg.det(q).sign()


def bones_of(joints_m: np.ndarray | torch.Tensor, handedness: Handedness = Handedness.RIGHT) -> BoneTransforms:
    """The transforms of a pose, from the built-in hand."""
    transform = JointTransform(load_template().joints_m, handedness=handedness)
    return transform.bones(torch.as_tensor(joints_m))


def frames_of(pose: str = "relaxed") -> HandFrames:
    """The frames of a named pose, float64."""
    return bones_of(joints_of(pose)).frames
