"""Damaged template files: refused with the field that is wrong."""

from __future__ import annotations

import io
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.npz_files import read_arrays
from jghand_engine.template.builtin import ASSETS, FIELDS, load_fields, load_template
from jghand_engine.template.checks import check_template


@pytest.fixture(scope="module")
def fields():
    return load_fields()


def refused(tmp_path: Path, fields: dict, **changes) -> str:
    """The message with which a file with changed fields is refused."""
    path = tmp_path / "hand_right.npz"
    np.savez(path, **{name: array for name, array in {**fields, **changes}.items() if array is not None})
    with pytest.raises(InputError) as caught:
        load_fields(path)
    return str(caught.value)


@pytest.mark.parametrize("name", ["vertices", "weights25", "joint_names"])
def test_a_missing_field_is_named(tmp_path, fields, name):
    assert f"wanted fields {name}" in refused(tmp_path, fields, **{name: None})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("vertices", np.zeros((1610, 2), np.float32)),
        ("weights", np.zeros((1609, 21), np.float32)),
        ("faces", np.zeros((3216, 3), np.float32)),
        ("joints", np.full((21, 3), np.nan, np.float32)),
        ("face_uv", np.zeros((3216, 2), np.float32)),
        ("n_skin_faces", np.zeros(1, int)),
        ("parents", np.array(["a"] * 21)),
        ("joint_names", np.array([f"joint{k}" for k in range(21)])),
        ("vertices", np.float32(1)),
    ],
)
def test_a_wrong_field_is_named(tmp_path, fields, name, value):
    assert name in refused(tmp_path, fields, **{name: value})


def test_a_pickled_array_is_never_opened(tmp_path, fields):
    class Trap:
        def __reduce__(self):
            return Path.touch, (tmp_path / "it_ran",)

    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.array([Trap()], dtype=object), allow_pickle=True)
    path = tmp_path / "hand_right.npz"
    np.savez(path, **{name: array for name, array in fields.items() if name != "vertices"})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("vertices.npy", buffer.getvalue())
    with pytest.raises(InputError):
        load_fields(path)
    path.write_bytes(pickle.dumps(Trap()))
    with pytest.raises(InputError):
        load_fields(path)
    assert not (tmp_path / "it_ran").exists()


def test_a_cut_file_is_refused(tmp_path):
    whole = (ASSETS / "hand_right.npz").read_bytes()
    path = tmp_path / "hand_right.npz"
    for length in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match="a whole"):
            load_fields(path)


def test_changed_bytes_are_noticed(tmp_path):
    whole = (ASSETS / "hand_right.npz").read_bytes()
    path = tmp_path / "hand_right.npz"
    for place in range(200, 140_000, 20_011):
        changed = bytearray(whole)
        changed[place] ^= 0xFF
        path.write_bytes(changed)
        with pytest.raises(InputError):
            load_fields(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.npz"):
        load_fields(tmp_path / "nothing.npz")


def test_an_archive_that_unpacks_to_gigabytes_is_not_unpacked():
    whole = read_arrays(ASSETS / "hand_right.npz", FIELDS, "the hand")
    # the sum counts, not the largest: 146 kB in the file
    total, largest = sum(array.nbytes for array in whole.values()), max(array.nbytes for array in whole.values())
    assert largest < total // 2
    with pytest.raises(InputError, match=f"at most {total // 2} bytes"):
        read_arrays(ASSETS / "hand_right.npz", FIELDS, "the hand", max_bytes=total // 2)


def test_a_damaged_installation_says_what_to_do(monkeypatch):
    def damaged():
        raise InputError("template file", wanted="a whole .npz file", came="half of it")

    monkeypatch.setattr("jghand_engine.template.builtin.load_fields", damaged)
    with pytest.raises(InputError, match="Install JGHand again"):
        load_template.__wrapped__()


def changed(array, place, value):
    copy = array.copy()
    copy[place] = value
    return copy


@pytest.mark.parametrize(
    ("field", "change", "message"),
    [
        ("faces", lambda t: changed(t.faces, 0, -1), "vertex numbers"),
        ("faces", lambda t: changed(t.faces, 0, t.faces[0, ::-1]), "closed surface"),
        ("faces", lambda t: t.faces[:, ::-1], "inside-out"),
        ("face_uv", lambda t: t.face_uv * np.inf, "finite"),
        ("skin_face_count", lambda t: 4000, "skin faces"),
        ("vertices_m", lambda t: changed(t.vertices_m, 7, np.nan), "vertices: wanted finite"),
        ("bone_weights", lambda t: t.bone_weights * 0.5, "sum to 1"),
        ("bone_weights", lambda t: t.bone_weights[:, :20], "weights: wanted shape"),
        ("vertices_m", lambda t: t.vertices_m[:, :2], r"vertices: wanted shape \(any, 3\)"),
        ("face_uv", lambda t: t.face_uv[:-1], r"UV: wanted shape \(3216, 3, 2\)"),
        ("joints_m", lambda t: t.joints_m[:20], r"joints: wanted shape \(21, 3\)"),
        ("joints_m", lambda t: changed(t.joints_m, (3, 1), np.inf), "joints: wanted finite"),
        ("faces", lambda t: changed(t.faces, 0, 1610), "vertex numbers 0..1609"),
        ("face_uv", lambda t: changed(t.face_uv, (5, 1, 0), -1e-9), "coordinates 0..1"),
        ("skin_face_count", lambda t: 3217, r"skin faces: wanted 1\.\.3216"),
        ("vertices_m", lambda t: t.vertices_m * [1, 1, 0], "inside-out"),
        ("joints_m", lambda t: t.joints_m * 1000, "millimeters"),
        ("joints_m", lambda t: t.joints_m[np.arange(JOINT_COUNT)[::-1]], "joints"),
    ],
)
def test_an_unusable_surface_is_refused_with_its_fault(field, change, message):
    template = load_template()
    with pytest.raises(InputError, match=message):
        check_template(replace(template, **{field: change(template)}))


def test_a_surface_without_faces_is_refused():
    template = load_template()
    nothing = replace(template, faces=template.faces[:0], face_uv=template.face_uv[:0])
    with pytest.raises(InputError, match="vertex numbers"):
        check_template(nothing)
