"""Files of avatars: their cards are read from the header alone, and changes are noticed."""

import json
import math
import struct
from pathlib import Path

import pytest

from blender_addon.core import kinematics
from blender_addon.errors import JGHandFailure
from blender_addon.hand import avatar_files
from blender_addon.hand.avatar_files import MEAN_ALBEDO, SHIPPED_CARDS, albedo_of, card_of, fist_of, read_card

NO_FIST = kinematics.NO_FIST
ASSETS = Path(__file__).resolve().parents[2] / "jghand_engine" / "assets"


@pytest.fixture(autouse=True)
def disk_is_asked_every_time(monkeypatch):
    monkeypatch.setattr(avatar_files, "LOOK_S", 0.0)


def write_avatar(path: Path, **about: object) -> Path:
    header = json.dumps({"__metadata__": {"jghand": json.dumps(about)}}).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header)
    return path


@pytest.mark.parametrize(("name", "file"), [("builtin", "builtin_right.jghand"), ("painted", "painted_right.jghand")])
def test_the_cards_of_avatars_that_come_with_jghand_are_those_of_their_files(name, file):
    read = read_card(ASSETS / file)
    assert read.written
    assert [line for line in read.lines() if line[0] != "Written"] == card_of(name).lines()
    for fact in ("gaussians", "learned", "light", "has_forearm", "fist"):
        assert getattr(read, fact) == getattr(SHIPPED_CARDS[name], fact)
    assert read.albedo == pytest.approx(SHIPPED_CARDS[name].albedo, abs=1e-3)


@pytest.mark.parametrize("file", ["builtin_right.jghand", "hands/strong.jghand"])
def test_the_color_of_a_hand_is_the_mean_of_its_skin_as_the_engine_has_it(file):
    avatar = pytest.importorskip("jghand_engine.avatar.file").load_avatar(ASSETS / file)
    mean = pytest.importorskip("jghand_engine.avatar.relighting").covered_mean(avatar, avatar.rgb)
    assert read_card(ASSETS / file).albedo == pytest.approx(mean, rel=1e-3)


@pytest.mark.parametrize("file", ["builtin_right.jghand", "hands/strong.jghand"])
def test_a_card_has_the_fist_that_the_engine_reads(file):
    avatar = pytest.importorskip("jghand_engine.avatar.file").load_avatar(ASSETS / file)
    assert read_card(ASSETS / file).fist == avatar.fist != NO_FIST
    assert fist_of(str(ASSETS / file)) == avatar.fist


@pytest.mark.parametrize(
    "fist",
    [
        {"turns_deg": [0, 0, 0]},
        {"turns_deg": [0, 0, 0], "room_parts": [0, 0, 0]},
        {"turns_deg": [0, 0, 0], "room_parts": [0, 0], "thumb_part": 0},
        {"turns_deg": [0, 0, 0, 0], "room_parts": [0, 0], "thumb_part": 0},
        {"turns_deg": [0, math.nan, 0], "room_parts": [0, 0, 0], "thumb_part": 0},
        {"turns_deg": [0, 0, 0], "room_parts": [0, 0, 0.5], "thumb_part": 0},
        {"turns_deg": [0, 0, 0], "room_parts": [0, 0, 0], "thumb_part": -1},
        [1, 2],
    ],
)
def test_a_fist_that_no_hand_has_is_damage(tmp_path, fist):
    path = write_avatar(tmp_path / "a.jghand", name="a", gaussians=7, fist=fist)
    with pytest.raises(JGHandFailure) as caught:
        read_card(path)
    assert caught.value.kind == "bad_avatar"
    assert fist_of(str(path)) == NO_FIST


def with_skin(path: Path, **numbers: tuple[float, float, float]) -> Path:
    """The built-in hand with other `response` arrays."""
    content = bytearray((ASSETS / "builtin_right.jghand").read_bytes())
    (length,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + length])
    for name, values in numbers.items():
        struct.pack_into("<3f", content, 8 + length + header[f"response.{name}"]["data_offsets"][0], *values)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    "numbers",
    [
        {"bounce": (0.4, math.nan, 0.2)},
        {"bounce": (0.4, math.inf, 0.2)},
        {"bounce": (0, 0, 0)},
        # learned beside an ambient light, it is no part of the albedo
        {"bounce": (0.4, 0.3, 0.2), "ambient": (0, 0.1, 0)},
    ],
)
def test_a_hand_whose_file_does_not_tell_its_color_is_none_the_worse(tmp_path, numbers):
    path = with_skin(tmp_path / "a.jghand", **numbers)
    assert read_card(path).albedo is None
    assert albedo_of(str(path)) == MEAN_ALBEDO


def test_skin_is_no_brighter_than_white(tmp_path):
    assert read_card(with_skin(tmp_path / "a.jghand", bounce=(0.9, 0.4, 0))).albedo == pytest.approx((1, 0.5, 0))


def test_a_hand_of_unknown_color_has_that_of_skin(tmp_path):
    for avatar in ("painted", str(write_avatar(tmp_path / "b.jghand", name="b", gaussians=7))):
        assert albedo_of(avatar) == MEAN_ALBEDO
    assert pytest.importorskip("jghand_engine.avatar.relighting").MEAN_ALBEDO == MEAN_ALBEDO


def test_a_painted_avatar_says_that_nothing_was_learned():
    assert not card_of("painted").learned
    assert ("Learned From", "nothing: it is painted") in card_of("painted").lines()


@pytest.mark.parametrize(
    ("learnt", "wanted", "answers"),
    [
        ({"light": {"kind": "known"}}, "Lit by lamps and world", True),
        # an own hand
        ({"light": {"kind": "estimated"}}, "Lit by lamps and world: its skin was estimated together", True),
        ({"light": {"kind": "learnt"}}, "Lit by lamps and world, as is estimated:", False),
        # as files were written before light could be known
        ({"lobes": 8}, "Lit by lamps and world, as is estimated:", False),
        (None, "Shines with its own colors:", False),
    ],
)
def test_a_card_says_how_its_hand_answers_the_light_of_a_scene(tmp_path, learnt, wanted, answers):
    card = read_card(write_avatar(tmp_path / "a.jghand", name="a", gaussians=7, learnt=learnt))
    assert card.in_scene_light.startswith(wanted)
    assert card.answers_light == answers


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff" * 8, struct.pack("<Q", 2) + b"{}", struct.pack("<Q", 2) + b"[]", struct.pack("<Q", 9) + b"not json!"],
)
def test_what_is_no_avatar_is_refused(tmp_path, content):
    path = tmp_path / "a.jghand"
    path.write_bytes(content)
    with pytest.raises(JGHandFailure) as caught:
        read_card(path)
    assert caught.value.kind == "bad_avatar"


def test_an_avatar_that_is_not_there_is_no_damaged_one(tmp_path):
    with pytest.raises(JGHandFailure) as caught:
        read_card(tmp_path / "a.jghand")
    assert (caught.value.kind, caught.value.detail) == ("no_avatar", str(tmp_path / "a.jghand"))


def test_long_and_many_lined_texts_of_an_avatar_do_not_break_the_panel(tmp_path):
    card = read_card(write_avatar(tmp_path / "a.jghand", name="a\n\nb" + "x" * 5000, gaussians=3))
    assert "\n" not in card.name
    assert len(card.name) <= 300


def test_a_card_follows_its_file(tmp_path):
    path = tmp_path / "a.jghand"
    with pytest.raises(JGHandFailure):
        card_of(str(path))
    for name in ("Ana", "Bettina"):
        write_avatar(path, name=name, gaussians=7)
        assert card_of(str(path)).name == name


def test_films_whose_names_hold_other_letters_are_different_hands():
    names = ["左手", "右手", "IMG (1)", "IMG (2)", "x" * 60, "x" * 61]
    hands = [avatar_files.name_of_film(Path(f"{name}.mp4")) for name in names]
    assert len(set(hands)) == len(names)
    assert all(avatar_files.is_name(hand) and hand.startswith("my_") for hand in hands)
    assert avatar_files.name_of_film(Path("IMG 01.MOV")) == "my_img_01"
