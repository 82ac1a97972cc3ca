"""What Python packages read from a splat file, as a table of 32-bit floats, a row for a Gaussian.

    python read_with_python.py gsply|gaussforge|fourdgs FILE TABLE

Runs in the environment of the clients. Row: center (3), sigma (3), quaternion w, x, y, z (4), color (3), opacity (1).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

SH_C0 = 0.28209479177387814


def logistic(values):
    return 1 / (1 + np.exp(-np.asarray(values, np.float64)))


def table(positions, ln_sigma, rotations_wxyz, harmonics, logit):
    parts = positions, np.exp(ln_sigma), rotations_wxyz, np.asarray(harmonics) * SH_C0 + 0.5, logistic(logit)
    count = len(positions)
    return np.concatenate([np.asarray(part, np.float64).reshape(count, -1) for part in parts], 1)


def with_gsply(path: Path):
    import gsply  # pyright: ignore[reportMissingImports]

    readers = {
        ".ply": lambda p: gsply.plyread(p),
        ".spz": lambda p: gsply.read_spz(p),
        ".sog": lambda p: gsply.sogread(p),
    }
    data = readers[path.suffix](path)
    return table(data.means, data.scales, data.quats, np.reshape(data.sh0, (-1, 3)), data.opacities)


def with_gaussforge(path: Path):
    """Its own reading gives no arrays in this version: it converts to PLY, whose fields are read by name."""
    import gaussforge  # pyright: ignore[reportMissingImports]

    answer = gaussforge.GaussForge().convert(path.read_bytes(), path.suffix[1:], "ply")
    if "error" in answer:
        raise SystemExit(answer["error"])
    return of_ply(bytes(answer["data"]))


def of_ply(content: bytes):
    end = content.index(b"end_header\n") + len(b"end_header\n")
    names = [line.split()[2] for line in content[:end].decode().splitlines() if line.startswith("property float ")]
    rows = np.frombuffer(content, "<f4", offset=end).reshape(-1, len(names)).astype(np.float64)

    def columns(*wanted: str):
        return np.stack([rows[:, names.index(name)] for name in wanted], -1)

    return table(
        columns("x", "y", "z"),
        columns("scale_0", "scale_1", "scale_2"),
        columns("rot_0", "rot_1", "rot_2", "rot_3"),
        columns("f_dc_0", "f_dc_1", "f_dc_2"),
        columns("opacity"),
    )


def with_fourdgs(path: Path):
    import fourdgs.gltf  # pyright: ignore[reportMissingImports]

    data = fourdgs.gltf.from_gltf(str(path)).gaussians
    turns = np.asarray(data.rotations)[:, [3, 0, 1, 2]]
    return np.concatenate([data.positions, data.scales, turns, data.colors], 1)


READERS = {"gsply": with_gsply, "gaussforge": with_gaussforge, "fourdgs": with_fourdgs}

if __name__ == "__main__":
    client, source, target = sys.argv[1:]
    rows = READERS[client](Path(source))
    Path(target).write_bytes(np.ascontiguousarray(rows, "<f4").tobytes())
