"""A PLY of a posed hand in another renderer beside our picture: Spark (three.js, WebGL) in a headless Chromium.

    python scripts/show_splat_file.py --out docs/formats.png [--pose point] [--avatar builtin]

To be run with the engine's Python. Needs the programs of `check_splat_files.py --install`, and a Chromium: the variable
JGHAND_CHROMIUM, else the commands chromium, chromium-browser or google-chrome.

Four pictures: the engine's own with gloss and self-shadow; of what the file holds, without them; Spark's picture of
the file; and eight times the difference of these two. The picture-to-picture figure is told for Spark with the low pass
that the hand was learned with, and as Spark is by itself.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

import check_splat_files as clients

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_avatar_called
from jghand_engine.color import decibels
from jghand_engine.export.camera_file import camera_to_dict
from jghand_engine.export.pictures import Cell, SheetStyle, contact_sheet, flatten, read_png, write_png
from jghand_engine.export.splats.cloud import SplatCloud
from jghand_engine.export.splats.files import SplatMotion
from jghand_engine.export.splats.ply import ply_bytes
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.native.contract import ALPHA_MIN, BLUR_PX2
from jghand_engine.render.camera import Camera
from jghand_engine.render.framing import framing_camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset

BLACK = (0.0, 0.0, 0.0)
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# the rasterization contract in Spark's words: low pass without a change of opacity, order by depth, the same cut-offs
AS_LEARNED = {
    "preBlurAmount": BLUR_PX2, "blurAmount": 0.0, "sortRadial": False, "minAlpha": ALPHA_MIN,
    "maxStdDev": float(np.sqrt(2 * np.log(255))),
}  # fmt: skip


def browser() -> str | None:
    """The command of a Chromium, None where there is none."""
    return os.environ.get("JGHAND_CHROMIUM") or next(filter(None, map(shutil.which, BROWSERS)), None)


def drawn_by_spark(ply: Path, camera: Camera, settings: dict) -> np.ndarray:
    """(H, W, 3) uint8 on black. RuntimeError when the browser fails."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "camera.json").write_text(json.dumps(camera_to_dict(camera)))
        (folder / "settings.json").write_text(json.dumps(settings))
        os.environ["JGHAND_CHROMIUM"] = browser() or ""
        picture = folder / "picture.png"
        clients.node("draw_with_spark.mjs", ply, folder / "camera.json", picture, folder / "settings.json")
        return read_png(picture)[..., :3]


def drawn_by_us(cloud: SplatCloud, camera: Camera) -> np.ndarray:
    """(H, W, 3) uint8 on black of what a file of `cloud`, axes rub, holds."""
    six = clients.Found.of_cloud(cloud).covariance_m2[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    parts = cloud.positions_m, cloud.scales_m.mean(1), cloud.opacity, cloud.rgb, six
    position_m, sigma_m, opacity, rgb, covariance_m2 = (
        torch.tensor(np.array(part), dtype=torch.float32) for part in parts
    )
    picture = rasterize(Gaussians(position_m, sigma_m, opacity, rgb, covariance_m2), camera)
    return flatten(torch.cat([picture.rgb, picture.alpha[..., None]], -1).numpy(), BLACK)


def psnr_db(one: np.ndarray, other: np.ndarray) -> float:
    return decibels(float(np.square((one.astype(float) - other) / 255).mean()))


def posed(name: str, pose: str) -> tuple[HandAvatar, PoseSequence, Camera]:
    """An avatar in a named pose, and the camera that both renderers look through."""
    avatar = load_avatar_called(name)
    joints_m = named_pose(pose, avatar.rest_joints_m, handedness=avatar.handedness, fist=avatar.fist)
    camera = framing_camera(joints_m[None], avatar.handedness, "quarter", width=512, height=512)
    return avatar, PoseSequence(joints_m[None], 30.0, avatar.handedness), camera


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--pose", default="point")
    parser.add_argument("--avatar", default="builtin")
    options = parser.parse_args()
    if browser() is None:
        print("There is no Chromium here; JGHAND_CHROMIUM names one.", file=sys.stderr)
        return 1
    avatar, sequence, camera = posed(options.avatar, options.pose)
    whole = flatten(HandRenderer(avatar, preset("viewport")).render(sequence.joints_m[0], camera).rgba, BLACK)
    ours = drawn_by_us(SplatMotion(avatar, sequence, axes="rub").cloud(0), camera)
    with tempfile.TemporaryDirectory() as folder:
        ply = Path(folder) / "hand.ply"
        ply.write_bytes(ply_bytes(SplatMotion(avatar, sequence, axes="rdf").cloud(0)))
        theirs, by_itself = (drawn_by_spark(ply, camera, settings) for settings in (AS_LEARNED, {}))
    difference = np.clip(8 * np.abs(ours.astype(int) - theirs), 0, 255).astype(np.uint8)
    print(f"Spark with the low pass of the hand: {psnr_db(ours, theirs):.1f} dB, "
          f"largest difference of a channel {np.abs(ours.astype(int) - theirs).max()} of 255")  # fmt: skip
    print(f"Spark as it is by itself: {psnr_db(ours, by_itself):.1f} dB")
    print(f"Gloss and self-shadow, which files do not hold: {psnr_db(ours, whole):.1f} dB")
    cells = [
        Cell("JGHand, with gloss and shadow", whole), Cell("JGHand, what the file holds", ours),
        Cell("Spark 2.2 in Chromium, the PLY file", theirs), Cell("8 x their difference", difference),
    ]  # fmt: skip
    write_png(options.out, contact_sheet(cells, SheetStyle(columns=4, cell_px=400)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
