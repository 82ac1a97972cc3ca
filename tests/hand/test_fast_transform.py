"""The native transform of a single hand is the torch transform. Degenerate hands: tests/hard_cases."""

import numpy as np
import pytest
import torch
from hand import sampled_hands as hands

from jghand_engine.errors import InputError, RetryError
from jghand_engine.hand.fast_transform import FastTransform
from jghand_engine.hand.frames import FrameFlag
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.transform import JointTransform
from jghand_engine.native import library

CANONICAL = hands.canonical()
VARIANTS = ["torch", "auto"]


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
    fast = FastTransform(CANONICAL, **options, variant=variant)
    for k, one in enumerate(joints.numpy()):
        found = fast.bones64(one)
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
    fast = FastTransform(moved.numpy(), handedness=Handedness.RIGHT, variant=variant)
    joints = hands.sample(1)[0].numpy()
    bones = fast.bones(joints)
    assert bones.linear_offset.dtype == np.float32
    assert bones.root_m.dtype == np.float64
    centered = np.concatenate([moved.numpy() - fast.canonical_root_m, np.ones((21, 1))], axis=1)
    placed = (bones.linear_offset.astype(np.float64) @ centered[:, :, None])[..., 0] + bones.root_m
    assert np.abs(placed - joints).max() < 1e-7


@pytest.mark.parametrize("variant", VARIANTS)
def test_other_memory_layouts_and_types_of_joints_are_read_right(variant):
    fast = FastTransform(CANONICAL, handedness=Handedness.RIGHT, variant=variant)
    joints = np.round(hands.sample(1)[0].numpy(), 3)
    wanted = fast.bones64(joints).linear_offset
    strided = np.zeros((21, 6))[:, ::2]
    strided[:] = joints
    assert np.array_equal(fast.bones64(strided).linear_offset, wanted)
    assert np.array_equal(fast.bones64(np.asfortranarray(joints)).linear_offset, wanted)
    assert np.abs(fast.bones64(joints.astype(np.float32)).linear_offset - wanted).max() < 1e-5


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_bad_joint_gives_nan_and_its_flag(variant, bad):
    fast = FastTransform(CANONICAL, handedness=Handedness.RIGHT, variant=variant)
    for joint in (0, 1, 20):
        joints = hands.canonical_np()
        joints[joint, 2] = bad
        bones = fast.bones(joints)
        assert np.isnan(bones.linear_offset[..., :3]).all()
        assert np.isnan(bones.scale)
        assert np.isnan(bones.angles_rad).all()
        assert bones.flags == FrameFlag.NOT_FINITE


@pytest.mark.parametrize("variant", VARIANTS)
def test_wrong_shapes_are_named(variant):
    fast = FastTransform(CANONICAL, handedness=Handedness.RIGHT, variant=variant)
    with pytest.raises(InputError, match="two hands"):
        fast.bones(np.zeros((42, 3)))
    with pytest.raises(InputError, match="joints of one hand"):
        fast.bones(np.zeros((5, 21, 3)))


@pytest.mark.skipif("auto" not in VARIANTS, reason="no native variant runs on this processor")
def test_a_library_with_another_skeleton_is_refused(monkeypatch):
    loaded = library.load()
    assert loaded is not None
    monkeypatch.setattr(loaded.call, "jg_skeleton_bytes", lambda: 8)
    with pytest.raises(RetryError, match=r"wanted a Skeleton of \d+ bytes, got 8"):
        FastTransform(CANONICAL, handedness=Handedness.RIGHT)


def test_one_transform_serves_many_threads():
    from concurrent.futures import ThreadPoolExecutor

    fast = FastTransform(CANONICAL, handedness=Handedness.RIGHT)
    joints = hands.sample(64).numpy()
    alone = [fast.bones64(one).linear_offset for one in joints]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda one: fast.bones64(one).linear_offset, joints))
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))
