"""What programs other than Pixar's read of the splats in a USD file, as a NumPy file.

    python read_usd.py lightusd|fourdgs FILE TABLE FRAMES

Runs in the environment of the clients. TABLE gets positions_m (F, N, 3), scales_m (F, N, 3), turns_wxyz (F, N, 4), rgb
(F, N, 3), which are what an attribute has at each frame, and opacity (N,). fourdgs reads the Default time alone: F is 1
then.
"""

from __future__ import annotations

import sys

import numpy as np

SH_C0 = 0.28209479177387814
HARMONICS = "radiance:sphericalHarmonicsCoefficients"


def with_lightusd(path: str, frames: int) -> dict[str, np.ndarray]:
    import lightusd  # pyright: ignore[reportMissingImports]

    stage = lightusd.load(path)
    (prim,) = stage.prims_of_type("ParticleField3DGaussianSplat")
    half = "h" if "positionsh" in prim.attributes else ""
    first = int(stage.start_time)
    wrist = "xformOp:translate" if "xformOp:translate" in prim.attributes else None

    def at(name: str, time: float) -> np.ndarray:
        return np.asarray(prim.attribute(name).get(time=time), np.float64)

    def moving(name: str) -> np.ndarray:
        return np.stack([at(f"{name}{half}", float(first + index)) for index in range(frames)])

    positions_m = moving("positions")
    if wrist is not None:
        positions_m += np.stack([at(wrist, float(first + index)) for index in range(frames)])[:, None]
    return {
        "positions_m": positions_m,
        "scales_m": moving("scales"),
        "turns_wxyz": moving("orientations"),
        "rgb": 0.5 + SH_C0 * moving(HARMONICS),
        "opacity": np.asarray(prim[f"opacities{half}"], np.float64),
    }


def with_fourdgs(path: str, frames: int) -> dict[str, np.ndarray]:
    import fourdgs.usd  # pyright: ignore[reportMissingImports]

    data = fourdgs.usd.from_usd(path).gaussians
    return {
        "positions_m": np.asarray(data.positions, np.float64)[None],
        "scales_m": np.asarray(data.scales, np.float64)[None],
        "turns_wxyz": np.asarray(data.rotations, np.float64)[None, :, [3, 0, 1, 2]],
        "rgb": np.asarray(data.colors, np.float64)[None, :, :3],
        "opacity": np.asarray(data.colors, np.float64)[:, 3],
    }


READERS = {"lightusd": with_lightusd, "fourdgs": with_fourdgs}

if __name__ == "__main__":
    client, source, target, count = sys.argv[1:]
    np.savez(target, **READERS[client](source, int(count)))  # type: ignore[arg-type]
