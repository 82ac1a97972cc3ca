"""The compiled skin of trained hands is the torch functions' in float64: every tier, light, gloss, every odd hand."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from small_avatars import ellipsoid_avatar, trained_avatar
from small_hands import joints_of

from jghand_engine.avatar.avatar import FOREARM_WAY, HandAvatar
from jghand_engine.avatar.blocks import padded_rows
from jghand_engine.avatar.correctives import LinearCorrectives, PoseFeatures, PoseNetShape, PoseNetwork
from jghand_engine.avatar.learned import Learned
from jghand_engine.avatar.posing import Poser, new_rows
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import Bones, Skeleton
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.pose_features import Angles
from jghand_engine.learn.skinning import posed_skin, seen_from, skin_maps
from jghand_engine.learn.tensors import HandTensors
from jghand_engine.native.binding import Library
from jghand_engine.native.threads import shared_pool
from jghand_engine.template.builtin import WITH_FOREARM

AVATAR = trained_avatar(601)
EYE_M = np.array([0.1, 0.2, 0.45])


def learned_of(avatar: HandAvatar) -> Learned:
    assert avatar.learned is not None
    return avatar.learned


def changed(avatar: HandAvatar = AVATAR, **what) -> HandAvatar:
    return replace(avatar, learned=replace(learned_of(avatar), **what))


def net_of(avatar: HandAvatar = AVATAR) -> PoseNetwork:
    net = learned_of(avatar).correctives
    assert isinstance(net, PoseNetwork)
    return net


def linear_tier(basis: int, avatar: HandAvatar = AVATAR, seed: int = 4) -> LinearCorrectives:
    """Random, of any basis; not near any network."""
    g, net, count = np.random.default_rng(seed), net_of(avatar), len(avatar)
    channels = net.shape.angle_channels

    def normal(*shape: int) -> np.ndarray:
        return g.standard_normal(shape, np.float32)

    return LinearCorrectives(
        angles=net.angles,
        mean=0.1 * normal(channels),
        projection=0.5 * normal(channels, min(channels, basis)),
        constant=np.concatenate([0.004 * normal(count, 3), 0.2 * normal(count, 3)], 1),
        direction=g.integers(-127, 128, (count, basis, 6), np.int8),
        scale=np.array([3e-6, 2e-4], np.float32) * (1 + g.random((count, 2), np.float32)),
    )


def bones_of_hand(avatar: HandAvatar, joints_m: np.ndarray) -> Bones:
    transform = Skeleton(avatar.canonical_joints_m, handedness=avatar.handedness)
    return transform.bones(joints_m)


def natively(
    library: Library, avatar: HandAvatar, bones: Bones, *, threads: int = 1, eyes_m: tuple[np.ndarray, ...] = (EYE_M,)
) -> Gaussians:
    """In the avatar's order, as the last of the eyes sees it."""
    into, count, pool = (
        new_rows(padded_rows(len(avatar)), ellipsoids=True, fades=False),
        len(avatar),
        shared_pool(threads),
    )
    poser = Poser(library, avatar, into)
    for array in (into.position_m, into.sigma_m, into.rgb, into.covariance_m2):
        array.fill(np.nan)
    poser.prepare(bones, np.array([0.01, 0.02, -0.03]))
    pool.run(lambda _thread: poser.run())
    for eye_m in eyes_m:
        if poser.prepare_gloss(eye_m):
            pool.run(lambda _thread: poser.run_gloss())
    assert (into.sigma_m[count:] == 0).all()
    order = np.argsort(poser.blocks.order)
    assert into.covariance_m2 is not None
    arrays = (into.position_m, into.sigma_m, into.opacity, into.rgb, into.covariance_m2)
    return Gaussians(*(torch.from_numpy(array[:count][order]) for array in arrays))


@dataclass(frozen=True)
class RootRelative:
    """Bones as torch tensors (learn.skinning.PoseTransforms), around the picture's origin, not the world's."""

    linear: torch.Tensor
    offset_m: torch.Tensor
    root_m: torch.Tensor
    canonical_root_m: torch.Tensor
    scale: torch.Tensor

    @classmethod
    def of(cls, avatar: HandAvatar, bones: Bones, shift_m: np.ndarray) -> "RootRelative":
        """shift_m: (3,) the hand's root relative to the picture's origin."""
        matrices = torch.from_numpy(np.asarray(bones.linear_offset, np.float32))
        return cls(
            linear=matrices[:, :, :3],
            offset_m=matrices[:, :, 3],
            root_m=torch.from_numpy(shift_m.astype(np.float32)),
            canonical_root_m=torch.from_numpy(avatar.canonical_joints_m[0]),
            scale=torch.tensor(bones.scale, dtype=torch.float32),
        )


def exactly(avatar: HandAvatar, bones: Bones, dtype: torch.dtype = torch.float64) -> Gaussians:
    """By the functions that training uses, from the same transforms."""
    made = RootRelative.of(avatar, bones, np.array([0.01, 0.02, -0.03]))
    wide = RootRelative(*(getattr(made, name).to(dtype) for name in vars(made)))
    with torch.no_grad():
        hand = HandTensors.of(avatar)
        skin = posed_skin(hand, wide, Angles.of(torch.from_numpy(bones.angles_rad)))
        return seen_from(skin, torch.from_numpy(EYE_M), hand)


def sound(avatar: HandAvatar, bones: Bones) -> torch.Tensor:
    """(N,) not at the limit where the palm's rotation takes over: rounding decides there."""
    linear = torch.from_numpy(bones.linear_offset[:, :, :3].astype(np.float64)) / max(bones.scale, 1e-38)
    weights = torch.from_numpy(avatar.map_weights(avatar.position_m, avatar.bone_weights))
    blended = torch.einsum("nb,bij->nij", weights.double(), linear)
    return (torch.linalg.det(blended).abs() / 1e-3 - 1).abs() > 1e-4


def check(avatar: HandAvatar, bones: Bones, found: Gaussians, *, size_m: float = 1.0) -> None:
    wanted, good = exactly(avatar, bones), sound(avatar, bones)
    assert float(good.double().mean()) > 0.99
    off_m = float((found.position_m - wanted.position_m)[good].abs().max())
    assert off_m < 1.5e-7 * max(size_m, 1.0)  # observed 9.3e-8
    assert float((found.rgb / wanted.rgb - 1)[good].abs().max()) < 2e-5  # observed 1.7e-5
    assert bool(((found.sigma_m - wanted.sigma_m).abs() <= 1e-6 * wanted.sigma_m).all())  # observed 4.5e-7
    assert found.covariance_m2 is not None
    wanted_m2 = wanted.covariance_m2
    if wanted_m2 is None:
        wanted_m2 = wanted.sigma_m[:, None] ** 2 * torch.tensor([1.0, 0, 0, 1, 0, 1])
    largest = wanted_m2[:, [0, 3, 5]].amax(1, keepdim=True)
    assert bool(((found.covariance_m2 - wanted_m2).abs() <= 2e-6 * largest).all())  # observed 1.5e-6


def check_pose(library: Library, avatar: HandAvatar, joints_m: np.ndarray, *, size_m: float = 1.0) -> None:
    bones = bones_of_hand(avatar, joints_m)
    check(avatar, bones, natively(library, avatar, bones), size_m=size_m)


# ---- ordinary hands --------------------------------------------------------------------------------------------------

KINDS = {
    "network": AVATAR,
    "no correctives": changed(correctives=None),
    "no cast shadow": changed(cast=None),
    "no gloss": changed(shine=np.zeros(601, np.float32)),
    "world offsets": changed(world_offsets=True),
    **{f"linear-{basis}": changed(correctives=linear_tier(basis)) for basis in (1, 6, 8, 13, 44)},
    "ellipsoids": ellipsoid_avatar(333),
    "odd width": trained_avatar(50, shape=PoseNetShape((3, 3, 2), 6, 5, hidden=21)),
    "full width": trained_avatar(70, shape=PoseNetShape(hidden=128)),
    "without shade": trained_avatar(64, shape=PoseNetShape((3, 3, 2), 6, 5, hidden=24, shaded=False)),
    "still metacarpals": trained_avatar(64, shape=PoseNetShape((3, 3, 2), 6, 5, hidden=24, level1=False)),
}


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("pose", ["open", "fist"])
def test_native_skin_is_the_one_that_training_uses(library, name, pose):
    check_pose(library, KINDS[name], 1.1 * joints_of(pose))


@pytest.mark.parametrize("name", ["network", "linear-8", "ellipsoids", "world offsets"])
def test_left_hands_are_lit_as_the_world_lights_them(library, name):
    check_pose(library, KINDS[name].for_hand(Handedness.LEFT), joints_of("claw", Handedness.LEFT))


@pytest.mark.parametrize("side", list(Handedness))
@pytest.mark.parametrize("name", ["network", "linear-8", "ellipsoids"])
def test_a_turned_forearm_is_the_one_that_training_uses(library, name, side):
    avatar = with_forearm(KINDS[name]).for_hand(side)
    joints_m, turn = joints_of("fist", side), np.array([0.9, 0.3, -0.2, 0.25])
    bones, straight = (avatar.skeleton().bones(joints_m, forearm=forearm) for forearm in (turn, None))
    found = natively(library, avatar, bones)
    check(avatar, bones, found)
    moved_m = found.position_m - exactly(avatar, straight).position_m
    assert float(moved_m.norm(dim=-1).max()) > 0.05


def with_forearm(avatar: HandAvatar) -> HandAvatar:
    """The same whose first Gaussians, and the anchors at them, lie along a forearm and follow the palm."""
    learned, count, g = learned_of(avatar), 20, np.random.default_rng(0)
    behind_m = avatar.canonical_joints_m[0] + g.uniform(-0.03, 0.15, (count, 1)) * FOREARM_WAY
    places_m = (behind_m + g.normal(0, 0.02, (count, 3))).astype(np.float32)
    of_palm = np.eye(21, dtype=np.float32)[:1].repeat(count, 0)

    def placed(record):
        parts = {"position_m": places_m, "bone_weights": of_palm}
        return replace(
            record, **{name: np.concatenate([part, getattr(record, name)[count:]]) for name, part in parts.items()}
        )

    assert learned.cast is not None
    cast = replace(learned.cast, anchors=placed(learned.cast.anchors))
    info = replace(avatar.info, template=WITH_FOREARM)
    return replace(placed(avatar), info=info, learned=replace(learned, cast=cast))


@pytest.mark.parametrize("count", [1, 15, 16, 17, 47])
@pytest.mark.parametrize("tier", ["network", "linear"])
def test_any_number_of_gaussians_can_be_posed(library, count, tier):
    avatar = trained_avatar(count, seed=5)
    if tier == "linear":
        avatar = changed(avatar, correctives=linear_tier(8, avatar))
    check_pose(library, avatar, joints_of("fist"))


def test_a_prefix_is_posed_with_its_own_correctives(library):
    for whole in (AVATAR, changed(correctives=linear_tier(8))):
        check_pose(library, whole.prefix(123), joints_of("fist"))


def test_gloss_follows_the_eye_and_leaves_nothing_behind(library):
    bones = bones_of_hand(AVATAR, joints_of("relaxed"))
    straight = natively(library, AVATAR, bones)
    after_another = natively(library, AVATAR, bones, eyes_m=(-EYE_M, EYE_M))
    assert torch.equal(straight.rgb, after_another.rgb)
    assert float((natively(library, AVATAR, bones, eyes_m=(-EYE_M,)).rgb - straight.rgb).abs().max()) > 0.05


def test_features_of_the_bones_are_those_of_the_planes():
    for level1 in (True, False):
        shape = PoseNetShape((3, 3, 2), 6, 5, hidden=24, level1=level1)
        net = HandTensors.of(trained_avatar(20, shape=shape)).learned.correctives
        features = PoseFeatures(net.plain().angles)
        g = np.random.default_rng(2)
        for _ in range(20):
            # far beyond the ranges too
            angles = g.normal(0, 1.5, 37)
            wanted = net.angles.double()(Angles.of(torch.from_numpy(angles))).detach().numpy()
            assert np.abs(features(angles) - wanted).max() < 1e-14  # observed 2.3e-15


# ---- odd hands -------------------------------------------------------------------------------------------------------


def flattened(bones: Bones) -> Bones:
    """Every other finger pressed to a line: skin of its bones has hardly any volume."""
    matrices = bones.linear_offset.copy()
    matrices[[0, 1, 3, 6, 8, 11, 13, 16, 18], :, 1:3] *= 1e-3
    return replace(bones, linear_offset=matrices)


@pytest.mark.parametrize("name", ["network", "linear-8", "world offsets", "ellipsoids"])
def test_where_a_blend_collapses_the_palm_turns_what_is_attached(library, name):
    avatar = KINDS[name]
    bones = flattened(bones_of_hand(avatar, joints_of("fist")))
    maps = skin_maps(torch.from_numpy(avatar.bone_weights), RootRelative.of(avatar, bones, np.zeros(3)))
    collapsed = torch.linalg.det(maps.linear.double()).abs() < 1e-3 * bones.scale**3
    assert 0.01 < float(collapsed.double().mean()) < 0.99
    check(avatar, bones, natively(library, avatar, bones))


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1e3])
def test_hands_of_any_size_are_lit_alike(library, size):
    """Smaller than float32 has cubes for, and larger than any hand."""
    check_pose(library, AVATAR, size * joints_of("fist"), size_m=size)


def test_a_hand_without_size_turns_nothing(library):
    bones = bones_of_hand(AVATAR, np.zeros((21, 3)))
    found, wanted = natively(library, AVATAR, bones), exactly(AVATAR, bones)
    assert bool(torch.isfinite(found.rgb).all())
    assert torch.allclose(found.rgb.double(), wanted.rgb, atol=1e-5)
    assert torch.allclose(found.position_m.double(), wanted.position_m, atol=1e-8)
    assert not bool(found.sigma_m.any())


def test_a_normal_of_no_length_reflects_nothing_odd(library):
    normal = learned_of(AVATAR).normal.copy()
    normal[::7] = 0
    avatar = changed(normal=normal)
    bones = bones_of_hand(avatar, joints_of("open"))
    found = natively(library, avatar, bones)
    assert bool(torch.isfinite(found.rgb).all())
    check(avatar, bones, found)


def test_light_and_shade_stay_inside_their_range(library):
    light = replace(learned_of(AVATAR).light, irradiance=20 * learned_of(AVATAR).light.irradiance)
    check_pose(library, changed(light=light), joints_of("open"))


def test_the_last_pose_is_not_remembered(library):
    """Of networks and linear tiers: a second pose is that of a fresh hand."""
    for name in ("network", "linear-13"):
        avatar = KINDS[name]
        poser = Poser(library, avatar)
        for pose in ("fist", "open"):
            poser.prepare(bones_of_hand(avatar, joints_of(pose)), np.array([0.01, 0.02, -0.03]))
            poser.run()
        fresh = natively(library, avatar, bones_of_hand(avatar, joints_of("open")))
        order = np.argsort(poser.blocks.order)
        assert np.array_equal(poser.into.position_m[: len(avatar)][order], fresh.position_m.numpy())
