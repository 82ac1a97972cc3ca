"""Cheaper tiers of the correctives: the linear one is near, and none is used without a price."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_avatars import trained_avatar

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.correctives import LinearCorrectives, PoseNetShape, PoseNetwork, largest_basis
from jghand_engine.avatar.file import load_avatar, save_avatar, stored_form
from jghand_engine.avatar.learned_storage import pack_learned
from jghand_engine.avatar.storage import Storage
from jghand_engine.avatar.tiers import Distilled, Price, Tier
from jghand_engine.errors import InputError
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.shapes import pose_names
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.distill import distill, poses_near
from jghand_engine.learn.pose_features import Angles, flat_angles
from jghand_engine.learn.pose_net import LinearNet, PoseNet, numbers_of
from jghand_engine.learn.tensors import HandTensors
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings, preset

# with features of the palm, too: then every bone says something of the pose
SHAPE = PoseNetShape(octaves=(3, 3, 2), angle_channels=6, angle_texels=5, hidden=24, level1=True)
AVATAR = trained_avatar(400, shape=SHAPE)
# ripples of a few degrees would be no hand: planes as smooth as learned ones
AVATAR.learned.correctives.weights["angles.planes"] *= 0.15
NET = HandTensors.of(AVATAR).learned.correctives


def known_poses() -> torch.Tensor:
    joints = [named_pose(name, AVATAR.canonical_joints_m, handedness=AVATAR.handedness) for name in pose_names()]
    transform = transform_of(AVATAR)
    return torch.stack([flat_angles(transform.frames(torch.from_numpy(each))) for each in joints]).float()


KNOWN = known_poses()
POSES = torch.cat([KNOWN, poses_near(KNOWN, 150, seed=1)])
TIERS = distill(AVATAR, POSES, (1, 3, 6, 14))


def both(correctives: PoseNet | LinearCorrectives, pose: torch.Tensor) -> torch.Tensor:
    if isinstance(correctives, LinearCorrectives):
        count = len(correctives.constant)
        correctives = LinearNet.of(correctives, *(torch.tensor(a[:count]) for a in (AVATAR.bone_weights, AVATAR.uvd)))
    correction = correctives(Angles.of(pose))
    return torch.cat([correction.offset_m, correction.shade], -1)


def error_of(correctives: LinearCorrectives, poses: torch.Tensor) -> torch.Tensor:
    """(6,) root of the mean square over poses and Gaussians, against the network."""
    return torch.stack([both(correctives, pose) - both(NET, pose) for pose in poses]).square().mean((0, 1)).sqrt()


def test_no_offset_is_longer_than_a_linear_tier_says():
    tier = TIERS[6]
    longest_m = max(float(both(tier, pose)[:, :3].norm(dim=-1).max()) for pose in poses_near(KNOWN, 50, seed=3))
    assert longest_m <= tier.longest_offset_m()
    still = replace(tier, direction=np.zeros_like(tier.direction))
    assert still.longest_offset_m() == pytest.approx(float(np.linalg.norm(tier.constant[:, :3], axis=1).max()))


def test_a_larger_basis_is_nearer_and_a_small_one_much_better_than_none():
    fresh = poses_near(KNOWN, 20, seed=2)
    errors = [error_of(TIERS[basis], fresh) for basis in sorted(TIERS)]
    changes = torch.stack([both(NET, pose) for pose in fresh]).std(0).square().mean(0).sqrt()
    for larger, smaller in zip(errors[1:], errors[:-1], strict=True):
        assert bool((larger < smaller).all())
    assert bool((errors[-1] < 0.12 * changes).all()), errors[-1] / changes  # observed 0.106


def test_a_linear_network_is_distilled_exactly():
    """But for the steps of int8 and half precision: a network whose output is linear in the features."""
    linear = PoseNet.of(AVATAR.learned.correctives, NET.bone_weights, torch.from_numpy(AVATAR.uvd))
    linear.encoding_in.bias += 100.0  # every unit of both layers is far inside its linear part
    linear.middle.weight.abs_()
    linear.out.weight *= 1e-5
    linear.out.bias.zero_()
    avatar = replace(AVATAR, learned=replace(AVATAR.learned, correctives=linear.plain()))
    tier = distill(avatar, POSES, (6,))[6]
    wanted, got = (torch.stack([both(each, pose) for pose in KNOWN]) for each in (linear, tier))
    # the constant, of half precision: observed 4.8e-7 of 1.4e-3
    assert float((got[0] - wanted[0]).abs().max()) < 5.2e-7
    # what the pose changes, in offset and in shade: observed 1.8 % and 1.0 % of the largest change in that pose
    for part in (slice(0, 3), slice(3, 6)):
        change, ours = (each[1:, :, part] - each[0, :, part] for each in (wanted, got))
        assert bool(((ours - change).abs().amax((1, 2)) < 0.019 * change.abs().amax((1, 2))).all())


def test_a_prefix_of_a_linear_tier_is_that_of_its_gaussians():
    assert torch.equal(both(TIERS[6].prefix(50), KNOWN[3]), both(TIERS[6], KNOWN[3])[:50])


def test_numbers_beyond_the_features_are_products_of_them():
    features, mean, projection = torch.randn(21, 3), torch.randn(3), torch.randn(3, 3)
    numbers = numbers_of(features, mean, projection, 9)
    a, b, c = numbers[:, :3].unbind(-1)
    assert torch.allclose(numbers[:, 3:], torch.stack([a * a, a * b, b * b, a * c, b * c, c * c], -1))
    assert torch.equal(numbers_of(features, mean, projection[:, :2], 2), numbers[:, :2])
    assert largest_basis(PoseNetShape(angle_channels=3)) == 9


def test_made_up_poses_stay_near_the_known_ones():
    made = poses_near(KNOWN, 200, seed=7)
    beyond = torch.deg2rad(torch.tensor(5.001))
    assert bool((made >= KNOWN.amin(0) - beyond).all())
    assert bool((made <= KNOWN.amax(0) + beyond).all())
    assert torch.equal(made, poses_near(KNOWN, 200, seed=7))
    assert not torch.equal(made, poses_near(KNOWN, 200, seed=8))
    assert poses_near(KNOWN, 0, seed=7).shape == (0, 37)


# ---- prices ----------------------------------------------------------------------------------------------------------

EXACT = Price(Tier.EXACT, 0, 40.0, 0.0, 33.0, 0.0)


def linear_price(lost_db: float) -> Price:
    return Price(Tier.LINEAR, 6, 10.0, 0.1, 33.0 - lost_db, lost_db)


def distilled_avatar(*prices: Price, linear: LinearCorrectives | None = TIERS[6]) -> HandAvatar:
    return replace(AVATAR, learned=replace(AVATAR.learned, distilled=Distilled(linear, prices, "held-out pictures")))


@pytest.mark.parametrize(
    ("prices", "wanted", "taken"),
    [
        ((EXACT, linear_price(0.05)), Tier.AUTO, LinearCorrectives),
        ((EXACT, linear_price(0.11)), Tier.AUTO, PoseNetwork),
        ((EXACT,), Tier.AUTO, PoseNetwork),
        # hardly faster: its accuracy is not given up for noise
        ((EXACT, replace(linear_price(0.05), frame_ms=36.1)), Tier.AUTO, PoseNetwork),
        ((EXACT, replace(linear_price(0.05), frame_ms=36.0)), Tier.AUTO, LinearCorrectives),
        ((linear_price(0.05),), Tier.AUTO, LinearCorrectives),
        ((EXACT, linear_price(0.11)), Tier.LINEAR, LinearCorrectives),
        ((EXACT, linear_price(0.05)), Tier.EXACT, PoseNetwork),
        ((), Tier.AUTO, PoseNetwork),
        ((), Tier.EXACT, PoseNetwork),
    ],
)
def test_the_cheapest_tier_that_loses_little_is_taken(prices, wanted, taken):
    learned, _ = distilled_avatar(*prices).learned.with_tier(wanted)
    assert isinstance(learned.correctives, taken)


def test_a_tier_without_a_price_is_refused():
    for avatar, wanted in ((AVATAR, Tier.LINEAR), (AVATAR, Tier.LINEAR), (distilled_avatar(EXACT), Tier.LINEAR)):
        with pytest.raises(InputError, match=r"tier.*jghand distill"):
            HandRenderer(avatar, RenderSettings(correctives=wanted))


def test_the_frame_says_what_it_took_and_what_that_costs():
    avatar = distilled_avatar(EXACT, linear_price(0.04))
    joints = AVATAR.canonical_joints_m
    view = torch.eye(4, dtype=torch.float64)
    view[2, 3] = 0.5
    camera = Camera(60, 60, 100.0, 100.0, 30.0, 30.0, view)
    for settings, told in ((RenderSettings(), "linear-6 (0.04 dB lost)"), (preset("final"), "exact (0.00 dB lost)")):
        report = HandRenderer(avatar, settings).render(joints, camera).report
        assert told in report.tier


# ---- the file --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("storage", list(Storage))
def test_tiers_come_back_from_a_file_bit_for_bit(tmp_path, storage):
    avatar = distilled_avatar(EXACT, linear_price(0.05))
    save_avatar(tmp_path / "hand.jghand", avatar, storage=storage)
    again, stored = (
        load_avatar(tmp_path / "hand.jghand").learned.distilled,
        stored_form(avatar, storage).learned.distilled,
    )
    assert again.prices == avatar.learned.distilled.prices
    assert again.measured_on == "held-out pictures"
    for name in ("mean", "projection", "constant", "direction", "scale"):
        assert np.array_equal(getattr(again.linear, name), getattr(TIERS[6], name)), name
    for pose in KNOWN[:3]:
        assert torch.equal(both(again.linear, pose), both(stored.linear, pose))


def test_prices_without_a_linear_tier_come_back(tmp_path):
    save_avatar(tmp_path / "hand.jghand", distilled_avatar(EXACT, linear=None))
    distilled = load_avatar(tmp_path / "hand.jghand").learned.distilled
    assert distilled.linear is None
    assert [price.tier for price in distilled.prices] == [Tier.EXACT]


def test_a_shipped_avatar_with_a_linear_tier_fits_into_12_megabytes():
    """Of 40,000 Gaussians, at the size of the trained network; bytes per Gaussian grow with nothing else."""
    count, shape = 1000, PoseNetShape()
    avatar = trained_avatar(count, shape=shape)
    linear = distill(avatar, poses_near(KNOWN, 20, seed=0), (32,))[32]
    avatar = replace(avatar, learned=replace(avatar.learned, distilled=Distilled(linear, (), "")))
    packed = pack_learned(avatar.learned, Storage.COMPACT)
    per_gaussian = sum(a.nbytes for name, a in packed.items() if len(a) == count and not name.startswith("pose_net"))
    fixed = sum(a.nbytes for a in packed.values()) - per_gaussian
    plain = 39 * count
    size = fixed + 40 * (per_gaussian + plain)
    assert size < 12e6, size  # observed 10.8e6
