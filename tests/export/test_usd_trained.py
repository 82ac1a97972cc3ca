"""Trained avatars in USD: offsets in the positions, the light of every frame in the colors, no gloss."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pxr import Usd, UsdGeom, UsdShade
from small_avatars import known_avatar, trained_avatar
from usd_samples import lively_motion, small_avatar
from usd_stages import opened

from jghand_engine.avatar.learned import no_light
from jghand_engine.avatar.relighting import MEAN_ALBEDO, material_of
from jghand_engine.color import srgb_to_linear
from jghand_engine.export.splats.cloud import SH_C0
from jghand_engine.export.usd.check import check_usd
from jghand_engine.export.usd.package import UsdOptions, export_usd
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.template.builtin import load_template

pytestmark = pytest.mark.usefixtures("no_usd_warnings")

FRAMES = 4
HARMONICS = "radiance:sphericalHarmonicsCoefficients"


@pytest.fixture(scope="module", params=[Handedness.RIGHT, Handedness.LEFT])
def export(request, tmp_path_factory):
    avatar = trained_avatar(400)
    avatar = replace(avatar, info=replace(avatar.info, template=load_template().identifier))
    motion = lively_motion(request.param, FRAMES)
    report = export_usd(tmp_path_factory.mktemp("usd"), avatar, motion)
    transform = JointTransform(avatar.canonical_joints_m, handedness=request.param)
    posed = []
    for joints_m in motion.joints_m:
        bones = transform.bones(torch.tensor(joints_m))
        posed.append(pose_gaussians(avatar, bones, frames=bones.frames))
    return report, posed


def prim(report, variant: str) -> tuple[Usd.Prim, Usd.Prim, Usd.Stage]:
    """The hand, what a variant shows, and the stage, which must outlive both."""
    stage = opened(report.stage, variant)
    return stage.GetDefaultPrim(), stage.GetPrimAtPath(f"/Hand/{variant.capitalize()}"), stage


def test_nothing_is_wrong_with_the_stage(export):
    assert check_usd(export[0].stage) == []


def test_splats_are_where_the_engine_puts_them_in_the_light_of_every_frame(export):
    report, posed = export
    _, splats, _stage = prim(report, "splats")
    for index, gaussians in enumerate(posed):
        positions = np.array(splats.GetAttribute("positions").Get(index))
        assert np.abs(positions - gaussians.position_m.numpy()).max() < 1e-6
        harmonics = np.array(splats.GetAttribute(HARMONICS).Get(index))
        assert np.abs(0.5 + SH_C0 * harmonics - gaussians.rgb.clamp(0, 1).numpy()).max() < 1e-5
    assert float((posed[0].rgb.clamp(0, 1) - posed[2].rgb.clamp(0, 1)).abs().max()) > 0.1


def test_points_and_display_colors_follow(export):
    report, posed = export
    for variant in ("splats", "points"):
        _, shown, _stage = prim(report, variant)
        color = UsdGeom.PrimvarsAPI(shown).GetPrimvar("displayColor")
        assert len(color.GetTimeSamples()) == FRAMES
        for index, gaussians in enumerate(posed):
            wanted = srgb_to_linear(gaussians.rgb.clamp(0, 1).numpy())
            assert np.abs(np.array(color.Get(index)) - wanted).max() < 1e-5


def test_a_reader_without_time_sees_the_first_frame_s_colors(export):
    report, posed = export
    _, splats, _stage = prim(report, "splats")
    harmonics = np.array(splats.GetAttribute(HARMONICS).Get())
    assert np.abs(0.5 + SH_C0 * harmonics - posed[0].rgb.clamp(0, 1).numpy()).max() < 1e-5


def test_the_stage_says_what_is_in_it_and_what_is_not(export):
    hand, _, _stage = prim(export[0], "splats")
    about = {key: hand.GetCustomDataByKey(f"jghand:{key}") for key in ("offsets", "colors", "gloss")}
    assert "positions" in about["offsets"]
    assert "per frame" in about["colors"]
    assert "left out" in about["gloss"]


SMALL = small_avatar()
TRAINED, KNOWN = (
    replace(one, info=replace(one.info, template=load_template().identifier))
    for one in (trained_avatar(400), known_avatar(400))
)


def numbers(prim: Usd.Prim) -> dict[str, np.ndarray]:
    """What a prim has for the material Look."""
    api = UsdGeom.PrimvarsAPI(prim)
    return {name: np.array(api.GetPrimvar(name).Get()) for name in ("displayColor", "roughness", "ior")}


@pytest.mark.parametrize(("avatar", "kind"), [(KNOWN, "known"), (TRAINED, "estimated")], ids=["known", "estimated"])
def test_the_mesh_has_the_albedo_of_the_skin_around_each_vertex_and_no_light(tmp_path, avatar, kind):
    motion, material = lively_motion(Handedness.LEFT, 1), material_of(avatar)
    stage = opened(export_usd(tmp_path, avatar, motion).stage, "mesh")
    mesh = stage.GetPrimAtPath("/Hand/Rig/Mesh")
    found, points_m = numbers(mesh), np.array(mesh.GetAttribute("points").Get())
    for vertex in range(0, len(points_m), 97):
        away_m = np.linalg.norm(avatar.position_m * [-1, 1, 1] - points_m[vertex], axis=1)
        near = np.argsort(away_m)[:8]
        assert np.abs(found["displayColor"][vertex] - material.albedo[near].mean(0)).max() < 1e-5
        assert found["roughness"][vertex] == pytest.approx(material.roughness[near].mean(), abs=1e-5)
        # Fresnel at right angles
        reflected = np.square((found["ior"][vertex] - 1) / (found["ior"][vertex] + 1))
        assert reflected == pytest.approx(material.reflectance[near].mean(), rel=1e-4)
    assert stage.GetDefaultPrim().GetCustomDataByKey("jghand:material") == kind


def test_an_estimated_albedo_has_the_mean_of_skin_whatever_light_the_hand_was_learned_in():
    assert TRAINED.learned is not None
    bright = replace(TRAINED, rgb=0.5 + 0.2 * TRAINED.rgb)
    dark = replace(bright, rgb=0.4 * bright.rgb, learned=replace(TRAINED.learned, light=no_light()))
    weight = TRAINED.opacity * np.square(TRAINED.sigma_m)
    for avatar in (bright, dark):
        assert np.average(material_of(avatar).albedo, axis=0, weights=weight) == pytest.approx(MEAN_ALBEDO, rel=1e-3)


@pytest.mark.parametrize("avatar", [KNOWN, TRAINED, SMALL], ids=["known", "estimated", "painted"])
def test_splats_and_points_carry_albedo_for_the_light_of_others_where_that_is_asked_for(tmp_path, avatar):
    motion, material = lively_motion(Handedness.RIGHT, 2), material_of(avatar)
    stage = export_usd(tmp_path, avatar, motion, options=UsdOptions(radiance="albedo")).stage
    assert check_usd(stage) == []
    for variant, path in (("splats", "Splats"), ("points", "Points"), ("points_skinned", "Rig/Points")):
        shown = opened(stage, variant)
        prim = shown.GetPrimAtPath(f"/Hand/{path}")
        found = numbers(prim)
        assert np.abs(found["displayColor"] - material.albedo).max() < 1e-5
        assert np.abs(found["roughness"] - material.roughness).max() < 1e-6
        assert UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor").GetTimeSamples() == []
        bound, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        assert bool(bound) == (variant != "splats")
    shown = opened(stage)
    harmonics = np.array(shown.GetPrimAtPath("/Hand/Splats").GetAttribute(HARMONICS).Get(1))
    assert np.abs(0.5 + SH_C0 * harmonics - material.albedo).max() < 1e-5
    assert shown.GetDefaultPrim().GetCustomDataByKey("jghand:imageState") == "linear albedo"
