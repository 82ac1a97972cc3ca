"""Gaussians as a SOG file (tables in WebP pictures, EXPORT 9), by the optional package gaussforge (extra `formats`)."""

from __future__ import annotations

from typing import Any

from jghand_engine.errors import InputError, install_extra
from jghand_engine.export.splats.cloud import SplatCloud
from jghand_engine.export.splats.ply import ply_bytes

# of a hand about 10; an estimate for the check of the disk
BYTES_PER_GAUSSIAN = 20


def sog_bytes(cloud: SplatCloud) -> bytes:
    """The content of a file; the Gaussians come in another order. InputError where the package is missing."""
    answer = converter().convert(ply_bytes(cloud), "ply", "sog")
    if "error" in answer:
        raise InputError("SOG file", wanted="Gaussians that gaussforge can write", came=str(answer["error"])[:200])
    return bytes(answer["data"])


def converter() -> Any:
    """gaussforge's converter. Raises InputError that says how to get it."""
    try:
        import gaussforge  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise InputError(
            "SOG files", wanted="the package gaussforge", came="none",
            remedy=install_extra("formats"),
        ) from error  # fmt: skip
    return gaussforge.GaussForge()
