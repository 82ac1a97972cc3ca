"""Maps of a picture as an OpenEXR file, by the optional package OpenEXR (extra `formats`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError, install_extra
from jghand_engine.files import writing


def write_exr(path: Path | str, channels: Mapping[str, np.ndarray], about: Mapping[str, str] | None = None) -> None:
    """Writes channels (H, W), float32 or uint32, losslessly packed, whole or not at all. about: texts of the header.

    InputError where the package is missing, RetryError when the disk is full.
    """
    package = exr_package()
    header = {"type": package.scanlineimage, "compression": package.ZIP_COMPRESSION, **(about or {})}
    arrays = {name: np.ascontiguousarray(channel) for name, channel in channels.items()}
    with writing(path) as temporary:
        package.File(header, arrays).write(str(temporary))


def exr_package() -> Any:
    """The package OpenEXR. Raises InputError that says how to get it."""
    try:
        import OpenEXR  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise InputError(
            "EXR files", wanted="the package OpenEXR", came="none",
            remedy=install_extra("formats"),
        ) from error  # fmt: skip
    return OpenEXR
