"""Meshes hold the posed surface, with the colors of the skin where its UV says, in files that other programs read."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from detail_samples import detail_of
from PIL import Image
from usd_samples import engine_mesh, lively_motion, small_avatar

from jghand_engine.avatar.builtin import load_painted
from jghand_engine.avatar.detail import ratio_bytes
from jghand_engine.avatar.relief import HEIGHT_STEP_M, Relief
from jghand_engine.cli import main
from jghand_engine.color import srgb_to_linear
from jghand_engine.errors import InputError
from jghand_engine.export import skin
from jghand_engine.export.mesh import MESH_FORMATS, export_meshes
from jghand_engine.export.skin import TEXTURE_PX
from jghand_engine.export.splats.cloud import RUB_FROM_UP
from jghand_engine.export.splats.files import FrameFiles
from jghand_engine.hand.joints import Handedness
from jghand_engine.template.builtin import load_template

# float32 of the files, half a meter from the origin; OBJ has eight decimals
POSITION_ERROR_M = 1e-7


@pytest.fixture
def few_texels(monkeypatch):
    """For who looks at no color: most of the time of an export goes into its texture."""
    monkeypatch.setattr(skin, "TEXTURE_PX", 64)


def read(path) -> trimesh.Trimesh:
    """As trimesh reads it, nothing merged and nothing left out."""
    return trimesh.load(path, process=False, maintain_order=True, force="mesh")


@pytest.mark.usefixtures("few_texels")
@pytest.mark.parametrize("handedness", list(Handedness))
@pytest.mark.parametrize("suffix", list(MESH_FORMATS.values()))
def test_every_frame_is_the_surface_where_the_bones_put_it(tmp_path, suffix, handedness):
    """Faces look outwards for the left hand too."""
    avatar, motion = small_avatar(), lively_motion(handedness, 2)
    report = export_meshes(tmp_path, avatar, motion, FrameFiles("hand", suffix, first_frame=7), up="z")
    assert [path.name for path in report.files] == [f"hand.0007.{suffix}", f"hand.0008.{suffix}"]
    assert report.bytes == sum(path.stat().st_size for path in tmp_path.iterdir())
    template = load_template()
    for path, wanted_m in zip(report.files, engine_mesh(motion), strict=True):
        mesh = read(path)
        assert mesh.volume > 0.5 * trimesh.Trimesh(template.vertices_m, template.faces).volume
        wanted_m = wanted_m @ RUB_FROM_UP["z"].T
        faces = template.faces[:, ::-1] if handedness is Handedness.LEFT else template.faces
        np.testing.assert_allclose(mesh.triangles, wanted_m[faces], atol=POSITION_ERROR_M)


def test_the_texture_has_the_color_of_the_skin_at_its_uv(tmp_path):
    """Seen through the UV of each face, glTF and OBJ have what PLY has at the vertices, where skin is of one color."""
    avatar = load_painted(handedness=Handedness.RIGHT).prefix(4000)
    side = np.asarray(avatar.position_m)[:, :1] > 0.0
    avatar = replace(avatar, rgb=np.where(side, [1.0, 0.2, 0.0], [0.0, 0.2, 1.0]).astype(np.float32))
    motion = lively_motion(Handedness.RIGHT, 1)
    plain = None
    for suffix in ("ply", "glb", "obj"):
        (path,) = export_meshes(tmp_path, avatar, motion, FrameFiles(suffix=suffix)).files
        mesh = read(path)
        if suffix == "ply":
            plain = mesh.visual.vertex_colors[:, :3].astype(int)
            at = load_template().vertices_m[:, 0]
            np.testing.assert_array_equal(plain[at > 0.004], [[255, 51, 0]] * int((at > 0.004).sum()))
            np.testing.assert_array_equal(plain[at < -0.004], [[0, 51, 255]] * int((at < -0.004).sum()))
            continue
        material = mesh.visual.material
        image = np.asarray((material.baseColorTexture if suffix == "glb" else material.image).convert("RGB"))
        assert image.shape == (TEXTURE_PX, TEXTURE_PX, 3)
        uv = mesh.visual.uv[mesh.faces].mean(axis=1)
        column, row = (TEXTURE_PX * uv[:, 0]).astype(int), (TEXTURE_PX * (1 - uv[:, 1])).astype(int)
        corners = plain[load_template().faces]
        of_one_color = (np.abs(load_template().vertices_m[load_template().faces, 0]) > 0.004).all(axis=1)
        assert of_one_color.sum() > 2500
        wrong = (image[row, column] != corners[:, 0]).any(axis=1)[of_one_color]
        # a face that is smaller than a texel may show its neighbor's color: 5 of 2969 do
        assert wrong.mean() < 0.005


@pytest.mark.parametrize("size", [64, 1024])
def test_the_texture_has_the_detail_of_the_hand(tmp_path, size):
    """Half as bright in some columns of the texture, and as it was elsewhere."""
    texture = np.full((size, size, 3), 128, np.uint8)
    texture[:, size // 4 : size // 2] = ratio_bytes(np.full(3, np.log(0.5)))
    plain = load_painted(handedness=Handedness.RIGHT).prefix(4000)
    motion = lively_motion(Handedness.RIGHT, 1)
    images = []
    for name, avatar in (("plain", plain), ("detailed", replace(plain, detail=detail_of(texture)))):
        (path,) = export_meshes(tmp_path / name, avatar, motion, FrameFiles(suffix="glb")).files
        images.append(read(path).visual.material.baseColorTexture.convert("RGB"))
    assert images[1].size == 2 * (max(size, TEXTURE_PX),)
    without, ours = (np.asarray(image.resize(2 * (TEXTURE_PX,)), float) for image in images)
    dark = slice(TEXTURE_PX // 4 + 4, TEXTURE_PX // 2 - 4)
    # the finer picture is smooth between the Gaussians' texels
    assert np.abs(ours[:, dark] - 0.5 * without[:, dark]).mean() < 2 < without[:, dark].mean() / 10
    assert np.abs(ours - without)[:, TEXTURE_PX // 2 + 4 :].mean() < 2


@pytest.mark.usefixtures("few_texels")
@pytest.mark.parametrize("suffix", ["glb", "obj"])
def test_the_relief_of_the_hand_is_a_normal_map(tmp_path, suffix):
    """Skin that rises along u leans back from it, skin that rises along the rows forward, up the texture."""
    motion, avatar = lively_motion(Handedness.RIGHT, 1), load_painted(handedness=Handedness.RIGHT).prefix(500)
    steps = (np.arange(64) - 32).astype(np.int8)
    for along, wanted in ((steps[None, :], (-1, 0)), (steps[:, None], (0, 1))):
        height = np.broadcast_to(along[..., None], (64, 64, 2)).copy()
        detail = replace(detail_of(np.full((64, 64, 3), 128, np.uint8)), relief=Relief(height))
        options, folder = FrameFiles(suffix=suffix), tmp_path / str(wanted)
        report = export_meshes(folder, replace(avatar, detail=detail), motion, options)
        assert report.bytes == sum(path.stat().st_size for path in folder.iterdir())
        if suffix == "glb":
            image = read(report.files[0]).visual.material.normalTexture.convert("RGB")
        else:
            named = dict(line.split(" ", 1) for line in (folder / "hand.0000.mtl").read_text().splitlines() if line)
            image = Image.open(folder / named["norm"])
            # Blender takes this for a normal map in sRGB
            bumps = np.asarray(Image.open(folder / named["map_Bump"].removeprefix("-bm 1 ")))
            assert np.abs(srgb_to_linear(bumps / 255) - np.asarray(image) / 255).max() < 0.005
        normal = (np.asarray(image, float) - 128) / 127
        inner = normal[24:40, 24:40][detail.skin[24:40, 24:40]].mean(0)
        steep = HEIGHT_STEP_M * detail.density_per_m[1]
        assert inner == pytest.approx(np.array([*wanted, 1 / steep]) * steep / np.hypot(1, steep), abs=0.01)
        assert not normal[~detail.skin][:, :2].any()


@pytest.mark.usefixtures("few_texels")
def test_another_avatars_surface_is_refused_and_so_are_files_that_would_be_lost(tmp_path):
    avatar, motion = small_avatar(), lively_motion(Handedness.RIGHT, 1)
    foreign = replace(load_template(), identifier="another")
    with pytest.raises(InputError, match="on which the avatar was made"):
        export_meshes(tmp_path, avatar, motion, FrameFiles(suffix="glb"), template=foreign)
    export_meshes(tmp_path, avatar, motion, FrameFiles(suffix="glb"))
    with pytest.raises(InputError, match="--overwrite"):
        export_meshes(tmp_path, avatar, motion, FrameFiles(suffix="glb"))


@pytest.mark.usefixtures("few_texels")
@pytest.mark.parametrize("name", ["hand.0000.png", "hand.0000.mtl", "hand.normal.png", "hand.bump.png"])
def test_a_picture_of_the_name_of_a_texture_is_not_replaced(tmp_path, name):
    relief = Relief(np.zeros((64, 64, 2), np.int8))
    detail = replace(detail_of(np.full((64, 64, 3), 128, np.uint8)), relief=relief)
    avatar, motion = replace(small_avatar(), detail=detail), lively_motion(Handedness.RIGHT, 1)
    (tmp_path / name).write_text("somebody's")
    with pytest.raises(InputError, match=f"{name}.*--overwrite"):
        export_meshes(tmp_path, avatar, motion, FrameFiles(suffix="obj"))
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "somebody's")]
    export_meshes(tmp_path, avatar, motion, FrameFiles(suffix="obj", overwrite=True))
    written = ["0000.mtl", "0000.obj", "0000.png", "bump.png", "normal.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"hand.{name}" for name in written]


@pytest.mark.usefixtures("few_texels")
def test_frames_written_in_parts_share_the_pictures_of_the_relief(tmp_path):
    detail = replace(detail_of(np.full((64, 64, 3), 128, np.uint8)), relief=Relief(np.zeros((64, 64, 2), np.int8)))
    avatar, motion = replace(small_avatar(), detail=detail), lively_motion(Handedness.RIGHT, 2)
    for frame in range(2):
        export_meshes(tmp_path, avatar, motion, FrameFiles(suffix="obj"), frames=range(frame, frame + 1))
    assert [path.name for path in sorted(tmp_path.glob("*.obj"))] == ["hand.0000.obj", "hand.0001.obj"]


def test_one_pose_of_a_motion_can_be_had_from_the_command_line(tmp_path, capsys):
    words = ["export", "mesh-ply", "--poses", "open,fist", "--avatar", "painted", "--frames", "3"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    assert "1610 vertices, 3216 faces" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["hand.0003.ply"]
    assert main(["export", "web", "--poses", "fist", "--template", "MANO_RIGHT.pkl", "--out", str(tmp_path)]) == 2
    assert "jghand export usd or mesh" in capsys.readouterr().err


def test_without_trimesh_a_sentence_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(InputError, match=r"package trimesh.*jghand\[learn\]"):
        export_meshes(tmp_path, small_avatar(), lively_motion(Handedness.RIGHT, 1), FrameFiles(suffix="glb"))
    assert list(tmp_path.iterdir()) == []
