import numpy as np
import pytest
from pxr import UsdSkel
from scipy.spatial.transform import Rotation

from jghand_engine.export.motion import JOINT_AXES, BonePoses, joint_axes
from jghand_engine.export.usd.rig import (
    FINE_SHARE,
    build_skeleton,
    in_motion,
    joint_tokens,
    same_hemisphere,
    skin_influences,
    split_scales,
)
from jghand_engine.hand.joints import JOINT_COUNT, STANDARD_NAMES, Handedness
from jghand_engine.template.builtin import load_template


def test_control_joints_are_named_as_everywhere_and_come_first():
    tokens = joint_tokens()
    assert len(tokens) == 3 * JOINT_COUNT
    assert tuple(token.split("/")[-1] for token in tokens[:21]) == STANDARD_NAMES
    assert tokens[8] == "wrist/index1/index2/index3/index4"


def test_skin_leaves_hang_on_the_joint_where_their_bone_starts():
    tokens = joint_tokens()
    assert tokens[21] == "wrist/palm_skin"
    assert "wrist/index1_skin" in tokens
    assert "wrist/index1/index2_skin_fine" in tokens


def test_usd_accepts_the_hierarchy():
    valid, reason = UsdSkel.Topology(joint_tokens()).Validate()
    assert valid, reason


def test_coarse_and_fine_scale_make_up_what_half_precision_loses():
    scales = np.random.default_rng(0).uniform(0.3, 3, (1000, 21, 3))
    coarse, fine = split_scales(scales)
    for part in (coarse, fine):
        assert (part == part.astype(np.float16)).all()
        assert (part > 0).all()
    together = (1 - FINE_SHARE) * coarse + FINE_SHARE * fine
    # half a step of half precision times the share, 2^-11 * 2^-8, and a little for twins above 2; observed 2.0e-6
    assert np.abs(together / scales - 1).max() < 2.2e-6
    assert np.abs(coarse / scales - 1).max() > 4e-4, "half precision alone would do, then the twins are not needed"


def test_a_bone_without_length_has_no_scale():
    coarse, fine = split_scales(np.zeros((1, 21, 3)))
    assert not coarse.any()
    assert not fine.any()


def test_quaternions_never_jump_to_the_other_side_of_the_sphere():
    angle = np.linspace(0, 8 * np.pi, 200)[:, None]
    quaternions = np.stack([np.sin(angle / 2), 0 * angle, 0 * angle, np.cos(angle / 2)], axis=-1)
    flipped = quaternions * np.random.default_rng(1).choice([-1.0, 1.0], (200, 1, 1))
    smooth = same_hemisphere(flipped)
    assert ((smooth[1:] * smooth[:-1]).sum(-1) > 0).all()


def test_rotations_do_not_jump_between_the_parts_of_a_motion():
    """A wrist that turns twice all round: without care its quaternions change sign somewhere."""
    frames = 60
    angle = np.linspace(0, 4 * np.pi, frames)
    turn = Rotation.from_rotvec(angle[:, None] * [0.6, -0.48, 0.64]).as_matrix()
    axes = np.broadcast_to(turn[:, None], (frames, 21, 3, 3))
    joints_m = np.einsum("fab,jb->fja", turn, load_template().joints_m)
    poses = BonePoses(joints_m, axes, np.ones((frames, 21, 3)))
    parts = [BonePoses(*(getattr(poses, name)[part] for name in ("joints_m", "axes", "scales")))
             for part in (slice(0, 1), *(slice(first, first + 7) for first in range(0, frames, 7)))]  # fmt: skip
    skeleton = build_skeleton(parts[0])
    rotations = np.concatenate([one.rotations_xyzw for one in in_motion(skeleton, parts[1:])])
    assert len(rotations) == frames
    assert ((rotations[1:] * rotations[:-1]).sum(-1) > 0.9).all()


def test_influences_drop_nothing():
    weights = load_template().bone_weights
    joints, shares = skin_influences(weights)
    assert np.abs(shares.sum(axis=1) - 1).max() < 1e-12
    assert (shares > 0).sum() == 2 * (weights > 0).sum()
    assert joints[shares > 0].min() >= 21, "control joints move no skin"


@pytest.mark.parametrize("handedness", list(Handedness))
def test_joint_axes_are_right_handed_with_y_along_the_bone(handedness):
    frame = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    frame *= np.sign(np.linalg.det(frame))
    axes = joint_axes(frame[None], handedness)[0]
    assert np.isclose(np.linalg.det(axes), 1)
    mirror = [-1, 1, 1] if handedness is Handedness.LEFT else [1, 1, 1]
    assert np.allclose(axes[:, 1], frame[:, 2] * mirror)
    assert np.allclose(axes[:, 2], frame[:, 0] * mirror)
    assert JOINT_AXES == (1, 2, 0)
