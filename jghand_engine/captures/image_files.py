"""Images and masks of a data set, read so that a broken file is named instead of ruining the training."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from jghand_engine.errors import InputError, first_line

# gray value of a mask file from which a pixel is hand: JPEG smears the edge over some pixels around the middle
MASK_THRESHOLD = 128
# last bytes of an image file in which its end mark must stand; some cameras pad the file behind it
IMAGE_TAIL_BYTES = 64

_REMEDY = "Get that file again, or leave it out of the set."
# PIL's readers raise the plain ones on damaged files; an image of few bytes may claim gigapixels
_DAMAGE = (OSError, ValueError, SyntaxError, EOFError, struct.error, zlib.error, Image.DecompressionBombError)
# the last bytes of a whole PNG and of a whole JPEG
_ENDS = {"PNG": b"IEND\xaeB`\x82", "JPEG": b"\xff\xd9"}


@dataclass(frozen=True)
class ImageFacts:
    """What the head of an image file says. width, height: pixels."""

    width: int
    height: int
    has_alpha: bool


def probe_image(path: Path) -> ImageFacts:
    """The facts in an image's head. InputError for a missing, broken or cut-off file.

    Nothing is decoded, but a PNG's checksums are compared: a decoder would show its damaged parts as noise. A JPEG has
    none.
    """
    with _opened(path, "image") as image:
        facts = ImageFacts(image.width, image.height, _has_alpha(image))
        end = _ENDS.get(image.format or "")
        image.verify()
        cut_off = end is not None and end not in _tail(path)
    if cut_off:
        raise InputError(f"cannot read the image {path}", came="a file that is cut off", remedy=_REMEDY)
    return facts


def image_texts(path: Path) -> dict[str, str]:
    """The texts in the head of a PNG, by key; its pixels are not looked at. InputError for a missing or broken head."""
    with _opened(path, "image") as image:
        return {str(key): str(text) for key, text in image.info.items() if isinstance(text, str)}


def probe_sized(path: Path, size_px: tuple[int, int], source: str) -> ImageFacts:
    """`probe_image`, and InputError unless the image is (width, height) pixels, as `source` says of its camera."""
    facts = probe_image(path)
    if (facts.width, facts.height) != size_px:
        raise InputError(
            f"size of {path}",
            wanted=f"{size_px[0]} x {size_px[1]} pixels, as {source} says",
            came=f"{facts.width} x {facts.height}",
            remedy="Images that were resized or turned do not fit their cameras: take the originals.",
        )
    return facts


def read_image(path: Path) -> np.ndarray:
    """The bytes of an image file as stored, (H, W, 3) or, with straight alpha, (H, W, 4) uint8, sRGB.

    InputError when it is missing or cannot be decoded whole.
    """
    with _opened(path, "image") as image:
        return np.asarray(image.convert("RGBA" if _has_alpha(image) else "RGB"))


def read_mask(path: Path) -> np.ndarray:
    """A mask file -> (H, W) float32, 0 or 1: what is at least half bright belongs to the hand, for JPEG blurs the edge.

    A mask with an alpha channel is its alpha. InputError as in `read_image`.
    """
    with _opened(path, "mask") as image:
        gray = np.asarray(image.getchannel("A") if "A" in image.getbands() else image.convert("L"))
    return (gray >= MASK_THRESHOLD).astype(np.float32)


@contextmanager
def _opened(path: Path, what: str) -> Iterator[Image.Image]:
    try:
        with Image.open(path) as image:
            yield image
    except FileNotFoundError as error:
        raise InputError(f"{what} {path}", came="no such file", remedy=_REMEDY) from error
    except _DAMAGE as error:
        raise InputError(f"cannot read the {what} {path}", came=first_line(error), remedy=_REMEDY) from error


def _has_alpha(image: Image.Image) -> bool:
    return "A" in image.getbands() or "transparency" in image.info


def _tail(path: Path) -> bytes:
    with open(path, "rb") as stream:
        stream.seek(0, os.SEEK_END)
        stream.seek(max(0, stream.tell() - IMAGE_TAIL_BYTES))
        return stream.read()
