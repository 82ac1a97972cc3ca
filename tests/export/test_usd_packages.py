"""Other ways to write the same stage: one file. They hold what the layers hold."""

import io
import struct
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from detail_samples import detail_of
from PIL import Image
from pxr import Ar, Usd, UsdShade
from usd_samples import lively_motion, small_avatar
from usd_stages import opened

from jghand_engine.avatar.detail import ratio_bytes
from jghand_engine.avatar.relief import HEIGHT_STEP_M, Relief
from jghand_engine.avatar.relighting import material_of
from jghand_engine.color import linear_to_srgb
from jghand_engine.errors import InputError
from jghand_engine.export.usd import package
from jghand_engine.export.usd.check import NO_SPLATS, check_usd
from jghand_engine.export.usd.package import UsdOptions, export_usd
from jghand_engine.export.usd.stage import Variant
from jghand_engine.hand.joints import Handedness

pytestmark = pytest.mark.usefixtures("no_usd_warnings")

FRAMES = 30
MOTION = lively_motion(Handedness.RIGHT, FRAMES)


def exported(folder, motion=MOTION, **options):
    return export_usd(folder, small_avatar(), motion, options=UsdOptions(**options))


# ---- one file --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", list(Variant))
def test_one_file_holds_the_chosen_variant_as_the_layers_do(tmp_path, variant):
    layers, single = (
        exported(tmp_path / package, package=package, default_variant=variant) for package in ("layers", "usdc")
    )
    assert set(single.bytes) == {"hand.usdc"}
    assert single.stage == tmp_path / "usdc" / "hand.usdc"
    assert single.shot is None
    assert [path.name for path in (tmp_path / "usdc").iterdir()] == ["hand.usdc"]
    found = [str(finding) for finding in check_usd(single.stage)]
    assert found == ([] if variant is Variant.SPLATS else [NO_SPLATS])
    one, many = opened(single.stage), opened(layers.stage, variant)
    assert "ParticleField3DGaussianSplat" in one.GetMetadata("fallbackPrimTypes")
    assert one.GetRootLayer().customLayerData == many.GetRootLayer().customLayerData
    assert len(one.GetUsedLayers()) == 2, "the file and the session's"
    about, wanted = (stage.GetDefaultPrim().GetAssetInfo() for stage in (one, many))
    assert about.pop("identifier").path == "./hand.usdc"
    assert wanted.pop("identifier").path == "./hand.usda"
    assert about == wanted
    assert str(tmp_path) not in one.GetRootLayer().ExportToString(), "no path of the writer's disk"
    assert {str(p.GetPath()) for p in one.Traverse()} == {str(p.GetPath()) for p in many.Traverse()}
    for prim in many.Traverse():
        for attr in prim.GetAuthoredAttributes():
            other = one.GetAttributeAtPath(attr.GetPath())
            assert other.GetTimeSamples() == attr.GetTimeSamples(), attr.GetPath()
            for time in (Usd.TimeCode.Default(), 3.0, 7.5):
                assert other.Get(time) == attr.Get(time), attr.GetPath()


def test_an_archive_holds_all_variants(tmp_path):
    layers, archive = (exported(tmp_path / str(package), package=package) for package in ("layers", "usdz"))
    assert check_usd(archive.stage) == []
    with zipfile.ZipFile(archive.stage) as opened_archive:
        assert opened_archive.namelist()[0] == "hand.usda"
    for variant, path, name in (("splats", "Splats", "positions"), ("points", "Points", "points")):
        one, many = (opened(report.stage, variant) for report in (archive, layers))
        for time in (Usd.TimeCode.Default(), 11.0):
            read = [stage.GetPrimAtPath(f"/Hand/{path}").GetAttribute(name).Get(time) for stage in (one, many)]
            assert read[0] == read[1]


def test_files_in_an_archive_are_stored_at_multiples_of_64_bytes(tmp_path):
    archive = exported(tmp_path, package="usdz").stage
    content = archive.read_bytes()
    with zipfile.ZipFile(archive) as opened_archive:
        assert opened_archive.testzip() is None
        for entry in opened_archive.infolist():
            assert entry.compress_type == zipfile.ZIP_STORED
            name, extra = struct.unpack_from("<HH", content, entry.header_offset + 26)
            begin = entry.header_offset + 30 + name + extra
            assert begin % 64 == 0
            assert content[begin : begin + entry.file_size] == opened_archive.read(entry)


def test_an_archive_that_a_zip_cannot_hold_is_refused_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(package, "USDZ_BYTES_MAX", 3_000_000)
    with pytest.raises(InputError, match="fewer frames"):
        exported(tmp_path, lively_motion(Handedness.RIGHT, 200), package="usdz")
    assert list(tmp_path.iterdir()) == []
    exported(tmp_path, package="usdz")


def test_one_file_leaves_layers_of_the_same_name_alone(tmp_path):
    layers = exported(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    exported(tmp_path, package="usdz")
    exported(tmp_path, package="usdz", overwrite=True)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.suffix != ".usdz"} == before
    assert check_usd(layers.stage) == []


# ---- a hand with detail ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", package.PACKAGES)
def test_the_mesh_of_a_hand_with_detail_shows_it_by_its_uv(tmp_path, kind):
    """The ratio of half in a column of texels is in the picture that the mesh's material reads, and nowhere else; and
    skin that rises along the rows leans up the texture in another."""
    texture = np.full((64, 64, 3), 128, np.uint8)
    texture[:, 16:32] = ratio_bytes(np.full(3, np.log(0.5)))
    avatar, motion = small_avatar(), lively_motion(Handedness.LEFT, 3)
    rises = np.broadcast_to((np.arange(64) - 32).astype(np.int8)[:, None, None], (64, 64, 2)).copy()
    detail = replace(detail_of(texture), relief=Relief(rises))
    avatar = replace(avatar, rgb=np.full_like(avatar.rgb, 0.4), detail=detail)
    report = export_usd(tmp_path, avatar, motion, options=UsdOptions(package=kind, default_variant=Variant.MESH))
    assert set(report.bytes) >= ({"hand.usdz"} if kind == "usdz" else {"hand.skin.png", "hand.normal.png"})
    found = [str(finding) for path in (report.stage, report.shot) if path for finding in check_usd(path)]
    assert found == ([NO_SPLATS] if kind == "usdc" else [])
    stage = opened(report.stage, Variant.MESH)
    material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/Hand/Rig/Mesh")).ComputeBoundMaterial()
    surface = material.ComputeSurfaceSource()[0]
    image, shader = picture_of(surface, "diffuseColor")
    assert shader.GetInput("file").Get().path == "./hand.skin.png"
    columns = image.shape[1] // 64
    dark, plain = image[:, 17 * columns : 31 * columns], image[:, 33 * columns :]
    wanted = 255 * linear_to_srgb(material_of(avatar).albedo[0])
    assert np.abs(plain - wanted).max() <= 1
    assert np.abs(dark - 0.5 * wanted).max() <= 1
    normals, shader = picture_of(surface, "normal")
    read = {name: shader.GetInput(name).Get() for name in ("sourceColorSpace", "scale", "bias")}
    assert read == {"sourceColorSpace": "raw", "scale": (2, 2, 2, 1), "bias": (-1, -1, -1, 0)}
    inner = (normals[24:40, 24:40][detail.skin[24:40, 24:40]] / 255 * 2 - 1).mean(0)
    steep = HEIGHT_STEP_M * detail.density_per_m[1]
    # a byte has no middle: 128 for 0 is 0.004
    assert inner == pytest.approx(np.array([0, steep, 1]) / np.hypot(1, steep), abs=0.01)


def picture_of(surface: UsdShade.Shader, name: str) -> tuple[np.ndarray, UsdShade.Shader]:
    """(H, W, 3) bytes that an input of a material is read from by its UV, and the shader that reads them."""
    shader = UsdShade.Shader(surface.GetInput(name).GetConnectedSources()[0][0].source)
    assert shader.GetShaderId() == "UsdUVTexture"
    coordinates = UsdShade.Shader(shader.GetInput("st").GetConnectedSources()[0][0].source)
    assert coordinates.GetInput("varname").Get() == "st"
    path = shader.GetInput("file").Get().resolvedPath
    content = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(path))
    with content:
        return np.asarray(Image.open(io.BytesIO(bytes(content.GetBuffer()))), float), shader


# ---- long takes ------------------------------------------------------------------------------------------------------


MEMORY = """
import resource, sys, tempfile
sys.path.insert(0, {folder!r})
from usd_samples import lively_motion
from jghand_engine.avatar.builtin import load_painted
from jghand_engine.export.usd.package import UsdOptions, export_usd
from jghand_engine.hand.joints import Handedness

avatar = load_painted(handedness=Handedness.RIGHT).prefix(10_000)

def peak(frames):
    with tempfile.TemporaryDirectory() as folder:
        export_usd(folder, avatar, lively_motion(Handedness.RIGHT, frames), options=UsdOptions(package={package!r}))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

peak(48)
before = peak(48)
print(peak(300) - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads the peak of memory as Linux tells it")
# a .usdz is packed of layers
@pytest.mark.parametrize("package", ["usdc", "usdz"])
def test_a_long_take_is_never_in_memory_at_once(package):
    """300 frames of 10,000 Gaussians are 36 MB of positions. Seen 1.5 MB more than for 48 frames."""
    script = MEMORY.format(folder=str(Path(__file__).parent), package=package)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=300)
    assert float(done.stdout) < 15
