"""The writer of InterHand2.6M's layout, against the layout's own description."""

import json

import numpy as np
import pytest
import torch

from jghand_engine.captures.interhand_writer import RecordedHand, write_interhand
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.render.camera import Camera
from jghand_engine.template.builtin import load_template

JOINTS_M = load_template().joints_m + np.array([0.1, -0.2, 0.3])


def recorded(handedness: Handedness = Handedness.RIGHT) -> RecordedHand:
    turn = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)))[0]
    turn = turn * torch.linalg.det(turn)
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :3], matrix[:3, 3] = turn, torch.tensor([0.01, -0.02, 0.9], dtype=torch.float64)
    camera = Camera(334, 512, 1200.0, 1201.0, 170.5, 250.25, matrix)
    return RecordedHand(
        cameras={"400017": camera}, joints_m={2000: JOINTS_M}, boxes_px={(2000, "400017"): (1.0, 2.0, 30.0, 40.0)},
        handedness=handedness, capture=3, sequence="ROM04", split="test",
    )  # fmt: skip


def written(folder, hand: RecordedHand) -> dict[str, dict]:
    write_interhand(folder, hand)
    stem = folder / "annotations" / "test" / "InterHand2.6M_test"
    return {name: json.loads(stem.with_name(f"{stem.name}_{name}.json").read_text())
            for name in ("data", "camera", "joint_3d")}  # fmt: skip


@pytest.mark.parametrize("handedness", list(Handedness))
def test_joints_are_tip_first_in_millimeters_and_the_absent_hand_is_ones(tmp_path, handedness):
    frame = written(tmp_path, recorded(handedness))["joint_3d"]["3"]["2000"]
    world = np.array(frame["world_coord"])
    standard = from_level(JOINTS_M, JointOrder.STANDARD)
    present, absent = (world[:21], world[21:]) if handedness is Handedness.RIGHT else (world[21:], world[:21])
    # tip of the thumb, first joint of the thumb, tip of the index finger, wrist
    for place, joint in ((0, 4), (3, 1), (4, 8), (20, 0)):
        np.testing.assert_allclose(present[place], 1000 * standard[joint], atol=1e-12)
    assert (absent == 1).all()
    valid = np.array(frame["joint_valid"])
    assert valid.shape == (42, 1)
    assert valid[:21].all() == (handedness is Handedness.RIGHT)
    assert valid[21:].all() == (handedness is Handedness.LEFT)
    assert frame["hand_type"] == handedness.value


def test_cameras_project_by_r_times_x_minus_the_place(tmp_path):
    hand = recorded()
    rig = written(tmp_path, hand)["camera"]["3"]
    camera = hand.cameras["400017"]
    rotation, place_mm = np.array(rig["camrot"]["400017"]), np.array(rig["campos"]["400017"])
    ours = JOINTS_M @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    # observed 4e-13 mm
    np.testing.assert_allclose((1000 * JOINTS_M - place_mm) @ rotation.T, 1000 * ours, atol=1e-10)
    assert (rig["focal"]["400017"], rig["princpt"]["400017"]) == ([1200.0, 1201.0], [170.5, 250.25])


def test_pictures_are_named_as_the_data_set_names_them(tmp_path):
    hand = recorded()
    image = written(tmp_path, hand)["data"]["images"][0]
    assert image["file_name"] == "Capture3/ROM04/cam400017/image2000.png"
    assert (image["width"], image["height"], image["camera"], image["frame_idx"]) == (334, 512, "400017", 2000)
    assert hand.image(tmp_path, 2000, "400017") == tmp_path / "images" / "test" / image["file_name"]


def test_the_skeleton_is_that_of_the_data_set(tmp_path):
    write_interhand(tmp_path, recorded())
    lines = (tmp_path / "annotations" / "skeleton.txt").read_text().splitlines()
    assert len(lines) == 42
    assert lines[0] == "r_thumb4 0 1"
    assert lines[3] == "r_thumb1 3 20"
    assert lines[20] == "r_wrist 20 -1"
    assert lines[41] == "l_wrist 41 -1"


def test_joints_that_are_no_numbers_are_refused(tmp_path):
    broken = JOINTS_M.copy()
    broken[3, 1] = np.nan
    hand = RecordedHand(recorded().cameras, {7: broken}, {(7, "400017"): (0.0, 0.0, 1.0, 1.0)})
    with pytest.raises(InputError, match="frame 7"):
        write_interhand(tmp_path, hand)
    assert not list(tmp_path.iterdir())
