"""A .jghand file that is damaged, lies about itself or attacks the reader: refused by name, nothing runs."""

from __future__ import annotations

import contextlib
import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors
import safetensors.numpy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_avatars import ellipsoid_avatar, known_avatar, trained_avatar

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import ASSETS
from jghand_engine.avatar.correctives import LinearCorrectives
from jghand_engine.avatar.file import METADATA_KEY, load_avatar, save_avatar
from jghand_engine.avatar.storage import Storage
from jghand_engine.avatar.tiers import Distilled, Price, Tier
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import LEVEL_NAMES, STANDARD_NAMES, Handedness
from jghand_engine.learn.skeleton import JointTransform

WHOLE = Path(str(ASSETS / "painted_right.jghand")).read_bytes()
Parts = tuple[dict[str, np.ndarray], dict[str, Any]]


def parts() -> Parts:
    """A small valid file as arrays and description, cut from the built-in avatar."""
    arrays = {name: a if name == "canonical_joints_m" else a[:50] for name, a in safetensors.numpy.load(WHOLE).items()}
    with safetensors.safe_open(str(ASSETS / "painted_right.jghand"), framework="numpy") as content:
        about = json.loads(content.metadata()[METADATA_KEY])
    return arrays, {**about, "gaussians": 50}


def parts_of(path: Path, avatar: HandAvatar, storage: Storage = Storage.EXACT) -> Parts:
    """The file of an avatar as arrays and description."""
    save_avatar(path, avatar, storage=storage)
    with safetensors.safe_open(str(path), framework="numpy") as content:
        return safetensors.numpy.load_file(path), json.loads(content.metadata()[METADATA_KEY])


def written(path: Path, arrays: dict[str, np.ndarray], about: Any) -> Path:
    text = about if isinstance(about, str) else json.dumps(about)
    path.write_bytes(
        safetensors.numpy.save({k: np.ascontiguousarray(a) for k, a in arrays.items()}, metadata={METADATA_KEY: text})
    )
    return path


def refused(path: Path, *words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_avatar(path)
    message = str(caught.value)
    assert path.name in message
    for word in words:
        assert word in message, message
    assert caught.value.remedy


def test_the_file_these_are_made_from_is_read(tmp_path):
    assert len(load_avatar(written(tmp_path / "good.jghand", *parts()))) == 50


@pytest.mark.parametrize(
    "content",
    [
        *(WHOLE[:length] for length in (0, 1, 7, 8, 9, 100, 1000, len(WHOLE) // 2, len(WHOLE) - 1)),
        WHOLE + b"rubbish",
        safetensors.numpy.save({"weight": np.zeros(3)}),
    ],
    ids=len,
)
def test_what_is_no_whole_avatar_file_is_refused(tmp_path, content):
    path = tmp_path / "other.jghand"
    path.write_bytes(content)
    refused(path)


def test_a_pickle_is_refused_and_does_not_run(tmp_path):
    class Attack:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    path = tmp_path / "pickle.jghand"
    path.write_bytes(pickle.dumps(Attack()) + b" " * 100)
    refused(path)
    assert not (tmp_path / "ran").exists()


def test_a_newer_version_says_to_update(tmp_path):
    arrays, about = parts()
    refused(written(tmp_path / "new.jghand", arrays, {**about, "format_version": 5}), "newer JGHand", "update")


FIELDS = {
    "format_version": [0, -1, "1", 1.5, True, None],
    "name": [None, 3, "two\nlines", "\x1b[31mred", "\ud800", "x" * 501],
    "template": [None, []],
    "licence": [{}],
    "units": ["millimeters", None],
    "handedness": ["both", None, 1],
    "joint_names": [None, [], ["wrist"] * 21],
    "swing": ["maximal", None],
    "scale_mode": ["huge", "alpha", 1.5, -0.1, 10**400, float("nan"), True, None, [0.3]],
    "storage": ["pickle", None],
    "gaussians": [0, -5, 49, 10**12, "50", True, None],
    "position_box_m": [
        None,
        [],
        [[0, 0, 0]],
        [[0, 0, 0], [1, 1]],
        [[0, 0, 0], [1, 1, "1"]],
        [[0, 0, 0], [1, 1, 1e308]],
    ],
    "pose_statistics": [None, [], {"a": 1}, {"a": [1]}, {"a": [1, None]}, {"a": [2, 1]}, {"a\0": [1, 2]}],
}
# what it was learned from is said of trained avatars alone
OPTIONAL_FIELDS = {
    "learnt_from": [
        [],
        "all",
        {},
        {"capture": "a", "split": "b", "digest": "c"},
        {"capture": "a", "split": "b", "digest": "c", "pictures": 0},
        {"capture": "a", "split": 7, "digest": "c", "pictures": 1},
        {"capture": "two\nlines", "split": "b", "digest": "c", "pictures": 1},
        *(
            {"capture": "a", "split": "b", "digest": "c", "pictures": 1, "pixel_m": size_m}
            for size_m in ("1", None, True, -1, 1e300)
        ),
    ]
}


@pytest.mark.parametrize(
    ("field", "value"), [(f, v) for f, values in (FIELDS | OPTIONAL_FIELDS).items() for v in values]
)
def test_a_wrong_description_is_refused(tmp_path, field, value):
    arrays, about = parts()
    refused(written(tmp_path / "wrong.jghand", arrays, {**about, field: value}))


@pytest.mark.parametrize("field", FIELDS)
def test_a_missing_description_field_is_refused(tmp_path, field):
    arrays, about = parts()
    del about[field]
    refused(written(tmp_path / "missing.jghand", arrays, about))


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "null", "[" * 20_000, '{"format_version": 1e999}', "NaN"])
def test_a_description_that_is_no_json_object_is_refused(tmp_path, text):
    refused(written(tmp_path / "json.jghand", parts()[0], text))


def refused_without(path: Path, whole: Parts, name: str) -> None:
    """An array is missed, and its length and type looked at."""
    arrays, about = whole
    refused(written(path, {k: a for k, a in arrays.items() if k != name}, about), name)
    refused(written(path, {**arrays, name: arrays[name][:-1]}, about), name)
    refused(written(path, {**arrays, name: arrays[name].astype(np.int64)}, about), name, "I64")


@pytest.mark.parametrize("name", sorted(parts()[0]))
def test_every_array_is_missed_and_its_length_and_type_looked_at(tmp_path, name):
    refused_without(tmp_path / "wrong.jghand", parts(), name)


def test_an_unknown_array_is_refused(tmp_path):
    arrays, about = parts()
    refused(written(tmp_path / "more.jghand", {**arrays, "payload": np.zeros(3)}, about), "payload")


VALUES = {
    "sigma_m": (np.nan, np.inf, 0, -1e-3, 1e-5, 1.0),
    "canonical_joints_m": (np.nan, np.inf, 1e3),
    "weight": (0, 65535),
    "weight_bone": (21, 255),
}


@pytest.mark.parametrize(("name", "value"), [(n, v) for n, values in VALUES.items() for v in values])
def test_values_that_no_hand_has_are_refused(tmp_path, name, value):
    arrays, about = parts()
    arrays[name] = arrays[name].copy()
    arrays[name][13] = value
    refused(written(tmp_path / "value.jghand", arrays, about))


def test_positions_far_from_the_hand_are_refused(tmp_path):
    arrays, about = parts()
    refused(written(tmp_path / "far.jghand", arrays, {**about, "position_box_m": [[0, 0, 0], [0, 0, 90]]}), "wrist")


def test_coincident_joints_are_refused(tmp_path):
    arrays, about = parts()
    arrays["canonical_joints_m"] = arrays["canonical_joints_m"].copy()
    arrays["canonical_joints_m"][6] = arrays["canonical_joints_m"][5]
    refused(written(tmp_path / "joints.jghand", arrays, about), "index2")


def bent_sideways(joints_m: np.ndarray) -> np.ndarray:
    """The small finger along its flexion axis, its bones as long as before; standard order."""
    frames = JointTransform(
        joints_m[[STANDARD_NAMES.index(name) for name in LEVEL_NAMES]], handedness=Handedness.RIGHT
    ).canonical
    lengths_m = np.linalg.norm(np.diff(joints_m[17:], axis=0), axis=1)
    along_m = np.concatenate([[0], np.cumsum(lengths_m)])[:, None]
    return np.concatenate([joints_m[:17], joints_m[17] + along_m * frames.S[:, 1, 4, 0].numpy()])


@pytest.mark.parametrize(
    ("change", "named"),
    [
        # palm bones in a line, a finger bent sideways by 90 degrees, fingers in another order
        (lambda joints: np.where(np.arange(21)[:, None] == 9, joints[5], joints), "palm bones"),
        (lambda joints: bent_sideways(joints), "sideways"),
        (lambda joints: joints[[0, *range(1, 5), *range(17, 21), *range(5, 17)]], "joints read in level order"),
    ],
)
def test_a_canonical_hand_that_no_joints_can_drive_is_refused(tmp_path, change, named):
    """Found when the file is read, not when the first frame is drawn."""
    arrays, about = parts()
    arrays["canonical_joints_m"] = change(arrays["canonical_joints_m"])
    refused(written(tmp_path / "joints.jghand", arrays, about), named)


def read_with_flipped_bytes(path: Path, data: st.DataObject) -> None:
    """A whole avatar or an InputError: anything else fails the test."""
    good = bytearray(path.read_bytes())
    header = 8 + int.from_bytes(good[:8], "little")
    # half of the flips in the header, where the harm is
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, header - 1) | st.integers(0, len(good) - 1))
        good[at] = data.draw(st.integers(0, 255))
    path.write_bytes(bytes(good))
    with contextlib.suppress(InputError):
        assert len(load_avatar(path)) == 50


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_flipped_bytes_give_an_avatar_or_an_input_error(tmp_path, data):
    read_with_flipped_bytes(written(tmp_path / "good.jghand", *parts()), data)


# ---- what training adds ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=list(Storage))
def known_parts(request, tmp_path_factory) -> Parts:
    """The same of an avatar that was learned in known light."""
    return parts_of(tmp_path_factory.mktemp("known") / "hand.jghand", known_avatar(50), request.param)


@pytest.mark.parametrize(
    ("light", "named"),
    [
        ({"kind": "guessed", "trained_on": {}}, "'guessed'"),
        ({"kind": None, "trained_on": {}}, "kind"),
        ({"kind": "known"}, "trained_on"),
        ({"kind": "known", "trained_on": {"sun": -1}}, "sun"),
        ({"kind": "known", "trained_on": {"sun\n": 1}}, "trained_on"),
        ([], "light"),
        ({"kind": "learnt", "trained_on": {}}, "arrays"),
        (None, "arrays"),
    ],
)
def test_a_light_of_another_kind_is_refused_by_name(tmp_path, known_parts, light, named):
    arrays, about = known_parts
    refused(written(tmp_path / "bad.jghand", arrays, {**about, "learnt": {**about["learnt"], "light": light}}), named)


def test_a_known_light_without_lamps_for_its_shadows_is_refused(tmp_path, known_parts):
    arrays, about = known_parts
    for cast in (None, {"lamps": 20, "anchors": 50}):
        learned = {**about["learnt"], "cast": cast}
        refused(written(tmp_path / "wrong.jghand", arrays, {**about, "learnt": learned}), "cast")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 6e4, -1.0])
def test_a_response_that_no_skin_has_is_refused(tmp_path, known_parts, value):
    arrays, about = known_parts
    for name in (name for name in arrays if name.startswith("response.") and arrays[name].dtype == np.float32):
        bad = arrays[name].copy()
        bad.reshape(-1)[-1] = value
        refused(written(tmp_path / "value.jghand", {**arrays, name: bad}, about), "response")


@pytest.fixture(scope="module", params=list(Storage))
def learned_parts(request, tmp_path_factory) -> Parts:
    """The same of a trained avatar with ellipsoids: with everything but tiers, which come below."""
    return parts_of(tmp_path_factory.mktemp("learnt") / "hand.jghand", ellipsoid_avatar(50), request.param)


LEARNED_FIELDS: dict[str, list[Any]] = {
    "lobes": [None, -1, 4, 6, 65, 10**12, True, "5", 5.0],
    "world_offsets": [None, 0, "no"],
    "ellipsoids": [None, 1, False],
    "shadow": [1, [], {}, {"gain": -1, "tint": [0, 0, 0]}, {"gain": 1, "tint": [0, 0]}, {"gain": 1, "tint": [0, 0, 2]}],
    "net": [None, 1, [], {}],
    "cast": [
        None,
        1,
        [],
        {},
        {"lamps": 20},
        *({"lamps": lamps, "anchors": 50} for lamps in (0, 7, 18, -20, 10**9, "20", True)),
        *({"lamps": 20, "anchors": anchors} for anchors in (0, 49, -1, 65536, 50.0, None)),
    ],
}
NET_FIELDS: dict[str, list[Any]] = {
    "octaves": [None, [], [4, 4], [4, 4, 13], [0, 0, 0], [4, 4, -1], [4, 4, True], [4, 4, 3], [4.0, 4, 2]],
    "angle_channels": [None, 0, -1, 9, 10**9, "8"],
    "angle_texels": [None, 1, 7, 10**6],
    "hidden": [None, 0, 33, 10**6],
    "level1": [None, 1],
    "shaded": [None, False],
    "reach_m": [None, -0.1, 1.0, float("nan"), float("inf"), 10**400, True],
}


def learned_refused(path: Path, parts: Parts, learned: Any) -> None:
    arrays, about = parts
    refused(written(path, arrays, {**about, "learnt": learned}))


def test_what_was_learned_is_refused_in_a_version_that_does_not_know_it(tmp_path, learned_parts):
    arrays, about = learned_parts
    refused(written(tmp_path / "old.jghand", arrays, {**about, "format_version": 1}), "unknown")


@pytest.mark.parametrize(("field", "value"), [(f, v) for f, values in LEARNED_FIELDS.items() for v in values])
def test_a_wrong_description_of_what_was_learned_is_refused(tmp_path, learned_parts, field, value):
    learned_refused(tmp_path / "wrong.jghand", learned_parts, {**learned_parts[1]["learnt"], field: value})


@pytest.mark.parametrize(("field", "value"), [(f, v) for f, values in NET_FIELDS.items() for v in values])
def test_a_wrong_description_of_the_network_is_refused(tmp_path, learned_parts, field, value):
    learned = learned_parts[1]["learnt"]
    learned_refused(tmp_path / "wrong.jghand", learned_parts, {**learned, "net": {**learned["net"], field: value}})


def test_every_learned_array_is_missed_and_its_length_and_type_looked_at(tmp_path, learned_parts):
    for name in set(learned_parts[0]) - set(parts()[0]):
        refused_without(tmp_path / "wrong.jghand", learned_parts, name)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 6e4])
def test_learned_numbers_that_no_training_gives_are_refused(tmp_path, learned_parts, value):
    arrays, about = learned_parts
    for name in set(arrays) - set(parts()[0]):
        if arrays[name].dtype in (np.float16, np.float32) and name not in ("position_m", "opacity", "rgb", "uvd"):
            bad = arrays[name].copy()
            bad.reshape(-1)[-1] = value
            refused(written(tmp_path / "value.jghand", {**arrays, name: bad}, about))


@pytest.mark.parametrize(
    ("name", "value"), [("nearest", 50), ("nearest", 65535), ("share", 255), ("bone_weights", 0.5)]
)
def test_anchors_that_are_not_there_or_share_too_much_are_refused(tmp_path, learned_parts, name, value):
    arrays, about = learned_parts
    bad = arrays[f"cast.{name}"].copy()
    bad[3] = value
    refused(written(tmp_path / "value.jghand", {**arrays, f"cast.{name}": bad}, about), name)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_flipped_bytes_of_a_trained_file_give_an_avatar_or_an_input_error(tmp_path, learned_parts, data):
    read_with_flipped_bytes(written(tmp_path / "good.jghand", *learned_parts), data)


# ---- what `jghand distill` adds -------------------------------------------------------------------------------------

BASIS = 12  # more than the features of the small network: products too


@pytest.fixture(scope="module")
def baked_parts(tmp_path_factory) -> Parts:
    """The same of a trained avatar with a linear tier."""
    avatar, g = trained_avatar(50), np.random.default_rng(3)
    assert avatar.learned is not None
    net: Any = avatar.learned.correctives
    channels = net.shape.angle_channels
    linear = LinearCorrectives(
        net.angles,
        np.zeros(channels, np.float32),
        g.standard_normal((channels, channels), np.float32),
        np.zeros((50, 6), np.float32),
        g.integers(-127, 128, (50, BASIS, 6), np.int8),
        np.full((50, 2), 1e-5, np.float32),
    )
    prices = (Price(Tier.EXACT, 0, 9.0, 0.1, 30.0, 0.0), Price(Tier.LINEAR, BASIS, 1.0, 0.1, 29.9, 0.1))
    learned = replace(avatar.learned, distilled=Distilled(linear, prices, "pictures"))
    return parts_of(tmp_path_factory.mktemp("baked") / "hand.jghand", replace(avatar, learned=learned))


BAKED_FIELDS: dict[str, list[Any]] = {
    "basis": [None, -1, 0, 11, 13, 45, 65, 10**12, True, "12", 12.0],
    "measured_on": [None, 3, "two\nlines"],
    "prices": [None, {}, [1], [{}]],
}
PRICE_FIELDS: dict[str, list[Any]] = {
    "tier": [None, "auto", "free", ["linear"], "exact"],
    "basis": [None, 0, 11, "12"],
    "frame_ms": [None, "1", float("nan"), float("inf"), 10**400, True],
    "lost_db": [None, float("nan")],
}


@pytest.mark.parametrize(("field", "value"), [(f, v) for f, values in BAKED_FIELDS.items() for v in values])
def test_a_wrong_description_of_tiers_is_refused(tmp_path, baked_parts, field, value):
    learned = baked_parts[1]["learnt"]
    learned_refused(tmp_path / "wrong.jghand", baked_parts, {**learned, "baked": {**learned["baked"], field: value}})


@pytest.mark.parametrize(("field", "value"), [(f, v) for f, values in PRICE_FIELDS.items() for v in values])
def test_a_wrong_price_is_refused(tmp_path, baked_parts, field, value):
    learned = baked_parts[1]["learnt"]
    exact, linear = learned["baked"]["prices"]
    prices = [exact, {**linear, field: value}]
    learned_refused(
        tmp_path / "wrong.jghand", baked_parts, {**learned, "baked": {**learned["baked"], "prices": prices}}
    )


@pytest.mark.parametrize(
    ("name", "column", "value", "said"),
    [
        ("constant", 2, 0.51, "constant of the offset"),
        ("constant", 3, -3.1, "constant of the shade"),
        ("scale", 0, 0.0040, "scale of the offset"),
        ("scale", 1, 0.0240, "scale of the shade"),
    ],
)
def test_a_tier_that_moves_or_shades_beyond_any_hand_is_refused(tmp_path, baked_parts, name, column, value, said):
    arrays, about = baked_parts
    bad = arrays[f"linear.{name}"].copy()
    bad[7, column] = value
    refused(written(tmp_path / "far.jghand", {**arrays, f"linear.{name}": bad}, about), said)


def test_tiers_of_no_network_are_refused(tmp_path, baked_parts):
    learned_refused(tmp_path / "wrong.jghand", baked_parts, {**baked_parts[1]["learnt"], "net": None})


def test_every_array_of_a_tier_is_missed_and_its_length_type_and_values_looked_at(tmp_path, baked_parts):
    arrays, about = baked_parts
    names = [name for name in arrays if name.startswith("linear.")]
    assert len(names) == 5
    for name in names:
        path = tmp_path / "wrong.jghand"
        refused_without(path, baked_parts, name)
        if arrays[name].ndim > 1:
            refused(written(path, {**arrays, name: arrays[name][:, :-1]}, about), name)
        if arrays[name].dtype != np.int8:  # every number of eight bits is a direction
            for value in (np.nan, np.inf, 6e4):
                bad = arrays[name].copy()
                bad.reshape(-1)[-1] = value
                refused(written(path, {**arrays, name: bad}, about), "linear")
