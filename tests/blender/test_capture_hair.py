"""Hair in a real capture with Cycles: dark strands where the plan has them on the skin of the pose."""

import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from tiny_captures import make

from blender_addon.capture import lit

PROGRAM = (
    "import sys\nfrom jghand_engine.captures.making import person_skin\nfrom jghand_engine.cli import main\n"
    "person_skin.MAP_PX = 128\nsys.exit(main())\n"
)
# a view of 20 mm of the back from so far, meters; pixels are 0.17 mm wide, strands 0.08
EDGE_PX, FIELD_M, AWAY_M = 120, 0.020, 0.3


@pytest.fixture(scope="module")
def plan_folder(engine_python, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("capture")
    (folder / "hairy.json").write_text(json.dumps({"hair": 1, "seed": 3}), encoding="utf-8")
    words = ("--cameras", "1", "--poses", "1", "--lights", "varied", "--samples", "1", "--subdivisions", "1")
    make(engine_python, folder / "tiny", PROGRAM, *words, "--person", str(folder / "hairy.json"))
    return folder / "tiny" / "plan"


def strands_m(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """(S, K, 3) points of the strands in the only pose, and (S, K, 3) where the skin below them faces."""
    mesh_m = np.load(folder / "mesh.npy")[0, :, :3]
    face, second, third, rise_m, _ = np.moveaxis(np.load(folder / "hair.npy"), 2, 0)
    with np.load(folder / "hands.npz") as arrays:
        a, b, c = np.moveaxis(mesh_m[arrays["faces"][face.astype(int)]], 2, 0)
    outwards = np.cross(b - a, c - a)
    outwards /= np.linalg.norm(outwards, axis=2, keepdims=True)
    place_m = a + second[..., None] * (b - a) + third[..., None] * (c - a)
    return place_m + rise_m[..., None] * outwards, outwards


def traced(plan: dict, folder: Path, camera: dict, scratch: Path) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) brightness of a picture, and its box."""
    scratch.mkdir()
    job = {"pose": 0, "camera": 0, "light": "0/400000", "stamp": "0123456789"}
    npz = lit.LitScene(plan["render"], folder, 1).picture(job, camera, scratch)[".npz"]
    shown = np.zeros((camera["height"], camera["width"]))
    with np.load(io.BytesIO(npz)) as picture:
        left, top, right, bottom = box_px = picture["box_px"]
        shown[top:bottom, left:right] = picture["groups"].astype(float).sum(0).mean(-1)
    return shown, box_px


def seen_px(points_m: np.ndarray, camera: dict) -> np.ndarray:
    """(N, 3) -> (N, 2) column and row."""
    matrix = np.array(camera["camera_from_world"])
    seen = points_m @ matrix[:3, :3].T + matrix[:3, 3]
    return seen[:, :2] / seen[:, 2:] * camera["fx"] + [camera["cx"], camera["cy"]]


def test_the_picture_is_darker_along_strands_and_the_same_beside_them(plan_folder, tmp_path):
    plan = json.loads((plan_folder / "plan.json").read_text(encoding="utf-8"))
    plan["render"]["sampling"]["samples"] = 12
    points_m, outwards = strands_m(plan_folder)
    middle = np.linalg.norm(points_m[:, 0] - np.median(points_m[:, 0], 0), axis=1).argmin()
    target, away = points_m[middle, 0], outwards[middle, 0].astype(float)
    right = np.cross([0.0, 1.0, 0.0], -away)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-away, right), -away])
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3], camera_from_world[:3, 3] = rotation, -rotation @ (target + AWAY_M * away)
    focal = EDGE_PX * AWAY_M / FIELD_M
    camera = {
        "width": EDGE_PX, "height": EDGE_PX, "fx": focal, "fy": focal, "cx": EDGE_PX / 2, "cy": EDGE_PX / 2,
        "camera_from_world": camera_from_world.tolist(),
    }  # fmt: skip
    hairy, _ = traced(plan, plan_folder, camera, tmp_path / "hairy")
    del plan["render"]["skin"]["hair_rgb"]
    bare, _ = traced(plan, plan_folder, camera, tmp_path / "bare")
    # the thicker half of strands on skin that faces the camera
    column, row = np.floor(seen_px(points_m[:, :5][outwards[:, :5] @ away > 0.8], camera)).astype(int).T
    inside = (np.minimum(column, row) >= 0) & (np.maximum(column, row) < EDGE_PX)
    ratio, on = hairy / bare, np.zeros((EDGE_PX, EDGE_PX), bool)
    on[row[inside], column[inside]] = True
    # observed 0.89, and 0.99 of all pixels
    assert np.median(ratio[on]) < 0.92
    assert np.median(ratio) == pytest.approx(1, abs=0.02)


def test_the_box_of_a_picture_has_all_of_its_hair(plan_folder, tmp_path):
    """... of hair that stands 5 cm off the skin."""
    folder = Path(shutil.copytree(plan_folder, tmp_path / "plan"))
    strands = np.load(folder / "hair.npy")
    strands[..., 3] *= 0.05 / strands[..., 3].max()
    np.save(folder / "hair.npy", strands)
    plan = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    camera = plan["cameras"][0]
    _, (left, top, right, bottom) = traced(plan, folder, camera, tmp_path / "long")
    points_px = seen_px(strands_m(folder)[0].reshape(-1, 3), camera)
    size = [camera["width"], camera["height"]]
    inside = points_px[((points_px >= 0) & (points_px < size)).all(1)]
    assert ((inside >= [left, top]) & (inside <= [right, bottom])).all()
