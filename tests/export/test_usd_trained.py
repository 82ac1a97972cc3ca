"""Trained avatars in USD: offsets in the positions, the light of every frame in the colors, no gloss."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from pxr import Usd, UsdGeom
from small_avatars import ellipsoid_avatar, trained_avatar
from usd_samples import lively_motion, small_avatar
from usd_stages import opened

from jghand_engine.color import srgb_to_linear
from jghand_engine.export.splats.cloud import SH_C0
from jghand_engine.export.usd import package
from jghand_engine.export.usd.check import check_usd
from jghand_engine.export.usd.package import UsdOptions, export_usd
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.template.builtin import load_template

pytestmark = pytest.mark.usefixtures("no_usd_warnings")

FRAMES = 4


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
        harmonics = np.array(splats.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get(index))
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
    harmonics = np.array(splats.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get())
    assert np.abs(0.5 + SH_C0 * harmonics - posed[0].rgb.clamp(0, 1).numpy()).max() < 1e-5


def test_the_stage_says_what_is_in_it_and_what_is_not(export):
    hand, _, _stage = prim(export[0], "splats")
    about = {key: hand.GetCustomDataByKey(f"jghand:{key}") for key in ("offsets", "colors", "gloss")}
    assert "positions" in about["offsets"]
    assert "per frame" in about["colors"]
    assert "left out" in about["gloss"]


SMALL = small_avatar()
ELLIPSOIDS, TRAINED = (
    replace(one, info=replace(one.info, template=load_template().identifier))
    for one in (ellipsoid_avatar(300), trained_avatar(400))
)


@pytest.mark.parametrize("options", [{}, {"sizes": "per_frame"}, {"precision": "half"}], ids=str)
@pytest.mark.parametrize("avatar", [SMALL, TRAINED, ELLIPSOIDS], ids=["painted", "trained", "ellipsoids"])
def test_the_room_that_is_asked_for_is_rather_more_than_is_taken(tmp_path, monkeypatch, avatar, options):
    asked, taken = [], []
    monkeypatch.setattr(package, "check_room", lambda _folder, needed, _what: asked.append(needed))
    for frames in (12, 24):
        motion = lively_motion(Handedness.RIGHT, frames)
        report = export_usd(tmp_path / str(frames), avatar, motion, options=UsdOptions(**options))
        taken.append(sum(report.bytes.values()))
    assert asked[1] >= taken[1]
    # seen 1.01 to 1.35: of small hands the bones count
    assert 1 <= (asked[1] - asked[0]) / (taken[1] - taken[0]) < 1.5
