"""Whether an export fits: said before minutes of work, not after."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from jghand_engine.export.usd.options import Package
from jghand_engine.export.usd.zip import check_zip_size
from jghand_engine.files import check_room
from jghand_engine.limits import USD_FRAME_BYTES, USD_STATIC_BYTES, USD_STATIC_BYTES_PER_GAUSSIAN


@dataclass(frozen=True)
class Expected:
    """gaussians, frames: of the export · sample_bytes: of all Gaussians in one frame, 0 where they are in none."""

    gaussians: int
    frames: int
    sample_bytes: int

    @property
    def size(self) -> int:
        """Of all layers together, bytes; rather too many."""
        return self._beside + self.sample_bytes * (self.frames + 1)

    def room(self, package: Package) -> int:
        """What an export takes at most while it is written, bytes. The layers of a .usdz are whole when it is packed;
        those of a .usdc never hold the frames of Gaussians."""
        layers = {Package.LAYERS: 0, Package.USDC: self._beside + self.sample_bytes, Package.USDZ: self.size}
        return self.size + layers[package]

    @property
    def _beside(self) -> int:
        still = self.gaussians * USD_STATIC_BYTES_PER_GAUSSIAN + USD_STATIC_BYTES
        return still + self.frames * USD_FRAME_BYTES


def check_space(folder: Path, expected: Expected, package: Package) -> None:
    """Raises RetryError when the export cannot fit on the disk of `folder`, InputError when not into its package."""
    if package is Package.USDZ:
        check_zip_size(expected.size, f"{expected.frames} frames")
    check_room(folder, expected.room(package), "the USD stage")
