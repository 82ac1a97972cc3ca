"""A hand in the light of a scene: the kernel is the torch form in float64, and light behaves as light does."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.polynomial.legendre import legval
from small_avatars import known_avatar
from small_hands import joints_of
from test_trained_posing import RootRelative

from jghand_engine.avatar import cast_task
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.cast_task import Capsules
from jghand_engine.avatar.lamp_rows import LIMITS, Limits, compared_at, irradiance_at, lamp_rows, light_shares
from jghand_engine.avatar.learned import CastShadow, SkinResponse
from jghand_engine.avatar.posing import Poser
from jghand_engine.avatar.relighting import estimated
from jghand_engine.avatar.scene_light import (
    Baked,
    Lamp,
    SceneLight,
    Shades,
    World,
    cosine_bands,
    mirrored_lobes,
    soft_cosine,
)
from jghand_engine.color import linear_to_srgb
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import Bones
from jghand_engine.learn import scene_light as torch_light
from jghand_engine.learn.light import unit
from jghand_engine.learn.pose_features import Angles
from jghand_engine.learn.skinning import apply, posed_anchors, skin_maps
from jghand_engine.learn.tensors import HandTensors
from jghand_engine.native import library as native_library
from jghand_engine.native.scene_light_task import LampKind

EYE_M = np.array([0.1, 0.25, 0.5])
# of the root from the picture's origin
SHIFT_M = np.array([0.01, 0.02, -0.03])
EVEN = World(np.broadcast_to(np.array([0.2, 0.5, 1.0], np.float32), (16, 32, 3)))


AVATAR = known_avatar(601)


def baked_field(seed: int = 0) -> np.ndarray:
    """(N, 4, 3) of which some normals get nothing; of more Gaussians than are drawn."""
    return np.random.default_rng(seed).normal(size=(len(AVATAR) + 5, 4, 3))


def cast_of(avatar: HandAvatar) -> CastShadow:
    assert avatar.learned is not None
    assert avatar.learned.cast is not None
    return avatar.learned.cast


def response_of(avatar: HandAvatar) -> SkinResponse:
    assert avatar.learned is not None
    assert avatar.learned.response is not None
    return avatar.learned.response


def with_response(avatar: HandAvatar, **changes) -> HandAvatar:
    assert avatar.learned is not None
    return replace(avatar, learned=replace(avatar.learned, response=replace(response_of(avatar), **changes)))


def world(seed: int = 0) -> World:
    g = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(g.standard_normal((3, 3)))
    return World(g.random((16, 32, 3)) ** 4 * [3, 2, 1], turn * np.sign(np.linalg.det(turn)))


LAMPS = {
    "sun": Lamp(LampKind.SUN, (3, 2, 1), (0.2, 0.5, 1), angle_rad=0.1),
    "point": Lamp(LampKind.POINT, (0.2, 0.3, 0.1), (0.3, 0.2, 0.1), radius_m=0.03),
    "hard point": Lamp(LampKind.POINT, (0.2, 0.3, 0.1), (-0.3, 0.2, 0.1), radius_m=0.03, is_soft=False),
    "spot": Lamp(LampKind.SPOT, (0.3, 0.3, 0.3), (0, 0.1, 0.6), (0, 0, -1), radius_m=0.01, cone_rad=0.25, blend=0.4),
    "area": Lamp(LampKind.AREA, (2, 3, 4), (0, 0.6, 0.4), (0, -1, -0.6), size_m=(0.3, 0.2), spread_rad=2.0),
    "small disk": Lamp(LampKind.AREA, (90, 80, 70), (0, 0.6, 0.4), (0, -1, -1), size_m=(0.02, 0.02), is_ellipse=True),
    "without shadow": Lamp(LampKind.SUN, (1, 1, 1), (0, 0, 1), has_shadow=False),
    "gloss alone": Lamp(LampKind.SUN, (1, 1, 1), (0, 0, 1), on_matt=False),
    "matt alone": Lamp(LampKind.SUN, (1, 1, 1), (0, 0, 1), on_gloss=False),
}
EVEN_LIGHT = SceneLight(EVEN)
LIGHTS = {name: SceneLight(None, (lamp,)) for name, lamp in LAMPS.items()} | {
    "world": SceneLight(world()),
    "all": SceneLight(world(1), tuple(LAMPS.values())),
    "nothing": SceneLight(),
    "baked": SceneLight(world(1), tuple(LAMPS.values()), baked=Baked((baked_field(),))),
    # lamps, and shadows of lamps, that are drawn in part
    "fading": SceneLight(None, (LAMPS["sun"], *(Lamp(LampKind.SUN, (r, r, r), (1, 0.3, 0)) for r in (0.006, 0.016)))),
}


def bones_of(avatar: HandAvatar, pose: str = "fist") -> Bones:
    return avatar.skeleton().bones(joints_of(pose, avatar.handedness))


def natively(
    avatar: HandAvatar, bones: Bones, light: SceneLight, variant: str = "auto", others: Capsules | None = None
) -> np.ndarray:
    """(N, 3) colors towards the eye, in the avatar's order."""
    poser = Poser(native_library.load(variant), avatar)
    poser.prepare(bones, SHIFT_M, others=others, light=light)
    poser.run()
    return seen(poser, len(avatar))


def seen(poser: Poser, count: int, eye_m: np.ndarray = EYE_M) -> np.ndarray:
    """(N, 3) a copy of the colors towards an eye, in the avatar's order."""
    poser.prepare_gloss(eye_m)
    poser.run_gloss()
    return poser.into.rgb[:count][np.argsort(poser.blocks.order)]


def from_all_sides(poser: Poser, count: int) -> np.ndarray:
    """(N, 3) how bright each Gaussian is where it faces an eye: every one faces one of these."""
    return np.max([seen(poser, count, eye_m) for eye_m in np.concatenate([np.eye(3), -np.eye(3)])], 0)


def exactly(avatar: HandAvatar, bones: Bones, light: SceneLight, others: Capsules | None = None) -> torch.Tensor:
    """By the functions of `learn`, in float64."""
    hand = HandTensors.of(avatar)
    assert hand.learned is not None
    assert hand.learned.cast is not None
    assert hand.learned.correctives is not None
    made = RootRelative.of(avatar, bones, SHIFT_M)
    wide = RootRelative(*(getattr(made, name).double() for name in vars(made)))
    correction = hand.learned.correctives(Angles.of(torch.from_numpy(bones.angles_rad)))
    maps = skin_maps(hand.bone_weights, wide)
    relative = hand.position_m.double() - wide.canonical_root_m
    offset = wide.scale * apply(maps.turning, correction.offset_m.double())
    skin = torch_light.Skin(
        apply(maps.linear, relative) + maps.offset_m + offset, unit(apply(maps.turning, hand.learned.normal.double()))
    )
    anchors, ends_m = posed_anchors(hand.learned.cast, wide)
    response = torch_light.ResponseTensors.of(response_of(avatar))
    root = avatar.canonical_joints_m - avatar.canonical_joints_m[0]
    lamps = torch_light.LampRows.of(light, bones.root_m, bones.linear_offset, root)
    flesh = torch_light.Flesh.of(hand.learned.cast, ends_m, wide.scale, others)
    cast, anchored = hand.learned.cast, torch_light.Skin(*anchors)
    fallen = torch_light.shadows(cast, torch_light.Patches.of(cast.anchors), anchored, skin, flesh, light, lamps)
    got = torch_light.reached(cast, anchored, fallen, light, lamps, response)
    matt = torch_light.matt(hand.rgb.double(), skin, got, light, lamps, response, correction.shade.double())
    return torch_light.towards_eye(matt, skin, torch.from_numpy(EYE_M - SHIFT_M), got, light, lamps, response)


# ---- the kernel ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LIGHTS)
def test_the_kernel_lights_skin_as_training_does(name):
    bones = bones_of(AVATAR)
    wanted = exactly(AVATAR, bones, LIGHTS[name]).numpy()
    found = natively(AVATAR, bones, LIGHTS[name])
    assert np.abs(found - wanted).max() <= 1e-4 * max(wanted.max(), 1e-6)


def test_the_shadow_of_a_faint_world_fades_in_the_kernel_as_in_training():
    hand, bones = with_response(AVATAR, bounce=np.zeros(3)), bones_of(AVATAR)
    faint = replace(EVEN, radiance=EVEN.radiance * 0.04)
    light = SceneLight(faint, (LAMPS["sun"],))
    wanted, found = exactly(hand, bones, light).numpy(), natively(hand, bones, light)
    assert np.abs(found - wanted).max() <= 1e-4 * wanted.max()
    shares = light_shares(light, bones.root_m, np.zeros((1, 3)))
    assert 0.02 < shares[-1] < 0.04


def flesh_around() -> Capsules:
    """Sixteen capsules on all sides of the hand, which stand before some lamps and beside others."""
    g, turn = np.random.default_rng(0), np.arange(16) * np.pi / 8
    middle_m = np.array([0.0, 0.08, 0.0]) + 0.14 * np.stack([np.cos(turn), np.sin(turn), g.uniform(-1, 1, 16)], -1)
    half_m = g.uniform(-0.02, 0.02, (16, 3))
    return Capsules(middle_m - half_m, middle_m + half_m, g.uniform(0.008, 0.02, 16), g.uniform(0.3, 1.0, 16))


@pytest.mark.parametrize(
    "others",
    [
        Capsules(
            np.array([[0.03, 0.05, 0.08], [-0.02, 0.05, 0.28]]),
            np.array([[0.03, 0.13, 0.08], [0.02, 0.05, 0.32]]),
            np.array([0.012, 0.01]),
            np.array([1.0, 0.6]),
        ),
        flesh_around(),
    ],
    ids=["before it", "around it"],
)
def test_another_hand_casts_its_shadow_in_the_kernel_as_in_training(others):
    bones = bones_of(AVATAR)
    wanted = exactly(AVATAR, bones, LIGHTS["all"], others).numpy()
    alone = natively(AVATAR, bones, LIGHTS["all"])
    found = natively(AVATAR, bones, LIGHTS["all"], others=others)
    assert np.abs(found - wanted).max() <= 1e-4 * wanted.max()
    assert np.abs(found - alone).max() > 0.05 * alone.max()


def test_lamps_among_the_fingers_cast_the_shadows_that_training_finds():
    """What is far from the rays of a lamp is left out of its shadow: near lamps have rays in all directions."""
    g, bones = np.random.default_rng(5), bones_of(AVATAR, "spread")
    places_m = bones.root_m + g.normal((0, 0.08, 0), 0.05, (24, 3))
    lamps = tuple(
        Lamp(LampKind.POINT, (1e-3, 2e-3, 3e-3), tuple(place_m), radius_m=radius_m)
        for place_m, radius_m in zip(places_m, g.choice([0.004, 0.02, 0.06], 24), strict=True)
    )
    light = SceneLight(None, lamps)
    wanted, found = exactly(AVATAR, bones, light).numpy(), natively(AVATAR, bones, light)
    assert np.abs(found - wanted).max() <= 1e-4 * wanted.max()


def test_a_world_that_changes_is_seen_in_the_next_pose():
    bones, poser = bones_of(AVATAR), Poser(native_library.load(), AVATAR)
    for light in (LIGHTS["world"], SceneLight(world(3))):
        poser.prepare(bones, SHIFT_M, light=light)
        poser.run()
        shown = seen(poser, len(AVATAR))
    assert np.array_equal(shown, natively(AVATAR, bones, light))


@pytest.mark.parametrize("name", ["all", "sun", "nothing"])
def test_a_new_light_leaves_the_pose_alone(name):
    bones, poser = bones_of(AVATAR), Poser(native_library.load(), AVATAR)
    poser.prepare(bones, SHIFT_M, light=LIGHTS["all"])
    poser.run()
    # whoever poses again would find no Gaussians
    for values in poser._arrays.values():
        values.fill(0)
    assert poser.prepare_light(LIGHTS[name])
    poser.run()
    assert np.array_equal(seen(poser, len(AVATAR)), natively(AVATAR, bones, LIGHTS[name]))


# ---- light -----------------------------------------------------------------------------------------------------------


def white(avatar: HandAvatar, bounce: float) -> HandAvatar:
    """A hand that throws all light back, matt."""
    none = np.zeros(len(avatar), np.float32)
    hand = replace(avatar, rgb=np.ones_like(avatar.rgb))
    return with_response(hand, reflectance=none, shade_gain=0.0, bounce=np.full(3, bounce))


def furnace(pose: str, limits: Limits, *, sweeps: bool = False) -> np.ndarray:
    """(N, 3) how bright a white hand is over the even world around it, where it faces an eye."""
    hand = white(estimated(load_builtin(handedness=Handedness.RIGHT)), 1.0)
    bones, poser = bones_of(hand, pose), Poser(native_library.load(), hand, limits=limits, sweeps=sweeps)
    poser.prepare(bones, np.zeros(3), light=EVEN_LIGHT)
    poser.run()
    return from_all_sides(poser, len(hand)) / [0.2, 0.5, 1.0]


@pytest.mark.parametrize("pose", ["open", "fist"])
def test_a_white_hand_in_an_even_world_is_as_bright_as_the_world(pose):
    """The furnace, without shadows: skin throws back all that it gets."""
    assert np.abs(furnace(pose, Limits(world_shadow=np.inf)) - 1).max() < 0.01


def test_what_fingers_take_of_an_even_world_they_throw_back():
    """The furnace, with shadows: 64 directions hold half of a sphere to some percent."""
    ratio = furnace("open", LIMITS)
    assert np.abs(ratio - 1).max() < 0.08
    assert ratio.mean() == pytest.approx(1, abs=0.005)


def test_a_fist_keeps_most_of_the_light_of_an_even_world_and_makes_none():
    """Skin that sees nothing but skin throws back nothing: that of a white fist would go to and fro without end."""
    ratio = furnace("fist", LIMITS)
    assert ratio.max() < 1.1
    assert ratio.mean() > 0.93


def two_plates(apart_m: float) -> tuple[torch_light.Patches, torch_light.Skin]:
    """Sixteen anchors that face +z, and as many so far above them, a patch in each corner, that face them."""
    g = np.random.default_rng(0)
    corner = 0.05 * np.repeat([[0, 0], [1, 0]], 8, 0)
    flat = np.concatenate([corner + g.uniform(0, 0.005, (16, 2)), np.zeros((16, 1))], 1)
    place_m = torch.from_numpy(np.concatenate([flat, flat + np.array([0, 0, apart_m])]))
    normal = torch.tensor([[0.0, 0.0, 1.0]] * 16 + [[0.0, 0.0, -1.0]] * 16).double()
    alone = np.arange(32)[:, None]
    return torch_light.Patches(np.arange(32) // 8, 4, alone), torch_light.Skin(place_m, normal)


ALL_HIDDEN = torch.ones(32, 1).double()


def test_skin_gets_light_of_the_skin_that_it_faces_and_more_of_what_is_near():
    patches, plates = two_plates(0.02)
    faced = patches.faced(plates, ALL_HIDDEN)
    assert faced[:16, :2].abs().max() == 0
    assert faced[16:, 2:].abs().max() == 0
    # cosines of 0.37 at both ends and 7.3 times the squared distance
    assert faced[:8, 3].mean() / faced[:8, 2].mean() == pytest.approx((0.02**2 / (0.02**2 + 0.05**2)) ** 2, rel=0.3)


def test_no_more_is_made_of_skin_than_four_times_what_is_seen_of_it_and_no_more_than_is_hidden():
    near, far = (patches.faced(plates, ALL_HIDDEN).sum(1) for patches, plates in (two_plates(0.004), two_plates(0.2)))
    assert near.mean() > 0.8
    assert near.max() < 1 + 1e-9
    # patches of 5 mm, 20 cm away: some millionths of all directions, counted four times
    assert far.min() > 0
    assert far.max() < 2e-3


def test_light_is_evened_over_the_nearest_anchors_that_face_the_same_way():
    anchors = cast_of(load_builtin(handedness=Handedness.RIGHT)).anchors
    beside = torch_light.anchors_beside(anchors.position_m, anchors.normal)
    at = np.concatenate([anchors.position_m, cast_task.NORMAL_M * anchors.normal], 1).astype(np.float64)
    for anchor in range(0, len(at), 37):
        apart = np.linalg.norm(at - at[anchor], axis=1)
        assert anchor in beside[anchor]
        assert apart[beside[anchor]].max() <= np.sort(apart)[cast_task.EVENED - 1] + 1e-5
    # the two sides of a finger, 15 mm apart, do not mix
    facing = (anchors.normal[beside] * anchors.normal[:, None]).sum(-1)
    assert (facing > 0).mean() > 0.99


def test_skin_of_one_brightness_stays_so_when_it_is_evened_and_other_skin_becomes_more_alike():
    anchors, g = cast_of(AVATAR).anchors, torch.Generator().manual_seed(0)
    beside = torch_light.anchors_beside(anchors.position_m, anchors.normal)
    patches = torch_light.Patches(np.zeros(len(beside), np.int64), 1, beside)
    hidden = torch.rand(len(beside), 1, generator=g).double()
    hidden[:5] = 0
    np.testing.assert_allclose(patches.evened(0.3 * hidden, hidden), 0.3 * hidden, atol=1e-12)
    mixed = patches.evened(hidden * torch.rand(len(beside), 1, generator=g).double(), hidden)
    assert not mixed[:5].any()
    # uniform numbers, whose deviation is 0.29, eight at a time
    assert (mixed[5:] / hidden[5:]).std() < 0.2


def test_skin_that_faces_away_throws_nothing_and_gets_nothing():
    patches, plates = two_plates(0.02)
    # the upper plate shows the lower one its back
    same_way = replace(plates, normal=plates.normal.abs())
    for turned in (same_way, replace(plates, normal=-plates.normal)):
        assert patches.faced(turned, ALL_HIDDEN).abs().max() == 0


def palm_in_the_dark(pose: str, towards: tuple[float, float, float], others: Capsules | None = None) -> np.ndarray:
    """(N, 3) how bright the skin of the palm's side is that a sun does not reach, over what faces it (about 0.16)."""
    hand = estimated(load_builtin(handedness=Handedness.RIGHT))
    assert hand.learned is not None
    palm, bones = hand.learned.normal[:, 2] > 0.7, bones_of(hand, pose)
    light = SceneLight(None, (replace(LAMPS["sun"], rgb=(1, 1, 1), place_m=towards),))
    alone = natively(with_response(hand, bounce=np.zeros(3)), bones, light, others=others)
    return natively(hand, bones, light, others=others)[palm & (alone.max(1) < 1e-3)]


def test_a_lamp_behind_an_open_hand_leaves_its_palm_dark():
    dark = palm_in_the_dark("open", (0, 0, -1))
    assert len(dark) > 5000
    assert dark.mean() < 0.002


def test_a_second_hand_before_a_dark_palm_does_not_make_it_glow_with_its_own_light():
    before = Capsules(np.array([[-0.1, 0.05, 0.08]]), np.array([[0.1, 0.05, 0.08]]), np.array([0.04]), np.ones(1))
    for towards in ((0, 0, -1), (1, 0, 0)):
        assert palm_in_the_dark("open", towards, before).mean() < 0.003


def test_skin_in_the_shadow_of_fingers_glows_red():
    dark = palm_in_the_dark("fist", (0, 0, 1))
    assert len(dark) > 500
    # observed: 0.006 and 0.001
    red, green, _ = np.quantile(dark, 0.9, axis=0)
    assert red > 0.003
    assert red > 2 * green


def test_a_hand_in_two_lights_is_the_sum_of_both_hands():
    bones = bones_of(AVATAR)
    sun, point = LAMPS["sun"], replace(LAMPS["point"], rgb=(1, 1, 1))
    both = natively(AVATAR, bones, SceneLight(None, (sun, point)))
    each = [natively(AVATAR, bones, SceneLight(None, (lamp,))) for lamp in (sun, point)]
    assert np.abs(both - sum(each)).max() < 1e-5 * both.max()


def test_a_hand_in_a_world_and_a_lamp_is_the_sum_of_both_hands():
    """Without bounced light: what is hidden from an anchor is asked in directions that the world's light chooses."""
    bones, around, sun = bones_of(AVATAR), world(8), LAMPS["sun"]

    def parted(bounce: float) -> float:
        hand = with_response(AVATAR, bounce=np.full(3, bounce))
        both, *each = (
            natively(hand, bones, light)
            for light in (SceneLight(around, (sun,)), SceneLight(around), SceneLight(None, (sun,)))
        )
        return np.abs(both - sum(each)).max() / both.max()

    # observed: 9e-8 and 4e-4
    assert parted(0.0) < 1e-5
    assert parted(0.3) < 1e-3


def test_what_stands_before_a_lamp_takes_its_light_where_its_shadow_falls():
    """All of one lamp, half of the other, and of a lamp beyond the rows nothing."""
    bones = bones_of(AVATAR)
    sun, point, area = LAMPS["sun"], replace(LAMPS["point"], rgb=(1, 1, 1)), replace(LAMPS["area"], rgb=(9, 9, 9))
    left = np.array([[0.0], [0.5]]).repeat(len(cast_of(AVATAR).anchors.position_m), 1)
    shaded = natively(AVATAR, bones, SceneLight(None, (sun, point, area), Shades((left,))))
    alone = {lamp: natively(AVATAR, bones, SceneLight(None, (lamp,))) for lamp in (point, area)}
    assert np.abs(shaded - 0.5 * alone[point] - alone[area]).max() < 1e-5 * shaded.max()


def test_the_shadow_of_a_thing_falls_where_its_anchors_are():
    """The fingers of the second hand are behind a card: they alone are dark, and no other hand's."""
    hand, sun = estimated(load_builtin(handedness=Handedness.RIGHT)), replace(LAMPS["sun"], place_m=(0, 0, 1))
    hand = with_response(hand, bounce=np.zeros(3))
    bones, edge_m = bones_of(hand, "open"), 0.09
    behind = cast_of(hand).anchors.position_m[:, 1] > edge_m
    light = SceneLight(None, (sun,), Shades((np.ones((1, len(behind))), 1.0 - behind[None])))
    bare, first, second = (
        natively(hand, bones, each) for each in (SceneLight(None, (sun,)), light.on_hand(0), light.on_hand(1))
    )
    assert np.abs(first - bare).max() < 1e-5 * bare.max()
    up_m = hand.position_m[:, 1] - edge_m
    assert second[up_m > 0.01].mean() < 0.02 * bare[up_m > 0.01].mean()
    assert second[up_m < -0.01].mean() > 0.98 * bare[up_m < -0.01].mean()


def test_on_one_hand_a_lamp_that_lights_it_is_as_one_that_lights_all():
    sun = LAMPS["sun"]
    light = SceneLight(None, (replace(sun, hands=(1,)), sun))
    dark, lit = light.on_hand(0).lamps, light.on_hand(1).lamps
    assert lit == (sun, sun)
    assert dark == (replace(sun, rgb=(0.0, 0.0, 0.0)), sun)


def test_light_that_was_baked_takes_the_place_of_lamps_and_world_on_matt_skin_alone():
    """Of two hands each has its own; what skin mirrors stays that of the lamps, and so does the next light."""
    bones, hand = bones_of(AVATAR), with_response(AVATAR, reflectance=np.zeros(len(AVATAR), np.float32))
    lit, dark = LIGHTS["all"], Baked((baked_field(), np.zeros_like(baked_field())))
    black, first = (replace(lit, baked=dark).on_hand(place) for place in (1, 0))
    gloss_alone = replace(lit, lamps=tuple(replace(lamp, on_matt=False) for lamp in lit.lamps), world=None)
    assert natively(hand, bones, black).max() == 0
    assert natively(hand, bones, first).max() > 0
    mirrored = natively(AVATAR, bones, replace(black, world=None))
    assert mirrored.max() > 0
    assert np.abs(mirrored - natively(AVATAR, bones, gloss_alone)).max() < 1e-5 * mirrored.max()


def test_a_baked_light_turns_with_the_normal():
    """A field from above lights what looks up, and as much as it says."""
    hand = white(estimated(load_builtin(handedness=Handedness.RIGHT)), 0.0)
    field = np.zeros((len(hand), 4, 3))
    field[:, 0], field[:, 2] = 1.0, [2.0, 1.0, 0.5]
    bones, poser = bones_of(hand, "open"), Poser(native_library.load(), hand)
    poser.prepare(bones, np.zeros(3), light=SceneLight(baked=Baked((field,))))
    poser.run()
    up = from_all_sides(poser, len(hand)) * np.pi - 1
    assert up[:, 1].max() == pytest.approx(1, abs=0.02)
    assert np.abs(up[:, 0] - np.maximum(2 * up[:, 1], -1)).max() < 1e-3
    assert np.abs(up[:, 2] - 0.5 * up[:, 1]).max() < 1e-3


def test_hand_and_lights_that_turn_together_look_the_same():
    g = np.random.default_rng(2)
    turn, _ = np.linalg.qr(g.standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    joints_m = joints_of("fist")
    lamps = (LAMPS["area"], LAMPS["spot"], LAMPS["sun"])
    turned = tuple(
        replace(lamp, **{name: tuple(turn @ getattr(lamp, name)) for name in ("place_m", "axis", "side")})
        for lamp in lamps
    )
    # what fingers throw onto each other is found for directions of the world
    hand = with_response(AVATAR, bounce=np.zeros(3))
    skeleton, poser, here = hand.skeleton(), Poser(native_library.load(), hand), []
    for joints, light, eye in ((joints_m, lamps, EYE_M), (joints_m @ turn.T, turned, turn @ EYE_M)):
        poser.prepare(skeleton.bones(joints), joints[0], light=SceneLight(None, light))
        poser.run()
        here.append(seen(poser, len(hand), eye))
    # observed: 3e-6
    assert np.abs(here[1] - here[0]).max() < 1e-5 * here[0].max()


def test_a_world_whose_picture_is_rolled_is_that_world_turned_about_its_pole():
    still, columns = world(7), 5
    cosine, sine = (f(2 * np.pi * columns / still.radiance.shape[1]) for f in (np.cos, np.sin))
    about_pole = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    rolled = replace(still, radiance=np.roll(still.radiance, columns, axis=1))
    turned = replace(still, env_from_world=about_pole @ still.env_from_world)
    for name in ("harmonics", "direction", "light"):
        np.testing.assert_allclose(getattr(rolled.terms, name), getattr(turned.terms, name), atol=1e-9)
    pictures = [natively(AVATAR, bones_of(AVATAR), SceneLight(each)) for each in (rolled, turned, still)]
    assert np.abs(pictures[1] - pictures[0]).max() < 1e-5 * pictures[0].max()
    assert np.abs(pictures[2] - pictures[0]).max() > 0.1 * pictures[0].max()


def test_a_lamp_behind_a_lone_surface_gives_it_nothing():
    cosine = np.linspace(-1, 1, 2001)
    for width in (0.02, 0.2, 0.9):
        f = soft_cosine(cosine, np.full_like(cosine, width))
        assert (f[cosine <= -width] == 0).all()
        assert np.allclose(f[cosine >= width], cosine[cosine >= width])
        # C1: no step in the slope
        assert np.abs(np.diff(f, 2)).max() < 2 * (0.001**2) / (4 * width) * 1.01


@pytest.mark.parametrize("width", [0.1, 0.11, 0.17, 0.24, 0.5, 0.9])
def test_each_degree_of_harmonics_keeps_its_part_of_a_rounded_cosine(width):
    """Against a sum over 200,000 slices of the sphere."""
    cosine = (np.arange(200_000) + 0.5) / 100_000 - 1
    rounded = np.where(cosine > width, cosine, np.maximum(cosine + width, 0) ** 2 / (4 * width))
    wanted = np.array([legval(cosine, np.eye(4)[degree]) @ rounded for degree in range(4)])
    # observed: 9e-5, of 48 nodes
    np.testing.assert_allclose(cosine_bands(np.array([width]))[:, 0], wanted * np.pi / wanted[0], atol=1e-4)


def test_lobes_together_are_the_blurred_world():
    shown = world(4)
    direction, light = (values.reshape(-1, 3) for values in shown.samples)
    lobes = mirrored_lobes(shown, 12.0)
    towards = direction[::37]
    blurred = np.exp(12 * (towards @ direction.T - 1)) @ light / (2 * np.pi / 12)
    fitted = np.exp(12 * (towards @ lobes[:, :3].T - 1)) @ lobes[:, 4:]
    assert np.sqrt(np.mean((fitted - blurred) ** 2)) < 0.15 * blurred.mean()


# ---- which lamps -----------------------------------------------------------------------------------------------------


def rows_of(light: SceneLight, *points: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[int]]:
    points_m = np.stack(points)
    return lamp_rows(light, light_shares(light, np.zeros(3), points_m), np.zeros(3), points_m, LIMITS)


def test_lamps_that_nobody_sees_are_left_out_and_faint_ones_cast_no_shadow():
    far = Lamp(LampKind.POINT, (1, 1, 1), (100, 0, 0))
    faint = replace(LAMPS["sun"], rgb=(0.009, 0.006, 0.003))
    rows, casting, sources = rows_of(SceneLight(None, (far, LAMPS["sun"], faint)), np.zeros(3))
    assert len(rows) == 2
    assert len(casting) == 1
    assert sources == [1]


def test_a_large_area_is_four_lamps_of_one_shadow_and_gives_the_same_light():
    area = LAMPS["area"]
    rows, casting, _ = rows_of(SceneLight(None, (area,)), np.array([0.0, 0.05, 0]))
    assert len(rows) == 4
    assert len(casting) == 1
    assert len({float(row[17]) for row in rows}) == 1
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
    assert irradiance_at(rows, points).sum(0) == pytest.approx(irradiance_at(casting, points)[0], rel=0.1)


def steps(hand: HandAvatar, lights: list[SceneLight]) -> np.ndarray:
    """The largest step of an 8-bit picture from each light to the next, the brightest skin being white."""
    poser, shown = Poser(native_library.load(), hand), []
    poser.prepare(bones_of(hand), np.zeros(3), light=lights[0])
    poser.run()
    for light in lights:
        poser.prepare_light(light)
        poser.run()
        shown.append(seen(poser, len(hand)))
    display = linear_to_srgb(np.clip(np.stack(shown) / shown[0].max(), 0, 1))
    return 255 * np.abs(np.diff(display, axis=0)).max((1, 2))


def test_a_lamp_that_grows_out_of_nothing_and_its_shadow_appear_in_no_step():
    """Skin that the strong lamp leaves black shows the faint one, and what hides that, as nothing else does."""
    hand = with_response(AVATAR, bounce=np.zeros(3))
    powers = np.linspace(0.0015, 0.011, 200) * 3
    strong, place = Lamp(LampKind.SUN, (3, 3, 3), (0, 0.2, -1), has_shadow=False), (0.6, 0.2, 1)
    lights = [SceneLight(None, (strong, Lamp(LampKind.SUN, (p, p, p), place))) for p in powers]
    assert steps(hand, lights).max() <= 1


@pytest.mark.parametrize("pose", ["open", "fist"])
def test_a_spot_on_any_part_of_the_hand_is_not_left_out(pose):
    bones = bones_of(AVATAR, pose)
    root = AVATAR.canonical_joints_m - AVATAR.canonical_joints_m[0]
    points_m = compared_at(bones.linear_offset, root)
    skin_m = Poser(native_library.load(), AVATAR)
    skin_m.prepare(bones, np.zeros(3))
    skin_m.run()
    for place_m in skin_m.into.position_m[: len(AVATAR) : 20].astype(np.float64):
        # 6 cm across where it shines
        away_m = place_m + bones.root_m + [0, 0, 0.5]
        spot = Lamp(LampKind.SPOT, (1, 1, 1), tuple(away_m), cone_rad=2 * np.arctan(0.03 / 0.5))
        assert light_shares(SceneLight(EVEN, (spot,)), bones.root_m, points_m)[0] > 0.5


def test_the_shadow_of_a_world_that_grows_out_of_nothing_appears_in_no_step():
    hand = with_response(AVATAR, bounce=np.zeros(3), reflectance=np.zeros(len(AVATAR), np.float32))
    strong = Lamp(LampKind.SUN, (3, 3, 3), (0, 0.2, -1))
    parts = np.array([0.01998, 0.02, 0.02002, 0.03998, 0.04, 0.04002])
    powers = 3 * parts / (1 - parts)
    lights = [SceneLight(World(np.full((4, 8, 3), p / np.pi)), (strong,)) for p in powers]
    assert steps(hand, lights)[[0, 1, 3, 4]].max() <= 1


@pytest.mark.parametrize("spread_rad", [0.1, 0.2, 0.5, 1.0, 2.0])
def test_a_large_area_that_shines_straight_ahead_lights_what_is_in_its_beam(spread_rad):
    """Against the sum over all of its points, each of which shines into a cone."""
    size_m, distance_m, edge = 0.6, 0.8, np.tan(spread_rad / 2)
    area = Lamp(LampKind.AREA, (1, 1, 1), (0, 0, distance_m), size_m=(size_m, size_m), spread_rad=spread_rad)
    grid = size_m * ((np.arange(200) + 0.5) / 200 - 0.5)

    def wanted(aside_m: float) -> float:
        tangent2 = ((grid[:, None] - aside_m) ** 2 + grid**2) / distance_m**2
        cones = np.maximum(edge - np.sqrt(tangent2), 0) / (edge - spread_rad / 2)
        return (cones / (1 + tangent2) ** 2).mean() * (size_m / distance_m) ** 2

    def found(aside_m: float) -> float:
        point_m = np.array([aside_m, 0, 0])
        rows, *_ = rows_of(SceneLight(None, (area,)), point_m)
        way_m = rows[:, :3] - point_m
        return float(way_m[:, 2] / np.linalg.norm(way_m, axis=1) @ irradiance_at(rows, point_m[None])[:, 0, 0])

    assert found(0.0) == pytest.approx(wanted(0.0), rel=0.25)
    assert found(0.15) == pytest.approx(wanted(0.15), rel=0.25)
    assert found(0.9) == pytest.approx(wanted(0.9), abs=0.01 * wanted(0.0))


def test_a_beam_that_passes_the_palm_by_lights_the_fingers():
    spot = Lamp(LampKind.SPOT, (1, 1, 1), (0.08, 0, 0.5), (0, 0, -1), cone_rad=0.1)
    rows, casting, _ = rows_of(SceneLight(None, (spot,)), np.zeros(3), np.array([0.08, 0.0, 0.0]))
    assert len(rows) == len(casting) == 1


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Lamp(LampKind.POINT, (np.nan, 1, 1), (0, 0, 0)), "finite"),
        (lambda: Lamp(LampKind.POINT, (-1, 1, 1), (0, 0, 0)), "0 and up"),
        (lambda: Lamp(LampKind.SUN, (1, 1, 1), (0, 0, 0)), "a direction"),
        (lambda: World(np.ones((4, 8))), "rows, columns"),
        (lambda: World(-np.ones((4, 8, 3))), "0 and up"),
        (lambda: World(np.ones((4, 8, 3)), 2 * np.eye(3)), "a rotation"),
    ],
)
def test_light_that_is_none_is_refused(make, says):
    with pytest.raises(InputError, match=says):
        make()


def test_a_hand_without_learned_shadows_cannot_be_relit():
    assert AVATAR.learned is not None
    with pytest.raises(InputError, match="shadows of its fingers"):
        estimated(replace(AVATAR, learned=None))
    with pytest.raises(InputError, match="shadows of its fingers"):
        estimated(replace(AVATAR, learned=replace(AVATAR.learned, cast=None)))
