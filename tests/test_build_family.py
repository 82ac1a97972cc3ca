"""The script that makes the family of built-in hands: what it keeps, and what it packs."""

from dataclasses import replace
from types import SimpleNamespace

import build_family
import numpy as np
import pytest
from PIL import Image

from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.hand.joints import Handedness

HAND = load_painted(handedness=Handedness.RIGHT).prefix(50)


@pytest.fixture(autouse=True)
def nothing_is_drawn(monkeypatch):
    monkeypatch.setattr(build_family, "thumbnail", lambda avatar: Image.new("RGBA", (8, 8)))


@pytest.fixture
def drafted(tmp_path, monkeypatch):
    """Options of a run in which each hand is the same small one, and where its assets go."""
    (tmp_path / "assets").mkdir()
    monkeypatch.setattr(build_family, "HANDS", tmp_path / "assets")
    monkeypatch.setattr(build_family, "load_avatar_called", lambda name: HAND)
    monkeypatch.setattr(build_family, "_somebody", lambda *whom: None)
    monkeypatch.setattr(build_family, "as_person", lambda trained, own, other: trained)
    monkeypatch.setattr(build_family, "picture", lambda files: Image.new("RGB", (8, 8)))
    return build_family.Options(out=tmp_path / "family")


def test_a_part_of_the_family_leaves_the_picture_and_the_pack_of_all(drafted):
    build_family.main(drafted)
    shared = [drafted.out / "family.png", drafted.out / build_family.PACK]
    for file in shared:
        file.write_bytes(b"of all")
    build_family.main(replace(drafted, only=("child",)))
    assert [file.read_bytes() for file in shared] == [b"of all"] * 2


def test_a_hand_that_is_not_made_in_this_run_is_not_carried(drafted):
    build_family.main(drafted)
    with pytest.raises(SystemExit, match="elder"):
        build_family.main(replace(drafted, only=("child",), carried=("child", "elder")))
    assert not list(build_family.HANDS.iterdir())
    build_family.main(replace(drafted, only=("child",), carried=("child",)))
    assert (build_family.HANDS / "child.jghand").is_file()


def test_a_hand_larger_than_eight_megabytes_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(build_family, "FILE_MAX_BYTES", 100)
    with pytest.raises(SystemExit, match="larger than"):
        build_family._kept(tmp_path / "child.jghand", "one", lambda: HAND)


def test_no_arm_is_cut_off_at_the_edge_of_its_cell(tmp_path, monkeypatch):
    """Hands that fill their cells are whole above and the background below."""
    width, height = build_family.CELL_PX
    frame = SimpleNamespace(displayed=lambda: np.ones((height, width, 4), np.float32))
    monkeypatch.setattr(build_family, "load_avatar", lambda file: HAND)
    monkeypatch.setattr(build_family, "_frame", lambda avatar, side, size, field_m: frame)
    cells = np.asarray(build_family.picture([tmp_path / "one.jghand", tmp_path / "other.jghand"]))
    assert cells.shape == (2 * height, 2 * width, 3)
    for row in np.split(cells, 2):
        assert (row[: height // 2] == 255).all()
        np.testing.assert_allclose(row[-1], 255 * np.broadcast_to(build_family.BACKGROUND, (2 * width, 3)), atol=1)


def test_what_was_measured_is_told_to_be_of_the_trained_hand():
    told = build_family._told(load_builtin(handedness=Handedness.RIGHT).prefix(10), "JGHand child")
    assert told.info.name == "JGHand child, made from JGHand built-in"
    assert told.learned is not None
    assert told.learned.distilled is not None
    assert told.learned.distilled.measured_on.startswith("the hand that it was made from: held-out")
