"""Stands in for blender_addon/capture where there is no Blender: same lines of JSON, the vertices of the hand as dots.
Where the light varies every group of it gives the same, and the environments of Blender are plain.

The environment says what goes wrong: JGHAND_STAND_IN_FAILS_AT, number of a picture at which the process ends; how long
a picture takes: JGHAND_STAND_IN_TAKES_S; and which Blender it says it is: JGHAND_STAND_IN_BLENDER.
"""

import json
import os
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image, PngImagePlugin


def main() -> None:
    plan = json.loads((Path(sys.argv[1]) / "plan.json").read_text(encoding="utf-8"))
    vertices_m = np.load(Path(sys.argv[1]) / "hands.npz", allow_pickle=False)["vertices_m"]
    print(json.dumps({"ready": os.environ.get("JGHAND_STAND_IN_BLENDER", "5.0.1")}), flush=True)
    for name in plan["render"]["light"].get("shipped", ()):
        np.save(Path(sys.argv[1]) / "worlds" / f"{name}.npy", np.ones((4, 8, 3), np.float32))
    fails_at = int(os.environ.get("JGHAND_STAND_IN_FAILS_AT", "-1"))
    for number, line in enumerate(sys.stdin):
        if number == fails_at:
            sys.exit("the stand-in was told to fail")
        time.sleep(float(os.environ.get("JGHAND_STAND_IN_TAKES_S", "0")))
        job = json.loads(line)
        camera = plan["cameras"][job["camera"]]
        pixels = dots(vertices_m[job["pose"]], camera)
        picture = Image.fromarray(pixels)
        stamp = PngImagePlugin.PngInfo()
        stamp.add_text("jghand-stamp", job["stamp"])
        Path(job["file"]).parent.mkdir(parents=True, exist_ok=True)
        if job["light"]:
            np.savez_compressed(
                Path(job["file"]).with_suffix(".npz"), groups=np.stack([pixels[..., :3] / 255] * 3).astype(np.float16),
                alpha=pixels[..., 3], box_px=np.array([0, 0, *pixels.shape[1::-1]], np.int32), stamp=job["stamp"],
            )  # fmt: skip
        picture.save(job["file"], pnginfo=stamp)
        print(json.dumps({"file": job["file"], "seconds": 0.1, "cpu_seconds": 0.2}), flush=True)


def dots(vertices_m: np.ndarray, camera: dict) -> np.ndarray:
    """(H, W, 4) uint8: every vertex (V, 3) where it is seen, the brighter the nearer it is to its camera."""
    matrix = np.array(camera["camera_from_world"])
    seen = vertices_m @ matrix[:3, :3].T + matrix[:3, 3]
    column, row = np.floor(seen[:, :2] / seen[:, 2:] * camera["fx"] + [camera["cx"], camera["cy"]]).astype(int).T
    inside = (column >= 0) & (column < camera["width"]) & (row >= 0) & (row < camera["height"])
    rgba = np.zeros((camera["height"], camera["width"], 4), np.uint8)
    farthest_first = np.argsort(-seen[inside, 2], kind="stable")
    bright = np.clip(200 - 400 * (seen[:, 2] - seen[:, 2].min()), 0, 255)[inside][farthest_first]
    for channel, value in enumerate((bright, 0.8 * bright, 0.6 * bright, 255)):
        rgba[row[inside][farthest_first], column[inside][farthest_first], channel] = value
    return rgba


if __name__ == "__main__":
    main()
