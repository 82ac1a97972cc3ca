"""Run by the engine's Python: writes a stage and what the engine says about it, for `test_usd_import`.

usage: python usd_for_blender.py FOLDER VARIANT HANDEDNESS RADIANCE plain|detailed
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "export"))

from detail_samples import detail_of, flat
from usd_samples import engine_gaussians, engine_mesh, lively_motion, small_avatar

from jghand_engine.avatar.relief import Relief
from jghand_engine.color import srgb_to_linear
from jghand_engine.export.usd.package import UsdOptions, export_usd
from jghand_engine.export.usd.stage import Variant
from jghand_engine.hand.joints import LEVEL_NAMES, Handedness
from jghand_engine.render.camera import Camera


def main(folder: Path, variant: Variant, handedness: Handedness, radiance: str, kind: str) -> None:
    avatar, motion = small_avatar(), lively_motion(handedness, frames=12)
    if kind == "detailed":
        heights = np.random.default_rng(2).integers(-100, 101, (64, 64, 2)).astype(np.int8)
        avatar = replace(avatar, detail=replace(detail_of(flat(64, 0.0)), relief=Relief(heights)))
    up, eye_m = torch.tensor([0.0, 1.0, 0.0]), torch.tensor([0.1, 0.2, 0.6])
    camera = Camera.looking_at(eye_m, torch.zeros(3), up, width=640, height=480, focal_px=900)
    options = UsdOptions(default_variant=variant, radiance=radiance)
    export_usd(folder, avatar, motion, [camera], options)
    centers, radii = engine_gaussians(avatar, motion)
    np.savez(
        folder / "truth.npz",
        centers=centers,
        radii=radii,
        linear_rgb=srgb_to_linear(avatar.rgb),
        opacity=avatar.opacity,
        mesh=engine_mesh(motion),
        joints=motion.joints_m,
        names=np.array(LEVEL_NAMES),
        fps=motion.fps,
        camera_focal=camera.fx / camera.width,
        camera_aspect=camera.height / camera.width,
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), Variant(sys.argv[2]), Handedness(sys.argv[3]), *sys.argv[4:])
