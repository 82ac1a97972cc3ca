"""The .jghand file: what is written comes back, exactly as promised, and a failure never touches the old file."""

import errno
import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import safetensors
import safetensors.numpy
from small_avatars import ellipsoid_avatar, known_avatar, small_avatar, trained_avatar

from jghand_engine.avatar.avatar import HandAvatar, LearnedFrom
from jghand_engine.avatar.correctives import PoseNetShape
from jghand_engine.avatar.file import ARRAY_NAMES, METADATA_KEY, load_avatar, save_avatar, stored_form
from jghand_engine.avatar.learned import Anchors, CastShadow, Learned, Light, ShadowLook, SkinResponse
from jghand_engine.avatar.relighting import thrown_back
from jghand_engine.avatar.storage import Storage
from jghand_engine.errors import InputError, RetryError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import NO_FIST, Fist
from jghand_engine.hand.skeleton import Swing, Transform, scale_exponent
from jghand_engine.learn.baselines import HaloLikeTransform, transform_of
from jghand_engine.learn.skeleton import JointTransform


def same(one: HandAvatar, other: HandAvatar) -> bool:
    equal = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ARRAY_NAMES)
    joints = np.array_equal(one.canonical_joints_m, other.canonical_joints_m)
    learned = same_learned(one.learned, other.learned)
    return equal and joints and learned and one.info == other.info and one.handedness == other.handedness


def same_learned(one: Learned | None, other: Learned | None) -> bool:
    if one is None or other is None:
        return one is other
    arrays = [
        [
            learned.normal,
            learned.shine,
            *(getattr(learned.light, f.name) for f in fields(Light)),
            *weights_of(learned),
            *(() if learned.response is None else (getattr(learned.response, f.name) for f in fields(SkinResponse))),
            *(() if learned.ellipsoid is None else (learned.ellipsoid.log_stretch, learned.ellipsoid.quaternion)),
            *([] if learned.cast is None else arrays_of(learned.cast)),
        ]
        for learned in (one, other)
    ]
    equal = all(np.array_equal(a, b) for a, b in zip(*arrays, strict=True))
    return equal and one.shadow == other.shadow and one.world_offsets == other.world_offsets


def arrays_of(cast: CastShadow) -> list[np.ndarray]:
    own = [cast.lamp_rgb, cast.bounced_rgb, cast.flesh, cast.own]
    return [*own, *(getattr(cast.anchors, f.name) for f in fields(Anchors))]


def weights_of(learned: Learned) -> list[np.ndarray]:
    return [] if learned.correctives is None else list(learned.correctives.weights.values())


def back(folder: Path, avatar: HandAvatar, storage: Storage = Storage.EXACT) -> HandAvatar:
    """What a file returns of it."""
    save_avatar(folder / "hand.jghand", avatar, storage=storage)
    return load_avatar(folder / "hand.jghand")


def parts_of(path: Path) -> tuple[dict[str, np.ndarray], dict]:
    """Arrays and description of a file."""
    with safetensors.safe_open(path, framework="numpy") as content:
        return safetensors.numpy.load_file(path), json.loads(content.metadata()[METADATA_KEY])


def test_an_exact_file_returns_every_bit(tmp_path):
    avatar = small_avatar().for_hand(Handedness.LEFT)
    assert same(back(tmp_path, avatar), avatar)


def test_a_compact_file_returns_exactly_the_stored_form(tmp_path):
    avatar = small_avatar()
    assert same(back(tmp_path, avatar, Storage.COMPACT), stored_form(avatar, Storage.COMPACT))


@pytest.mark.parametrize("swing", list(Swing))
@pytest.mark.parametrize("scale_mode", ["axial", "uniform", 0.3, 1])
def test_the_conventions_come_back_as_the_transform_takes_them(tmp_path, swing, scale_mode):
    avatar = small_avatar()
    avatar = replace(avatar, info=replace(avatar.info, swing=swing, scale_mode=scale_mode))
    again = back(tmp_path, avatar)
    assert same(again, avatar)
    assert isinstance(again.info.scale_mode, str) == isinstance(scale_mode, str)
    transform = JointTransform(
        again.canonical_joints_m, handedness=again.handedness, swing=again.info.swing, scale_mode=again.info.scale_mode
    )
    assert transform.exponent == scale_exponent(scale_mode)


def test_a_file_says_how_the_bones_follow_the_joints(tmp_path):
    avatar = small_avatar()
    avatar = replace(avatar, info=replace(avatar.info, transform=Transform.HALO_LIKE))
    again = back(tmp_path, avatar)
    assert same(again, avatar)
    assert isinstance(transform_of(again), HaloLikeTransform)


def test_a_file_that_does_not_say_how_the_bones_follow_the_joints_means_the_usual_way(tmp_path):
    """As those of the first JGHand."""
    path = tmp_path / "hand.jghand"
    save_avatar(path, small_avatar())
    arrays, about = parts_of(path)
    assert about.pop("transform") == "joints"
    path.write_bytes(safetensors.numpy.save(arrays, {METADATA_KEY: json.dumps(about)}))
    assert same(load_avatar(path), small_avatar())


def test_an_older_file_that_has_light_that_no_shadow_takes_throws_light_by_its_albedo(tmp_path):
    avatar, path = known_avatar(), tmp_path / "known.jghand"
    learned = replace(avatar.learned, response=replace(avatar.learned.response, bounce=np.float32([0.1, 0.2, 0.3])))
    save_avatar(path, replace(avatar, learned=learned))
    assert np.array_equal(load_avatar(path).learned.response.bounce, np.float32([0.1, 0.2, 0.3]))
    arrays, about = parts_of(path)
    arrays["response.ambient"] += 0.02
    del about["checksum"]
    path.write_bytes(safetensors.numpy.save(arrays, {METADATA_KEY: json.dumps(about)}))
    assert np.array_equal(load_avatar(path).learned.response.bounce, thrown_back(avatar, avatar.rgb))


def test_saving_a_compact_avatar_again_changes_nothing():
    for seed in range(20):
        once = stored_form(small_avatar(500, seed), Storage.COMPACT)
        assert same(stored_form(once, Storage.COMPACT), once)


def test_compact_storage_costs_what_its_table_says():
    avatar = small_avatar(5000)
    stored = stored_form(avatar, Storage.COMPACT)
    box_m = np.ptp(avatar.position_m, axis=0).max()
    # half a step, and half a unit in the last place of a float32 on top
    assert np.abs(stored.position_m - avatar.position_m).max() <= float(box_m) / 65535 / 2 + 8e-9
    assert np.abs(stored.sigma_m / avatar.sigma_m - 1).max() <= 0.5e-3
    assert np.abs(stored.rgb - avatar.rgb).max() <= 1 / 510 + 1e-7
    assert np.abs(stored.opacity - avatar.opacity).max() <= 1 / 510 + 1e-7
    assert np.abs(stored.uvd - avatar.uvd).max() <= 1 / 131070 + 1e-7
    dropped = np.sort(avatar.bone_weights, 1)[:, :-7].sum(1)
    moved = np.abs(stored.bone_weights - avatar.bone_weights).max(1)
    assert (moved <= dropped + 1 / 65535 + 1e-6).all()
    assert np.abs(stored.bone_weights.sum(1, dtype=np.float64) - 1).max() < 1e-6


BAD = {
    "position_m": (float("nan"), "finite"),
    "sigma_m": (0.0, "radii"),
    "opacity": (1.5, "0 to 1"),
    "rgb": (-0.1, "0 to 1"),
    "bone_weights": (0.7, "sum to 1"),
    "uvd": (float("inf"), "finite"),
}


@pytest.mark.parametrize("name", BAD)
def test_an_avatar_that_cannot_be_rendered_is_not_written(tmp_path, name):
    value, wanted = BAD[name]
    array = getattr(small_avatar(), name).copy()
    array[17] = value
    with pytest.raises(InputError, match=f"{name}.*{wanted}.*Gaussian 17"):
        save_avatar(tmp_path / "bad.jghand", replace(small_avatar(), **{name: array}))
    assert list(tmp_path.iterdir()) == []


NAN = float("nan")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"swing": "maximal"}, "swing"),
        ({"transform": "guessed"}, "transform.*joints or halo-like"),
        ({"scale_mode": "alpha"}, "scale mode"),
        ({"scale_mode": NAN}, "scale mode"),
        ({"scale_mode": True}, "scale mode"),
        ({"name": 7}, "name"),
        ({"name": "x" * 501}, "name.*at most 500"),
        ({"license": "MIT\0"}, "licence"),
        ({"template": "\ud800"}, "template"),
        ({"pose_statistics": {"index mcp": (0.0, NAN)}}, "description.*finite"),
        ({"pose_statistics": {"index mcp": (1.0, 0.0)}}, "pose_statistics index mcp"),
        ({"pose_statistics": {"index mcp": (1.0,)}}, "pose_statistics index mcp"),
        ({"pose_statistics": {"two\nlines": (0.0, 1.0)}}, "pose_statistics"),
        ({"pose_statistics": {"a": (0.0, object())}}, "description.*texts"),
    ],
)
def test_what_could_not_be_loaded_again_is_not_saved(tmp_path, change, named):
    avatar = small_avatar()
    with pytest.raises(InputError, match=rf"avatar for .*bad\.jghand.*{named}"):
        save_avatar(tmp_path / "bad.jghand", replace(avatar, info=replace(avatar.info, **change)))
    assert list(tmp_path.iterdir()) == []


def test_joints_in_single_precision_and_names_of_any_script_can_be_saved(tmp_path):
    avatar = small_avatar()
    info = replace(avatar.info, name="手 · la main d'Ève", license="x" * 500)
    avatar = replace(avatar, info=info, canonical_joints_m=avatar.canonical_joints_m.astype(np.float32))
    again = back(tmp_path, avatar)
    assert again.info == info
    assert np.array_equal(again.canonical_joints_m, avatar.canonical_joints_m)
    assert again.canonical_joints_m.dtype == np.float64


def test_the_pictures_that_an_avatar_was_learned_from_are_kept(tmp_path):
    learned_from = LearnedFrom("id3 train/Capture0", "splits.json of the capture", 360, "0123456789abcdef", 4.8e-4)
    avatar = small_avatar()
    again = back(tmp_path, replace(avatar, info=replace(avatar.info, learned_from=learned_from)))
    assert again.info.learned_from == learned_from


def test_the_joints_of_a_hand_that_is_not_the_canonical_one_are_kept(tmp_path):
    avatar = small_avatar()
    assert back(tmp_path, avatar).own_joints_m is None
    child = replace(avatar, own_joints_m=0.7 * avatar.canonical_joints_m)
    loaded = back(tmp_path, child)
    assert np.array_equal(loaded.own_joints_m, child.own_joints_m)
    assert np.array_equal(loaded.rest_joints_m, child.own_joints_m)
    assert np.array_equal(loaded.canonical_joints_m, avatar.canonical_joints_m)
    flat = replace(avatar, own_joints_m=0 * avatar.canonical_joints_m)
    with pytest.raises(InputError, match="flat"):
        save_avatar(tmp_path / "flat.jghand", flat)


@pytest.mark.parametrize("storage", Storage)
def test_the_fist_that_skin_wants_is_kept_and_those_of_no_hand_are_refused(tmp_path, storage):
    avatar = small_avatar()
    assert back(tmp_path, avatar, storage).fist == NO_FIST
    assert "fist" not in parts_of(tmp_path / "hand.jghand")[1]
    fist = Fist((-1.25, 0.1, 6.0), (0.0, -0.0031, 0.02), 0.0107)
    thick = replace(avatar, fist=fist)
    assert back(tmp_path, thick, storage).fist == stored_form(thick, storage).fist == fist
    for wrong in (Fist((0, 0, 7.0)), Fist((0, 0)), Fist(room_parts=(0, -0.03, 0)), Fist(thumb_part=0.1)):
        with pytest.raises(InputError, match="fist"):
            save_avatar(tmp_path / "hand.jghand", replace(avatar, fist=wrong))


def test_a_full_disk_leaves_the_old_file_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "hand.jghand"
    save_avatar(path, small_avatar(seed=1))
    before = path.read_bytes()

    def full(self, data):
        with self.open("wb") as stream:
            stream.write(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(RetryError, match="disk is full"):
        save_avatar(path, small_avatar(seed=2))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["hand.jghand"]


# ---- trained avatars -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("storage", list(Storage))
@pytest.mark.parametrize("make", [trained_avatar, ellipsoid_avatar, known_avatar])
def test_a_trained_avatar_comes_back_as_promised(tmp_path, storage, make):
    avatar = make()
    again = back(tmp_path, avatar, storage)
    assert same(again, stored_form(avatar, storage))
    if storage is Storage.EXACT:
        assert same(again, avatar)


def test_an_anchor_far_from_the_hand_is_refused(tmp_path):
    avatar = known_avatar()
    cast = avatar.learned.cast
    position_m = cast.anchors.position_m.copy()
    position_m[3] = 0.9
    cast = replace(cast, anchors=replace(cast.anchors, position_m=position_m))
    with pytest.raises(InputError, match="cast position_m"):
        save_avatar(tmp_path / "far.jghand", replace(avatar, learned=replace(avatar.learned, cast=cast)))
    assert not list(tmp_path.iterdir())


def test_a_trained_avatar_without_correctives_or_shadow_comes_back(tmp_path):
    avatar = trained_avatar()
    avatar = replace(avatar, learned=replace(avatar.learned, correctives=None, shadow=None, world_offsets=True))
    assert same(back(tmp_path, avatar), avatar)


def test_a_shadow_of_the_papers_own_form_comes_back(tmp_path):
    avatar = trained_avatar()
    avatar = replace(avatar, learned=replace(avatar.learned, shadow=ShadowLook(tint=(0.1, 0.2, 0.3), printed=True)))
    assert same(back(tmp_path, avatar), avatar)


@pytest.mark.parametrize("shaded", [False, True])
def test_a_network_of_any_shape_comes_back(tmp_path, shaded):
    shape = PoseNetShape((1, 0, 3), 3, 2, 5, level1=False, reach_m=0.004, shaded=shaded)
    avatar = trained_avatar(shape=shape)
    assert same(back(tmp_path, avatar), avatar)


def test_compact_storage_of_what_was_learned_costs_what_its_table_says():
    avatar = trained_avatar(20_000)
    stored = stored_form(avatar, Storage.COMPACT).learned
    ours, theirs = stored.normal.astype(np.float64), avatar.learned.normal.astype(np.float64)
    sine = np.linalg.norm(np.cross(ours, theirs), axis=-1)
    assert np.degrees(np.arctan2(sine, (ours * theirs).sum(-1))).max() < 0.004  # observed 0.0029
    assert np.abs(stored.shine / avatar.learned.shine - 1).max() <= 0.5e-3
    assert np.array_equal(stored.light.irradiance, avatar.learned.light.irradiance)
    pairs = zip(weights_of(stored), weights_of(avatar.learned), strict=True)
    assert all(np.abs(ours / theirs - 1).max() < 0.5e-3 for ours, theirs in pairs)


def test_compact_storage_of_a_known_light_costs_what_its_table_says():
    avatar = known_avatar(20_000)
    stored = stored_form(avatar, Storage.COMPACT)
    assert np.abs(stored.rgb - avatar.rgb).max() <= 1.6e-5
    for name in ("spread", "roughness", "reflectance"):
        ours, theirs = (getattr(each.learned.response, name) for each in (stored, avatar))
        assert np.abs(ours - theirs).max() <= np.ptp(theirs) / 509
    assert np.allclose(stored.learned.response.softness, avatar.learned.response.softness, rtol=1e-6)


def test_a_prefix_keeps_what_it_answers_light_with():
    avatar = known_avatar().prefix(50)
    assert len(avatar.learned.response.spread) == len(avatar.learned.response.reflectance) == 50
    assert avatar.learned.response.trained_on == {"worlds": 3, "sun": 5}


def test_normals_along_the_axes_and_on_the_folds_survive():
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    folds = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, -1.0], [1.0, 0.0, -1.0]]) / 2**0.5
    normal = np.concatenate([axes, folds]).astype(np.float32)
    avatar = trained_avatar(len(normal))
    stored = stored_form(replace(avatar, learned=replace(avatar.learned, normal=normal)), Storage.COMPACT)
    assert np.abs(stored.learned.normal - normal).max() < 5e-5


def test_an_avatar_is_written_for_the_oldest_readers_that_can_draw_it(tmp_path):
    for avatar, version in ((small_avatar(), 1), (trained_avatar(), 2), (known_avatar(), 3)):
        save_avatar(tmp_path / "hand.jghand", avatar)
        with safetensors.safe_open(str(tmp_path / "hand.jghand"), framework="numpy") as content:
            assert json.loads(content.metadata()[METADATA_KEY])["format_version"] == version


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"normal": np.full((200, 3), NAN)}, "normal"),
        ({"normal": np.ones((199, 3))}, "normal"),
        ({"shadow": ShadowLook(gain=NAN)}, "finite numbers"),
        ({"shadow": ShadowLook(tint=(0.1, 0.2, 1.5))}, "shadow"),
        ({"shadow": ShadowLook(seen=1.1)}, "shadow seen"),
    ],
)
def test_what_no_training_can_give_is_not_written(tmp_path, change, named):
    avatar = trained_avatar()
    with pytest.raises(InputError, match=named):
        save_avatar(tmp_path / "bad.jghand", replace(avatar, learned=replace(avatar.learned, **change)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["nothing.jghand", "no\0thing.jghand"])
def test_a_missing_file_is_named_once(tmp_path, name):
    with pytest.raises(InputError, match="cannot read") as refused:
        load_avatar(tmp_path / name)
    assert str(refused.value).count(name) == 1


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_bytes_that_were_lost_on_the_way_are_noticed_before_the_hand_is_drawn(tmp_path, part):
    """4,000 zeros, as of a copy that broke off, in the middle of numbers that remain numbers."""
    path = tmp_path / "hand.jghand"
    save_avatar(path, known_avatar(), storage=Storage.COMPACT)
    content = bytearray(path.read_bytes())
    arrays_at = 8 + int.from_bytes(content[:8], "little")
    first = arrays_at + int(part * (len(content) - arrays_at))
    content[first : first + 4000] = bytes(4000)
    path.write_bytes(content)
    with pytest.raises(InputError, match="damaged"):
        load_avatar(path)


def test_a_file_of_before_that_has_no_checksum_is_read(tmp_path):
    path = tmp_path / "hand.jghand"
    save_avatar(path, small_avatar())
    arrays, about = parts_of(path)
    del about["checksum"]
    path.write_bytes(safetensors.numpy.save(arrays, {METADATA_KEY: json.dumps(about)}))
    assert same(load_avatar(path), small_avatar())
