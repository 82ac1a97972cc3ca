"""Cameras as JSON."""

import json

import numpy as np
import pytest
import torch

from jghand_engine.errors import InputError
from jghand_engine.export.camera_file import camera_from_dict, camera_to_dict, read_camera
from jghand_engine.render.camera import Camera


def a_camera():
    eye, target, up = torch.tensor([0.1, 0.2, 0.6]), torch.tensor([0.0, 0.1, 0.0]), torch.tensor([0.0, 1.0, 0.0])
    return Camera.looking_at(eye, target, up, width=64, height=48, focal_px=90.5)


def test_a_camera_survives_the_file(tmp_path):
    camera = a_camera()
    (tmp_path / "camera.json").write_text(json.dumps(camera_to_dict(camera)))
    back = read_camera(tmp_path / "camera.json")
    assert camera_to_dict(back) == camera_to_dict(camera)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"fx": None}, "fx"),
        ({"fx": "90"}, "fx"),
        ({"fx": -1.0}, "fx"),
        ({"width": 64.5}, "width"),
        ({"height": True}, "height"),
        ({"width": 0}, "size"),
        ({"camera_from_world": [[1, 0], [0, 1]]}, "camera_from_world"),
        ({"camera_from_world": None}, "camera_from_world"),
        ({"camera_from_world": [[float("nan")] * 4] * 4}, "camera_from_world"),
        ({"camera_from_world": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]}, "rotation"),
        ({"camera_from_world": [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "rotation"),
    ],
)
def test_a_wrong_entry_is_named(change, named):
    with pytest.raises(InputError, match=named):
        camera_from_dict({**camera_to_dict(a_camera()), **change})


@pytest.mark.parametrize(("matrix", "came"), [
    ([[1, 0], [0, 1]], r"numbers of shape \(2, 2\)"), (None, r"numbers of shape \(\)"),
    ([[1, 0, 0, 1e7], *np.eye(4).tolist()[1:]], r"1e\+07"), ([[1, 0, 0, -2e6], *np.eye(4).tolist()[1:]], r"-2e\+06"),
    ([[1, 0], [0]], "no rows of numbers"), ("none", "no rows of numbers"), ([[float("nan")] * 4] * 4, "nan"),
])  # fmt: skip
def test_what_a_wrong_map_of_a_camera_is_instead_is_said(matrix, came):
    wanted = r"(numbers of shape \(4, 4\)|4 rows of 4 numbers of at most 1e.06)"
    with pytest.raises(InputError, match=f"camera_from_world: wanted {wanted}, got .?{came}"):
        camera_from_dict({**camera_to_dict(a_camera()), "camera_from_world": matrix})
