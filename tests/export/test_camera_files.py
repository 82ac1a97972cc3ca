"""Cameras for COLMAP and nerfstudio, read as those programs say that they read them, project as ours do."""

import json

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from jghand_engine.errors import InputError
from jghand_engine.export.cameras import Shot, write_colmap, write_transforms
from jghand_engine.render.camera import Camera

POINTS_M = np.random.default_rng(2).uniform(-0.1, 0.1, (50, 3))
# worst observed 2.3e-13 px: nothing is rounded
TOLERANCE_PX = 1e-10


def shots() -> list[Shot]:
    """Two pictures through one lens, and one with a principal point aside and other focal lengths."""
    up = torch.tensor([0.0, 1.0, 0.0])
    eyes = torch.tensor([[0.1, 0.2, 0.6], [-0.5, 0.1, 0.3]])
    cameras = [Camera.looking_at(eye, torch.zeros(3), up, width=400, height=300, focal_px=700) for eye in eyes]
    odd = Camera(300, 500, 800.0, 750.0, 100.0, 333.3, cameras[0].camera_from_world)
    return [Shot(f"frame_{index:05d}.png", camera) for index, camera in enumerate([*cameras, odd])]


def apart_px(pixels: np.ndarray, camera: Camera) -> float:
    return float(np.abs(pixels - camera.project(POINTS_M)[0]).max())


def lines(path) -> list[str]:
    return [line for line in path.read_text().splitlines() if not line.startswith("#")]


def test_colmap_projects_as_we_do(tmp_path):
    folder = write_colmap(tmp_path / "colmap", shots())
    lenses = {}
    for line in lines(folder / "cameras.txt"):
        number, model, *values = line.split()
        assert model == "PINHOLE"
        lenses[number] = [float(value) for value in values]
    assert len(lenses) == 2
    images = lines(folder / "images.txt")
    # every second line lists points, and there are none
    assert [line for line in images[1::2] if line] == []
    for line, shot in zip(images[0::2], shots(), strict=True):
        _, *pose, lens, name = line.split()
        qw, qx, qy, qz, *offset = map(float, pose)
        seen = Rotation.from_quat([qx, qy, qz, qw]).apply(POINTS_M) + offset
        width, height, fx, fy, cx, cy = lenses[lens]
        pixels = np.stack([fx * seen[:, 0] / seen[:, 2] + cx, fy * seen[:, 1] / seen[:, 2] + cy], -1)
        assert (name, width, height) == (shot.name, shot.camera.width, shot.camera.height)
        assert apart_px(pixels, shot.camera) < TOLERANCE_PX
    assert lines(folder / "points3D.txt") == []


def test_nerfstudio_projects_as_we_do(tmp_path):
    write_transforms(tmp_path / "transforms.json", shots())
    content = json.loads((tmp_path / "transforms.json").read_text())
    for frame, shot in zip(content["frames"], shots(), strict=True):
        matrix = np.array(frame["transform_matrix"])
        assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1)
        # its cameras look along -z with y up, its pictures have v down
        seen = (POINTS_M - matrix[:3, 3]) @ matrix[:3, :3]
        assert (seen[:, 2] < 0).all()
        u = frame["fl_x"] * seen[:, 0] / -seen[:, 2] + frame["cx"]
        v = -frame["fl_y"] * seen[:, 1] / -seen[:, 2] + frame["cy"]
        assert apart_px(np.stack([u, v], -1), shot.camera) < TOLERANCE_PX
        assert (frame["file_path"], frame["w"], frame["h"]) == (shot.name, shot.camera.width, shot.camera.height)


@pytest.mark.parametrize("write", [write_colmap, write_transforms])
def test_pictures_that_these_files_cannot_hold_are_refused(tmp_path, write):
    camera = shots()[0].camera
    parallel = Camera(400, 300, 1000.0, 1000.0, 200.0, 150.0, camera.camera_from_world, orthographic=True)
    for wrong in ([], [Shot("a.png", parallel)], [Shot("my hand.png", camera)]):
        with pytest.raises(InputError):
            write(tmp_path / "new", wrong)
    assert not (tmp_path / "new").exists()
