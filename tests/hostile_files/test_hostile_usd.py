"""USD files that are damaged, of another kind, or lie are refused by name, not by an error of the library."""

from __future__ import annotations

import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from jghand_engine.errors import InputError
from jghand_engine.export.usd.check import check_usd
from jghand_engine.export.usd.package import UsdOptions, export_usd
from jghand_engine.export.usd.stage import Variant
from jghand_engine.hand.joints import Handedness

sys.path.insert(0, str(Path(__file__).parents[1] / "export"))
from usd_samples import lively_motion, small_avatar


@pytest.fixture(scope="module")
def crate(tmp_path_factory) -> Path:
    from pxr import Usd, UsdGeom

    path = tmp_path_factory.mktemp("usd") / "sound.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1)
    UsdGeom.SetStageUpAxis(stage, "Y")
    points = UsdGeom.Points.Define(stage, "/Points")
    points.CreatePointsAttr([(index, 0.5 * index, 1) for index in range(500)])
    points.CreateWidthsAttr([0.1 + 0.001 * index for index in range(500)])
    points.CreateExtentAttr([(-1, -1, -1), (600, 300, 2)])
    stage.SetDefaultPrim(points.GetPrim())
    stage.Save()
    return path


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        check_usd(path)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_the_file_that_is_damaged_below_is_sound(crate):
    assert not any(finding.is_error for finding in check_usd(crate))


@pytest.mark.parametrize("kept", [0, 7, 20, 60, 500, 0.5, 0.9, 0.999])
def test_a_file_that_was_cut_off_is_refused(tmp_path, crate, kept):
    content = crate.read_bytes()
    path = tmp_path / "cut.usdc"
    path.write_bytes(content[: int(kept * len(content)) if kept < 1 else kept])
    refused(path)


@pytest.mark.parametrize("offset", [-1, 0, 2**40, 2**63 - 1])
def test_a_table_of_contents_that_is_not_in_the_file_is_refused(tmp_path, crate, offset):
    content = bytearray(crate.read_bytes())
    struct.pack_into("<q", content, 16, offset)
    path = tmp_path / "lying.usdc"
    path.write_bytes(content)
    refused(path)


@pytest.fixture(scope="module")
def mesh(tmp_path_factory) -> bytes:
    """A skinned hand in one file: what is lied about in it shows when values are read, not when it is opened."""
    options = UsdOptions(package="usdc", default_variant=Variant.MESH)
    folder = tmp_path_factory.mktemp("mesh")
    return export_usd(folder, small_avatar(), lively_motion(Handedness.RIGHT, 2), options=options).stage.read_bytes()


def test_lies_about_lengths_are_refused_or_told(tmp_path, mesh):
    """Of 64 files in which eight bytes are another number, each is sound, found wrong, or refused by name."""
    refusals = {}
    for number, offset in enumerate(np.random.default_rng(0).integers(88, 4000, 64)):
        content = bytearray(mesh)
        struct.pack_into("<Q", content, int(offset), (2**31 - 1, 2**40, 2**63 - 1, 2**64 - 1)[number % 4])
        path = tmp_path / f"lying{number}.usdc"
        path.write_bytes(content)
        try:
            check_usd(path)
        except InputError as error:
            refusals[path.name] = str(error)
    assert all(name in sentence for name, sentence in refusals.items()), refusals
    assert any("damaged" in sentence for sentence in refusals.values()), refusals


@pytest.mark.parametrize("name", ["hand.usd", "hand.usda", "hand.usdc", "hand.usdz"])
def test_a_file_of_another_kind_is_refused(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"ply\nformat binary_little_endian 1.0\n" * 3)
    refused(path)


def test_a_file_with_another_suffix_is_refused(tmp_path, crate):
    path = tmp_path / "hand.ply"
    path.write_bytes(crate.read_bytes())
    refused(path)


def test_an_archive_without_a_stage_or_with_compressed_ones_is_refused(tmp_path, crate):
    path = tmp_path / "hand.usdz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("notes.txt", "mine")
    refused(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(crate, "hand.usdc")
    refused(path)


def layer(path: Path, content: str) -> Path:
    path.write_text(f"#usda 1.0\n{content}\n")
    return path


def test_a_damaged_layer_below_is_named(tmp_path):
    layer(tmp_path / "below.usda", "def (((")
    path = layer(tmp_path / "hand.usda", 'def "a" (payload = @./below.usda@) {}')
    assert "below.usda" in refused(path)


def test_text_that_is_no_stage_is_refused(tmp_path):
    path = tmp_path / "hand.usda"
    path.write_text('#usda 1.0\n(\n    defaultPrim = "World"\n)\ndef Xform "World"\n{\n    float3 x = (1, 2\n')
    refused(path)
