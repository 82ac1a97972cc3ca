"""The golden files: arrays by name, packed small, and how a picture becomes such arrays."""

import functools
import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).parent
# of depth, meters; finer than what is compared, and coarser only for a hand deeper than 0.13 m
DEPTH_STEP_M = 2e-6
# marks in a picture's depth
NOTHING, NOT_COMPARED = 0, 2**16 - 1


def path_of(group: str) -> Path:
    return FOLDER / f"{group}.npz"


def write(group: str, arrays: dict[str, np.ndarray]) -> None:
    """Equal arrays give equal files: no times in them, and a stronger packing than numpy's own."""
    with zipfile.ZipFile(path_of(group), "w") as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.save(content, array, allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue(), zipfile.ZIP_LZMA)


@functools.cache
def read(group: str) -> dict[str, np.ndarray]:
    with np.load(path_of(group)) as archive:
        return dict(archive)


def of_case(group: str, case: str) -> dict[str, np.ndarray]:
    """The arrays of one case, which stand under its name and a bar."""
    return {name.removeprefix(f"{case}|"): array for name, array in read(group).items() if name.startswith(f"{case}|")}


def to_bytes(rgba: np.ndarray) -> np.ndarray:
    """(H, W, 4) premultiplied 0..1 in steps of 8 bits."""
    return np.rint(255 * np.clip(rgba, 0, 1)).astype(np.uint8)


def packed(rgba: np.ndarray, depth_m: np.ndarray, compared: np.ndarray) -> dict[str, np.ndarray]:
    """A picture, with a mark where it is not `compared` (H, W). Rows are stored as differences, which pack well."""
    there = (depth_m > 0) & compared
    near_m, far_m = float(depth_m[there].min()), float(depth_m[there].max())
    step_m = max(DEPTH_STEP_M, (far_m - near_m) / (NOT_COMPARED - 2))
    steps = np.where(depth_m > 0, 1 + np.rint((depth_m.astype(float) - near_m) / step_m), NOTHING)
    steps = np.where(compared, steps, NOT_COMPARED).astype(np.uint16)
    return {
        "rgba": np.diff(to_bytes(rgba), axis=1, prepend=np.uint8(0)),
        "depth": np.diff(steps, axis=1, prepend=np.uint16(0)),
        "depth_range": np.array([near_m, step_m]),
    }


def unpacked(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """rgba (H, W, 4) uint8, depth (H, W) meters, 0 where there is nothing, and where it is compared (H, W)."""
    rgba: Any = arrays["rgba"].cumsum(axis=1, dtype=np.uint8)
    steps = arrays["depth"].cumsum(axis=1, dtype=np.uint16)
    near_m, step_m = arrays["depth_range"]
    return rgba, np.where(steps == NOTHING, 0, near_m + (steps - 1.0) * step_m), steps != NOT_COMPARED
