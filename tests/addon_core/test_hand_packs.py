"""Hands that are chosen by picture: what a zip of them may hold, and which are found."""

import zipfile
from pathlib import Path

import pytest
from test_avatar_cards import write_avatar

from blender_addon.errors import JGHandFailure
from blender_addon.hand.avatar_files import hands_in, is_name, unpack


def write_pack(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def hand(folder: Path) -> bytes:
    return write_avatar(folder / "made.tmp", name="a", gaussians=7).read_bytes()


@pytest.fixture
def folder(tmp_path) -> Path:
    (tmp_path / "hands").mkdir()
    return tmp_path / "hands"


def test_a_pack_with_a_broken_file_says_so_and_the_rest_appear(tmp_path, folder):
    whole = hand(tmp_path)
    files = {"child.jghand": whole, "child.png": b"picture", "elder.jghand": whole[:-5], "man.jghand": whole}
    names, broken = unpack(write_pack(tmp_path / "pack.zip", files), folder)
    assert (names, broken) == (["child", "man"], ["elder.jghand"])
    assert [(one.name, one.picture is not None) for one in hands_in([folder])] == [("child", True), ("man", False)]
    assert sorted(path.name for path in folder.iterdir()) == ["child.jghand", "child.png", "man.jghand"]


@pytest.mark.parametrize("damaged", ["child.jghand", "child.png"])
@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_hand_of_which_a_file_is_damaged_is_left_out_and_the_one_of_its_name_stays(
    tmp_path, folder, damaged, compression
):
    pack = tmp_path / "pack.zip"
    whole = hand(tmp_path)
    with zipfile.ZipFile(pack, "w", compression) as archive:
        for name, content in {"child.jghand": whole, "child.png": b"new", "man.jghand": whole}.items():
            archive.writestr(name, content)
        start = archive.getinfo(damaged).header_offset
    content = bytearray(pack.read_bytes())
    content[start + 30 + len(damaged)] ^= 0xFF  # the first byte behind the local header
    pack.write_bytes(content)
    for name in ("child.jghand", "child.png"):
        (folder / name).write_bytes(b"old")
    assert unpack(pack, folder) == (["man"], ["child.jghand"])
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {
        "child.jghand": b"old",
        "child.png": b"old",
        "man.jghand": whole,
    }


def test_nothing_is_written_beside_the_folder_of_hands(tmp_path, folder):
    whole = hand(tmp_path)
    files = {"../out.jghand": whole, "/tmp/root.jghand": whole, "in/side.jghand": whole, "Read Me.jghand": whole}
    names, broken = unpack(write_pack(tmp_path / "pack.zip", files), folder)
    assert (names, broken) == (["out", "root", "side"], [])
    assert not (tmp_path / "out.jghand").exists()


@pytest.mark.parametrize("content", [{}, {"child.png": b"picture"}, {"notes.txt": b""}])
def test_a_zip_without_hands_is_refused(tmp_path, folder, content):
    with pytest.raises(JGHandFailure) as refused:
        unpack(write_pack(tmp_path / "pack.zip", content), folder)
    assert refused.value.kind == "bad_pack"


def test_what_is_no_zip_is_refused(tmp_path, folder):
    (tmp_path / "pack.zip").write_bytes(b"not a zip")
    with pytest.raises(JGHandFailure) as refused:
        unpack(tmp_path / "pack.zip", folder)
    assert refused.value.kind == "bad_pack"


def test_the_first_folder_that_has_a_name_counts(tmp_path, folder):
    for place in (folder, tmp_path):
        (place / "child.jghand").write_bytes(hand(tmp_path))
    assert [one.file.parent for one in hands_in([folder, tmp_path, tmp_path / "none"])] == [folder]


def test_names_are_no_paths():
    assert all(map(is_name, ("child", "strong_2", "a-b")))
    assert not any(map(is_name, ("", "a.jghand", "//child", "/child", "a b", "C:", "..", "Child")))
