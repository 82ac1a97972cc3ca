"""Maps of a picture as an OpenEXR file, by the optional package OpenEXR (extra `formats`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError, package
from jghand_engine.files import writing


def write_exr(path: Path | str, channels: Mapping[str, np.ndarray], about: Mapping[str, str] | None = None) -> None:
    """Writes channels (H, W), float32 or uint32, losslessly packed, whole or not at all. about: texts of the header.

    InputError where the package is missing, RetryError when the disk is full.
    """
    exr = exr_package()
    header = {"type": exr.scanlineimage, "compression": exr.ZIP_COMPRESSION, **(about or {})}
    arrays = {name: np.ascontiguousarray(channel) for name, channel in channels.items()}
    with writing(path) as temporary:
        exr.File(header, arrays).write(str(temporary))


def exr_package() -> Any:
    return package("OpenEXR", "EXR files", "formats")


def probe_exr(path: Path, size_px: tuple[int, int]) -> None:
    """InputError unless `path` is a whole EXR file of (width, height) pixels, and where the package is missing.

    An EXR has no checksums: single changed bytes may pass.
    """
    exr = exr_package()
    try:
        # the size first: a broken one may claim more than there is memory
        with exr.File(str(path), header_only=True) as content:
            (left, top), (right, bottom) = (corner.tolist() for corner in content.header()["dataWindow"])
        if (right - left + 1, bottom - top + 1) != size_px:
            raise InputError(f"{path}", wanted=f"{size_px[0]} x {size_px[1]} pixels", came="another size")
        with exr.File(str(path)) as content:
            content.channels()  # of a damaged file the package keeps no part, and says so only here
    except (OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"cannot read {path}", came=str(error)[:200] or type(error).__name__) from error
