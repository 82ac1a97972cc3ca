"""The skin of a trained hand: its light stays in the world, its normals and axes turn and mirror with the hand."""

from dataclasses import replace

import pytest
import torch
from small_avatars import small_tensors, trained_tensors
from small_hands import bones_of, joints_of, rotation

from jghand_engine.avatar.learned import Ellipsoid
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.cast_shadow import exponent
from jghand_engine.learn.light import gloss, harmonics, lit, unit
from jghand_engine.learn.pose_net import Correction
from jghand_engine.learn.skeleton import BoneTransforms
from jghand_engine.learn.skinning import (
    PosedSkin,
    apply,
    pose_gaussians,
    pose_skin,
    posed_skin,
    see_lamps,
    seen_from,
    skin_maps,
    turning,
)
from jghand_engine.learn.tensors import HandTensors, LearnedTensors

POSES = ("open", "fist", "claw")
MIRROR = torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)
AVATAR = trained_tensors(150)
EYE_M = torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64)


def learned_of(avatar: HandTensors) -> LearnedTensors:
    assert avatar.learned is not None
    return avatar.learned


def elliptic(avatar: HandTensors = AVATAR) -> HandTensors:
    g = torch.Generator().manual_seed(6)
    count = len(avatar)
    ellipsoid = Ellipsoid(0.5 * torch.randn(count, 3, generator=g), torch.randn(count, 4, generator=g))
    return replace(avatar, learned=replace(learned_of(avatar), ellipsoid=ellipsoid))


def correction(seed: int = 2) -> Correction:
    g = torch.Generator().manual_seed(seed)
    offset_m = 0.003 * torch.randn(len(AVATAR), 3, dtype=torch.float64, generator=g)
    return Correction(offset_m, 0.1 * torch.randn(len(AVATAR), 3, dtype=torch.float64, generator=g))


def turned_bones(pose: str, R: torch.Tensor) -> BoneTransforms:
    return bones_of(torch.from_numpy(joints_of(pose)) @ R.T)


def normals(skin: PosedSkin) -> torch.Tensor:
    assert skin.normal is not None
    return skin.normal


def matrices(covariance_m2: torch.Tensor | None) -> torch.Tensor:
    """(N, 6) as (N, 3, 3)."""
    assert covariance_m2 is not None
    return covariance_m2[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)


def fallen(avatar: HandTensors, bones: BoneTransforms) -> torch.Tensor:
    """What the shadows that its fingers cast add to the exponent, in the world's light."""
    cast = learned_of(avatar).cast
    assert cast is not None
    return exponent(cast, see_lamps(cast, bones))


# ---- the light stays where it is -------------------------------------------------------------------------------------


@pytest.mark.parametrize("pose", POSES)
def test_a_hand_that_turns_with_its_joints_keeps_its_shape(pose):
    R, more = rotation(), correction()
    here, there = (pose_skin(elliptic(), bones, more) for bones in (turned_bones(pose, torch.eye(3).double()),
                                                                  turned_bones(pose, R)))  # fmt: skip
    # worst seen: 9e-17 m, 1e-15 of a normal
    torch.testing.assert_close(there.matt.position_m, here.matt.position_m @ R.T, atol=2e-16, rtol=0)
    torch.testing.assert_close(there.matt.sigma_m, here.matt.sigma_m, atol=0, rtol=1e-12)
    torch.testing.assert_close(normals(there), normals(here) @ R.T, atol=2e-15, rtol=0)
    # an element is a difference of larger ones, so its error goes with the norm of its matrix; worst seen 1.4e-15 of it
    wanted_m2 = R @ matrices(here.matt.covariance_m2) @ R.T
    norm_m2 = torch.linalg.matrix_norm(wanted_m2, ord=2, keepdim=True)
    torch.testing.assert_close(matrices(there.matt.covariance_m2) / norm_m2, wanted_m2 / norm_m2, atol=5e-15, rtol=0)


@pytest.mark.parametrize("pose", POSES)
def test_the_skin_takes_the_light_of_the_place_it_turns_to(pose):
    """Color over albedo is what falls on the turned normal, in the world."""
    R, more, learned = rotation(), correction(), learned_of(AVATAR)
    here, there = (pose_skin(AVATAR, turned_bones(pose, turn), more) for turn in (torch.eye(3).double(), R))
    falling = harmonics(normals(here) @ R.T) @ learned.light.irradiance.double() + more.shade
    falling = falling + fallen(AVATAR, turned_bones(pose, R))
    wanted = AVATAR.rgb.double() * falling.clamp(-3, 3).exp()
    # worst seen 4e-15
    torch.testing.assert_close(there.matt.rgb, wanted, atol=1e-14, rtol=0)
    # and it is another light
    assert float((there.matt.rgb / here.matt.rgb).log().abs().mean()) > 0.1


def test_a_hand_seen_from_elsewhere_reflects_something_else():
    skin = pose_skin(AVATAR, bones_of(joints_of("relaxed")), correction())
    learned = learned_of(AVATAR)
    for eye_m in (EYE_M, -EYE_M):
        seen = seen_from(skin, eye_m, AVATAR)
        to_eye = unit(eye_m - skin.matt.position_m)
        shine = learned.shine.double()[:, None] * gloss(normals(skin), to_eye, learned.light.to(torch.float64))
        torch.testing.assert_close(seen.rgb - skin.matt.rgb, shine, atol=1e-15, rtol=0)
        assert seen.position_m is skin.matt.position_m
        assert float(shine.max()) > 0.01


def test_where_the_skin_lies_is_not_pulled_about_by_what_it_reflects():
    avatar = replace(AVATAR, position_m=AVATAR.position_m.clone().requires_grad_(True))
    skin = pose_skin(avatar, bones_of(joints_of("relaxed")), correction())
    seen = seen_from(skin, EYE_M, avatar)
    assert not seen.rgb.requires_grad
    # but normals and shine are
    learned = learned_of(AVATAR)
    live = replace(
        learned, normal=learned.normal.clone().requires_grad_(True), shine=learned.shine.clone().requires_grad_(True)
    )
    avatar = replace(avatar, learned=live)
    seen_from(pose_skin(avatar, bones_of(joints_of("relaxed"))), EYE_M, avatar).rgb.sum().backward()
    assert live.normal.grad is not None
    assert live.shine.grad is not None
    assert bool(live.shine.grad.any())
    assert bool(live.normal.grad.any(1).all())
    assert avatar.position_m.grad is None


def test_a_painted_hand_looks_the_same_from_everywhere():
    avatar = small_tensors(50)
    skin = pose_skin(avatar, bones_of(joints_of("open")))
    assert (skin.normal, skin.shine) == (None, None)
    assert seen_from(skin, EYE_M, avatar) is skin.matt
    assert torch.equal(skin.matt.rgb, avatar.rgb.double())


# ---- left hands ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pose", POSES)
def test_a_left_hand_is_the_mirror_image_in_everything_but_light(pose):
    avatar, more = elliptic(), correction()
    right = pose_skin(avatar, bones_of(joints_of(pose)), more)
    left_joints = joints_of(pose, Handedness.LEFT)
    left = pose_skin(avatar.for_hand(Handedness.LEFT), bones_of(left_joints, Handedness.LEFT), more)
    # worst seen 0
    torch.testing.assert_close(left.matt.position_m, right.matt.position_m * MIRROR, atol=1e-16, rtol=0)
    torch.testing.assert_close(normals(left), normals(right) * MIRROR, atol=1e-15, rtol=0)
    torch.testing.assert_close(left.matt.sigma_m, right.matt.sigma_m, atol=0, rtol=1e-13)
    flip = torch.diag(MIRROR)
    torch.testing.assert_close(
        matrices(left.matt.covariance_m2), flip @ matrices(right.matt.covariance_m2) @ flip, atol=0, rtol=1e-13
    )
    # the lamps are not mirrored: the left hand is lit as the world lights its own normals
    light = learned_of(avatar).light.to(torch.float64)
    shade = more.shade + fallen(avatar, bones_of(left_joints, Handedness.LEFT))
    torch.testing.assert_close(left.matt.rgb, lit(avatar.rgb.double(), normals(left), light, shade))


# ---- maps, offsets, shade --------------------------------------------------------------------------------------------


def test_maps_say_how_the_skin_moves():
    bones = bones_of(joints_of("fist"))
    maps = skin_maps(AVATAR.bone_weights, bones)
    plain = small_tensors(150)
    posed = pose_gaussians(plain, bones)
    relative_m = plain.position_m.double() - bones.canonical_root_m
    torch.testing.assert_close(apply(maps.linear, relative_m) + maps.offset_m + bones.root_m, posed.position_m)
    torch.testing.assert_close(plain.sigma_m.double() * maps.radius, posed.sigma_m)
    assert torch.equal(maps.turning, turning(maps.linear, bones))


def test_offsets_turn_and_grow_with_the_hand_or_stay_in_the_world():
    R, more = rotation(), correction()
    size = 1.3
    bones = bones_of(size * torch.from_numpy(joints_of("claw")) @ R.T)
    bare = pose_skin(AVATAR, bones, replace(more, offset_m=torch.zeros_like(more.offset_m)))
    maps = skin_maps(AVATAR.bone_weights, bones)
    with_hand = pose_skin(AVATAR, bones, more).matt.position_m - bare.matt.position_m
    torch.testing.assert_close(with_hand, bones.scale * apply(maps.turning, more.offset_m), atol=1e-15, rtol=0)
    world = replace(AVATAR, learned=replace(learned_of(AVATAR), world_offsets=True))
    in_world = pose_skin(world, bones, more).matt.position_m - bare.matt.position_m
    torch.testing.assert_close(in_world, more.offset_m, atol=1e-15, rtol=0)


@pytest.mark.parametrize("pose", POSES)
def test_a_left_hand_with_offsets_in_the_world_is_the_mirror_image_of_the_right_one(pose):
    """Its axes are mirrored with it."""
    right = replace(AVATAR, learned=replace(learned_of(AVATAR), world_offsets=True))
    left, joints_m, more = right.for_hand(Handedness.LEFT), torch.from_numpy(joints_of(pose)), correction()
    posed = pose_skin(right, bones_of(joints_m), more).matt.position_m
    other = pose_skin(left, transform_of(left).bones(joints_m * MIRROR), more).matt.position_m
    # the same arithmetic but for signs; exact where observed
    torch.testing.assert_close(other * MIRROR, posed, atol=1e-16, rtol=0)


# ---- ellipsoids ------------------------------------------------------------------------------------------------------


def test_round_gaussians_have_no_covariance_and_round_ellipsoids_that_of_their_map():
    bones = bones_of(joints_of("fist"))
    assert pose_skin(AVATAR, bones).matt.covariance_m2 is None
    count = len(AVATAR)
    around = Ellipsoid(torch.zeros(count, 3), torch.tensor([[2.0, 0.0, 0.0, 0.0]]).expand(count, 4))
    avatar = replace(AVATAR, learned=replace(learned_of(AVATAR), ellipsoid=around))
    got = matrices(pose_skin(avatar, bones).matt.covariance_m2)
    L = skin_maps(AVATAR.bone_weights, bones).linear
    wanted = AVATAR.sigma_m.double()[:, None, None] ** 2 * L @ L.transpose(1, 2)
    # sigma goes through a logarithm in float32; worst seen 5e-7
    torch.testing.assert_close(got, wanted, atol=0, rtol=8e-7)


def test_the_axes_of_an_ellipsoid_are_stretched_and_turned():
    """Of the canonical hand: sigma e^s along each axis, turned by the quaternion."""
    avatar = elliptic()
    ellipsoid = learned_of(avatar).ellipsoid
    assert ellipsoid is not None
    got = matrices(pose_skin(avatar, bones_of(avatar.canonical_joints_m)).matt.covariance_m2)
    length, _ = torch.linalg.eigh(got)
    wanted = (AVATAR.sigma_m[:, None] * ellipsoid.log_stretch.exp()).double().square().sort(1).values
    # worst seen 1.3e-6
    torch.testing.assert_close(length, wanted, atol=0, rtol=2e-6)


# ---- what a finished avatar does with it -----------------------------------------------------------------------------


def test_a_finished_avatar_applies_its_own_correctives():
    bones = bones_of(joints_of("claw"))
    net = learned_of(AVATAR).correctives
    assert net is not None
    with torch.no_grad():
        wanted = pose_skin(AVATAR, bones, net(bones.frames))
        got = posed_skin(AVATAR, bones, bones.frames)
    assert torch.equal(got.matt.position_m, wanted.matt.position_m)
    assert torch.equal(got.matt.rgb, wanted.matt.rgb)
    assert float((got.matt.position_m - pose_skin(AVATAR, bones).matt.position_m).abs().max()) > 1e-3


def test_correctives_without_the_frames_of_the_pose_are_refused():
    bones = bones_of(joints_of("claw"))
    with pytest.raises(InputError, match="frames"):
        posed_skin(AVATAR, bones, None)
    bare = replace(AVATAR, learned=replace(learned_of(AVATAR), correctives=None))
    assert torch.equal(posed_skin(bare, bones, None).matt.position_m, pose_skin(bare, bones).matt.position_m)


def test_gradients_of_the_skin_are_those_of_finite_differences():
    """Of everything that training changes, through the posed color, place and shape."""
    avatar = elliptic(trained_tensors(5))
    learned = learned_of(avatar)
    bones = bones_of(joints_of("claw"))
    assert learned.ellipsoid is not None
    inputs = (
        avatar.position_m, avatar.sigma_m, avatar.rgb, learned.normal, learned.shine, learned.light.irradiance,
        learned.light.lobe_direction, learned.ellipsoid.log_stretch, learned.ellipsoid.quaternion,
        0.1 * torch.ones(5, 3), 0.1 * torch.ones(5, 3),
    )  # fmt: skip

    def drawn(position_m, sigma_m, rgb, normal, shine, irradiance, lobes, stretch, quaternion, offset, shade):
        light = replace(learned.light.to(torch.float64), irradiance=irradiance, lobe_direction=lobes)
        live = replace(learned, normal=normal, shine=shine, light=light, ellipsoid=Ellipsoid(stretch, quaternion))
        one = replace(avatar, position_m=position_m, sigma_m=sigma_m, rgb=rgb, learned=live)
        skin = pose_skin(one, bones, Correction(0.01 * offset, shade))
        seen = seen_from(skin, EYE_M, one)
        assert seen.covariance_m2 is not None
        matt = torch.cat([100 * seen.position_m, 1000 * seen.sigma_m[:, None], skin.matt.rgb], 1)
        return torch.cat([matt, 1e6 * seen.covariance_m2, seen.rgb], 1)

    live = tuple(tensor.double().clone().requires_grad_(True) for tensor in inputs)
    place_m, offset, others = live[0], live[9], (*live[1:9], live[10])

    # where the skin lies has no gradient to what it reflects, by design: it is checked apart, without that
    def in_place(*others: torch.Tensor) -> torch.Tensor:
        return drawn(place_m.detach(), *others[:8], offset.detach(), others[8])

    def moved(place_m: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
        return drawn(place_m, *others[:8], offset, others[8])[:, :13]

    assert torch.autograd.gradcheck(in_place, others, eps=1e-6, atol=1e-5, rtol=1e-3)
    assert torch.autograd.gradcheck(moved, (place_m, offset), eps=1e-6, atol=1e-5, rtol=1e-3)
