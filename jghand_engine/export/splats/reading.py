"""Splat files of anybody, read without trust: PLY, .splat, GLB with KHR_gaussian_splatting, SPZ 2 and 3.

What a file claims about itself is compared with the bytes that are there before memory is taken for it, and of what is
there only a part is decoded at a time. Only degree 0 of the harmonics is read. What can be read and is yet suspicious
is told in sentences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.export.splats.cloud import SplatCloud
from jghand_engine.export.splats.dot_splat import BYTES_PER_GAUSSIAN, ROW
from jghand_engine.export.splats.gltf_reading import glb_rows
from jghand_engine.export.splats.ply_reading import ply_rows
from jghand_engine.export.splats.rows import REMEDY, SplatRows, damaged
from jghand_engine.export.splats.spz_reading import spz_rows
from jghand_engine.limits import SPLAT_SIGMA_SANE_M, SPLAT_SIZE_SANE_M


@dataclass(frozen=True)
class SplatFile:
    """What a file holds. format: suffix · axes: "" where the file does not say · size_m: (3,) how far the centers
    reach · sigma_m, opacity: smallest and largest · findings: what is suspicious"""

    format: str
    gaussians: int
    axes: str
    size_m: tuple[float, ...]
    sigma_m: tuple[float, float]
    opacity: tuple[float, float]
    findings: tuple[str, ...]


@contextmanager
def open_splats(path: Path | str) -> Iterator[SplatRows]:
    """The Gaussians of a file, as long as it is open. InputError, which names the file and what is wrong, for one that
    cannot be read: another kind, damaged, cut off, or longer than it says."""
    place = Path(path)
    reader = _READERS.get(place.suffix.lower())
    if reader is None:
        raise InputError(f"{place}", wanted=f"a splat file: {', '.join(_READERS)}", came=place.suffix or "no suffix")
    try:
        with place.open("rb") as stream:
            if not place.stat().st_size:
                raise InputError(f"{place}", wanted="Gaussians", came="an empty file", remedy=REMEDY)
            yield reader(place, stream)
    except OSError as error:
        raise InputError(f"cannot read {place}", came=error.strerror or str(error), remedy="Check the name.") from error


def read_splats(path: Path | str) -> SplatFile:
    """What a file holds. InputError as `open_splats`, and for values that are no numbers."""
    seen = _Seen()
    with open_splats(path) as rows:
        for cloud in rows.parts():
            seen.add(cloud)
        reach_m = np.subtract(seen.position_m.high, seen.position_m.low)
        size_m = tuple(float(edge) for edge in reach_m) if rows.count else (0.0, 0.0, 0.0)
        return SplatFile(
            Path(path).suffix.lower()[1:], rows.count, rows.axes, size_m, seen.sigma_m.ends(), seen.opacity.ends(),
            (*rows.findings, *_findings(rows.count, seen, size_m)),
        )  # fmt: skip


class _Range:
    """The lowest and highest of numbers, in float64; axis: None for all of them together."""

    def __init__(self, axis: int | None = None) -> None:
        self.axis = axis
        self.low, self.high = np.array(np.inf), np.array(-np.inf)

    def add(self, numbers: np.ndarray) -> None:
        self.low = np.asarray(np.minimum(self.low, numbers.min(self.axis)))
        self.high = np.asarray(np.maximum(self.high, numbers.max(self.axis)))

    def ends(self) -> tuple[float, float]:
        return float(self.low), float(self.high)


@dataclass
class _Seen:
    """What the parts of a file have shown. wide: sizes above SPLAT_SIGMA_SANE_M · turnless: rotations of no length"""

    position_m: _Range = field(default_factory=lambda: _Range(axis=0))
    sigma_m: _Range = field(default_factory=_Range)
    opacity: _Range = field(default_factory=_Range)
    wide: int = 0
    turnless: int = 0

    def add(self, cloud: SplatCloud) -> None:
        self.position_m.add(cloud.positions_m)
        self.sigma_m.add(cloud.scales_m)
        self.opacity.add(cloud.opacity)
        self.wide += int((cloud.scales_m > SPLAT_SIGMA_SANE_M).sum())
        self.turnless += int((np.linalg.norm(cloud.rotations_wxyz, axis=1) < 1e-6).sum())


def _findings(count: int, seen: _Seen, size_m: tuple[float, ...]) -> Iterator[str]:
    if count == 0:
        yield "there are no Gaussians"
        return
    if max(size_m) > SPLAT_SIZE_SANE_M:
        yield f"the Gaussians reach over {max(size_m):.2g} m: some are probably damaged, or the unit is not the meter"
    if seen.sigma_m.low <= 0:
        yield "sizes are not all above 0: they are probably logarithms where meters are wanted"
    elif 2 * seen.wide > 3 * count:
        yield "half of the Gaussians are wider than a meter: sizes are probably linear where logarithms are wanted"
    if seen.opacity.low < 0 or seen.opacity.high > 1:
        yield "opacities are not all from 0 to 1: they are probably logits"
    elif seen.opacity.low >= 0.5 and seen.opacity.high <= 0.7311:
        yield "opacities are all from 0.5 to 0.73: they are probably no logits where logits are wanted"
    if seen.turnless:
        yield "some rotations have no length: readers drop those Gaussians or draw nothing"


def _dot_splat_rows(path: Path, stream: IO[bytes]) -> SplatRows:
    size = path.stat().st_size
    if size % BYTES_PER_GAUSSIAN:
        raise damaged(path, f"a multiple of {BYTES_PER_GAUSSIAN} bytes", size)
    table = np.memmap(stream, ROW, "r")

    def part(rows: slice) -> SplatCloud:
        some = table[rows]
        rgba = some["rgba"] / np.float32(255)
        turns = (some["rotation"].astype(np.float32) - 128) / 128
        return SplatCloud(np.array(some["position"]), np.array(some["scale"]), turns, rgba[:, 3], rgba[:, :3], "")

    return SplatRows(path, len(table), "", part)


_READERS: dict[str, Callable[[Path, IO[bytes]], SplatRows]] = {
    ".ply": ply_rows,
    ".splat": _dot_splat_rows,
    ".glb": glb_rows,
    ".spz": spz_rows,
}
