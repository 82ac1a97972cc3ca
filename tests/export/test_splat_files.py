"""Splat files of every format hold what the engine has, by readers written from the formats' descriptions."""

import gzip
import json
import struct
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from small_avatars import known_avatar, trained_avatar
from usd_samples import engine_gaussians, lively_motion, small_avatar

from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.color import srgb_to_linear
from jghand_engine.errors import InputError
from jghand_engine.export.light_file import ENV_FROM_WORLD
from jghand_engine.export.splats.cloud import SH_C0, SplatCloud
from jghand_engine.export.splats.files import SplatMotion, SplatOptions, export_splats
from jghand_engine.export.splats.gltf import EXTENSION, glb_bytes
from jghand_engine.export.splats.ply import ply_bytes, splat_bytes
from jghand_engine.export.splats.spz import fractional_bits, spz_bytes
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.native.scene_light_task import LampKind

HALF_BYTE = 0.5 / 255 + 1e-6


def some_cloud(axes: str, count: int = 500) -> SplatCloud:
    """Ellipsoids in all directions; the first has no rotation, the second half a turn about each axis in a row."""
    rng = np.random.default_rng(3)
    turns = Rotation.from_quat(rng.normal(size=(count, 4))).as_quat(scalar_first=True)
    turns[:4] = np.eye(4)
    return SplatCloud(
        rng.uniform(-0.3, 0.3, (count, 3)),
        rng.uniform(0.0002, 0.004, (count, 3)),
        turns,
        np.concatenate([[0.0, 1.0], rng.uniform(0, 1, count - 2)]),
        np.concatenate([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]], rng.uniform(0, 1, (count - 2, 3))]),
        axes,
    )


def apart_deg(found_wxyz: np.ndarray, wanted_wxyz: np.ndarray) -> float:
    """The largest angle between rotations, degrees."""
    found = Rotation.from_quat(found_wxyz, scalar_first=True)
    return float(np.degrees((found.inv() * Rotation.from_quat(wanted_wxyz, scalar_first=True)).magnitude()).max())


def test_a_splat_file_holds_32_bytes_for_each_gaussian():
    cloud = some_cloud("rdf")
    rows = np.frombuffer(splat_bytes(cloud), np.uint8).reshape(len(cloud), 32)
    numbers = rows[:, :24].copy().view("<f4")
    assert np.array_equal(numbers[:, :3], cloud.positions_m.astype(np.float32))
    assert np.array_equal(numbers[:, 3:], cloud.scales_m.astype(np.float32))
    assert np.abs(rows[:, 24:27] / 255 - cloud.rgb).max() <= HALF_BYTE
    assert np.abs(rows[:, 27] / 255 - cloud.opacity).max() <= HALF_BYTE
    # seen 0.73 degrees: steps of 1/128 in each component
    assert apart_deg((rows[:, 28:32].astype(float) - 128) / 128, cloud.rotations_wxyz) < 0.75


def glb_parts(content: bytes) -> tuple[dict, bytes]:
    magic, version, total, text_bytes, text_kind = struct.unpack_from("<IIIII", content)
    assert (magic, version, total, text_kind) == (0x46546C67, 2, len(content), 0x4E4F534A)
    assert text_bytes % 4 == 0
    binary_bytes, binary_kind = struct.unpack_from("<II", content, 20 + text_bytes)
    assert (binary_kind, 28 + text_bytes + binary_bytes) == (0x004E4942, total)
    return json.loads(content[20 : 20 + text_bytes]), content[28 + text_bytes :]


def test_a_glb_file_holds_linear_sizes_and_quaternions_with_w_last():
    cloud = some_cloud("rub")
    about, binary = glb_parts(glb_bytes(cloud))
    assert about["extensionsUsed"] == [EXTENSION]
    (primitive,) = about["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert primitive["extensions"][EXTENSION]["kernel"] == "ellipse"
    assert primitive["extensions"][EXTENSION]["colorSpace"] == "srgb_rec709_display"

    def values(name: str) -> np.ndarray:
        accessor = about["accessors"][primitive["attributes"][name]]
        view = about["bufferViews"][accessor["bufferView"]]
        dtype = {5126: "<f4", 5121: "u1"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        assert view["byteOffset"] % 4 == 0
        data = np.frombuffer(binary, dtype, accessor["count"] * width, view["byteOffset"]).reshape(-1, width)
        assert data.nbytes == view["byteLength"]
        if "min" in accessor:
            assert (data.min(0).tolist(), data.max(0).tolist()) == (accessor["min"], accessor["max"])
        return data

    assert "min" in about["accessors"][primitive["attributes"]["POSITION"]]
    assert np.array_equal(values("POSITION"), cloud.positions_m.astype(np.float32))
    assert np.array_equal(values(f"{EXTENSION}:SCALE"), cloud.scales_m.astype(np.float32))
    assert np.array_equal(values(f"{EXTENSION}:ROTATION")[:, [3, 0, 1, 2]], cloud.rotations_wxyz.astype(np.float32))
    assert np.array_equal(values(f"{EXTENSION}:OPACITY")[:, 0], cloud.opacity.astype(np.float32))
    harmonics = values(f"{EXTENSION}:SH_DEGREE_0_COEF_0").astype(np.float64)
    assert np.abs(harmonics * SH_C0 + 0.5 - cloud.rgb).max() < 1e-7
    light = values("COLOR_0") / 255
    assert np.abs(light[:, :3] - srgb_to_linear(cloud.rgb)).max() <= HALF_BYTE


def spz_quaternions(packed: np.ndarray) -> np.ndarray:
    """w, x, y, z from the 32 bits of SPZ 3, one at a time, as the format's own library unpacks them."""
    result = []
    for number in packed.tolist():
        largest, values = number >> 30, [0.0] * 4
        for place in (3, 2, 1, 0):
            if place != largest:
                size = (number & 511) / 511 / np.sqrt(2)
                values[place] = -size if number >> 9 & 1 else size
                number >>= 10
        values[largest] = np.sqrt(1 - sum(value**2 for value in values))
        result.append([values[3], *values[:3]])
    return np.array(result)


def test_an_spz_file_holds_positions_finer_than_a_hundredth_of_a_millimeter():
    cloud = some_cloud("rub")
    content = gzip.decompress(spz_bytes(cloud))
    magic, version, count, degree, bits, flags, zero = struct.unpack_from("<IIIBBBB", content)
    assert (magic, version, count, degree, flags, zero) == (0x5053474E, 3, len(cloud), 0, 0, 0)
    parts, start = [], 16
    for width in (9, 1, 3, 3, 4):
        parts.append(np.frombuffer(content, np.uint8, count * width, start).reshape(count, width))
        start += count * width
    assert start == len(content)
    positions, alphas, colors, sizes, turns = parts
    whole = np.pad(positions.reshape(-1, 3, 3), ((0, 0), (0, 0), (1, 0))).copy().view("<i4")[..., 0] >> 8
    assert np.abs(whole / 2**bits - cloud.positions_m).max() <= 2.0**-19
    assert np.abs(alphas[:, 0] / 255 - cloud.opacity).max() <= HALF_BYTE
    assert np.abs((colors / 255 - 0.5) / 0.15 * SH_C0 + 0.5 - cloud.rgb).max() <= HALF_BYTE * SH_C0 / 0.15
    assert np.abs(sizes / 16 - 10 - np.log(cloud.scales_m)).max() <= 1 / 32 + 1e-9
    # seen 0.184 degrees: 9 bits for each of three components
    assert apart_deg(spz_quaternions(turns.copy().view("<u4")[:, 0]), cloud.rotations_wxyz) < 0.19


@pytest.mark.parametrize(("farthest_m", "bits"), [(0.0, 18), (0.3, 18), (31.9, 18), (32.0, 17), (1000.0, 13), (1e6, 3)])
def test_spz_keeps_as_many_bits_as_the_farthest_gaussian_leaves(farthest_m, bits):
    assert fractional_bits(np.array([[0.0, -farthest_m, 0.0]])) == bits
    assert round(farthest_m * 2**bits) < 2**23


def test_a_trained_hand_has_the_colors_of_every_frame(tmp_path):
    avatar, motion = trained_avatar(), lively_motion(Handedness.RIGHT, 2)
    clouds = SplatMotion(avatar, motion, axes="rub")
    for index, joints_m in enumerate(motion.joints_m):
        bones = transform_of(avatar).bones(torch.tensor(joints_m))
        rgb = pose_gaussians(avatar, bones, frames=bones.frames).rgb.clamp(0, 1).numpy()
        # worst observed 3e-6: the export poses in float32
        assert np.abs(clouds.cloud(index).rgb - rgb).max() < 5e-6
    assert np.abs(clouds.cloud(1).rgb - clouds.cloud(0).rgb).max() > 0.01


def test_files_say_whose_light_their_colors_show_and_paint_has_none(tmp_path):
    motion, light = lively_motion(Handedness.LEFT, 1), SceneLight(World(np.full((4, 8, 3), 0.3)))
    for avatar, carried in ((trained_avatar(), "capture"), (known_avatar(), "studio"), (small_avatar(), "none")):
        own, lit = (SplatMotion(avatar, motion, axes="rub", light=given).cloud(0) for given in (None, light))
        for cloud, said in ((own, carried), (lit, "none" if carried == "none" else "scene")):
            assert f" light={said}\n".encode() in ply_bytes(cloud)
            assert f'"extras":{{"light":"{said}"}}'.encode() in glb_bytes(cloud)
        assert np.array_equal(own.rgb, lit.rgb) == (carried == "none")


def test_a_light_that_is_told_falls_on_the_splats(tmp_path):
    avatar, motion = known_avatar(), lively_motion(Handedness.RIGHT, 1)
    rgb = {}
    for side in (-1, 1):
        for strength in (0.5, 1):
            lamp = Lamp(LampKind.SUN, (strength,) * 3, (side, 0, 0), angle_rad=0.1)
            clouds = SplatMotion(avatar, motion, axes="rub", light=SceneLight(None, (lamp,)))
            rgb[side, strength] = srgb_to_linear(clouds.cloud(0).rgb.astype(np.float64))
        assert np.abs(2 * rgb[side, 0.5] - rgb[side, 1]).max() < 1e-5
    # no Gaussian faces both but by its rounded corner
    assert (np.minimum(rgb[-1, 1], rgb[1, 1]) < 0.1).all()
    assert (rgb[-1, 1] > 0.05).any()
    assert (rgb[1, 1] > 0.05).any()


@pytest.mark.parametrize("avatar", [trained_avatar(), known_avatar()], ids=["own", "known"])
def test_light_comes_from_above_whichever_axis_points_up(avatar):
    motion = lively_motion(Handedness.RIGHT, 2)
    # x, y, z of a world with z up, as Blender has it
    z_up = replace(motion, joints_m=motion.joints_m[..., [0, 2, 1]] * [1, -1, 1])
    sky = World(np.linspace(1, 0, 16)[:, None, None].repeat(32, 1).repeat(3, 2), ENV_FROM_WORLD)
    for light in (None, SceneLight(sky)):
        one, other = (
            SplatMotion(avatar, moved, axes="rub", up=up, light=light).cloud(1)
            for moved, up in ((motion, "y"), (z_up, "z"))
        )
        assert np.abs(one.rgb - other.rgb).max() < 1e-5
        assert np.abs(one.positions_m - other.positions_m).max() < 1e-7


@pytest.mark.parametrize("format", ["splat", "glb", "spz"])
def test_a_motion_becomes_numbered_files_in_the_axes_of_the_format(tmp_path, format):
    avatar, motion = small_avatar(), lively_motion(Handedness.LEFT, 2)
    report = export_splats(tmp_path, avatar, motion, SplatOptions("left", format, first_frame=41))
    assert [path.name for path in report.files] == [f"left.0041.{format}", f"left.0042.{format}"]
    assert report.axes == ("rdf" if format == "splat" else "rub")
    if format == "splat":
        written = np.frombuffer(report.files[1].read_bytes(), "<f4").reshape(-1, 8)[:, :3]
        centers, _ = engine_gaussians(avatar, motion)
        # worst observed: the steps of float32 at 0.5 m
        assert np.abs(written * [1, -1, -1] - centers[1]).max() <= 1e-7


def test_gltf_is_not_written_in_axes_that_it_does_not_have():
    with pytest.raises(InputError, match="axes of glb files: wanted rub, got 'rdf'"):
        SplatOptions(suffix="glb", axes="rdf")


def test_without_its_package_sog_says_what_to_install_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gaussforge", None)
    with pytest.raises(InputError, match=r"jghand\[formats\]"):
        export_splats(tmp_path / "new", small_avatar(), lively_motion(Handedness.RIGHT, 1), SplatOptions(suffix="sog"))
    assert not (tmp_path / "new").exists()
