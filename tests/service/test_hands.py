"""The engine's own pictures for the service."""

import os
import tracemalloc
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_avatars import trained_avatar
from test_requests import request

from jghand_engine.avatar import PAINTED
from jghand_engine.avatar.builtin import load_painted
from jghand_engine.avatar.file import save_avatar
from jghand_engine.avatar.forearm import ended
from jghand_engine.avatar.storage import Storage
from jghand_engine.color import srgb_to_linear
from jghand_engine.errors import InputError
from jghand_engine.gpu import device
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.hand.sequence import HandPose
from jghand_engine.native import contract
from jghand_engine.render import blur, budget
from jghand_engine.render.blur import Moment
from jghand_engine.render.camera import Camera, Lens
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset
from jghand_engine.service import hands
from jghand_engine.service.commands import Commands, error_header
from jghand_engine.service.hands import IDLE_AVATARS_MAX, HandImages
from jghand_engine.service.image_request import ImageRequest, ImageSettings, RequestedHand, RequestedLight

PINHOLE = (200.0, 200.0, 60.0, 45.0)
DRAFT = ImageSettings("draft")
# half a meter before the palm of a hand that points up
CAMERA_FROM_WORLD = np.diag([1.0, -1, -1, 1])
CAMERA_FROM_WORLD[:3, 3] = (0, 0.09, 0.5)


@dataclass(frozen=True)
class Hand:
    joints_m: np.ndarray
    avatar: str = PAINTED
    handedness: str = "right"
    world_from_hand: np.ndarray = field(default_factory=lambda: np.eye(4))


def seen(
    hands: list[Hand], camera_from_world: np.ndarray = CAMERA_FROM_WORLD, lens: Lens | None = None, forearm=None
) -> Moment:
    """120 x 90 pixels of hands at one moment. forearm: of each of them"""
    turns, offsets_m = (np.stack([hand.world_from_hand[:3, part] for hand in hands]) for part in (slice(3), 3))
    joints_m = np.einsum("nab,njb->nja", turns, np.stack([hand.joints_m for hand in hands])) + offsets_m[:, None]
    poses = [HandPose(each, forearm) for each in to_level(joints_m, JointOrder.STANDARD)]
    return Moment(poses, Camera(120, 90, *PINHOLE, camera_from_world, lens))


def asked(hands: list[Hand], *moments: Moment, **more) -> ImageRequest:
    """120 x 90 pixels of hands; without moments at one, from CAMERA_FROM_WORLD."""
    entries = tuple(RequestedHand(hand.avatar, hand.handedness) for hand in hands)
    moments = moments or (seen(hands),)
    told = {"settings": DRAFT, "depth": True, "weights": (1.0,) * len(moments), **more}
    return ImageRequest(120, 90, entries, moments, **told)


@pytest.fixture(scope="module")
def source() -> HandImages:
    return HandImages()


@pytest.fixture(scope="module")
def right(source) -> Hand:
    """The painted hand at rest."""
    return Hand(source.load(PAINTED).canonical_joints_m)


def test_a_picture_is_that_of_the_renderer_in_its_own_process(source, right):
    came = source.render(asked([right]))
    camera = Camera(120, 90, *PINHOLE, CAMERA_FROM_WORLD)
    renderer = HandRenderer(ended(load_painted(handedness=Handedness.RIGHT)), preset("draft"))
    frame = renderer.render(to_level(right.joints_m, JointOrder.STANDARD), camera)
    np.testing.assert_array_equal(came.rgba, frame.rgba)
    np.testing.assert_array_equal(came.depth_m, frame.depth_m)
    assert came.report["visible_gaussians"] > 0


def test_where_the_hands_own_space_is_does_not_matter(source, right):
    """Only joints seen from the camera count: the same hand given in another space is the same picture."""
    turn = np.array([[0, -1.0, 0, 0.3], [1, 0, 0, -2.0], [0, 0, 1, 0.7], [0, 0, 0, 1]])
    elsewhere = replace(
        right, joints_m=right.joints_m @ turn[:3, :3].T + turn[:3, 3], world_from_hand=np.linalg.inv(turn)
    )
    # worst observed 0: positions are kept relative to the root
    np.testing.assert_allclose(source.render(asked([elsewhere])).rgba, source.render(asked([right])).rgba, atol=1e-6)


def test_the_nearer_of_two_hands_covers_the_other_whatever_their_order(source, right):
    nearer = replace(right, handedness="left", world_from_hand=np.eye(4))
    nearer.world_from_hand[2, 3] = 0.1
    one, other = source.render(asked([right, nearer])), source.render(asked([nearer, right]))
    # worst observed 2.5e-6 of rounding, because positions are kept relative to the first hand; a Gaussian at the
    # contract's cut-off may fall on either side of it (observed: 24 of 43200 values, by 4.3e-4 at most)
    difference = np.abs(one.rgba - other.rgba)
    assert (difference > 5e-6).mean() < 6e-4
    assert difference.max() < contract.ALPHA_MIN
    # the other out of sight: how much larger hands are drawn and averaged depends on the smallest of them
    aside = replace(right, world_from_hand=np.eye(4))
    aside.world_from_hand[0, 3] = 10.0
    alone = source.render(asked([nearer, aside]))
    solid = alone.rgba[..., 3] > 0.998
    assert solid.sum() > 300
    # worst observed 0.0031 and 0.15 mm: the two thousandths that shine through, and where a block of pixels stops
    # early, which may cost the preset's t_stop of 0.01
    np.testing.assert_allclose(one.rgba[solid], alone.rgba[solid], atol=4e-3)
    np.testing.assert_allclose(one.depth_m[solid], alone.depth_m[solid], atol=2e-4)


def test_depth_is_left_out_when_nobody_asks_for_it(source, right):
    assert source.render(asked([right])).depth_m.any()
    assert not source.render(asked([right], depth=False)).depth_m.any()


def test_a_renderer_is_kept_and_only_the_last_few_are(source, right):
    fresh = HandImages()
    for _ in range(2):
        fresh.render(asked([right]))
        fresh.render(asked([right], settings=ImageSettings("viewport")))
    assert len(fresh._renderers) == 2
    for count in range(3, 12):
        fresh.render(replace(asked([right] * count), width=8, height=6))
    assert len(fresh._renderers) == 8


def test_what_a_large_picture_needs_is_given_back_and_the_next_one_is_the_same(right):
    fresh = HandImages()
    large = replace(asked([right]), width=900, height=700)
    fresh.render(asked([right]))
    fresh.rest()
    tracemalloc.start()
    try:
        before = fresh.render(large).rgba.copy()
        held = tracemalloc.get_traced_memory()[0] - before.nbytes
        fresh.rest()
        left = tracemalloc.get_traced_memory()[0] - before.nbytes
        after = fresh.render(large).rgba
    finally:
        tracemalloc.stop()
    assert held > 3e6  # observed 4.2e6, of the box that the hand fills
    assert left < 0.02 * held
    assert np.array_equal(before, after)


def test_an_avatar_whose_file_changed_is_drawn_anew_without_being_told(right, tmp_path):
    fresh, path = HandImages(), tmp_path / "hand.jghand"
    avatar = load_painted(handedness=Handedness.RIGHT).prefix(500)
    hand = replace(right, avatar=str(path))
    with pytest.raises(InputError):
        fresh.render(asked([hand]))
    pictures = []
    for age_ns, color in enumerate((avatar.rgb, 1 - avatar.rgb)):
        save_avatar(path, replace(avatar, rgb=color))
        os.utime(path, ns=(age_ns, age_ns))  # clocks of file systems are coarse
        pictures.append(fresh.render(asked([hand])).rgba)
    assert np.abs(pictures[0] - pictures[1]).max() > 0.2
    assert len(fresh._avatars) == len(fresh._renderers) == 1


def test_avatars_that_nothing_shows_are_let_go(tmp_path):
    fresh, avatar = HandImages(), load_painted(handedness=Handedness.RIGHT).prefix(50)
    for number in range(IDLE_AVATARS_MAX + 2):
        save_avatar(tmp_path / f"{number}.jghand", avatar)
        fresh.load(str(tmp_path / f"{number}.jghand"))
    assert len(fresh._avatars) == IDLE_AVATARS_MAX


def test_a_trained_hand_reflects_towards_the_camera_of_each_picture(source, right, tmp_path):

    avatar, path = trained_avatar(2000), tmp_path / "trained.jghand"
    save_avatar(path, avatar, storage=Storage.EXACT)
    hand = replace(right, avatar=str(path))
    assert avatar.learned is not None
    dark = replace(avatar, learned=replace(avatar.learned, shine=np.zeros(2000, np.float32)))
    turn = np.array([[0.96, 0, 0.28, 0], [0, 1, 0, 0], [-0.28, 0, 0.96, 0], [0, 0, 0, 1]])
    for camera_from_world in (CAMERA_FROM_WORLD, CAMERA_FROM_WORLD @ turn):
        moment = seen([hand], camera_from_world)
        came = source.render(asked([hand], moment, settings=ImageSettings("viewport")))
        camera = Camera(120, 90, *PINHOLE, camera_from_world)
        wanted, matt = (
            HandRenderer(ended(one), preset("viewport"))
            .render(to_level(right.joints_m, JointOrder.STANDARD), camera)
            .rgba
            for one in (avatar, dark)
        )
        np.testing.assert_array_equal(came.rgba, wanted)
        assert np.abs(wanted - matt).max() > 0.05
        assert any(stage["name"] == "gloss" and stage["ran"] for stage in came.report["stages"])


@pytest.mark.parametrize(("content", "kind"), [(None, "no_avatar"), (b"no avatar", "bad_avatar")])
def test_an_avatar_that_is_gone_is_told_from_a_damaged_one(source, right, tmp_path, content, kind):
    path = tmp_path / "mine.jghand"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        source.render(asked([replace(right, avatar=str(path))]))
    told = error_header(caught.value)
    assert told["kind"] == kind
    assert str(path) in told["sentence"]


@pytest.mark.parametrize("changes", [{"handedness": "both"}, {"avatar": "/nowhere.jghand"}])
def test_what_is_not_there_is_bad_input(source, right, changes):
    with pytest.raises(InputError):
        source.render(asked([replace(right, **changes)]))


def test_a_preset_that_nobody_knows_is_bad_input(source, right):
    with pytest.raises(InputError, match="preset"):
        source.render(asked([right], settings=ImageSettings("best")))


# ---- the world and its light ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def trained(source, right, tmp_path_factory) -> Hand:
    path = tmp_path_factory.mktemp("avatars") / "trained.jghand"
    save_avatar(path, trained_avatar(2000), storage=Storage.EXACT)
    return replace(right, avatar=str(path))


def about_up(angle_rad: float) -> np.ndarray:
    turn = np.eye(4)
    turn[[0, 2], [0, 2]] = np.cos(angle_rad)
    turn[0, 2], turn[2, 0] = np.sin(angle_rad), -np.sin(angle_rad)
    return turn


def test_the_light_stays_in_the_world_while_a_hand_and_its_camera_turn(source, right, trained):
    """Hand and camera together turned: the same picture of a painted hand, another light on a trained one."""
    turn = about_up(1.2)
    for hand, changes in ((right, False), (trained, True)):
        turned = replace(hand, world_from_hand=turn)
        one = source.render(asked([hand])).rgba
        other = source.render(asked([turned], seen([turned], CAMERA_FROM_WORLD @ turn.T))).rgba
        np.testing.assert_allclose(other[..., 3], one[..., 3], atol=0.02)
        assert bool(np.abs(other - one).mean() > 0.01) is changes


# ---- bones ----------------------------------------------------------------------------------------------------------


def test_ids_name_the_bone_that_ends_at_a_joint(source, right):
    """In the middle between two joints of a finger lies the bone that ends at the second one."""
    ids = source.render(asked([right], ids=True)).ids
    assert ids.dtype == np.uint8
    assert ids.max() <= 20
    view = CAMERA_FROM_WORLD
    for joint in (3, 4, 6, 7, 8, 10, 11, 12, 14, 15, 16, 18, 19, 20):
        x, y, z = 0.5 * (right.joints_m[joint - 1] + right.joints_m[joint]) @ view[:3, :3].T + view[:3, 3]
        assert ids[int(200 * y / z + 45), int(200 * x / z + 60)] == joint
    x, y, z = 0.5 * (right.joints_m[0] + right.joints_m[9]) @ view[:3, :3].T + view[:3, 3]
    assert ids[int(200 * y / z + 45), int(200 * x / z + 60)] in (5, 9, 13)  # the palm is moved by several bones
    assert not source.render(asked([right], ids=True)).rgba[ids == 0, 3].max() > 0.5


# ---- several moments ------------------------------------------------------------------------------------------------


def moved(hand: Hand, x_m: float) -> Hand:
    place = np.eye(4)
    place[0, 3] = x_m
    return replace(hand, world_from_hand=place)


@pytest.fixture
def as_given(monkeypatch):
    """No moments are put between those that are given."""
    monkeypatch.setattr(blur, "motion_count", lambda _: 2)


def test_moments_are_averaged_in_linear_light_and_the_middle_one_gives_depth_and_ids(source, right, as_given):
    at = [moved(right, x_m) for x_m in (-0.02, 0.0, 0.03)]
    came = source.render(asked([right], *(seen([hand]) for hand in at), ids=True))
    alone = [source.render(asked([hand], ids=True)) for hand in at]
    mean = np.mean([linear(one.rgba) for one in alone], 0)
    # worst observed 2e-6
    np.testing.assert_allclose(linear(came.rgba), mean, atol=1e-5)
    np.testing.assert_array_equal(came.depth_m, alone[1].depth_m)
    np.testing.assert_array_equal(came.ids, alone[1].ids)
    anywhere = np.max([one.depth_m > 0 for one in alone], 0)
    solid = np.max([one.rgba[..., 3] > 0.9 for one in alone], 0)
    assert (came.covered_depth_m[solid] > 0.4).all()
    assert not came.covered_depth_m[~anywhere].any()
    told = {effect["effect"]: effect for effect in came.report["effects"]}
    assert told["motion-blur"]["runs"]
    assert "3 images" in told["motion-blur"]["reason"]


def linear(rgba: np.ndarray) -> np.ndarray:
    alpha = rgba[..., 3:]
    straight = np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0)
    return np.concatenate([srgb_to_linear(straight) * alpha, alpha], -1)


def test_a_moment_counts_by_its_weight(source, right, as_given):
    at = [moved(right, x_m) for x_m in (0.0, 0.06)]
    came = source.render(asked([right], *(seen([hand]) for hand in at), weights=(3.0, 1.0))).rgba[..., 3]
    alone = [source.render(asked([hand])).rgba[..., 3] for hand in at]
    np.testing.assert_allclose(came, 0.75 * alone[0] + 0.25 * alone[1], atol=1e-5)


def test_a_lens_blurs_what_is_out_of_focus_and_leaves_depth_sharp(source, right):
    sharp = source.render(asked([right]))
    focused, blurred = (
        source.render(asked([right], seen([right], lens=Lens(0.02, focus_m)))) for focus_m in (0.5, 0.9)
    )
    edges = [np.abs(np.diff(picture.rgba[..., 3], axis=1)).max() for picture in (sharp, focused, blurred)]
    assert edges[1] > 0.7 * edges[0]
    assert edges[2] < 0.5 * edges[0]
    np.testing.assert_allclose(blurred.depth_m, sharp.depth_m, atol=1e-6)
    told = {effect["effect"]: effect for effect in blurred.report["effects"]}
    assert told["depth-of-field"]["runs"]


# ---- settings -------------------------------------------------------------------------------------------------------


def test_a_budget_chooses_settings(source, right, monkeypatch):
    """What is measured for it is one of a few sizes, not each that a view ever has."""
    asked_for = []

    def bought(budget_ms, avatar, size_px, backend):
        asked_for.append((budget_ms, size_px))
        return SimpleNamespace(settings=preset("draft"))

    monkeypatch.setattr(budget, "best_for", bought)
    request = asked([right], settings=ImageSettings("final", budget_ms=9.0))
    for width, height in ((120, 90), (150, 100), (80, 400)):
        report = source.render(replace(request, width=width, height=height)).report
    assert asked_for == [(9.0, (256, 171))]
    assert report["gaussians"] == 20_000
    source.render(replace(request, width=512, height=334))
    assert asked_for[1:] == [(9.0, (512, 341))]


# ---- light of a scene ------------------------------------------------------------------------------------------------


SUN = {"kind": "sun", "rgb": [3, 2, 1], "place_m": [0, 0, 1]}


def lit(*lamps: dict, world: str = "", radiance: np.ndarray | None = None) -> RequestedLight:
    record = {"lamps": list(lamps), "world": {"key": world} if world else None}
    return RequestedLight(record, radiance)


def trained_hand(tmp_path) -> Hand:
    path = tmp_path / "trained.jghand"
    if not path.exists():
        save_avatar(path, trained_avatar(601))
    return Hand(load_painted(handedness=Handedness.RIGHT).canonical_joints_m, str(path))


def test_a_lamp_lights_the_hand_in_linear_colors(source, tmp_path):
    hand = trained_hand(tmp_path)
    dark = source.render(asked([hand], light=lit()))
    once = source.render(asked([hand], light=lit(SUN)))
    twice = source.render(asked([hand], light=lit(SUN | {"rgb": [6, 4, 2]})))
    assert dark.linear
    assert once.linear
    assert dark.rgba[..., :3].max() == 0
    assert dark.rgba[..., 3].max() > 0.9
    assert once.rgba[..., :3].max() > 0.01
    assert np.allclose(twice.rgba[..., :3], 2 * once.rgba[..., :3], rtol=1e-5, atol=1e-7)
    assert not source.render(asked([hand])).linear


def test_a_world_is_known_again_by_its_key(source, tmp_path):
    hand, sky = trained_hand(tmp_path), np.full((4, 8, 3), 0.5, np.float32)
    first = source.render(asked([hand], light=lit(world="sky", radiance=sky)))
    same = source.render(asked([hand], light=lit(world="sky", radiance=3 * sky)))
    other = source.render(asked([hand], light=lit(world="noon", radiance=2 * sky)))
    assert np.array_equal(first.rgba, same.rgba)
    assert np.allclose(other.rgba[..., :3], 2 * first.rgba[..., :3], rtol=1e-5, atol=1e-7)


SKY = np.full((4, 8, 3), 0.5, np.float32)
IN_SKY = {"light": {"lamps": [], "world": {"key": "wrong"}}}


def told(lamp: dict, **changes: object) -> dict:
    return {"light": {"lamps": [SUN, lamp | changes], "world": None}}


def changed(value: float) -> np.ndarray:
    sky = SKY.copy()
    sky[1, 2, 0] = value
    return sky


POINT = {"kind": "point", "rgb": [1, 1, 1], "place_m": [0, 0, 1]}
WRONG_LIGHTS = {
    "a light that is a list": ({"light": [SUN]}, None, "light"),
    "a world that is a number": ({"light": {"world": 1}}, None, "light"),
    "a world without a key": ({"light": {"world": {}}}, SKY, "key"),
    "a world without its picture": (IN_SKY, None, "array world: .*nothing"),
    "a world of one color for each row": (IN_SKY, SKY[:, 0].copy(), "array world: .*rows, columns and 3"),
    "a world with alpha": (IN_SKY, np.ones((4, 8, 4), np.float32), "array world: .*rows, columns and 3"),
    "a world that is too large": (IN_SKY, np.ones((1025, 1, 3), np.float32), "array world: .*at most"),
    "a world in doubles": (IN_SKY, SKY.astype(np.float64), "array world: .*float32"),
    "a world that is no number": (IN_SKY, changed(np.nan), "world: .*finite radiance"),
    "a world that takes light": (IN_SKY, changed(-0.1), "world: .*0 and up"),
    "a world that is turned by nothing": (
        {"light": {"world": {"key": "turned", "env_from_world": [[0] * 3] * 3}}}, SKY, "a rotation",
    ),
    "lamps that are no list": ({"light": {"lamps": SUN}}, None, "lamps"),
    "more lamps than anybody needs": ({"light": {"lamps": [SUN] * 1000}}, None, "lamps"),
    "a lamp that takes light": (told(SUN, rgb=[1, -1, 1]), None, "lamp 2.*rgb"),
    "a lamp that is no number": (told(SUN, rgb=[1, np.nan, 1]), None, "lamp 2.*rgb"),
    "a lamp that is nowhere": (told(POINT, place_m=[0, np.nan, 1]), None, "lamp 2.*place_m"),
    "a lamp of less than nothing": (told(POINT, radius_m=-0.1), None, "lamp 2.*radius_m"),
    "a sun without a direction": (told(SUN, place_m=[0, 0, 0]), None, "lamp.*direction"),
    "a lamp of an unknown kind": (told(SUN, kind="bulb"), None, "lamp 2.*kind"),
    "a lamp in watts": (told(SUN, watts=4), None, "watts"),
    "a lamp of a hand that is not there": (told(SUN, hands=[0, 1]), None, "hands of a lamp.*below 1, got 1"),
    "a lamp of a hand without a number": (told(SUN, hands=["right"]), None, "lamp 2.*hands.*whole numbers"),
}  # fmt: skip


@pytest.mark.parametrize(("header", "world", "says"), WRONG_LIGHTS.values(), ids=WRONG_LIGHTS.keys())
def test_a_request_in_a_light_that_is_none_is_told_what_is_wrong_with_it(source, header, world, says):
    message = request(arrays=None if world is None else {"world": world}, **header)
    with pytest.raises(InputError, match=says):
        Commands(source).run(message)


def test_the_same_light_again_draws_nothing(source, tmp_path):
    hand = trained_hand(tmp_path)
    source.render(asked([hand], light=lit(SUN)))
    stages = source.render(asked([hand], light=lit(SUN))).report["stages"]
    assert {"skin", "gloss", "raster"}.isdisjoint(stage["name"] for stage in stages if stage["ran"])


def test_a_lamp_lights_the_hands_that_it_is_for_alone(source, tmp_path):
    one = trained_hand(tmp_path)
    away = replace(one, world_from_hand=np.eye(4))
    away.world_from_hand[0, 3] = 5.0  # beyond the shadows of the other
    pair, other = [one, away], SUN | {"rgb": [1, 1, 4]}
    both = [SUN | {"hands": [0, 1]}, other | {"hands": [1]}]
    near, far = CAMERA_FROM_WORLD, CAMERA_FROM_WORLD @ np.linalg.inv(away.world_from_hand)

    def drawn(eye: np.ndarray, *lamps: dict) -> np.ndarray:
        return source.render(asked(pair, seen(pair, eye), light=lit(*lamps))).rgba

    np.testing.assert_array_equal(drawn(near, *both), drawn(near, SUN))
    np.testing.assert_array_equal(drawn(far, *both), drawn(far, SUN, other))
    assert drawn(near, both[1])[..., :3].max() == 0
    assert drawn(far, both[1])[..., :3].max() > 0.01


def test_what_a_scene_takes_of_a_lamp_is_dark_on_the_hand_and_known_again(source, tmp_path):
    hand, lamps = trained_hand(tmp_path), lit(SUN, SUN | {"rgb": [1, 1, 1]})
    bare = source.render(asked([hand, hand], light=lit(SUN)))
    left, left_at = np.full((2, 2, 9), 255, np.uint8), np.random.default_rng(0).uniform(-0.1, 0.1, (9, 3))
    left[:, 1] = 0
    shaded = source.render(asked([hand, hand], light=replace(lamps, left=left, left_at=left_at)))
    assert np.allclose(shaded.rgba, bare.rgba, rtol=1e-4, atol=1e-6)
    stages = source.render(asked([hand, hand], light=replace(lamps, left=left.copy(), left_at=left_at))).report[
        "stages"
    ]
    assert {"skin", "gloss", "raster"}.isdisjoint(stage["name"] for stage in stages if stage["ran"])


def test_a_scene_that_casts_shadows_searches_no_points_around_gaussians(source, tmp_path, monkeypatch):
    """Only light that was baked is read there, and the search takes longer than a picture."""
    left, left_at = np.full((1, 1, 9), 255, np.uint8), np.random.default_rng(0).uniform(-0.1, 0.1, (9, 3))
    asked_for = asked([trained_hand(tmp_path)], light=replace(lit(SUN), left=left, left_at=left_at))
    counts = []
    around = hands._around
    monkeypatch.setattr(hands, "_around", lambda points, to, count: counts.append(count) or around(points, to, count))
    assert source.render(asked_for).rgba.max() > 0
    assert set(counts) == {1}


def test_light_that_was_baked_lights_each_hand_as_it_says_whatever_the_lamps_are(source, tmp_path):
    """It is smoothed over the points, so that an even one stays even."""
    hand, baked_at = trained_hand(tmp_path), np.random.default_rng(0).uniform(-0.1, 0.1, (50, 3))
    even = np.zeros((1, 50, 4, 3))
    even[:, :, 0] = [np.pi, 2 * np.pi, 0]
    light = replace(lit(SUN | {"on_gloss": False}), baked=even, baked_at=baked_at)
    once = source.render(asked([hand], light=light)).rgba
    twice = source.render(asked([hand], light=replace(light, baked=2 * even))).rgba
    assert once[..., :2].max() > 0.01
    assert once[..., 2].max() == 0
    assert np.allclose(twice[..., :3], 2 * once[..., :3], rtol=1e-4, atol=1e-6)


def test_a_hand_is_shown_with_its_forearm_or_without(source, tmp_path):
    from jghand_engine.template.builtin import WITH_FOREARM

    # some skin along twelve centimeters behind the wrist
    avatar = load_painted(handedness=Handedness.RIGHT).prefix(300)
    behind_m = np.maximum(0, 0.12 - 0.001 * np.arange(300))[:, None]
    place = avatar.position_m - behind_m * np.array([-0.18, 1, -0.12])
    info = replace(avatar.info, template=WITH_FOREARM)
    save_avatar(tmp_path / "arm.jghand", replace(avatar, info=info, position_m=place.astype(np.float32)))
    hand = Hand(avatar.canonical_joints_m, str(tmp_path / "arm.jghand"))
    request = asked([hand])
    shown, hidden = (
        source.render(replace(request, hands=(replace(request.hands[0], forearm=forearm),))).rgba[..., 3].sum()
        for forearm in (True, False)
    )
    assert hidden < 0.9 * shown
    # turned by a right angle about the axis of flexion it is not where it was; without one nothing is turned
    bent = replace(request, moments=(seen([hand], forearm=np.array([np.sqrt(0.5), 0, np.sqrt(0.5), 0])),))
    assert np.abs(source.render(bent).rgba - source.render(request).rgba).max() > 0.5
    cut = [replace(each, hands=(replace(each.hands[0], forearm=False),)) for each in (bent, request)]
    assert np.array_equal(*(source.render(each).rgba for each in cut))


@pytest.mark.graphics_card
def test_a_service_that_was_started_for_the_graphics_card_draws_on_it(right):
    report = HandImages("gpu").render(asked([right])).report
    assert device.open_device().name in report["backend"]


@pytest.mark.graphics_card
def test_a_service_without_its_graphics_card_answers_with_what_was_seen(right, monkeypatch):
    monkeypatch.setenv(device.ADAPTER_VARIABLE, "no such card")
    with pytest.raises(InputError, match="no such card"):
        HandImages("gpu").render(asked([right]))
