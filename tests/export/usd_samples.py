"""An avatar and motions for the tests of the USD export, also used to make the stages that Blender's tests import."""

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.hand.joints import PARENTS, Handedness
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.template.builtin import load_template

FPS = 30.0


def small_avatar(scale_mode: str | float = "axial", swing: str = "minimal") -> HandAvatar:
    """Gaussians on every second vertex of the built-in hand, in many colors and sizes."""
    template = load_template()
    rng = np.random.default_rng(5)
    some = slice(None, None, 2)
    position = template.vertices_m[some].astype(np.float32)
    count = len(position)
    return HandAvatar(
        info=AvatarInfo("test", template.identifier, "CC0-1.0", swing=swing, scale_mode=scale_mode),
        handedness=Handedness.RIGHT,
        canonical_joints_m=template.joints_m,
        position_m=position,
        sigma_m=rng.uniform(0.0005, 0.002, count).astype(np.float32),
        opacity=rng.uniform(0, 1, count).astype(np.float32),
        rgb=rng.uniform(0, 1, (count, 3)).astype(np.float32),
        bone_weights=template.bone_weights[some].astype(np.float32),
        uvd=np.zeros((count, 3), np.float32),
    )


def lively_motion(handedness: Handedness, frames: int = 40, *, length_change: float = 0.2) -> PoseSequence:
    """Curling fingers, a spreading and folding palm, bone lengths that change by +- `length_change` each in its own
    rhythm, and a wrist that turns all the way round and walks half a meter."""
    canonical = load_template().joints_m
    rng = np.random.default_rng(11)
    phase, axis = rng.uniform(0, 2 * np.pi, 21), rng.normal(size=(21, 3))
    joints_m = np.zeros((frames, 21, 3))
    for frame in range(frames):
        at = 2 * np.pi * frame / frames
        turn = {0: Rotation.from_rotvec(at * np.array([0.6, -0.5, 0.62]))}
        joints_m[frame, 0] = 0.25 * np.array([np.sin(at), np.cos(at), 0.3 * np.sin(2 * at)])
        for bone in range(1, 21):
            parent = PARENTS[bone]
            # fingers curl about the hand's x axis, metacarpals wander by up to 9 degrees
            curl = [-0.6 * (1 - np.cos(at + 0.3 * phase[bone])), 0, 0] if bone > 5 else [0, 0, 0]
            wander = 0.15 * np.sin(at + phase[bone]) * axis[bone] / np.linalg.norm(axis[bone])
            turn[bone] = turn[parent] * Rotation.from_rotvec(np.array(curl) + wander)
            length = 1 + length_change * np.sin(2 * at + phase[bone])
            step = turn[bone].apply(canonical[bone] - canonical[parent])
            joints_m[frame, bone] = joints_m[frame, parent] + length * step
    if handedness is Handedness.LEFT:
        joints_m = joints_m * [-1, 1, 1]
    return PoseSequence(joints_m, FPS, handedness)


def engine_mesh(sequence: PoseSequence, scale_mode: str | float = "axial", swing: str = "minimal") -> np.ndarray:
    """(F, V, 3) the vertices of the built-in hand as the engine skins them, meters, float64; a left hand's are the
    mirrored template's."""
    template = load_template()
    transform = JointTransform(
        torch.tensor(template.joints_m), handedness=sequence.handedness, scale_mode=scale_mode, swing=swing
    )
    matrices = transform.bones(torch.tensor(sequence.joints_m)).matrices().numpy()
    blended = np.einsum("vi,fiab->fvab", template.bone_weights, matrices)
    return np.einsum("fvab,vb->fva", blended[..., :3], template.vertices_m) + blended[..., 3]


def engine_gaussians(avatar: HandAvatar, sequence: PoseSequence) -> tuple[np.ndarray, np.ndarray]:
    """(F, N, 3) centers and (F, N) radii as the engine poses them, meters, in float64."""
    transform = transform_of(avatar.for_hand(sequence.handedness))
    poses = torch.tensor(sequence.joints_m)
    frames = [pose_gaussians(avatar, transform.bones(one), frames=transform.frames(one)) for one in poses]
    return (
        np.stack([frame.position_m.numpy() for frame in frames]),
        np.stack([frame.sigma_m.numpy() for frame in frames]),
    )
