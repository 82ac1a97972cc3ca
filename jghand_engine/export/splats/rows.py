"""Gaussians of a file whose content is not trusted, looked at some at a time: nothing is copied as a whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.export.splats.cloud import SplatCloud
from jghand_engine.limits import SPLAT_PART_ROWS

REMEDY = "Write the file again with the program that it came from."


def damaged(path: Path, wanted: str, came: object) -> InputError:
    """The error of a file that is not what it says."""
    return InputError(f"{path}", wanted=wanted, came=str(came)[:200], remedy=REMEDY)


@dataclass(frozen=True)
class SplatRows:
    """The Gaussians of an open file. axes: of the numbers, "" where the file does not say · part: those of a slice ·
    findings: what is suspicious beside their numbers"""

    path: Path
    count: int
    axes: str
    part: Callable[[slice], SplatCloud]
    findings: tuple[str, ...] = ()

    def parts(self) -> Iterator[SplatCloud]:
        """All of them, at most SPLAT_PART_ROWS at a time. InputError for values that are no numbers."""
        for start in range(0, self.count, SPLAT_PART_ROWS):
            cloud = self.part(slice(start, start + SPLAT_PART_ROWS))
            for name in ("positions_m", "scales_m", "rotations_wxyz", "opacity", "rgb"):
                if not np.isfinite(getattr(cloud, name)).all():
                    raise InputError(
                        f"{self.path}, {name}", wanted="finite numbers", came="NaN or infinity", remedy=REMEDY
                    )
            yield cloud
