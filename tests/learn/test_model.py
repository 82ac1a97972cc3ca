"""The learnable hand: how it starts, what it gives, what gradients reach, and its levels of detail."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_hands import INFO, SMALL_MODEL, frames_of, small_hand, stirred

from jghand_engine.avatar.avatar import SIGMA_MAX_M, SIGMA_MIN_M
from jghand_engine.avatar.learned import LOG_STRETCH_MAX
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.model import LOBE_SHARPNESS_MAX, SHADOW_GAIN_RANGE, SHINE_SPREAD, LearnedHand, OffsetFrame
from jghand_engine.learn.tensors import HandTensors, LearnedTensors

RIGHT = Handedness.RIGHT
# the constants of the shadow are learned through the picture: see tests/learn/test_step.py
OF_THE_SHADOW = {"raw_shadow_gain", "raw_shadow_tint"}


def avatar_of(hand: LearnedHand, count: int = 0) -> HandTensors:
    return hand.avatar(INFO, handedness=RIGHT, count=count)


def learned_of(hand: LearnedHand, count: int = 0) -> LearnedTensors:
    learned = avatar_of(hand, count).learned
    assert learned is not None
    return learned


def values(hand: LearnedHand) -> list[torch.Tensor]:
    return list(hand.state_dict().values())


def equal(one: LearnedHand, other: LearnedHand) -> bool:
    return all(torch.equal(a, b) for a, b in zip(values(one), values(other), strict=True))


# ---- the start -------------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_parameters():
    assert equal(small_hand(seed=4, moved=False), small_hand(seed=4, moved=False))
    assert not equal(small_hand(seed=4, moved=False), small_hand(seed=5, moved=False))


def test_making_a_hand_draws_no_random_numbers_of_others():
    torch.manual_seed(3)
    wanted = torch.rand(2)
    torch.manual_seed(3)
    small_hand(moved=False)
    assert torch.equal(torch.rand(2), wanted)


def test_a_new_hand_is_the_template_in_gray_without_light_or_offsets():
    hand = small_hand(moved=False)
    avatar, learned = avatar_of(hand), learned_of(hand)
    assert torch.equal(avatar.position_m, hand.points.position_m)
    torch.testing.assert_close(avatar.sigma_m, hand.points.sigma_m)
    assert torch.equal(avatar.rgb, torch.full((300, 3), 0.5))
    torch.testing.assert_close(avatar.opacity, torch.full((300,), 1 / (1 + math.exp(-SMALL_MODEL.opacity_bias))))
    torch.testing.assert_close(learned.normal, hand.points.normal)
    assert not learned.light.irradiance.any()
    assert learned.correctives is not None
    correction = learned.correctives(frames_of("fist"))
    assert not correction.offset_m.any()
    assert not correction.shade.any()


def test_feature_planes_start_with_the_spread_of_the_method():
    hand = small_hand(replace(SMALL_MODEL, plane_texels=64, depth_texels=16), moved=False)
    for plane in (hand.planes.uv.texels, hand.planes.ud.texels, hand.planes.vd.texels, hand.pose_net.angles.planes):
        assert float(plane.detach().std()) == pytest.approx(0.1, rel=0.05)


def test_the_avatar_has_the_conventions_it_is_trained_with():
    hand = small_hand(replace(SMALL_MODEL, swing="euler", scale_mode="uniform"))
    avatar = hand.avatar(replace(INFO, name="mine"), handedness=Handedness.LEFT)
    assert (avatar.info.name, avatar.info.template) == ("mine", "small")
    assert (avatar.info.swing, avatar.info.scale_mode) == ("euler", "uniform")
    assert avatar.handedness is Handedness.LEFT
    assert avatar.canonical_joints_m.dtype == torch.float64
    for name in ("bone_weights", "uvd"):
        assert torch.equal(getattr(avatar, name), getattr(hand.points, name))


# ---- limits ----------------------------------------------------------------------------------------------------------


def test_no_weight_carries_anything_out_of_its_range():
    hand = small_hand(replace(SMALL_MODEL, anisotropic=True))
    stirred(hand, by=50.0)
    hand.keep_in_range()
    avatar, learned = avatar_of(hand), learned_of(hand)
    moved_m = (avatar.position_m - hand.points.position_m).detach().abs()
    # to the rounding of positions
    assert 0.99 * SMALL_MODEL.identity_reach_m < float(moved_m.max()) <= SMALL_MODEL.identity_reach_m + 1e-8
    sigma_m = avatar.sigma_m.detach()
    assert float(sigma_m.min()) == pytest.approx(SIGMA_MIN_M)
    assert float(sigma_m.max()) == pytest.approx(SIGMA_MAX_M)
    for unit_range in (avatar.rgb, avatar.opacity):
        assert 0 <= float(unit_range.detach().min()) <= float(unit_range.detach().max()) <= 1
    assert float(learned.shine.detach().log().abs().max()) == pytest.approx(SHINE_SPREAD)
    torch.testing.assert_close(learned.normal.detach().norm(dim=1), torch.ones(300), atol=2e-7, rtol=0)
    light = learned.light
    assert float(light.lobe_sharpness.detach().max()) == pytest.approx(LOBE_SHARPNESS_MAX)
    assert float(light.lobe_rgb.detach().min()) >= 0
    assert float(light.rim.detach()) >= 0
    assert learned.shadow is not None
    assert SHADOW_GAIN_RANGE[0] <= learned.shadow.gain <= SHADOW_GAIN_RANGE[1]
    assert all(0 <= part <= 1 for part in learned.shadow.tint)
    assert learned.ellipsoid is not None
    assert float(learned.ellipsoid.log_stretch.detach().abs().max()) == LOG_STRETCH_MAX
    assert all(bool(torch.isfinite(tensor).all()) for tensor in (avatar.position_m, learned.normal, light.lobe_rgb))


def test_a_radius_a_stretch_and_a_lobe_that_were_pushed_past_their_limits_can_return():
    hand = small_hand(replace(SMALL_MODEL, anisotropic=True))
    with torch.no_grad():
        hand.log_sigma[0], hand.log_sigma[1] = math.log(1e-6), math.log(0.1)
        hand.log_stretch[0], hand.log_stretch[1] = -9.0, 9.0
        hand.lobe_log_sharpness[0] = 9.0
    hand.keep_in_range()
    parameters = (hand.log_sigma, hand.log_stretch, hand.lobe_log_sharpness)
    optimizer = torch.optim.SGD(parameters, lr=1.0)
    avatar, learned = avatar_of(hand), learned_of(hand)
    assert learned.ellipsoid is not None
    # towards the middle of each range
    loss = (avatar.sigma_m[1] - avatar.sigma_m[0]).log() + learned.light.lobe_sharpness[0].log()
    (loss + (learned.ellipsoid.log_stretch[1] - learned.ellipsoid.log_stretch[0]).sum()).backward()
    optimizer.step()
    hand.keep_in_range()
    sigma_m = avatar_of(hand).sigma_m
    assert float(sigma_m[0].detach()) > 1.02 * SIGMA_MIN_M  # observed 1.026
    assert float(sigma_m[1].detach()) < 0.4 * SIGMA_MAX_M  # observed 0.36
    assert hand.log_stretch[:2].detach().abs().max() == LOG_STRETCH_MAX - 1
    assert float(hand.lobe_log_sharpness[0].detach()) == pytest.approx(math.log(LOBE_SHARPNESS_MAX) - 1)


# ---- options ---------------------------------------------------------------------------------------------------------


def test_a_hand_learned_with_its_light_in_its_colors_has_none_apart():
    hand = small_hand(replace(SMALL_MODEL, lit=False))
    assert hand.irradiance.any()
    assert not learned_of(hand).light.irradiance.any()
    # the gloss is another matter
    assert learned_of(hand).shine.any()


@pytest.mark.parametrize("count", [0, 120])
def test_a_hand_without_gloss_reflects_nothing(count):
    hand = small_hand(replace(SMALL_MODEL, glossy=False))
    assert torch.equal(learned_of(hand, count).shine, torch.zeros(count or 300))


@pytest.mark.parametrize("frame", list(OffsetFrame))
def test_the_axes_of_the_offsets_are_told_to_the_avatar(frame):
    hand = small_hand(replace(SMALL_MODEL, offset_frame=frame))
    assert learned_of(hand).world_offsets is (frame is OffsetFrame.WORLD)


# ---- gradients -------------------------------------------------------------------------------------------------------


def everything(avatar: HandTensors) -> torch.Tensor:
    """A sum in which every number of the avatar counts, each by another weight."""
    learned = avatar.learned
    assert learned is not None
    assert learned.correctives is not None
    correction = learned.correctives(frames_of("claw"))
    light = learned.light
    parts = [
        avatar.position_m, avatar.sigma_m, avatar.opacity, avatar.rgb, learned.normal, learned.shine,
        light.irradiance, light.lobe_direction, light.lobe_sharpness, light.lobe_rgb, light.rim,
        correction.offset_m, correction.shade,
    ]  # fmt: skip
    if learned.ellipsoid is not None:
        parts += [learned.ellipsoid.log_stretch, learned.ellipsoid.quaternion]
    if learned.cast is not None:
        parts += [learned.cast.lamp_rgb, learned.cast.bounced_rgb]
    g = torch.Generator().manual_seed(12)
    return torch.stack([(part * torch.randn(part.shape, generator=g)).sum() for part in parts]).sum()


@pytest.mark.parametrize("anisotropic", [False, True])
def test_gradients_reach_every_parameter(anisotropic):
    hand = small_hand(replace(SMALL_MODEL, anisotropic=anisotropic))
    everything(avatar_of(hand)).backward()
    missed = [n for n, p in hand.named_parameters() if n not in OF_THE_SHADOW and (p.grad is None or not p.grad.any())]
    assert missed == []
    # the head has eleven numbers for eight things, and none of them is idle
    assert bool(hand.decoders[0][-1].weight.grad.any(1).all())  # type: ignore[union-attr]
    assert all(bool(torch.isfinite(p.grad).all()) for p in hand.parameters() if p.grad is not None)


# ---- levels of detail ------------------------------------------------------------------------------------------------


def deep_and_wide(hand: LearnedHand) -> None:
    """Some Gaussians far under the skin, and some as wide as may be."""
    hand.points.uvd[::3, 2] = 0.25  # 5 mm deep
    with torch.no_grad():
        hand.log_sigma[::5] = math.log(SIGMA_MAX_M)


@pytest.mark.parametrize("count", [30, 120, 299, 300])
def test_a_prefix_is_what_the_finished_avatar_gives_as_prefix(count):
    hand = small_hand(replace(SMALL_MODEL, anisotropic=True))
    deep_and_wide(hand)
    live, wanted = avatar_of(hand, count).avatar(), avatar_of(hand).avatar().prefix(count)
    assert len(live) == count
    for name in ("position_m", "sigma_m", "opacity", "rgb", "bone_weights", "uvd"):
        # a matrix product of another height may add up in another order; worst seen 6e-8
        np.testing.assert_allclose(getattr(live, name), getattr(wanted, name), atol=1.2e-7, rtol=1e-6)
    ours, theirs = live.learned, wanted.learned
    assert ours is not None
    assert theirs is not None
    np.testing.assert_allclose(ours.normal, theirs.normal, atol=4e-7, rtol=0)
    np.testing.assert_allclose(ours.shine, theirs.shine, atol=1.2e-7, rtol=0)
    assert ours.ellipsoid is not None
    assert theirs.ellipsoid is not None
    assert np.array_equal(ours.ellipsoid.log_stretch, theirs.ellipsoid.log_stretch)
    correctives = learned_of(hand, count).correctives
    assert correctives is not None
    assert len(correctives(frames_of("fist")).offset_m) == count


def test_radii_of_a_prefix_grow_as_gaps_on_a_surface_do():
    hand = small_hand(moved=False)
    hand.points.uvd[:, 2] = 0.5
    torch.testing.assert_close(avatar_of(hand, 75).sigma_m, (2 * hand.points.sigma_m[:75]).clamp(max=SIGMA_MAX_M))


def test_all_gaussians_keep_the_gradient_of_their_radii():
    """At full number nothing grows, and the limits of growth do not halve or stop what is learned."""
    hand = small_hand()
    deep_and_wide(hand)
    avatar = avatar_of(hand)
    (gradient,) = torch.autograd.grad(avatar.sigma_m.sum(), hand.log_sigma)
    inside = torch.arange(300) % 5 != 0
    torch.testing.assert_close(gradient[inside], avatar.sigma_m.detach()[inside])
