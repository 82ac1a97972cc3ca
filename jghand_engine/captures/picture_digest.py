"""What tells two sets of pictures apart, wherever their folders lie."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from jghand_engine.captures.sample import Sample


def picture_names(samples: Sequence[Sample]) -> list[str]:
    """A line for each picture, in their order."""
    return [f"{one.capture} {one.sequence} {one.frame} {one.camera_name}" for one in samples]


def picture_digest(samples: Sequence[Sample]) -> str:
    """16 hexadecimal digits that stand for these pictures, in whatever order: of their names and joints.

    The joints, because our own captures name their pictures alike.
    """
    lines = [
        f"{name} {np.rint(1e4 * one.joints_m[np.isfinite(one.joints_m)]).astype(int).tolist()}"
        for name, one in zip(picture_names(samples), samples, strict=True)
    ]
    return hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()[:16]
