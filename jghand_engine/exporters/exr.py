"""Maps of a picture as an OpenEXR file, by the optional package OpenEXR (extra `formats`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
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
            remedy="Install the extra: pip install 'jghand[formats]'.",
        ) from error  # fmt: skip
    return OpenEXR


def read_exr_text(path: Path, name: str) -> str:
    """A text in the header of a whole EXR file, '' where it has none of that name. InputError for a missing or broken
    file, and where the package is missing."""
    package = exr_package()
    try:
        with package.File(str(path)) as content:
            return str(content.header().get(name, ""))
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"cannot read {path}", came=str(error)[:200] or type(error).__name__) from error
