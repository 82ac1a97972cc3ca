"""The bones of a single hand are those of the differentiable form. Degenerate hands: tests/hard_cases."""

from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from hand import sampled_hands as hands

from jghand_engine.errors import InputError, RetryError
from jghand_engine.hand.canonical import CanonicalHand
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.skeleton import FrameFlag, Skeleton, Swing, describe_flags
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.native import library

CANONICAL = hands.canonical_np()
VARIANTS = library.runnable_variants()


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("handedness", list(Handedness))
@pytest.mark.parametrize("mode", ["axial", "uniform", 0.3])
@pytest.mark.parametrize("swing", ["minimal", "euler"])
def test_agrees_with_the_torch_transform(variant, handedness, mode, swing):
    # 6 mm of palm change: some of these hands need the palm clamp
    joints = hands.sample(200)
    options = {"handedness": handedness, "swing": swing, "scale_mode": mode}
    bones = JointTransform(CANONICAL, **options).bones(joints)
    wanted = torch.cat([bones.linear, bones.offset_m.unsqueeze(-1)], -1).numpy()
    frames = bones.frames
    angles = torch.cat([frames.angles.flatten(1), frames.palm_p, frames.palm_n], 1).numpy()
    skeleton = Skeleton(CANONICAL, **options, variant=variant)
    for k, one in enumerate(joints.numpy()):
        found = skeleton.bones(one, np.float64)
        # worst observed 3e-15
        assert np.abs(found.linear_offset - wanted[k]).max() < 2e-14
        assert abs(found.scale - float(bones.scale[k])) < 1e-14
        assert found.flags == int(bones.frames.flags[k])
        assert np.array_equal(found.root_m, one[0])
        # worst observed 5e-15
        assert np.abs(found.angles_rad - angles[k]).max() < 2e-14


@pytest.mark.parametrize("variant", VARIANTS)
def test_result_is_float32_root_relative(variant):
    moved = CANONICAL + 0.5
    skeleton = Skeleton(moved, handedness=Handedness.RIGHT, variant=variant)
    joints = hands.sample(1)[0].numpy()
    bones = skeleton.bones(joints)
    assert bones.linear_offset.dtype == np.float32
    assert bones.root_m.dtype == np.float64
    centered = np.concatenate([moved - skeleton.canonical_root_m, np.ones((21, 1))], axis=1)
    placed = (bones.linear_offset.astype(np.float64) @ centered[:, :, None])[..., 0] + bones.root_m
    assert np.abs(placed - joints).max() < 1e-7


@pytest.mark.parametrize("variant", VARIANTS)
def test_other_memory_layouts_and_types_of_joints_are_read_right(variant):
    skeleton = Skeleton(CANONICAL, handedness=Handedness.RIGHT, variant=variant)
    joints = np.round(hands.sample(1)[0].numpy(), 3)
    wanted = skeleton.bones(joints, np.float64).linear_offset
    strided = np.zeros((21, 6))[:, ::2]
    strided[:] = joints
    assert np.array_equal(skeleton.bones(strided, np.float64).linear_offset, wanted)
    assert np.array_equal(skeleton.bones(np.asfortranarray(joints), np.float64).linear_offset, wanted)
    assert np.abs(skeleton.bones(joints.astype(np.float32), np.float64).linear_offset - wanted).max() < 1e-5


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_bad_joint_gives_nan_and_its_flag(variant, bad):
    skeleton = Skeleton(CANONICAL, handedness=Handedness.RIGHT, variant=variant)
    for joint in (0, 1, 20):
        joints = hands.canonical_np()
        joints[joint, 2] = bad
        bones = skeleton.bones(joints)
        assert np.isnan(bones.linear_offset[..., :3]).all()
        assert np.isnan(bones.scale)
        assert np.isnan(bones.angles_rad).all()
        assert bones.flags == FrameFlag.NOT_FINITE


@pytest.mark.parametrize("variant", VARIANTS)
def test_wrong_shapes_are_named(variant):
    skeleton = Skeleton(CANONICAL, handedness=Handedness.RIGHT, variant=variant)
    with pytest.raises(InputError, match="two hands"):
        skeleton.bones(np.zeros((42, 3)))
    with pytest.raises(InputError, match="joints of one hand"):
        skeleton.bones(np.zeros((5, 21, 3)))


def test_a_library_with_another_skeleton_is_refused(monkeypatch):
    loaded = library.load()
    assert loaded is not None
    monkeypatch.setattr(loaded.call, "jg_skeleton_bytes", lambda: 8)
    with pytest.raises(RetryError, match=r"wanted a Skeleton of \d+ bytes, got 8"):
        Skeleton(CANONICAL, handedness=Handedness.RIGHT)


def test_one_transform_serves_many_threads():
    from concurrent.futures import ThreadPoolExecutor

    skeleton = Skeleton(CANONICAL, handedness=Handedness.RIGHT)
    joints = hands.sample(64).numpy()
    alone = [skeleton.bones(one, np.float64).linear_offset for one in joints]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda one: skeleton.bones(one, np.float64).linear_offset, joints))
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))


@pytest.mark.parametrize("make", [Skeleton, JointTransform, partial(named_pose, "open")])
def test_which_hand_it_is_must_be_said(make):
    with pytest.raises(TypeError, match="handedness"):
        make(CANONICAL)


def test_unusable_options_are_named():
    with pytest.raises(InputError, match="scale mode"):
        Skeleton(CANONICAL, handedness=Handedness.RIGHT, scale_mode=1.5)
    with pytest.raises(InputError, match="swing: wanted minimal or euler, got 'roll'"):
        Skeleton(CANONICAL, handedness=Handedness.RIGHT, swing="roll")


def test_unusable_canonical_hands_are_refused():
    same = CANONICAL.copy()
    same[7] = same[2]
    with pytest.raises(InputError, match="none at index2"):
        CanonicalHand.build(same)
    parallel = CANONICAL.copy()
    parallel[5] = 0.9 * parallel[4]
    with pytest.raises(InputError, match="Spread the fingers"):
        CanonicalHand.build(parallel)
    with pytest.raises(InputError, match="finite"):
        CanonicalHand.build(CANONICAL * np.nan)
    with pytest.raises(InputError, match="finite"):
        CanonicalHand.build(CANONICAL[:20])
    sideways = CANONICAL.copy()
    y_axis = CanonicalHand.build(CANONICAL).frames[2, :, 1]
    for k in range(3):
        sideways[7 + 5 * k] = sideways[2] + y_axis * 0.03 * (k + 1)
    with pytest.raises(InputError, match="bent sideways"):
        CanonicalHand.build(sideways)


@pytest.mark.filterwarnings("error")
def test_joints_in_a_tensor_are_copied_without_a_warning():
    tensor: Any = torch.from_numpy(CANONICAL.copy())
    hand = CanonicalHand.build(tensor)
    tensor += 1
    np.testing.assert_array_equal(hand.root_m, CANONICAL[0])


@pytest.mark.parametrize("seed", range(20))
def test_what_is_known_of_a_canonical_hand_is_what_the_reference_computes_of_it(seed):
    canonical = hands.sample(1, seed=seed, palm_m=0.001, bone=0.1, turned=bool(seed % 2))[0].numpy()
    hand, reference = (
        CanonicalHand.build(canonical),
        JointTransform(canonical, handedness=Handedness.RIGHT, swing=Swing.EULER).frames(torch.from_numpy(canonical)),
    )
    # worst observed 7e-16
    assert np.abs(hand.frames - torch.cat([reference.S0.unsqueeze(0), reference.S]).numpy()).max() < 1e-14
    assert np.abs(hand.u - reference.u.numpy()).max() < 1e-14
    assert np.abs(hand.length_m - reference.length.numpy()).max() < 1e-14
    assert np.abs(hand.palm_normal - reference.palm_normal.numpy()).max() < 1e-14


@pytest.mark.parametrize("handedness", list(Handedness))
@pytest.mark.parametrize("mode", ["axial", "uniform", 0.3])
def test_frames_follow_from_the_bones(handedness, mode):
    options = {"handedness": handedness, "scale_mode": mode}
    skeleton, joints = Skeleton(CANONICAL, **options), hands.sample(100)
    reference = JointTransform(CANONICAL, **options).frames(joints)
    wanted = torch.cat([reference.S0.unsqueeze(1), reference.S], 1).numpy()
    for k, one in enumerate(joints.numpy()):
        bones = skeleton.bones(one, np.float64)
        frames, scales = skeleton.frames(bones)
        # worst observed 2e-15
        assert np.abs(frames - wanted[k]).max() < 1e-13
        assert np.abs(scales[1:, 2] * skeleton.canonical.length_m - reference.length[k].numpy()).max() < 1e-14
        linear = frames @ (scales[..., None] * np.swapaxes(skeleton.canonical.frames, -1, -2))
        mirror = -1 if handedness is Handedness.LEFT else 1
        assert np.abs(linear * np.array([mirror, 1, 1])[:, None] - bones.linear_offset[..., :3]).max() < 1e-13


def test_flags_read_as_sentences():
    assert describe_flags(0) == []
    assert describe_flags(FrameFlag.ZERO_BONE | FrameFlag.NO_PALM) == ["a bone has no length", "the palm has no plane"]
