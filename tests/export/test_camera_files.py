"""Cameras for COLMAP and nerfstudio, read as those programs say that they read them, project as ours do."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jghand_engine.export.camera_file import write_colmap, write_transforms
from jghand_engine.render.camera import Camera

POINTS_M = np.random.default_rng(2).uniform(-0.1, 0.1, (50, 3))
# worst observed 2.3e-13 px: nothing is rounded
TOLERANCE_PX = 1e-10


NAMES = ("frame_00000.png", "frame_00002.png")
PLAIN = Camera.looking_at((-0.5, 0.1, 0.3), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), width=400, height=300, focal_px=700)
# a principal point aside, and unlike focal lengths
ODD = Camera(300, 500, 800.0, 750.0, 100.0, 333.3, PLAIN.camera_from_world)


def apart_px(pixels: np.ndarray, camera: Camera) -> float:
    return float(np.abs(pixels - camera.project(POINTS_M)[0]).max())


def lines(path) -> list[str]:
    return [line for line in path.read_text().splitlines() if not line.startswith("#")]


@pytest.mark.parametrize("camera", [PLAIN, ODD])
def test_colmap_projects_as_we_do(tmp_path, camera):
    folder = write_colmap(tmp_path / "colmap", NAMES, camera)
    ((number, model, *lens),) = (line.split() for line in lines(folder / "cameras.txt"))
    assert model == "PINHOLE"
    width, height, fx, fy, cx, cy = map(float, lens)
    assert (width, height) == (camera.width, camera.height)
    images = lines(folder / "images.txt")
    # every second line lists points, and there are none
    assert [line for line in images[1::2] if line] == []
    for line, wanted in zip(images[0::2], NAMES, strict=True):
        _, *pose, lens_of, name = line.split()
        assert (lens_of, name) == (number, wanted)
        qw, qx, qy, qz, *offset = map(float, pose)
        seen = Rotation.from_quat([qx, qy, qz, qw]).apply(POINTS_M) + offset
        pixels = np.stack([fx * seen[:, 0] / seen[:, 2] + cx, fy * seen[:, 1] / seen[:, 2] + cy], -1)
        assert apart_px(pixels, camera) < TOLERANCE_PX
    assert lines(folder / "points3D.txt") == []


@pytest.mark.parametrize("camera", [PLAIN, ODD])
def test_nerfstudio_projects_as_we_do(tmp_path, camera):
    write_transforms(tmp_path / "transforms.json", NAMES, camera)
    content = json.loads((tmp_path / "transforms.json").read_text())
    for frame, name in zip(content["frames"], NAMES, strict=True):
        matrix = np.array(frame["transform_matrix"])
        assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1)
        # its cameras look along -z with y up, its pictures have v down
        seen = (POINTS_M - matrix[:3, 3]) @ matrix[:3, :3]
        assert (seen[:, 2] < 0).all()
        u = frame["fl_x"] * seen[:, 0] / -seen[:, 2] + frame["cx"]
        v = -frame["fl_y"] * seen[:, 1] / -seen[:, 2] + frame["cy"]
        assert apart_px(np.stack([u, v], -1), camera) < TOLERANCE_PX
        assert (frame["file_path"], frame["w"], frame["h"]) == (name, camera.width, camera.height)
