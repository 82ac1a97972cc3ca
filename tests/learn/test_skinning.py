"""Posing an avatar: where the canonical hand stays, what turns with it, and gradients that stay finite."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_avatars import small_tensors
from small_hands import rotation

from jghand_engine.avatar.skin_task import SIGMA_STRETCH_MAX
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.pose_net import Correction
from jghand_engine.learn.skeleton import BoneTransforms, JointTransform
from jghand_engine.learn.skinning import apply, blend, pose_gaussians, pose_skin, turning, volume_scale
from jghand_engine.learn.tensors import HandTensors
from jghand_engine.template.builtin import load_template
from jghand_engine.template.weight_field import WeightField

POSES = ("open", "fist", "point", "pinch", "claw")


def joints_of(avatar: HandTensors, pose: str) -> torch.Tensor:
    return torch.from_numpy(named_pose(pose, avatar.canonical_joints_m.numpy(), handedness=Handedness.RIGHT))


def bones_of(avatar: HandTensors, joints_m: torch.Tensor, **options) -> BoneTransforms:
    return JointTransform(avatar.canonical_joints_m, **{"handedness": avatar.handedness, **options}).bones(joints_m)


def posed_with(avatar: HandTensors, bones: BoneTransforms, offset_m: torch.Tensor) -> Gaussians:
    return pose_skin(avatar, bones, Correction(offset_m, torch.zeros_like(offset_m))).matt


def test_canonical_joints_give_the_canonical_gaussians():
    avatar = small_tensors()
    # float32 weights sum to 1 only within 1e-7, which is 5e-9 m
    weights = avatar.bone_weights.double()
    avatar = replace(avatar, bone_weights=weights / weights.sum(1, keepdim=True))
    posed = pose_gaussians(avatar, bones_of(avatar, avatar.canonical_joints_m))
    # worst seen 6e-17 m and 2e-16
    torch.testing.assert_close(posed.position_m, avatar.position_m.double(), atol=1e-15, rtol=0)
    torch.testing.assert_close(posed.sigma_m, avatar.sigma_m.double(), atol=1e-18, rtol=1e-14)
    assert torch.equal(posed.rgb, avatar.rgb.double())
    assert torch.equal(posed.opacity, avatar.opacity.double())


def test_where_the_canonical_hand_stands_is_of_no_matter():
    avatar, shift_m = small_tensors(), torch.tensor([0.3, -0.2, 0.7], dtype=torch.float64)
    joints_m = joints_of(avatar, "fist")
    moved = replace(
        avatar, position_m=avatar.position_m.double() + shift_m, canonical_joints_m=avatar.canonical_joints_m + shift_m
    )
    here, there = (pose_gaussians(one, bones_of(one, joints_m)).position_m for one in (avatar, moved))
    torch.testing.assert_close(there, here, atol=1e-14, rtol=0)


@pytest.mark.parametrize("pose", POSES)
def test_turning_moving_and_scaling_the_joints_does_the_same_to_the_gaussians(pose):
    avatar = small_tensors()
    joints_m, R, size = joints_of(avatar, pose), rotation(), 1.3
    shift_m = torch.tensor([0.3, -2.0, 0.7], dtype=torch.float64)
    offset_m = 0.002 * torch.randn(len(avatar), 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    here = posed_with(avatar, bones_of(avatar, joints_m), offset_m)
    there = posed_with(avatar, bones_of(avatar, size * joints_m @ R.T + shift_m), offset_m)
    # worst seen 6e-16 m
    torch.testing.assert_close(there.position_m, size * here.position_m @ R.T + shift_m, atol=5e-15, rtol=0)
    torch.testing.assert_close(there.sigma_m, size * here.sigma_m, atol=0, rtol=1e-12)


@pytest.mark.parametrize("pose", POSES)
def test_single_precision_agrees_with_double(pose):
    avatar = small_tensors()
    joints_m = joints_of(avatar, pose)
    exact = pose_gaussians(avatar, bones_of(avatar, joints_m))
    single = pose_gaussians(avatar, bones_of(avatar, joints_m.float()))
    assert single.position_m.dtype == torch.float32
    # worst seen 5e-8 m; METHOD 2.9 has 8e-5 mm
    assert float((single.position_m - exact.position_m).abs().max()) < 1.2e-7


def test_radii_follow_the_hands_size_and_bent_skin_is_not_thinned():
    avatar = small_tensors(2000)
    bones = bones_of(avatar, 1.2 * joints_of(avatar, "fist"))
    assert float(volume_scale(blend(avatar.bone_weights, bones)[0], bones.scale).min()) < 0.95 * 1.2
    stretch = pose_gaussians(avatar, bones).sigma_m / avatar.sigma_m
    assert torch.allclose(stretch, torch.full_like(stretch, 1.2), rtol=1e-6)


def test_radii_grow_with_a_bone_that_is_longer_up_to_a_bound():
    avatar = small_tensors(2000)
    bones = bones_of(avatar, avatar.canonical_joints_m)
    for longer, wanted in ((1.5, 1.5 ** (1 / 3)), (9.0, SIGMA_STRETCH_MAX)):
        along = replace(bones, linear=bones.linear * bones.linear.new_tensor([longer, 1.0, 1.0]))
        radius = pose_gaussians(avatar, along).sigma_m / avatar.sigma_m
        assert torch.allclose(radius, torch.full_like(radius, wanted), rtol=1e-6)


def collapsed(avatar: HandTensors) -> tuple[HandTensors, BoneTransforms]:
    """Half one bone and half the same bone turned by 180 degrees: the blend has no volume."""
    bones = bones_of(avatar, avatar.canonical_joints_m)
    linear = bones.linear.clone()
    linear[7] = torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))
    weights = torch.zeros_like(avatar.bone_weights)
    weights[:, [7, 12]] = 0.5
    return replace(avatar, bone_weights=weights), replace(bones, linear=linear)


def test_what_is_attached_to_a_collapsing_blend_moves_steadily():
    """Half one bone and half the same bone folded by nearly 180 degrees: no jump, and no offset grows threefold."""
    avatar, bones = collapsed(small_tensors())
    before = None
    for degrees in np.linspace(90, 180, 91):
        angle = torch.tensor(np.radians(degrees))
        bones.linear[7, 0, 0] = bones.linear[7, 1, 1] = angle.cos()
        bones.linear[7, 1, 0], bones.linear[7, 0, 1] = angle.sin(), -angle.sin()
        turned = turning(blend(avatar.bone_weights, bones)[0], bones)
        assert float(torch.linalg.matrix_norm(turned, 2).max()) < 2.2
        # worst observed 0.03 for a degree
        assert before is None or float((turned - before).abs().max()) < 0.05
        before = turned


def test_a_collapsed_blend_has_finite_gradients():
    avatar, bones = collapsed(small_tensors())
    linear = bones.linear.clone().requires_grad_(True)
    offset_m = torch.full((len(avatar), 3), 1e-3, dtype=torch.float64)
    posed = posed_with(avatar, replace(bones, linear=linear), offset_m)
    (posed.position_m.sum() + posed.sigma_m.sum()).backward()
    assert linear.grad is not None
    assert torch.isfinite(posed.position_m).all()
    assert torch.isfinite(linear.grad).all()


@pytest.mark.parametrize("pose", ["fist", "pinch"])
def test_gradients_with_respect_to_the_joints_are_those_of_finite_differences(pose):
    avatar = small_tensors(6)
    offset_m = torch.full((6, 3), 1e-3, dtype=torch.float64)

    def posed(joints_m: torch.Tensor) -> torch.Tensor:
        g = posed_with(avatar, bones_of(avatar, joints_m), offset_m)
        return torch.cat([g.position_m.flatten(), 100 * g.sigma_m])

    # millimeter noise moves the hand off straight fingers, where gradients are damped on purpose (METHOD 2.10)
    noise_m = 1e-3 * torch.randn(21, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    joints_m = (joints_of(avatar, pose) + noise_m).requires_grad_(True)
    assert torch.autograd.gradcheck(posed, (joints_m,), eps=1e-7, atol=1e-5, rtol=1e-3)


def lbs_joint_error_m(joint_weights, canonical_joints_m, bones, joints_m) -> torch.Tensor:
    """(21,) meters: how far blended skinning moves each joint from where it belongs (METHOD 3.5).

    The matrices themselves map every joint exactly; this second metric is of the skin's weights: joint_weights (21, 21)
    are those of the field at the canonical joints.
    """
    linear, offset_m = blend(joint_weights, bones)
    relative_m = canonical_joints_m - bones.canonical_root_m
    return torch.linalg.vector_norm(apply(linear, relative_m) + offset_m + bones.root_m - joints_m, dim=-1)


def test_blended_skinning_moves_the_joints_as_little_as_the_method_says(record_property):
    template = load_template()
    canonical_m = torch.from_numpy(template.joints_m.copy())
    weights = WeightField.build(template).query(canonical_m).double()
    transform = JointTransform(canonical_m, handedness=Handedness.RIGHT)
    errors = []
    for pose in POSES:
        joints_m = torch.from_numpy(named_pose(pose, template.joints_m, handedness=Handedness.RIGHT))
        errors.append(lbs_joint_error_m(weights, canonical_m, transform.bones(joints_m), joints_m))
    worst_mm = 1e3 * torch.stack(errors).max(0).values
    record_property("lbs_joint_error_mm", [round(float(e), 3) for e in worst_mm])
    # worst seen: 1.01 mm at the middle MCP, 0.64 mm at the thumb's MCP, which fist and point flex by all that it has,
    # 0.09 mm at the PIPs, 0 at the tips
    assert float(worst_mm[1:6].max()) < 1.03, worst_mm
    assert float(worst_mm[6:16].max()) < 0.66, worst_mm
    assert float(worst_mm[16:].max()) < 1e-3, worst_mm
