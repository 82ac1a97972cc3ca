"""Points that were placed before come from the user's cache, the same to the bit; nothing depends on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import safetensors.torch
import scipy
import torch

from jghand_engine.learn import canonical_points, points_cache
from jghand_engine.learn.canonical_points import CanonicalPoints, place_points
from jghand_engine.learn.points_cache import points_file
from jghand_engine.template.builtin import load_template

NUMBERS = {"depth_m": 0.001, "area_power": 0.78, "seed": 0}


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("JGHAND_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def placings(monkeypatch):
    """How many points were placed, each time that it was done anew; in no time, and others each time."""
    counts = []

    def placed(template, count, **_numbers):
        counts.append(count)
        part = torch.rand(count, generator=torch.Generator().manual_seed(len(counts)))
        rows = part[:, None].expand(-1, 3)
        weights = part[:, None].expand(-1, 21)
        joints_m = torch.from_numpy(template.joints_m.copy())
        return CanonicalPoints(rows, rows, rows, weights, part, joints_m, template.identifier)

    monkeypatch.setattr(canonical_points, "_placed", placed)
    return counts


def same(one: CanonicalPoints, other: CanonicalPoints) -> bool:
    names = ("position_m", "normal", "uvd", "bone_weights", "sigma_m", "joints_m")
    return one.template == other.template and all(torch.equal(getattr(one, n), getattr(other, n)) for n in names)


def test_points_are_placed_once_and_then_the_same(folder, placings):
    first = place_points(load_template(), 50, **NUMBERS)
    assert same(place_points(load_template(), 50, **NUMBERS), first)
    assert placings == [50]
    assert len(list(folder.iterdir())) == 1


def test_whatever_decides_the_points_is_in_the_name(folder, monkeypatch, tmp_path):
    template = load_template()
    moved = replace(template, vertices_m=template.vertices_m * (1 + 1e-12))
    files = [points_file(template, {**NUMBERS, "count": 50}), points_file(moved, {**NUMBERS, "count": 50})]
    files += [points_file(template, {**NUMBERS, "count": 50, name: 0.5}) for name in NUMBERS]
    closed = replace(template, skin_face_count=template.skin_face_count - 1)
    files.append(points_file(closed, {**NUMBERS, "count": 50}))
    for library in (torch, np, scipy):
        monkeypatch.setattr(library, "__version__", "another")
        files.append(points_file(template, {**NUMBERS, "count": 50}))
    monkeypatch.setattr(points_cache, "PACKAGE", tmp_path)
    files.append(points_file(template, {**NUMBERS, "count": 50}))
    assert len(set(files)) == len(files)


@pytest.mark.parametrize("content", [b"", b"nonsense", None])
def test_a_damaged_file_is_as_none_and_is_replaced(folder, placings, content):
    place_points(load_template(), 50, **NUMBERS)
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes()[:-40] if content is None else content)
    second = place_points(load_template(), 50, **NUMBERS)
    assert placings == [50, 50]
    assert same(place_points(load_template(), 50, **NUMBERS), second)
    assert placings == [50, 50]


@pytest.mark.parametrize(
    "change",
    [
        lambda points: {**points, "normal": points["normal"][:-1]},
        lambda points: {**points, "sigma_m": points["sigma_m"].double()},
        lambda points: {**points, "joints_m": points["joints_m"].float()},
        lambda points: {name: array for name, array in points.items() if name != "uvd"},
        lambda points: {**points, "more": points["uvd"].clone()},
    ],
)
def test_a_file_of_other_arrays_is_as_none_and_is_replaced(folder, placings, change):
    place_points(load_template(), 50, **NUMBERS)
    (file,) = folder.iterdir()
    file.write_bytes(safetensors.torch.save(change(safetensors.torch.load(file.read_bytes()))))
    place_points(load_template(), 50, **NUMBERS)
    place_points(load_template(), 50, **NUMBERS)
    assert placings == [50, 50]


def test_the_tree_of_joints_is_in_the_name(folder, monkeypatch, tmp_path):
    monkeypatch.setattr(points_cache, "PACKAGE", tmp_path)
    before = points_file(load_template(), NUMBERS)
    (tmp_path / "hand").mkdir()
    (tmp_path / "hand" / "joints.py").write_text("PARENTS = ()")
    assert points_file(load_template(), NUMBERS) != before


def test_a_folder_that_cannot_be_written_is_no_trouble(folder, placings):
    folder.write_text("a file is in the way")
    place_points(load_template(), 50, **NUMBERS)
    place_points(load_template(), 50, **NUMBERS)
    assert placings == [50, 50]


def test_a_user_without_a_home_can_train(monkeypatch):
    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(points_cache.Path, "home", homeless)
    for name in ("JGHAND_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    assert points_cache.cache_folder().is_absolute()
    monkeypatch.setenv("JGHAND_CACHE_DIR", "elsewhere")
    assert str(points_cache.cache_folder()) == "elsewhere"


def test_the_oldest_files_go(folder, placings, monkeypatch):
    monkeypatch.setattr(points_cache, "POINTS_CACHE_FILES", 2)
    for count in (10, 20, 30):
        place_points(load_template(), count, **NUMBERS)
    assert len(list(folder.iterdir())) == 2
    place_points(load_template(), 30, **NUMBERS)
    assert placings == [10, 20, 30]
