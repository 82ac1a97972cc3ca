"""USD files that are damaged, of another kind, or lie are refused by name, not by an error of the library."""

from __future__ import annotations

import struct
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from jghand_engine.errors import InputError
from jghand_engine.export.usd.check import check_usd
from jghand_engine.export.usd.export import UsdOptions, export_usd
from jghand_engine.export.usd.options import Package, Variant
from jghand_engine.hand.joints import Handedness
from jghand_engine.motion.files import MotionFormat
from jghand_engine.motion.foreign.read import read_motion_file
from jghand_engine.motion.usd_files import check_depth

sys.path.insert(0, str(Path(__file__).parents[1] / "exporters"))
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
    options = UsdOptions(package=Package.USDC, default_variant=Variant.MESH)
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
    assert ".usdc" in refused(path)


def test_an_archive_without_a_stage_or_with_compressed_ones_is_refused(tmp_path, crate):
    path = tmp_path / "hand.usdz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("notes.txt", "mine")
    assert "notes.txt" in refused(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(crate, "hand.usdc")
    assert "compressed" in refused(path)


def test_an_archive_that_wants_a_newer_unpacker_is_refused(tmp_path, crate):
    path = tmp_path / "hand.usdz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(crate, "hand.usdc")
    content = bytearray(path.read_bytes())
    struct.pack_into("<H", content, content.rfind(b"PK\x01\x02") + 6, 255)
    path.write_bytes(content)
    assert "25.5" in refused(path)


NESTED = {
    "prims": ('def "a"\n{\n' * 300 + "}\n" * 300),
    "dictionaries": ("(\n customLayerData = {" + "dictionary a = {" * 300 + "}" * 300 + "}\n)\n"),
    "prims behind a string": ('(\n doc = """ " \\""" { """\n)\n' + 'def "a"\n{\n' * 300 + "}\n" * 300),
    "prims behind a comment": ('# """\n/* " */ // \' {\n' + 'def "a"\n{\n' * 300 + "}\n" * 300),
}


def packed(path: Path, *files: Path) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for file in files:
            archive.write(file, file.name)
    return path


def layer(path: Path, content: str) -> Path:
    path.write_text(f"#usda 1.0\n{content}\n")
    return path


def below(folder: Path, deep: Path) -> Path:
    layer(folder / "between.usda", f"(\n subLayers = [@./{deep.name}@]\n)")
    return layer(folder / "hand.usda", 'def "a" (payload = @./between.usda@) {}')


def in_a_package_below(folder: Path, deep: Path) -> Path:
    packed(folder / "all.usdz", layer(folder / "sound.usda", ""), deep)
    return layer(folder / "hand.usda", f'def "a" (payload = @./all.usdz[{deep.name}]@) {{}}')


def outside_of_a_package(folder: Path, deep: Path) -> Path:
    inner = layer(folder / "inner.usda", f'def "a" (payload = @{deep}@) {{}}')
    return packed(folder / "all.usdz", layer(folder / "sound.usda", 'def "a" (payload = @./inner.usda@) {}'), inner)


def as_the_file_s_own_header_says(folder: Path, deep: Path) -> Path:
    """USD goes by the headers before the files; the directory says that the text begins behind them."""
    path = packed(folder / "hand.usdz", layer(folder / "sound.usda", ""), deep)
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, content.rfind(b"PK\x01\x02") + 42, 0)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("kind", NESTED)
@pytest.mark.parametrize(
    "place",
    [
        lambda _folder, deep: deep,
        below,
        lambda folder, deep: packed(folder / "hand.usdz", deep),
        in_a_package_below,
        outside_of_a_package,
        as_the_file_s_own_header_says,
    ],
    ids=["itself", "below", "in a package", "in a package below", "outside of a package", "by its own header"],
)
def test_text_that_is_deeper_than_usd_survives_is_refused_before_usd_reads_it(tmp_path, kind, place):
    """200,000 prims within each other end the process, 20,000 take half a gigabyte."""
    path = place(tmp_path, layer(tmp_path / "deep.usda", NESTED[kind]))
    with pytest.raises(InputError, match=r"at most 200 brackets open at once"):
        check_usd(path)
    with pytest.raises(InputError, match=r"at most 200 brackets open at once"):
        read_motion_file(path, MotionFormat(handedness=Handedness.RIGHT))


def test_ways_to_a_file_that_cannot_be_followed_beforehand_are_refused(tmp_path):
    deep = layer(tmp_path / "deep.usda", NESTED["prims"])
    words = layer(tmp_path / "words.usda", 'def "a" (payload = @./deep.usda:SDF_FORMAT_ARGS:x=y@) {}')
    with pytest.raises(InputError, match="SDF_FORMAT_ARGS"):
        check_usd(words)
    packed(tmp_path / "inner.usdz", deep)
    nested = packed(tmp_path / "outer.usdz", layer(tmp_path / "sound.usda", ""), tmp_path / "inner.usdz")
    with pytest.raises(InputError, match=r"a \.usdz within it"):
        check_usd(nested)
    layer(
        tmp_path / "between.usda",
        """(\n expressionVariables = { string N = "sound" }\n)\ndef "a" (payload = @`"./${N}.usda"`@) {}""",
    )
    variable = layer(
        tmp_path / "variable.usda",
        """(\n expressionVariables = { string N = "deep" }\n)\ndef "a" (payload = @./between.usda@</a>) {}""",
    )
    with pytest.raises(InputError, match="expressionVariables"):
        check_usd(variable)


def test_a_package_below_whose_files_are_compressed_is_refused_without_unpacking_it(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.usdz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb.usda", "#usda 1.0\n#" + " " * 50_000_000)
    path = layer(tmp_path / "hand.usda", 'def "a" (payload = @./bomb.usdz@) {}')
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="compressed"):
            check_usd(path)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_a_layer_below_that_may_not_be_read_is_named(tmp_path, monkeypatch):
    path = below(tmp_path, layer(tmp_path / "secret.usda", ""))
    opens = Path.open

    def refusing(self, *words, **named):
        if self.name == "secret.usda":
            raise PermissionError(13, "Permission denied")
        return opens(self, *words, **named)

    monkeypatch.setattr(Path, "open", refusing)
    with pytest.raises(InputError, match=r"cannot read .*secret\.usda"):
        check_usd(path)


def test_a_damaged_package_below_is_named(tmp_path):
    (tmp_path / "bad.usdz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(InputError, match=r"bad\.usdz.*which is a zip"):
        check_usd(layer(tmp_path / "hand.usda", 'def "a" (payload = @./bad.usdz@) {}'))


def test_brackets_in_words_and_beside_each_other_are_not_deep(tmp_path):
    path = tmp_path / "hand.usda"
    words = '''doc = """ { { \\""" { " """\n customLayerData = { string a = "{{\\"{{"\n asset b = @{{{"@\n }'''
    path.write_text(f"#usda 1.0\n(\n {words}\n)\n# {'{' * 300}\n" + 'def "a"\n{\n def "b" {}\n}\n' + "/* {{ */\n")
    check_usd(path)
    check_depth("".join(f'def "a{i}" {{ float3 b = (1, 2, 3) }}' for i in range(300)).encode(), "this")
    with pytest.raises(InputError, match="200 brackets"):
        check_depth(b'"{" @"{@ \'}\' # }\n' + b"{" * 201, "this")


def test_text_that_is_no_stage_is_refused(tmp_path):
    path = tmp_path / "hand.usda"
    path.write_text('#usda 1.0\n(\n    defaultPrim = "World"\n)\ndef Xform "World"\n{\n    float3 x = (1, 2\n')
    refused(path)
