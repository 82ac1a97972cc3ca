"""Points that follow the skeleton: all of them as a variant, and a tenth that stands in for the splats."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pxr import Usd, UsdGeom, UsdSkel, Vt
from usd_samples import engine_gaussians, lively_motion, small_avatar
from usd_stages import opened

from jghand_engine.export.usd.check import check_usd
from jghand_engine.export.usd.package import UsdOptions, export_usd
from jghand_engine.export.usd.rig import PROXY_STEP, SKIN_BONES, skin_influences
from jghand_engine.export.usd.stage import Variant
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.baselines import transform_of

pytestmark = pytest.mark.usefixtures("no_usd_warnings")

FRAMES = 12


@pytest.fixture(scope="module", params=list(Handedness))
def export(request, tmp_path_factory):
    """(report, avatar, motion) of each hand."""
    avatar, motion = small_avatar(), lively_motion(request.param, FRAMES)
    return export_usd(tmp_path_factory.mktemp(str(request.param)), avatar, motion), avatar, motion


def skinned(stage: Usd.Stage, path: str) -> np.ndarray:
    """(F, N, 3) the points as UsdSkel moves them."""
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(stage.GetPrimAtPath("/Hand/Rig")), Usd.PrimDefaultPredicate)
    prim = stage.GetPrimAtPath(path)
    query = cache.GetSkinningQuery(prim)
    skeleton = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/Hand/Rig/Skeleton")))
    result = []
    for time in range(FRAMES):
        points = Vt.Vec3fArray(prim.GetAttribute("points").Get())
        assert query.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(time), points, time)
        result.append(np.array(points))
    return np.stack(result)


def test_points_follow_the_skeleton_as_the_engine_skins_them(export):
    report, avatar, motion = export
    assert int((avatar.bone_weights > 0).sum(1).max()) <= SKIN_BONES, "nothing is dropped of these weights"
    truth, _ = engine_gaussians(avatar, motion)
    # worst observed 0.014 mm: half precision of the joints' scales
    assert np.abs(skinned(opened(report.stage, Variant.POINTS_SKINNED), "/Hand/Rig/Points") - truth).max() < 2e-5


def test_the_stand_in_is_every_tenth_gaussian_and_covers_as_much(export):
    report, avatar, motion = export
    stage = opened(report.stage, Variant.SPLATS)
    truth, _ = engine_gaussians(avatar, motion)
    assert np.abs(skinned(stage, "/Hand/Rig/Proxy") - truth[:, ::PROXY_STEP]).max() < 2e-5
    proxy = UsdGeom.Points(stage.GetPrimAtPath("/Hand/Rig/Proxy"))
    assert list(proxy.GetIdsAttr().Get()) == list(range(0, len(avatar), PROXY_STEP))
    area = (np.array(proxy.GetWidthsAttr().Get()) ** 2).sum()
    whole = (2 * avatar.sigma_m * scale_of(avatar, motion)) ** 2
    # a sum over other Gaussians: seen 4 % apart
    assert area == pytest.approx(whole.sum(), rel=0.08)


def scale_of(avatar, motion) -> float:
    transform = transform_of(avatar.for_hand(motion.handedness))
    return float(transform.bones(torch.tensor(motion.joints_m)).scale.mean())


def test_the_stand_in_and_the_splats_never_show_together(export):
    stage = opened(export[0].stage, Variant.SPLATS)
    splats, proxy = (stage.GetPrimAtPath(f"/Hand/{path}") for path in ("Splats", "Rig/Proxy"))
    assert UsdGeom.Imageable(splats).ComputePurpose() == "render"
    assert UsdGeom.Imageable(proxy).ComputePurpose() == "proxy"
    assert splats.GetRelationship("proxyPrim").GetTargets() == [proxy.GetPath()]
    drawn, _ = UsdGeom.Imageable(splats).ComputeProxyPrim() or (None, None)
    assert drawn == proxy


def test_the_stand_in_is_there_without_the_payload(export):
    stage = Usd.Stage.Open(str(export[0].stage), Usd.Stage.LoadNone)
    assert not stage.GetPrimAtPath("/Hand/Splats").HasAttribute("positions")
    assert stage.GetPrimAtPath("/Hand/Rig/Proxy").GetAttribute("points").Get()


@pytest.mark.parametrize("variant", list(Variant))
def test_a_variant_shows_one_thing(export, variant):
    """The template's mesh is a guide in all but its own variant, and of the clouds there is one."""
    stage = opened(export[0].stage, variant)
    drawn = {
        str(prim.GetPath())
        for prim in stage.Traverse()
        if prim.IsA(UsdGeom.Gprim) and UsdGeom.Imageable(prim).ComputePurpose() in ("default", "render")
    }
    wanted = {"splats": "Splats", "points": "Points", "points_skinned": "Rig/Points", "mesh": "Rig/Mesh"}[variant]
    assert drawn == {f"/Hand/{wanted}"}


def test_many_bones_become_the_heaviest_that_are_kept(tmp_path):
    weights = torch.softmax(4 * torch.randn(805, 21, generator=torch.Generator().manual_seed(0)), 1)
    avatar = replace(small_avatar(), bone_weights=weights.numpy())
    report = export_usd(tmp_path, avatar, lively_motion(Handedness.RIGHT, 2), options=UsdOptions(width_factor=2.0))
    assert check_usd(report.stage) == []
    stage = opened(report.stage, Variant.POINTS_SKINNED)
    points = stage.GetPrimAtPath("/Hand/Rig/Points")
    shares = np.array(UsdSkel.BindingAPI(points).GetJointWeightsPrimvar().Get()).reshape(805, -1)
    assert np.abs(shares.sum(1) - 1).max() < 1e-6
    heaviest = np.sort(weights.numpy(), axis=1)[:, : -SKIN_BONES - 1 : -1]
    assert np.allclose(shares, heaviest / heaviest.sum(1, keepdims=True), atol=1e-6)


def test_influences_that_are_not_too_many_keep_their_bits():
    weights = np.zeros((3, 21))
    weights[:, 2:5] = [0.5, 0.3, 0.2]
    _, shares = skin_influences(weights, most=4, fine=False)
    assert np.array_equal(shares, weights[:, 2:5])
