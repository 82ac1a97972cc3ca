"""`jghand render --passes` writes ground truth beside the pictures, and says what it cannot write."""

import json

import numpy as np
import pytest

from jghand_engine.cli import main
from jghand_engine.export.camera_file import read_camera
from jghand_engine.export.pictures import read_png
from jghand_engine.hand.joints import STANDARD_NAMES

SHORT = ("--poses", "point", "--frames", "0:2:2", "--avatar", "painted", "--threads", "1")


def render(folder, *words: str) -> int:
    size = () if words[-1:] and words[-1].endswith(".json") else ("--size", "160x120")
    return main(["render", *SHORT, *size, "--out", str(folder), *words])


def test_joints_and_cameras_come_beside_the_pictures(tmp_path):
    assert render(tmp_path, "--passes", "joints") == 0
    truth = json.loads((tmp_path / "joints.json").read_text())
    assert truth["names"] == list(STANDARD_NAMES)
    assert (truth["order"], truth["unit"], truth["hand"]) == ("standard", "m", "right")
    camera = read_camera(tmp_path / "camera.json")
    pictures = sorted(path.name for path in tmp_path.glob("*.png"))
    assert [frame["picture"] for frame in truth["frames"]] == pictures
    for frame in truth["frames"]:
        pixels, depth = camera.project(frame["joints_m"])
        assert np.abs(pixels - frame["px"]).max() < 1e-9
        assert np.abs(depth - frame["depth_m"]).max() < 1e-12
        alpha = read_png(tmp_path / frame["picture"])[..., 3]
        for (u, v), visible in zip(frame["px"], frame["visible"], strict=True):
            # a tip lies a pixel inside of the outline
            around = alpha[max(0, int(v) - 2) : int(v) + 3, max(0, int(u) - 2) : int(u) + 3]
            assert not visible or around.max() > 128
    assert {path.name for path in (tmp_path / "colmap").iterdir()} == {"cameras.txt", "images.txt", "points3D.txt"}
    frames = json.loads((tmp_path / "transforms.json").read_text())["frames"]
    assert [frame["file_path"] for frame in frames] == pictures
    assert not (tmp_path / "passes").exists()


def test_a_camera_in_the_wrist_gets_its_pictures_too(tmp_path):
    """Joints that are relative to the wrist, and a camera that was left where it is."""
    camera = {
        "width": 32,
        "height": 24,
        "fx": 40,
        "fy": 40,
        "cx": 16,
        "cy": 12,
        "camera_from_world": np.eye(4).tolist(),
    }
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    out = tmp_path / "out"
    assert render(out, "--passes", "joints", "--camera", str(tmp_path / "camera.json")) == 0
    frame = json.loads((out / "joints.json").read_text())["frames"][0]
    assert frame["depth_m"][0] == 0
    assert frame["px"][0] is None
    assert not frame["inside"][0]
    assert not frame["visible"][0]


def test_the_picture_is_the_same_with_and_without_passes(tmp_path):
    assert render(tmp_path / "plain") == 0
    assert render(tmp_path / "truth", "--passes", "joints") == 0
    for path in (tmp_path / "plain").glob("*.png"):
        assert np.array_equal(read_png(path), read_png(tmp_path / "truth" / path.name))


def test_maps_are_channels_of_an_exr_file(tmp_path):
    package = pytest.importorskip("OpenEXR", reason="the extra formats is not installed")
    assert render(tmp_path, "--passes", "depth,normal,ids,alpha") == 0
    files = sorted((tmp_path / "passes").iterdir())
    assert [path.name for path in files] == ["frame_00000.exr", "frame_00002.exr"]
    with package.File(str(files[0]), separate_channels=True) as content:
        found = {name: channel.pixels for name, channel in content.channels().items()}
        assert content.header()["units"] == "meters"
    floats = {"A", "Z", "normal.X", "normal.Y", "normal.Z"}
    assert set(found) == floats | {"hand_id", "bone_id"}
    assert all(found[name].dtype == np.float32 for name in floats)
    assert all(found[name].dtype == np.uint32 for name in ("hand_id", "bone_id"))
    assert all(values.shape == (120, 160) for values in found.values())
    alpha = read_png(tmp_path / "frame_00000.png")[..., 3] / 255
    assert np.abs(found["A"] - alpha).max() <= 0.5 / 255 + 1e-6
    assert ((found["Z"] > 0) == (found["hand_id"] == 1)).all()
    assert not (tmp_path / "joints.json").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--passes", "color"), "wanted names of depth"),
        (("--passes", "joints", "--shutter", "0.5"), "a moment through a pinhole"),
        (("--passes", "joints", "--aperture", "5"), "a moment through a pinhole"),
    ],
)
def test_what_cannot_be_true_is_refused_before_anything_is_written(tmp_path, capsys, words, sentence):
    assert render(tmp_path / "new", *words) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_truth_of_other_pictures_is_not_left_beside_new_ones(tmp_path, capsys):
    assert render(tmp_path, "--passes", "joints") == 0
    assert render(tmp_path, "--passes", "joints") == 0
    assert render(tmp_path) == 2
    assert "joints.json, colmap, transforms.json of an earlier run" in capsys.readouterr().err
    (tmp_path / "passes").mkdir()
    assert render(tmp_path, "--passes", "joints") == 2
    assert "got passes of an earlier run" in capsys.readouterr().err
