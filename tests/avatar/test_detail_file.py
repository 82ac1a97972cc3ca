"""The texture of a hand in its file: what is written comes back, small, and what draws nothing is refused."""

import json
import zlib
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import safetensors
import safetensors.numpy
from detail_samples import detail_of, detailed, moving, noise

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.detail import LOG_RATIO_MAX, Detail, log_ratios, ratio_bytes
from jghand_engine.avatar.detail_correctives import NUMBERS
from jghand_engine.avatar.file import METADATA_KEY, load_avatar, save_avatar, stored_form
from jghand_engine.avatar.relief import Relief
from jghand_engine.avatar.storage import Storage
from jghand_engine.errors import InputError


def same(one: Detail | None, other: Detail | None) -> bool:
    assert one is not None
    assert other is not None
    if one.relief is not None and other.relief is not None and (one.relief.height != other.relief.height).any():
        return False
    arrays = [f.name for f in fields(Detail) if f.name not in ("relief", "correctives")]
    is_same = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays)
    return is_same and (one.relief is None) == (other.relief is None)


@pytest.fixture(scope="module")
def hand() -> HandAvatar:
    """Few Gaussians: the detail is looked at here."""
    return detailed(noise(64)).prefix(100)


@pytest.fixture(scope="module")
def in_relief(hand) -> HandAvatar:
    height = np.random.default_rng(1).integers(-127, 128, (64, 64, 2)).astype(np.int8)
    return replace(hand, detail=replace(hand.detail, relief=Relief(height)))


def back(folder: Path, hand: HandAvatar, storage: Storage = Storage.EXACT) -> Detail:
    """What a file returns of its detail."""
    save_avatar(folder / "hand.jghand", hand, storage=storage)
    detail = load_avatar(folder / "hand.jghand").detail
    assert detail is not None
    return detail


def test_a_hand_that_was_made_to_fade_away_is_not_written(tmp_path, hand):
    fading = replace(hand.detail, whole=np.ones(len(hand.detail.position_m), np.float32))
    with pytest.raises(InputError, match="fades away"):
        save_avatar(tmp_path / "hand.jghand", replace(hand, detail=fading))


def test_a_file_says_whether_its_detail_ends_the_hand_and_older_programs_refuse_it(tmp_path, hand):
    for ends, version in ((True, 5), (False, 4)):
        assert back(tmp_path, replace(hand, detail=replace(hand.detail, ends_hand=ends))).ends_hand is ends
        with safetensors.safe_open(tmp_path / "hand.jghand", "numpy") as stored:
            assert json.loads(stored.metadata()[METADATA_KEY])["format_version"] == version


@pytest.mark.parametrize("storage", list(Storage))
def test_a_file_returns_relief_and_correctives_as_they_are(tmp_path, in_relief, storage):
    own = moving(in_relief)
    again, wanted = back(tmp_path, own, storage), own.detail
    assert again.relief.height.dtype == again.correctives.direction.dtype == np.int8
    assert np.array_equal(again.relief.height, wanted.relief.height)
    assert np.array_equal(again.correctives.direction, wanted.correctives.direction)
    assert np.array_equal(again.correctives.scale_m, wanted.correctives.scale_m)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"direction": np.zeros((3, NUMBERS, 3), np.int8)}, "direction.*shape"),
        ({"direction": np.zeros((3, NUMBERS, 3), np.float32)}, "direction.*signed bytes"),
        ({"scale_m": np.full(9999, np.nan, np.float32)}, "scale_m"),
        ({"scale_m": np.full(9999, 1.0, np.float32)}, "scale_m"),
    ],
)
def test_correctives_of_other_vertices_or_that_reach_too_far_are_not_written(tmp_path, hand, change, named):
    own = moving(hand).detail
    if "scale_m" in change:
        change = {"scale_m": change["scale_m"][: len(own.position_m)]}
    bad = replace(own, correctives=replace(own.correctives, **change))
    with pytest.raises(InputError, match=named):
        save_avatar(tmp_path / "hand.jghand", replace(hand, detail=bad))


def test_a_relief_of_another_size_than_its_texture_is_not_written(tmp_path, in_relief):
    small = Relief(in_relief.detail.relief.height[:32, :32])
    with pytest.raises(InputError, match="relief"):
        save_avatar(tmp_path / "hand.jghand", replace(in_relief, detail=replace(in_relief.detail, relief=small)))


@pytest.mark.parametrize("storage", list(Storage))
def test_a_file_returns_the_stored_form_of_a_detail(tmp_path, hand, storage):
    again = back(tmp_path, hand, storage)
    assert same(again, stored_form(hand, storage).detail)
    assert same(again, hand.detail) == (storage is Storage.EXACT)


def test_a_compact_detail_costs_what_its_table_says(hand):
    stored = stored_form(hand, Storage.COMPACT).detail
    assert np.abs(stored.position_m - hand.detail.position_m).max() < 1.6e-6
    assert np.abs(stored.face_uv - hand.detail.face_uv).max() <= 1 / 131070 + 1e-7
    assert np.abs(stored.bone_weights - hand.detail.bone_weights).max() < 0.01
    assert np.array_equal(stored.texture, hand.detail.texture)
    assert same(stored_form(replace(hand, detail=stored), Storage.COMPACT).detail, stored)


def test_a_detail_of_the_full_size_takes_less_than_four_megabytes(tmp_path, hand):
    """Noise as strong as skin's, finer than any that a picture shows, on the third of the square that skin takes."""
    sizes = []
    for spread in (0.0, 0.03):
        texture = noise(1024, spread=spread)
        texture[:, 370:] = 128
        save_avatar(tmp_path / "hand.jghand", replace(hand, detail=detail_of(texture)), storage=Storage.COMPACT)
        sizes.append((tmp_path / "hand.jghand").stat().st_size)
    # a texture of 2048 has four times as many texels
    assert sizes[0] + 4 * (sizes[1] - sizes[0]) < 4e6


def test_bytes_and_ratios_are_each_others_inverse():
    every = np.arange(1, 256, dtype=np.uint8)
    assert np.array_equal(ratio_bytes(log_ratios(every)), every)
    assert log_ratios(np.array([128], np.uint8))[0] == 0
    assert log_ratios(np.array([255], np.uint8))[0] == pytest.approx(LOG_RATIO_MAX)
    assert ratio_bytes(np.array([-9.0, 9.0])).tolist() == [1, 255]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"texture": np.zeros((60, 60, 3), np.uint8)}, "texture.*power of two"),
        ({"texture": np.zeros((64, 32, 3), np.uint8)}, "texture.*shape"),
        ({"texture": np.zeros((64, 64, 3), np.float32)}, "texture.*bytes"),
        ({"depth_m": float("nan")}, "depth_m"),
        ({"depth_m": -0.001}, "depth_m"),
        ({"faces": np.array([[0, 1, 1_000_000]], np.int32)}, "faces"),
        ({"face_uv": np.full((1, 3, 2), 0.5, np.float32)}, "face_uv.*shape"),
        ({"bone_weights": "double"}, "bone_weights.*sum to 1"),
        ({"position_m": "far"}, "position_m"),
        ({"position_m": "nan"}, "position_m"),
    ],
)
def test_a_detail_that_draws_nothing_is_not_written(tmp_path, hand, change, named):
    detail = hand.detail
    values = {"double": 0.5 * detail.bone_weights, "far": detail.position_m + 2, "nan": detail.position_m * np.nan}
    change = {name: values[value] if isinstance(value, str) else value for name, value in change.items()}
    with pytest.raises(InputError, match=named):
        save_avatar(tmp_path / "hand.jghand", replace(hand, detail=replace(detail, **change)))


def parts(path: Path, hand: HandAvatar) -> tuple[dict, dict]:
    save_avatar(path, hand, storage=Storage.COMPACT)
    with safetensors.safe_open(str(path), framework="numpy") as content:
        return safetensors.numpy.load_file(path), json.loads(content.metadata()[METADATA_KEY])


@pytest.mark.parametrize(
    ("array", "value", "named"),
    [
        ("texture", np.zeros(200, np.uint8), "texture"),
        ("texture", "more", "texture"),
        ("texture", "cut", "texture"),
        ("relief", "more", "relief"),
        ("relief", "cut", "relief"),
        ("direction", "more", "direction"),
        ("direction", "cut", "direction"),
        ("weight_bone", "bone 21", "weight_bone"),
        ("faces", "vertex", "faces"),
    ],
)
def test_a_damaged_detail_is_refused_by_name(tmp_path, in_relief, array, value, named):
    path = tmp_path / "hand.jghand"
    arrays, about = parts(path, moving(in_relief))
    name = f"detail.{array}"
    if isinstance(value, str):
        old = arrays[name]
        value = {
            "more": lambda: np.frombuffer(zlib.compress(bytes(100_000_000), 9), np.uint8),
            "cut": lambda: old[: len(old) // 2].copy(),
            "bone 21": lambda: np.full_like(old, 21),
            "vertex": lambda: np.full_like(old, 65535),
        }[value]()
    arrays[name] = value
    if array in ("texture", "relief", "direction"):
        about["detail"][f"{array}_bytes"] = len(value)
    path.write_bytes(safetensors.numpy.save(arrays, metadata={METADATA_KEY: json.dumps(about)}))
    with pytest.raises(InputError, match=named):
        load_avatar(path)


def test_a_file_without_a_detail_is_written_for_older_readers(tmp_path, hand, in_relief):
    path = tmp_path / "hand.jghand"
    assert parts(path, in_relief)[1]["format_version"] == 5
    assert parts(path, hand)[1]["format_version"] == 4
    _, about = parts(path, replace(hand, detail=None))
    assert about["format_version"] == 1
    assert "detail" not in about
