"""A real capture of varied light with Cycles, as small as can be: the groups are the light, and the records say it."""

import json
from pathlib import Path

import bpy
import mathutils
import numpy as np
import pytest
from hands import pixels
from tiny_captures import HEIGHT, WIDTH, make

from blender_addon.capture import lit
from blender_addon.capture.scene import STAMP_KEY

# the command with maps of few texels
PROGRAM = (
    "import sys\nfrom jghand_engine.captures.making import person_skin\nfrom jghand_engine.cli import main\n"
    "person_skin.MAP_PX = 128\nsys.exit(main())\n"
)


def capture(engine_python: str, folder: Path) -> str:
    words = ("--cameras", "2", "--poses", "1", "--lights", "varied", "--samples", "4", "--subdivisions", "0")
    return make(engine_python, folder, PROGRAM, *words)


@pytest.fixture(scope="module")
def captured(engine_python, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("capture") / "tiny"
    capture(engine_python, folder)
    return folder


def test_a_lost_picture_comes_back_byte_for_byte(captured, engine_python):
    lost, kept = sorted(captured.glob("images/**/*.npz"))
    before = {path: path.read_bytes() for path in (lost, lost.with_suffix(".png"))}
    times = kept.stat().st_mtime_ns
    lost.unlink()
    assert "1 pictures" in capture(engine_python, captured)
    assert {path: path.read_bytes() for path in before} == before
    assert kept.stat().st_mtime_ns == times


def test_a_picture_has_its_groups_its_light_and_a_picture_for_the_eye(captured):
    lights = json.loads((captured / "plan" / "lights.json").read_text(encoding="utf-8"))
    assert list(lights["pictures"]) == ["0/400000", "0/400001"]
    for file in captured.glob("images/**/*.npz"):
        with np.load(file, allow_pickle=False) as arrays:
            left, top, right, bottom = arrays["box_px"]
            assert arrays["groups"].shape == (3, bottom - top, right - left, 3)
            assert arrays["groups"].dtype == np.float16
            assert not arrays["groups"][:, arrays["alpha"] == 0].any()
            assert f"{STAMP_KEY}\0{arrays['stamp']}".encode() in file.with_suffix(".png").read_bytes()
            alpha = pixels(file.with_suffix(".png"), as_it_is=True)[..., 3]
            np.testing.assert_array_equal(np.rint(255 * alpha[top:bottom, left:right]), arrays["alpha"])
            assert alpha.sum() == pytest.approx(alpha[top:bottom, left:right].sum())
    for world in captured.glob("plan/worlds/*.npy"):
        radiance = np.load(world)
        assert radiance.shape[0] <= 256
        assert radiance.shape[1] == 2 * radiance.shape[0]
        assert (radiance >= 0).all()
        height = np.cos(np.pi * (0.5 - (np.arange(len(radiance)) + 0.5) / len(radiance)))[:, None, None]
        assert (radiance * height).sum() / (3 * 2 * len(radiance) * height.sum()) == pytest.approx(1, rel=2e-3)


def test_the_groups_sum_to_the_picture_of_all_lights(captured, tmp_path):
    plan = json.loads((captured / "plan" / "plan.json").read_text(encoding="utf-8"))
    # flesh that light goes through has noise of 2.5 % at 64
    plan["render"]["sampling"]["samples"] = 192
    scene = lit.LitScene(plan["render"], captured / "plan", 1)
    job = {"pose": 0, "camera": 0, "light": "0/400000", "stamp": "0123456789"}
    planes = scene.planes(job, plan["cameras"][0], tmp_path)
    hand = planes[lit.SUM][..., 3:] > 0
    total = planes[lit.SUM][..., :3]
    groups = np.stack([planes[group][..., :3] * hand for group in ("world", "lamp1", "lamp2")])
    # blocks of 8 x 8 pixels: single ones have the noise that the denoiser took from the groups. With OIDN's fast
    # prefilter the edge, a third of so small a hand, was 5 % too bright
    blocks = [part.reshape(HEIGHT // 8, 8, WIDTH // 8, 8, 3).mean((1, 3)) for part in (groups.sum(0), total)]
    assert np.abs(blocks[0] - blocks[1]).mean() < 0.02 * total.mean()
    assert groups.sum(0).mean() == pytest.approx(total.mean(), rel=0.01)
    assert all(group.mean() > 0 for group in groups)


def test_a_camera_may_have_a_size_and_rays_of_its_own(captured):
    plan = json.loads((captured / "plan" / "plan.json").read_text(encoding="utf-8"))
    scene, usual = lit.LitScene(plan["render"], captured / "plan", 1), plan["cameras"][0]
    for camera, expected in (({**usual, "width": 50, "samples": 9}, (50, 9)), (usual, (WIDTH, 4))):
        scene._aim(camera)
        assert (bpy.context.scene.render.resolution_x, bpy.context.scene.cycles.samples) == expected


# ---- records as Blender's lights, on a white card --------------------------------------------------------------------

KINDS = {
    "sun": {"rgb": [2.0, 1.0, 0.5], "place_m": [0.0, 0.6, 0.8], "angle_rad": 0.05},
    "point": {"rgb": [2.0, 1.0, 0.5], "place_m": [0.0, 0.3, 0.4], "radius_m": 0.02},
    "spot": {"rgb": [2.0, 1.0, 0.5], "place_m": [0.0, 0.3, 0.4], "axis": [0.0, -0.6, -0.8], "radius_m": 0.02,
             "cone_rad": 0.8, "blend": 0.2},
    "area": {"rgb": [2.0, 1.0, 0.5], "place_m": [0.0, 0.9, 1.2], "axis": [0.0, -0.6, -0.8], "side": [1.0, 0.0, 0.0],
             "size_m": [0.2, 0.1], "is_ellipse": True},
}  # fmt: skip
# of a card that faces +z, W/m2 a unit of rgb: cosine 0.8, distances 0.5 and 1.5 m
IRRADIANCE = {
    "sun": 0.8, "point": 0.8 / (0.25 + 0.0004), "spot": 0.8 / (0.25 + 0.0004), "area": 0.8 * np.pi * 0.005 / 2.25,
}  # fmt: skip


def card(tmp_path: Path, normal: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> np.ndarray:
    """(3,) radiance of a white card of 2 mm in the origin, times pi, in the lights of the scene."""
    scene = bpy.context.scene
    mesh = bpy.data.meshes.new("card")
    mesh.from_pydata([(-1e-3, -1e-3, 0), (1e-3, -1e-3, 0), (1e-3, 1e-3, 0), (-1e-3, 1e-3, 0)], [], [(0, 1, 2, 3)])
    white = bpy.data.materials.new("white")
    white.use_nodes = True
    shader = white.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (1, 1, 1, 1)
    white.node_tree.links.new(shader.outputs[0], white.node_tree.nodes["Material Output"].inputs["Surface"])
    mesh.materials.append(white)
    turn = mathutils.Vector(normal).to_track_quat("Z", "Y").to_matrix().to_4x4()
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    eye.data.type, eye.data.ortho_scale, eye.data.clip_start = "ORTHO", 1e-3, 1e-3
    eye.matrix_world = turn @ mathutils.Matrix.Translation((0, 0, 0.05))
    plane = bpy.data.objects.new("card", mesh)
    plane.matrix_world = turn
    for thing in (eye, plane):
        scene.collection.objects.link(thing)
    scene.camera = eye
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 64, False
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.render.film_transparent = True
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(tmp_path / "card.exr")
    bpy.ops.render.render(write_still=True)
    for thing in (eye, plane):
        bpy.data.objects.remove(thing)
    return np.pi * lit._pixels(tmp_path / "card.exr")[..., :3].mean((0, 1))


@pytest.mark.parametrize("kind", KINDS)
def test_a_record_is_the_lamp_that_it_says_in_radiometric_units(context, tmp_path, kind):
    lamp = lit._lamp_object(context.scene, "lamp1")
    # as from one picture to the next: of another kind before
    lit._set_lamp(lamp, {"kind": "area" if kind != "area" else "sun", **KINDS["area" if kind != "area" else "sun"]})
    lit._set_lamp(lamp, {"kind": kind, **KINDS[kind]})
    np.testing.assert_allclose(card(tmp_path), IRRADIANCE[kind] * np.array([2.0, 1.0, 0.5]), rtol=0.015)


def test_an_area_spreads_its_light_as_far_as_its_record_says(context, tmp_path):
    """The gain of a narrowed area on its axis: tan h / (tan h - h)."""
    lamp = lit._lamp_object(context.scene, "lamp1")
    lit._set_lamp(lamp, {"kind": "area", **KINDS["area"], "size_m": [0.02, 0.02], "spread_rad": 1.0})
    gain = np.tan(0.5) / (np.tan(0.5) - 0.5)
    expected = 0.8 * np.pi / 4 * 0.0004 / 2.25 * gain * np.array([2.0, 1.0, 0.5])
    np.testing.assert_allclose(card(tmp_path), expected, rtol=0.03)


def test_the_world_is_turned_as_its_record_says(context, tmp_path):
    """Bright where env x > 0, the middle columns: of the axes of the joints that is env_from_world's first row."""
    scene = lit.LitScene.__new__(lit.LitScene)
    scene._folder, scene._images = tmp_path, {}
    radiance = np.zeros((64, 128, 3), np.float32)
    radiance[:, 32:96] = 1
    np.save(tmp_path / "half.npy", radiance)
    _, environment, turn = lit.new_world(context.scene)
    environment.image = scene._world_image("half.npy")
    matrix = np.array(mathutils.Euler((0.3, -0.7, 1.9)).to_matrix())
    turn.inputs["Rotation"].default_value = mathutils.Matrix(matrix).to_euler("XYZ")
    bright = tuple(matrix[0].tolist())
    np.testing.assert_allclose(card(tmp_path, bright), np.pi, rtol=0.02)
    np.testing.assert_allclose(card(tmp_path, tuple(-matrix[0])), 0, atol=0.02)
