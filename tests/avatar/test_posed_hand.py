"""Posing for files is the torch functions' in float64, in the avatar's own order, without what skin mirrors."""

import numpy as np
import pytest
import torch
from small_avatars import ellipsoid_avatar, small_avatar, trained_avatar
from small_hands import joints_of

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.posing import Posing
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.native.binding import Library

AVATARS = {"painted": small_avatar, "trained": trained_avatar, "ellipsoids": ellipsoid_avatar}
# offsets move with the place where the angle planes are looked up, and that with the joints: see test_trained_posing
POSITION_M, RELATIVE, COLOR = 1.5e-7, 3e-6, 2e-5


def exactly(avatar: HandAvatar, joints_m: np.ndarray):
    bones = transform_of(avatar).bones(torch.from_numpy(joints_m))
    with torch.no_grad():
        return pose_gaussians(avatar, bones, frames=bones.frames)


@pytest.mark.parametrize("kind", AVATARS)
@pytest.mark.parametrize("handedness", list(Handedness))
@pytest.mark.parametrize("pose", ["open", "fist", "claw"])
def test_a_frame_is_what_the_engine_draws_without_gloss(library: Library, kind, handedness, pose):
    avatar = AVATARS[kind](333).for_hand(handedness)
    joints_m = 1.1 * joints_of(pose, handedness) + np.array([0.1, -0.2, 0.05])
    posed, wanted = Posing(avatar, 1, library)(joints_m), exactly(avatar, joints_m)
    # worst observed 9e-8 m
    assert np.abs(posed.position_m - wanted.position_m.numpy()).max() < POSITION_M
    assert np.abs(posed.sigma_m / wanted.sigma_m.numpy() - 1).max() < RELATIVE
    if kind == "painted":
        assert posed.rgb is None
    else:
        assert np.abs(posed.rgb - wanted.rgb.clamp(0, 1).numpy()).max() < COLOR
    if kind == "ellipsoids":
        largest = wanted.covariance_m2[:, [0, 3, 5]].amax(1, keepdim=True).numpy()
        assert (np.abs(posed.covariance_m2 - wanted.covariance_m2.numpy()) < RELATIVE * largest).all()
    else:
        assert posed.covariance_m2 is None


def test_a_hand_far_from_the_origin_is_off_by_the_steps_of_float32_alone(library: Library):
    avatar = trained_avatar(333)
    joints_m = joints_of("fist") + np.array([10.0, -20.0, 30.0])
    posed, wanted = Posing(avatar, 1, library)(joints_m), exactly(avatar, joints_m)
    # half a step at 30 m is 9.5e-7 m; the sum is made in float64, and rounded once
    assert np.abs(posed.position_m - wanted.position_m.numpy()).max() < 1.2e-6


def test_frames_do_not_share_memory(library: Library):
    posing = Posing(trained_avatar(50), 1, library)
    first = posing(joints_of("open"))
    copies = first.position_m.copy(), first.sigma_m.copy(), first.rgb.copy()
    posing(joints_of("fist"))
    for now, before in zip((first.position_m, first.sigma_m, first.rgb), copies, strict=True):
        assert np.array_equal(now, before)
