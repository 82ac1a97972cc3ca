"""Blender's own importers read the meshes: glTF and OBJ with their texture, upright, where the engine has them."""

import os
import subprocess
from pathlib import Path

import environments
import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs the bpy wheel of this Python")

ROOT = Path(__file__).parents[2]

# the importers turn y up into z up
Z_UP_FROM_Y_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
# one process for all kinds, by the hand of few texels
PROGRAM = """
import sys
from small_avatars import coarse_builtin
from jghand_engine.avatar import builtin
from jghand_engine.cli import main
hand = coarse_builtin(texels=512)
builtin._load_right = lambda name: hand
words = ["--poses", "fist", "--hand", "left", "--frames", "0", "--out", sys.argv[1]]
sys.exit(any(main(["export", kind, *words]) for kind in ("mesh", "mesh-obj", "mesh-ply")))
"""


@pytest.fixture(scope="module")
def exported(engine_python, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    variables = {**environments.clean_variables(), "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"}
    subprocess.run([engine_python, "-c", PROGRAM, folder], check=True, env=variables, timeout=300)
    return folder


@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_a_posed_hand_is_a_textured_mesh_in_blender(exported, kind):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if kind == "glb":
        bpy.ops.import_scene.gltf(filepath=str(exported / "hand.0000.glb"))
    else:
        bpy.ops.wm.obj_import(filepath=str(exported / "hand.0000.obj"))
    (hand,) = (one for one in bpy.data.objects if one.type == "MESH")
    came = np.array([hand.matrix_world @ vertex.co for vertex in hand.data.vertices])
    truth = ply_positions(exported / "hand.0000.ply") @ Z_UP_FROM_Y_UP.T
    for side in (np.min, np.max):
        np.testing.assert_allclose(side(came, axis=0), side(truth, axis=0), atol=1e-6)
    assert [layer.name for layer in hand.data.uv_layers] == ["UVMap"]
    (material,) = hand.data.materials
    images = [node.image for node in material.node_tree.nodes if node.type == "TEX_IMAGE"]
    # the colors, and the relief
    assert [tuple(image.size) for image in images] == [(512, 512)] * 2
    (relief,) = (node for node in material.node_tree.nodes if node.type == "NORMAL_MAP")
    assert (relief.space, relief.inputs["Strength"].default_value) == ("TANGENT", 1)
    assert [link.to_socket.name for link in relief.outputs["Normal"].links] == ["Normal"]
    (link,) = relief.inputs["Color"].links
    image = link.from_node.image
    normals = np.array(image.pixels).reshape(-1, 4)[:, :3]
    if image.colorspace_settings.name == "sRGB":
        normals = ((normals + 0.055) / 1.055) ** 2.4
    else:
        assert image.colorspace_settings.name == "Non-Color"
    # outward, but for lines: half a step of a byte, which sRGB has coarser there
    np.testing.assert_allclose(np.median(normals, axis=0), [0.5, 0.5, 1.0], atol=0.004)
    assert (np.abs(normals[:, :2] - 0.5).max(axis=1) > 0.05).mean() > 0.01
    # skin, not black: red is its strongest color
    red, green, blue, _ = np.array(images[0].pixels).reshape(-1, 4).mean(axis=0)
    assert red > green > blue > 0.1


def ply_positions(path: Path) -> np.ndarray:
    """(V, 3) of a binary PLY whose vertices begin with x, y, z and normals as floats and end with four bytes."""
    content = path.read_bytes()
    end = content.index(b"end_header\n") + len(b"end_header\n")
    (count,) = [int(line.split()[2]) for line in content[:end].splitlines() if line.startswith(b"element vertex ")]
    kind = np.dtype([("floats", "<f4", 6), ("rgba", "u1", 4)])
    return np.frombuffer(content, kind, count, end)["floats"][:, :3].astype(np.float64)
