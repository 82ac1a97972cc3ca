"""The exported stage holds what the engine computes, in every variant, for both hands."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdSkel, Vt
from scipy.spatial.transform import Rotation
from small_avatars import trained_avatar
from usd_samples import FPS, engine_gaussians, engine_mesh, lively_motion, small_avatar
from usd_stages import opened

from jghand_engine.avatar.avatar import LearnedFrom
from jghand_engine.avatar.posing import Posing
from jghand_engine.avatar.tiers import Distilled
from jghand_engine.errors import InputError, RetryError
from jghand_engine.export.made_from import made_from
from jghand_engine.export.usd import package
from jghand_engine.export.usd.check import NO_SPLATS, check_usd
from jghand_engine.export.usd.package import UsdOptions, export_usd
from jghand_engine.export.usd.stage import Variant
from jghand_engine.hand.joints import LEVEL_NAMES, Handedness
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.render.camera import Camera
from jghand_engine.template.builtin import load_template, load_template_with_forearm
from jghand_engine.template.mesh import mirrored, skinned

pytestmark = pytest.mark.usefixtures("no_usd_warnings")

FRAMES = 40
HARMONICS = "radiance:sphericalHarmonicsCoefficients"
DEFAULT = Usd.TimeCode.Default()


def some_cameras() -> dict[str, Camera]:
    """One looking at the hand, one with a shifted principal point, unequal focal lengths and a roll."""
    front = Camera.looking_at(
        torch.tensor([0.1, 0.2, 0.6]),
        torch.zeros(3),
        torch.tensor([0.0, 1.0, 0.0]),
        width=512,
        height=334,
        focal_px=700,
    )
    odd = Camera.looking_at(
        torch.tensor([-0.4, -0.1, 0.5]),
        torch.zeros(3),
        torch.tensor([0.4, 1.0, 0.1]),
        width=334,
        height=512,
        focal_px=1,
    )
    return {"front": front, "odd": Camera(334, 512, 610.0, 583.0, 121.5, 300.25, odd.camera_from_world)}


@pytest.fixture(scope="module", params=list(Handedness))
def export(request, tmp_path_factory):
    """(report, avatar, motion) of each hand."""
    avatar, motion = small_avatar(), lively_motion(request.param, FRAMES)
    folder = tmp_path_factory.mktemp(str(request.param))
    return export_usd(folder, avatar, motion, some_cameras()), avatar, motion


def values(report, variant: Variant, path: str, name: str, times=(DEFAULT,)) -> np.ndarray:
    """One attribute at each time, stacked; a prim does not outlive its stage, so numbers are what leaves here."""
    stage = opened(report.stage, variant)
    attr = stage.GetPrimAtPath(path).GetAttribute(name)
    return np.stack([np.array(attr.Get(time)) for time in times])


def skinned_mesh(stage: Usd.Stage, times: list[float]) -> np.ndarray:
    """(F, V, 3) the mesh as UsdSkel moves it."""
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(stage.GetPrimAtPath("/Hand/Rig")), Usd.PrimDefaultPredicate)
    mesh = stage.GetPrimAtPath("/Hand/Rig/Mesh")
    skinning = cache.GetSkinningQuery(mesh)
    skeleton = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/Hand/Rig/Skeleton")))
    result = []
    for time in times:
        points = Vt.Vec3fArray(mesh.GetAttribute("points").Get())
        assert skinning.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(time), points, time)
        result.append(np.array(points))
    return np.stack(result)


def test_nothing_is_found_in_any_variant_or_in_the_shot(export):
    report = export[0]
    assert [str(finding) for path in (report.stage, report.shot) for finding in check_usd(path)] == []


def test_every_layer_alone_is_sound(export):
    report = export[0]
    for layer, found in (("hand.rig.usdc", [NO_SPLATS]), ("hand.splats.usdc", [])):
        assert [str(finding) for finding in check_usd(report.stage.parent / layer)] == found


def test_splats_and_points_are_where_the_engine_puts_them(export):
    report, avatar, motion = export
    truth, _ = engine_gaussians(avatar, motion)
    for variant, path, name in ((Variant.SPLATS, "Splats", "positions"), (Variant.POINTS, "Points", "points")):
        stage = opened(report.stage, variant)
        assert stage.GetPrimAtPath(f"/Hand/{path}").GetAttribute(name).GetTimeSamples() == list(range(FRAMES))
        read = values(report, variant, f"/Hand/{path}", name, range(FRAMES))
        # worst observed 1.2e-7 m, float32 against float64; 1e-6 m is wanted
        assert np.abs(read - truth).max() < 2e-7


def test_mesh_skinned_by_usd_is_the_engine_s(export):
    report, _, motion = export
    lengths = motion.bone_lengths_m / motion.bone_lengths_m.mean(axis=0)
    assert lengths.max() > 1.19
    assert lengths.min() < 0.81
    read = skinned_mesh(opened(report.stage, Variant.MESH), list(range(FRAMES)))
    # worst observed 0.00011 mm; 0.01 mm is wanted
    assert np.abs(read - engine_mesh(motion)).max() < 2e-7


@pytest.mark.parametrize("handedness", list(Handedness))
def test_skin_and_splats_of_a_turned_forearm_are_the_engine_s(tmp_path, handedness):
    avatar, template = small_avatar(), load_template_with_forearm()
    rest_m = np.concatenate([avatar.position_m, template.vertices_m[1609::3]]).astype(np.float32)
    weights = np.concatenate([avatar.bone_weights, template.bone_weights[1609::3]]).astype(np.float32)
    rows = np.arange(len(rest_m)) % len(avatar)
    others = {name: getattr(avatar, name)[rows] for name in ("sigma_m", "opacity", "rgb", "uvd")}
    info = replace(avatar.info, template=template.identifier)
    avatar = replace(avatar, info=info, position_m=rest_m, bone_weights=weights, handedness=handedness, **others)
    turns = Rotation.from_rotvec(np.linspace(-1.2, 1.2, 6)[:, None] * [[0.4, 0.8, 0.9]]).as_quat()[:, [3, 0, 1, 2]]
    motion = replace(lively_motion(handedness, 6), forearm=turns)
    report = export_usd(tmp_path, avatar, motion)
    skin, skeleton = mirrored(template) if handedness is Handedness.LEFT else template, avatar.skeleton()
    map_weights = avatar.map_weights(template.vertices_m, template.bone_weights)
    truth = [skinned(template.vertices_m, map_weights, skeleton, one.joints_m, one.forearm) for one in motion.poses]
    read = skinned_mesh(opened(report.stage, Variant.MESH), list(range(6)))
    assert read.shape[1] == len(skin.vertices_m)
    # worst observed 1.2e-7
    assert np.abs(read - truth).max() < 3e-7
    written = values(report, Variant.SPLATS, "/Hand/Splats", "positions", range(6))
    posed = [Posing(avatar, threads=1)(one.joints_m, one.forearm).position_m for one in motion.poses]
    assert np.abs(written - posed).max() < 1e-6
    straight = made_from(avatar, replace(motion, forearm=None))
    assert made_from(avatar, motion).items() > straight.items()


@pytest.mark.parametrize(("scale_mode", "swing"), [("uniform", "minimal"), (0.3, "minimal"), ("axial", "euler")])
def test_mesh_is_exact_in_every_convention(tmp_path, scale_mode, swing):
    motion = lively_motion(Handedness.RIGHT, 12)
    report = export_usd(tmp_path, small_avatar(scale_mode, swing), motion, some_cameras())
    read = skinned_mesh(opened(report.stage, Variant.MESH), list(range(12)))
    truth = engine_mesh(motion, scale_mode, swing)
    assert np.abs(read - truth).max() < 2e-7
    assert np.abs(truth - engine_mesh(motion)).max() > 1e-4, "the convention makes no difference"


def test_bones_without_length_and_folded_back_are_as_exact(tmp_path):
    joints = lively_motion(Handedness.LEFT, 6).joints_m.copy()
    joints[1, 7], joints[2, 16], joints[3, 12] = joints[1, 2], joints[2, 11], joints[3, 2]
    joints[4, 1:6] = joints[4, :1]
    motion = PoseSequence(joints, FPS, Handedness.LEFT)
    report = export_usd(tmp_path, small_avatar(), motion)
    read = skinned_mesh(opened(report.stage, Variant.MESH), list(range(6)))
    assert np.abs(read - engine_mesh(motion)).max() < 2e-7
    assert check_usd(report.stage) == []


def test_a_hand_far_from_the_origin_keeps_what_float32_can_hold(tmp_path):
    joints = lively_motion(Handedness.RIGHT, 6).joints_m + 10.0
    motion = PoseSequence(joints, FPS, Handedness.RIGHT)
    report = export_usd(tmp_path, small_avatar(), motion)
    read = skinned_mesh(opened(report.stage, Variant.MESH), list(range(6)))
    # steps of float32 at 10 m are 1e-6 m; worst observed 3.5e-6 m, 1e-5 m is wanted
    assert np.abs(read - engine_mesh(motion)).max() < 4.5e-6


def test_mesh_between_two_samples_lies_between_them(export):
    """The twins overdraw their scale, but the sum is linear in time: nothing jumps between samples."""
    stage = opened(export[0].stage, Variant.MESH)
    times = list(np.linspace(7, 8, 9))
    steps = np.linalg.norm(np.diff(skinned_mesh(stage, times), axis=0), axis=-1)
    whole = np.linalg.norm(np.diff(skinned_mesh(stage, [7, 8]), axis=0), axis=-1)
    assert steps.max() < 2 * whole.max() / 8


def test_control_joints_are_on_the_joints_and_carry_no_scale(export):
    report, _, motion = export
    stage = opened(report.stage, Variant.MESH)
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(stage.GetPrimAtPath("/Hand/Rig")), Usd.PrimDefaultPredicate)
    skeleton = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/Hand/Rig/Skeleton")))
    order = [token.split("/")[-1] for token in skeleton.GetJointOrder()]
    places = [order.index(name) for name in LEVEL_NAMES]
    for frame in range(FRAMES):
        world = np.stack([np.array(matrix) for matrix in skeleton.ComputeJointSkelTransforms(frame)])[places]
        # worst observed 6e-8 m
        assert np.abs(world[:, 3, :3] - motion.joints_m[frame]).max() < 1e-7
        # a rotation and nothing else: worst observed 6e-7
        assert np.abs(world[:, :3, :3] @ world[:, :3, :3].swapaxes(1, 2) - np.eye(3)).max() < 2e-6
        assert (np.linalg.det(world[:, :3, :3]) > 0).all()


def test_control_joints_point_along_the_bone_that_starts_there(export):
    report, _, motion = export
    animation = values(report, Variant.MESH, "/Hand/Rig/Skeleton/Anim", "translations", range(FRAMES))
    stage = opened(report.stage, Variant.MESH)
    tokens = list(stage.GetPrimAtPath("/Hand/Rig/Skeleton").GetAttribute("joints").Get())
    names = [token.split("/")[-1] for token in tokens]
    for bone in range(6, 21):
        offset = animation[:, names.index(LEVEL_NAMES[bone])]
        # worst observed 2e-8 m
        assert np.abs(offset[:, [0, 2]]).max() < 1e-7
        assert np.abs(offset[:, 1] - motion.bone_lengths_m[:, bone - 1]).max() < 1e-7


def test_no_scale_is_negative(export):
    assert (values(export[0], Variant.MESH, "/Hand/Rig/Skeleton/Anim", "scales", range(FRAMES)) > 0).all()


def test_rest_pose_is_the_default_and_the_bind_pose(export):
    stage = opened(export[0].stage, Variant.MESH)
    rest = skinned_mesh(stage, [Usd.TimeCode.Default()])[0]
    assert np.abs(rest - np.asarray(stage.GetPrimAtPath("/Hand/Rig/Mesh").GetAttribute("points").Get())).max() < 1e-7


def test_mesh_keeps_faces_and_texture_coordinates_of_its_hand(export):
    report, _, motion = export
    template = load_template() if motion.handedness is Handedness.RIGHT else mirrored(load_template())
    assert (values(report, Variant.MESH, "/Hand/Rig/Mesh", "faceVertexIndices")[0] == template.faces.ravel()).all()
    stage = opened(report.stage, Variant.MESH)
    uv = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Hand/Rig/Mesh")).GetPrimvar("st").ComputeFlattened()
    assert np.abs(np.array(uv) - template.face_uv.reshape(-1, 2)).max() < 1e-7
    points, normals = (values(report, Variant.MESH, "/Hand/Rig/Mesh", name)[0] for name in ("points", "normals"))
    corners = points[template.faces]
    outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((normals[template.faces[:, 0]] * outwards).sum(-1) > 0).mean() > 0.99
    # signed volume: a mirrored hand must not be inside out
    assert (corners[:, 0] * outwards).sum() / 6 > 2e-4


def test_bounds_hold_every_gaussian_on_every_frame(export):
    report = export[0]
    stage = opened(report.stage, Variant.SPLATS)
    splats = stage.GetPrimAtPath("/Hand/Splats")
    for frame in range(FRAMES):
        names = ("positions", "extent", "scales")
        positions, extent, scales = (np.asarray(splats.GetAttribute(name).Get(frame)) for name in names)
        radius = 3 * scales
        assert np.allclose(extent, [(positions - radius).min(axis=0), (positions + radius).max(axis=0)], atol=1e-7)


@pytest.mark.parametrize("variant", list(Variant))
def test_world_bound_is_not_empty(export, variant):
    stage = opened(export[0].stage, variant)
    cache = UsdGeom.BBoxCache(5, [UsdGeom.Tokens.default_, UsdGeom.Tokens.render])
    size = cache.ComputeWorldBound(stage.GetDefaultPrim()).ComputeAlignedRange().GetSize()
    assert all(0.03 < edge < 0.5 for edge in size)


def test_cameras_project_as_the_engine_s(export):
    report = export[0]
    stage = Usd.Stage.Open(str(report.shot))
    points = np.random.default_rng(3).uniform(-0.1, 0.1, (50, 3))
    for name, camera in some_cameras().items():
        frustum = UsdGeom.Camera(stage.GetPrimAtPath(f"/World/Cameras/{name}")).GetCamera(0).frustum
        clip_from_world = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
        seen = np.array([clip_from_world.Transform(Gf.Vec3d(*point)) for point in points])
        pixels = (seen[:, :2] * [0.5, -0.5] + 0.5) * [camera.width, camera.height]
        truth, _ = camera.project(points)
        # worst observed 3e-5 px, from float32 apertures; 1e-3 px is wanted
        assert np.abs(pixels - truth).max() < 1e-4


@pytest.mark.parametrize(("distance_m", "scale"), [(0.25, 1.0), (0.6, 1.0), (60.0, 1.0), (0.6, 0.4)])
def test_cameras_clip_nothing_of_the_hand(tmp_path, distance_m, scale):
    motion = lively_motion(Handedness.RIGHT, 6)
    motion = PoseSequence((motion.joints_m - motion.joints_m[:, :1]) * scale, FPS, Handedness.RIGHT)
    eye = torch.tensor([0.0, 0.0, distance_m])
    camera = Camera.looking_at(eye, torch.zeros(3), torch.tensor([0.0, 1.0, 0.0]), width=64, height=64, focal_px=99)
    avatar = small_avatar()
    report = export_usd(tmp_path, avatar, motion, [camera])
    stage = Usd.Stage.Open(str(report.shot))
    near, far = UsdGeom.Camera(stage.GetPrimAtPath("/World/Cameras/cam0")).GetClippingRangeAttr().Get()
    _, depth_m = camera.project(engine_gaussians(avatar, motion)[0])
    assert near <= max(float(depth_m.min()), 0.01)
    assert far >= float(depth_m.max())
    # a depth buffer of 24 bits then tells tenths of a millimeter apart
    assert far / near < 2000


def test_colors_are_display_referred_in_the_splats_and_linear_for_display(export):
    report, avatar, _ = export
    stage = opened(report.stage, Variant.SPLATS)
    splats = stage.GetPrimAtPath("/Hand/Splats")
    harmonics = np.asarray(splats.GetAttribute(HARMONICS).Get())
    assert np.abs(0.5 + 0.28209479177387814 * harmonics - avatar.rgb).max() < 1e-6
    assert splats.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == 0
    assert Usd.ColorSpaceAPI(splats).GetColorSpaceNameAttr().Get() == "srgb_rec709_scene"
    display = UsdGeom.PrimvarsAPI(splats).GetPrimvar("displayColor")
    assert display.GetAttr().GetColorSpace() == "lin_rec709_scene"
    srgb = avatar.rgb
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    assert np.abs(np.asarray(display.Get()) - linear).max() < 1e-6


def test_linear_radiance_is_light_and_says_so(tmp_path):
    avatar = small_avatar()
    motion = lively_motion(Handedness.RIGHT, 2)
    srgb = export_usd(tmp_path / "s", avatar, motion)
    light = export_usd(tmp_path / "l", avatar, motion, [], UsdOptions(radiance="linear"))
    before, after = (
        0.5 + 0.28209479177387814 * values(report, Variant.SPLATS, "/Hand/Splats", HARMONICS)
        for report in (srgb, light)
    )
    curved = before > 0.04045
    assert np.allclose(after[curved], ((before[curved] + 0.055) / 1.055) ** 2.4, atol=1e-5)
    stage = opened(light.stage, Variant.SPLATS)
    space = Usd.ColorSpaceAPI(stage.GetPrimAtPath("/Hand/Splats")).GetColorSpaceNameAttr().Get()
    assert space == "lin_rec709_scene"
    before, after = Usd.Stage.Open(str(srgb.stage)), Usd.Stage.Open(str(light.stage))
    states = [stage.GetDefaultPrim().GetCustomDataByKey("jghand:imageState") for stage in (before, after)]
    assert states == ["display-referred sRGB", "linear light"]
    assert check_usd(light.stage) == []


def test_radii_of_a_hand_that_changes_its_size_are_the_engine_s_in_every_frame(export):
    report, avatar, motion = export
    _, truth = engine_gaussians(avatar, motion)
    written = values(report, Variant.SPLATS, "/Hand/Splats", "scales", range(FRAMES))
    # worst observed 8e-7
    assert np.abs(written / truth[..., None] - 1).max() < 2e-6
    assert report.sigma_error == 0


def test_radii_of_a_hand_that_keeps_its_size_are_constant_and_report_their_error(tmp_path):
    avatar, motion = small_avatar(), lively_motion(Handedness.RIGHT, FRAMES, length_change=0.0)
    report = export_usd(tmp_path, avatar, motion)
    _, truth = engine_gaussians(avatar, motion)
    constant = values(report, Variant.SPLATS, "/Hand/Splats", "scales")[0, :, 0]
    stage = opened(report.stage, Variant.SPLATS)
    assert stage.GetPrimAtPath("/Hand/Splats").GetAttribute("scales").GetNumTimeSamples() == 0
    assert report.sigma_error == pytest.approx(np.abs(constant / truth - 1).max(), rel=1e-4)


def test_a_point_is_two_standard_deviations_wide_times_the_factor(export, tmp_path):
    _, avatar, motion = export
    _, sigma_m = engine_gaussians(avatar, motion)
    for factor in (1.0, 1.5):
        report = export_usd(tmp_path / str(factor), avatar, motion, [], UsdOptions(width_factor=factor))
        widths = values(report, Variant.POINTS, "/Hand/Points", "widths", range(FRAMES))
        assert np.abs(widths / (2 * factor * sigma_m) - 1).max() < 2e-6


def test_time_is_that_of_the_motion(export):
    stage = Usd.Stage.Open(str(export[0].shot))
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == FPS
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, FRAMES - 1)


def test_positions_are_stored_once_for_splats_and_points(tmp_path):
    """Crate keeps equal arrays once per file: a further frame costs 12 bytes per Gaussian and a little."""
    avatar = small_avatar()
    short, long = (
        export_usd(tmp_path / str(n), avatar, lively_motion(Handedness.RIGHT, n, length_change=0.0)).bytes[
            "hand.splats.usdc"
        ]
        for n in (30, 60)
    )
    # worst observed 1.015
    assert (long - short) / 30 < 1.05 * 12 * len(avatar)


def test_a_reader_that_cannot_choose_gets_the_default_variant(tmp_path):
    for variant in Variant:
        report = export_usd(
            tmp_path / variant,
            small_avatar(),
            lively_motion(Handedness.RIGHT, 2),
            [],
            UsdOptions(default_variant=variant),
        )
        stage = Usd.Stage.Open(str(report.stage))
        assert stage.GetDefaultPrim().GetVariantSet("representation").GetVariantSelection() == variant


def test_files_carry_the_chosen_name_and_others_stay(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    report = export_usd(
        tmp_path, small_avatar(), lively_motion(Handedness.RIGHT, 2), [], UsdOptions(name="wave")
    )  # fmt: skip
    names = {"wave.usda", "wave.rig.usdc", "wave.splats.usdc", "wave.skinned.usdc", "wave.shot.usda"}
    assert set(report.bytes) == names
    assert {path.name for path in tmp_path.iterdir()} == {*names, "notes.txt"}
    assert check_usd(tmp_path / "wave.shot.usda") == []


def test_an_earlier_export_is_replaced_where_that_is_asked_for(tmp_path):
    export_usd(tmp_path, small_avatar(), lively_motion(Handedness.RIGHT, 5))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    shorter = lively_motion(Handedness.RIGHT, 3)
    with pytest.raises(InputError, match=r"hand\.rig\.usdc.*--overwrite"):
        export_usd(tmp_path, small_avatar(), shorter)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    report = export_usd(tmp_path, small_avatar(), shorter, options=UsdOptions(overwrite=True))
    assert Usd.Stage.Open(str(report.stage)).GetEndTimeCode() == 2


def test_missing_joints_are_refused_with_a_remedy(tmp_path):
    joints = lively_motion(Handedness.RIGHT, 4).joints_m.copy()
    joints[2, 7] = np.nan
    with pytest.raises(InputError, match="hold the last whole pose"):
        export_usd(tmp_path, small_avatar(), PoseSequence(joints, FPS, Handedness.RIGHT))
    assert list(tmp_path.iterdir()) == []


def test_another_template_than_the_avatar_s_is_refused(tmp_path):
    avatar = small_avatar()
    other = type(avatar)(**{**vars(avatar), "canonical_joints_m": avatar.canonical_joints_m * 1.1})
    with pytest.raises(InputError, match="template"):
        export_usd(tmp_path, other, lively_motion(Handedness.RIGHT, 2))


@pytest.mark.parametrize("wrong", [{"name": "a/b"}, {"width_factor": 0.0}])
def test_wrong_options_are_named(wrong):
    with pytest.raises(InputError, match=str(next(iter(wrong.values())))):
        UsdOptions(**wrong)


def test_a_camera_name_that_usd_refuses_is_named(tmp_path):
    with pytest.raises(InputError, match="2nd"):
        export_usd(tmp_path, small_avatar(), lively_motion(Handedness.RIGHT, 2), {"2nd": some_cameras()["front"]})


def test_a_disk_that_fills_up_leaves_the_earlier_export_as_it_was(tmp_path, monkeypatch):
    report = export_usd(tmp_path, small_avatar(), lively_motion(Handedness.RIGHT, 3))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def full(*_):
        raise Tf.ErrorException("Failed writing usdc data: 'Error occurred writing file: No space left on device'")

    monkeypatch.setattr(package.SplatLayer, "put", full)
    with pytest.raises(RetryError, match="disk is full"):
        export_usd(tmp_path, small_avatar(), lively_motion(Handedness.LEFT, 5), options=UsdOptions(overwrite=True))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert check_usd(report.stage) == []


def test_an_interrupted_export_leaves_nothing(tmp_path):
    def stop(done, _):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_usd(tmp_path, small_avatar(), lively_motion(Handedness.RIGHT, 5), progress=stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("variant", list(Variant))
def test_frames_may_begin_anywhere_and_z_may_point_up(tmp_path, variant):
    """Numbers and axes of another program's world are written down; the joints stay as they are."""
    motion = lively_motion(Handedness.RIGHT, 3)
    options = UsdOptions(default_variant=variant, first_frame=-7, up="z")
    report = export_usd(tmp_path, small_avatar(), motion, options=options)
    assert check_usd(report.stage) == []
    for path in (report.stage, report.shot):
        stage = Usd.Stage.Open(str(path))
        assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (-7, -5)
        assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    centers, _ = engine_gaussians(small_avatar(), motion)
    written = values(report, Variant.SPLATS, "/Hand/Splats", "positions", (-7, -6, -5))
    assert np.abs(written - centers).max() <= 1e-6
    stage = opened(report.stage, Variant.SPLATS)
    animation = stage.GetPrimAtPath("/Hand/Rig/Skeleton/Anim")
    assert animation.GetAttribute("rotations").GetTimeSamples() == [-7, -6, -5]


def test_a_stage_says_what_it_was_made_from(tmp_path):
    avatar, motion = small_avatar(), lively_motion(Handedness.RIGHT, 2)
    stage = Usd.Stage.Open(str(export_usd(tmp_path, avatar, motion).stage))
    stamp = stage.GetRootLayer().customLayerData["jghand"]
    assert stamp.items() >= made_from(avatar, motion).items()
    moved = replace(motion, joints_m=motion.joints_m + 1e-6)
    brighter = replace(avatar, rgb=avatar.rgb * 0.999)
    assert made_from(avatar, moved)["joints_sha256"] != stamp["joints_sha256"]
    assert made_from(brighter, motion)["avatar_sha256"] != stamp["avatar_sha256"]


def test_all_that_is_learned_is_in_the_digest_and_names_and_prices_are_not():
    motion, avatar = lively_motion(Handedness.RIGHT, 2), trained_avatar(20)
    learned = avatar.learned
    assert learned is not None
    others = [
        replace(learned, light=replace(learned.light, irradiance=3 * learned.light.irradiance)),
        replace(learned, correctives=None),
        replace(learned, shine=learned.shine + 0.1),
        replace(learned, world_offsets=not learned.world_offsets),
        None,
    ]
    digests = [_avatar_digest(one, motion) for one in (avatar, *(replace(avatar, learned=other) for other in others))]
    assert len(set(digests)) == 1 + len(others)
    assert _avatar_digest(trained_avatar(20), motion) == digests[0]
    renamed = replace(
        avatar, info=replace(avatar.info, name="another"), learned=replace(learned, distilled=Distilled(None, (), "x"))
    )
    assert _avatar_digest(renamed, motion) == digests[0]


def _avatar_digest(avatar, motion) -> str:
    return made_from(avatar, motion)["avatar_sha256"]


def test_every_layer_says_whose_it_is_and_under_which_license(tmp_path):
    avatar = small_avatar()
    learned_from = LearnedFrom("somebody", "every fifth", 12, "abc")
    avatar = replace(avatar, info=replace(avatar.info, license="CC-BY-4.0", learned_from=learned_from))
    report = export_usd(tmp_path, avatar, lively_motion(Handedness.RIGHT, 2))
    for name in report.bytes:
        about = Sdf.Layer.FindOrOpen(str(tmp_path / name)).customLayerData
        assert about["creator"].startswith("JGHand "), name
        wanted = {"licence": "CC-BY-4.0", "avatar": "test", "learnt_from": "somebody", "learned_from_pictures": 12}
        assert wanted.items() <= about["jghand"].items(), name
    stage = Usd.Stage.Open(str(report.shot))
    hand = stage.GetPrimAtPath("/World/Hand")
    assert hand.GetCustomDataByKey("jghand:licence") == "CC-BY-4.0"
    assert Usd.ModelAPI(hand).GetAssetName() == "test"
    assert Usd.ModelAPI(hand).GetAssetIdentifier().path == "./hand.usda"
    kinds = [Usd.ModelAPI(prim).GetKind() for prim in (stage.GetDefaultPrim(), hand)]
    assert kinds == ["assembly", "component"]
