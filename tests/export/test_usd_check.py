"""Broken stages are reported in words that say what is broken. USD's own validators pass most of them."""

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt
from usd_samples import lively_motion, small_avatar

from jghand_engine.errors import InputError
from jghand_engine.export.usd.check import check_usd
from jghand_engine.export.usd.package import export_usd
from jghand_engine.export.usd.stage import SPLAT_TYPE, TYPES
from jghand_engine.hand.joints import Handedness

COUNT = len(small_avatar())
HARMONICS = "radiance:sphericalHarmonicsCoefficients"


@pytest.fixture
def export(tmp_path):
    return export_usd(tmp_path, small_avatar(), lively_motion(Handedness.RIGHT, 3))


def broken_splats(report, name: str, value, time=None) -> list[str]:
    """Findings after one attribute of the splats was overwritten or, with None, removed."""
    stage = Usd.Stage.Open(str(report.stage.parent / "hand.splats.usdc"))
    attr = stage.GetPrimAtPath("/Splats").GetAttribute(name)
    if value is None:
        stage.GetPrimAtPath("/Splats").RemoveProperty(name)
    else:
        attr.Set(value, Usd.TimeCode.Default() if time is None else time)
    stage.Save()
    return sentences(report.stage)


def broken_interface(report, old: str, new: str) -> list[str]:
    text = report.stage.read_text()
    assert old in text
    report.stage.write_text(text.replace(old, new))
    Sdf.Layer.Find(str(report.stage)) and Sdf.Layer.Find(str(report.stage)).Reload()
    return sentences(report.stage)


def sentences(path) -> list[str]:
    return [str(finding) for finding in check_usd(path)]


def floats(array) -> Vt.FloatArray:
    return Vt.FloatArray.FromNumpy(np.ascontiguousarray(array, np.float32))


def vectors(array) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(array, np.float32))


@pytest.mark.parametrize(
    ("name", "value", "time", "wanted"),
    [
        ("scales", vectors(np.full((COUNT, 3), -6.9)), None, "probably logarithms"),
        ("scales", vectors(np.full((7, 3), 0.001)), None, "wanted 805, got 7"),
        ("scales", None, None, "1 unit wide"),
        ("opacities", floats(np.linspace(-4, 4, COUNT)), None, "probably logits"),
        ("opacities", floats([0.5]), None, "wanted 805, got 1"),
        ("opacities", None, None, "everything would be opaque"),
        ("radiance:sphericalHarmonicsDegree", None, None, "falls back to 3"),
        ("radiance:sphericalHarmonicsDegree", 1, None, "wanted 3220, got 805"),
        (HARMONICS, None, None, "everything would be gray"),
        ("orientations", Vt.QuatfArray.FromNumpy(np.zeros((COUNT, 4), np.float32)), None, "not unit quaternions"),
        ("orientations", Vt.QuatfArray(3, Gf.Quatf(1)), None, "orientations: wanted 805, got 3"),
        ("scales", vectors(np.full((COUNT, 3), np.nan)), None, "scales hold NaN"),
        ("scales", vectors(np.linspace(-1, 9, 3 * COUNT).reshape(-1, 3)), None, "not all above 0"),
        ("opacities", floats(np.full(COUNT, np.nan)), None, "opacities hold NaN"),
        ("radiance:sphericalHarmonicsDegree", 7, None, "wanted 0 to 3, got 7"),
        (HARMONICS, vectors(np.random.default_rng(0).uniform(0, 1, (COUNT, 3))), None, "probably colors"),
        (HARMONICS, vectors(np.full((COUNT, 3), np.inf)), None, "harmonics hold NaN"),
        ("colorSpace:name", "srgb_rec709_display", None, "'srgb_rec709_display' is unknown to USD"),
        ("colorSpace:name", None, None, "no color space is declared"),
        ("extent", None, None, "there is no extent at 4 times (first Default time)"),
        ("extent", vectors(np.zeros((2, 3))), 1, "extent at time 1 does not hold the Gaussians"),
        ("extent", vectors([[-0.005, 0, -0.02], [0.1, 0.2, 0.1]]), None, "extent at Default time does not hold"),
        ("extent", vectors(np.zeros((1, 3))), None, "extent at Default time has 1 vectors"),
        ("extent", vectors(np.full((2, 3), np.nan)), 1, "extent at time 1 does not hold the Gaussians"),
        ("positions", None, None, "positions have no Default value"),
        (
            "scales",
            vectors(np.full((COUNT, 3), -6.9)),
            1,
            "scales are not all above 0 at time 1, but from -6.9 to -6.9",
        ),
        ("scales", vectors(np.full((7, 3), 0.001)), 1, "wanted 805, got 7 at time 1"),
        ("opacities", floats(np.linspace(-4, 4, COUNT)), 1, "from -4 to 4: they are probably logits"),
        ("orientations", Vt.QuatfArray.FromNumpy(np.zeros((COUNT, 4), np.float32)), 1, "unit quaternions at time 1"),
        (
            HARMONICS,
            vectors(np.random.default_rng(0).uniform(0, 1, (COUNT, 3))),
            1,
            "from 0 to 1 at time 1: they are probably colors",
        ),
        ("positions", vectors(np.full((COUNT, 3), np.nan)), 2, "NaN or infinity at time 2"),
        ("positions", vectors(np.zeros((3, 3))), 2, "number of positions changes at time 2"),
    ],
)
def test_wrong_splat_data_is_named(export, name, value, time, wanted):
    found = broken_splats(export, name, value, time)
    assert any(wanted in sentence and "[splats] /Hand/Splats" in sentence for sentence in found), found


def test_gaussians_whose_number_changes_in_time_are_a_note_as_long_as_everything_changes_with_it(export):
    stage = Usd.Stage.Open(str(export.stage.parent / "hand.splats.usdc"))
    splats, time = stage.GetPrimAtPath("/Splats"), 1
    for name, value in (
        ("positions", vectors(np.zeros((7, 3)))),
        ("scales", vectors(np.full((7, 3), 0.001))),
        ("opacities", floats(np.ones(7))),
        ("orientations", Vt.QuatfArray(7, Gf.Quatf(1))),
        (HARMONICS, vectors(np.zeros((7, 3)))),
        ("extent", vectors([[-0.01] * 3, [0.01] * 3])),
        ("positions", None),
        ("scales", None),
    ):
        if value is None:  # and back to the first number
            value, time = splats.GetAttribute(name).Get(), 2
        splats.GetAttribute(name).Set(value, time)
    for name in ("opacities", "orientations", HARMONICS):
        splats.GetAttribute(name).Set(splats.GetAttribute(name).Get(), 2)
    splats.GetAttribute("extent").Set(vectors([[-1] * 3, [1] * 3]), 2)
    stage.Save()
    found = [one for one in check_usd(export.stage) if "Splats" in one.site]
    assert [one.is_error for one in found] == [False], found
    assert "the number of positions changes at 2 times (first time 1)" in found[0].sentence
    splats.GetAttribute("opacities").ClearAtTime(1)
    splats.GetAttribute("scales").ClearAtTime(1)
    stage.Save()
    found = [str(one) for one in check_usd(export.stage) if one.is_error]
    assert ["wanted 7, got 805 at time 1; readers drop them all" in one for one in found] == [True, True], found
    for name, kind in (("positions", Vt.Vec3fArray), ("scales", Vt.Vec3fArray), ("opacities", Vt.FloatArray)):
        splats.GetAttribute(name).Set(kind(), 1)
    stage.Save()
    found = [str(one) for one in check_usd(export.stage) if one.is_error]
    assert ["wanted 0" in one for one in found] == [True, True], "of orientations and harmonics, which are 7"


def test_a_lost_skeleton_is_reported(export):
    stage = Usd.Stage.Open(str(export.stage.parent / "hand.rig.usdc"))
    stage.GetPrimAtPath("/Rig/Mesh").GetRelationship("skel:skeleton").SetTargets([])
    stage.Save()
    assert any("the skeleton got lost" in sentence for sentence in sentences(export.stage))


def test_weights_that_do_not_sum_to_one_are_reported(export):
    stage = Usd.Stage.Open(str(export.stage.parent / "hand.rig.usdc"))
    attr = stage.GetPrimAtPath("/Rig/Mesh").GetAttribute("primvars:skel:jointWeights")
    attr.Set(floats(np.asarray(attr.Get()) * 0.9))
    stage.Save()
    assert any("do not sum to 1" in sentence for sentence in sentences(export.stage))


@pytest.mark.parametrize("count", [1, 3])
def test_points_with_an_extent_that_is_no_box_are_reported(export, count):
    stage = Usd.Stage.Open(str(export.stage.parent / "hand.splats.usdc"))
    stage.GetPrimAtPath("/_Points").GetAttribute("extent").Set(vectors(np.zeros((count, 3))), 1)
    stage.Save()
    found = sentences(export.stage)
    assert any(f"has {count} vectors" in sentence and "[points]" in sentence for sentence in found), found


def test_both_of_two_hands_are_looked_at_in_every_variant(tmp_path):
    for side in Handedness:
        export_usd(tmp_path / side, small_avatar(), lively_motion(side, 3))
    two = tmp_path / "two.usda"
    two.write_text(
        """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
    startTimeCode = 0
    endTimeCode = 2
    fallbackPrimTypes = { token[] ParticleField3DGaussianSplat = ["Points"] }
)
def Xform "World" (kind = "assembly")
{
    def "Right" (references = @./right/hand.usda@) {}
    def "Left" (references = @./left/hand.usda@) {}
}
"""
    )
    assert sentences(two) == []
    stage = Usd.Stage.Open(str(tmp_path / "left" / "hand.splats.usdc"))
    stage.GetPrimAtPath("/_Points").GetAttribute("extent").Clear()
    stage.GetPrimAtPath("/Splats").GetAttribute("opacities").Clear()
    stage.Save()
    found = sentences(two)
    assert any(sentence.startswith("[points] /World/Left/Points") for sentence in found), found
    assert any(sentence.startswith("[splats] /World/Left/Splats") for sentence in found), found
    assert not any("/World/Right" in sentence for sentence in found), found


def test_points_without_default_value_are_reported(export):
    stage = Usd.Stage.Open(str(export.stage.parent / "hand.splats.usdc"))
    stage.GetPrimAtPath("/_Points").GetAttribute("points").ClearDefault()
    stage.Save()
    found = sentences(export.stage)
    assert any("no Default value" in sentence and "[points]" in sentence for sentence in found), found


def test_a_missing_fallback_is_reported(export):
    found = broken_interface(export, 'token[] ParticleField3DGaussianSplat = ["Points"]', "")
    assert any("fallbackPrimTypes" in sentence for sentence in found)


def test_a_missing_payload_is_reported(export):
    found = broken_interface(export, "hand.splats.usdc", "gone.usdc")
    assert any("gone.usdc" in sentence for sentence in found), found


def test_missing_units_are_found_by_usd_s_own_validators(export):
    assert any("metersPerUnit" in sentence for sentence in broken_interface(export, "metersPerUnit = 1", ""))


def test_a_file_that_is_no_stage_is_bad_input(tmp_path):
    (tmp_path / "wrong.usda").write_text("hello")
    for name in ("wrong.usda", "absent.usda"):
        with pytest.raises(InputError, match=name):
            check_usd(tmp_path / name)


def lone_splats(path, parent: str = "/World", kind: str = "Xform", **values) -> Usd.Stage:
    """A sound stage of another program's making: five splats in a variant set of its own, under `parent`."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1)
    UsdGeom.SetStageUpAxis(stage, "Y")
    stage.SetMetadata("fallbackPrimTypes", {SPLAT_TYPE: Vt.TokenArray(["Points"])})
    stage.SetDefaultPrim(stage.DefinePrim(parent, kind))
    prim = stage.DefinePrim(f"{parent}/Cloud", SPLAT_TYPE)
    some = np.linspace(-1, 1, 15).reshape(5, 3)
    authored = {
        "positions": (TYPES.Point3fArray, vectors(some)),
        "scales": (TYPES.Float3Array, vectors(np.full((5, 3), 0.1))),
        "opacities": (TYPES.FloatArray, floats(np.full(5, 0.5))),
        "radiance:sphericalHarmonicsDegree": (TYPES.Int, 0),
        HARMONICS: (TYPES.Float3Array, vectors(some)),
        "extent": (TYPES.Float3Array, vectors([[-2, -2, -2], [2, 2, 2]])),
    }
    for name, (type_name, value) in authored.items():
        if values.get(name, True):
            prim.CreateAttribute(name, type_name, False).Set(value)
    if prim.HasAttribute(HARMONICS):
        prim.GetAttribute(HARMONICS).SetMetadata("interpolation", "vertex")
        prim.GetAttribute(HARMONICS).SetMetadata("elementSize", 1)
    Usd.ColorSpaceAPI.Apply(prim).CreateColorSpaceNameAttr("srgb_rec709_scene")
    stage.Save()
    return stage


def test_an_extent_of_bare_centers_is_noted(tmp_path):
    stage = lone_splats(tmp_path / "theirs.usda")
    stage.GetPrimAtPath("/World/Cloud").GetAttribute("extent").Set(vectors([[-1, -1, -1], [1, 1, 1]]))
    stage.Save()
    (found,) = check_usd(tmp_path / "theirs.usda")
    assert "holds the centers, not 3 standard deviations" in found.sentence
    assert not found.is_error


def test_a_sound_stage_of_another_program_has_no_findings(tmp_path):
    lone_splats(tmp_path / "theirs.usda")
    assert sentences(tmp_path / "theirs.usda") == []


def test_splats_below_a_skeleton_root_are_reported(tmp_path):
    lone_splats(tmp_path / "theirs.usda", kind="SkelRoot")
    assert any("below the SkelRoot /World" in sentence for sentence in sentences(tmp_path / "theirs.usda"))


def test_splats_that_want_to_be_skinned_are_reported(tmp_path):
    stage = lone_splats(tmp_path / "theirs.usda")
    prim = stage.GetPrimAtPath("/World/Cloud")
    UsdGeom.PrimvarsAPI(prim).CreatePrimvar("skel:jointWeights", TYPES.FloatArray).Set(floats(np.ones(5)))
    stage.Save()
    assert any("nothing skins splats" in sentence for sentence in sentences(tmp_path / "theirs.usda"))


def test_harmonics_without_their_metadata_are_reported(tmp_path):
    stage = lone_splats(tmp_path / "theirs.usda")
    stage.GetPrimAtPath("/World/Cloud").GetAttribute(HARMONICS).ClearMetadata("elementSize")
    stage.Save()
    assert any("elementSize 1" in sentence for sentence in sentences(tmp_path / "theirs.usda"))


def test_a_file_without_splats_is_not_called_sound(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "ball.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1)
    UsdGeom.SetStageUpAxis(stage, "Y")
    ball = UsdGeom.Sphere.Define(stage, "/World")
    ball.CreateExtentAttr([(-1, -1, -1), (1, 1, 1)])
    stage.SetDefaultPrim(ball.GetPrim())
    stage.Save()
    (found,) = check_usd(tmp_path / "ball.usda")
    assert found.sentence.startswith("there are no Gaussian splats in it")
    assert not found.is_error
