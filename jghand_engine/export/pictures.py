"""Pictures on disk: PNG with straight alpha, pictures on a background, contact sheets.

Inside the engine a picture is premultiplied RGBA in display-referred sRGB (RENDERING 3); PNG stores straight alpha.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jghand_engine.captures.image_files import read_image
from jghand_engine.color import to_bytes
from jghand_engine.errors import InputError
from jghand_engine.export.png import encode_png
from jghand_engine.files import write_file

RGB = tuple[float, float, float]

# what a transparent picture lies on in a video
VIDEO_BACKGROUND = (0.91, 0.90, 0.89)


def straight_rgba8(rgba_premultiplied: np.ndarray) -> np.ndarray:
    """(H, W, 4) premultiplied float -> (H, W, 4) uint8 with straight alpha; color 0 where alpha rounds to 0."""
    rgba = _checked(rgba_premultiplied)
    result = np.zeros(rgba.shape, np.uint8)
    result[..., 3] = to_bytes(rgba[..., 3])
    visible = result[..., 3] > 0
    result[visible, :3] = to_bytes(rgba[visible, :3] / rgba[visible, 3:])
    return result


def premultiplied(straight8: np.ndarray) -> np.ndarray:
    """(H, W, 3 | 4) uint8 with straight alpha, as `read_png` gives it -> (H, W, 4) premultiplied float32."""
    values = straight8.astype(np.float32) / 255.0
    if values.shape[2] == 3:
        return np.concatenate([values, np.ones_like(values[..., :1])], -1)
    return np.concatenate([values[..., :3] * values[..., 3:], values[..., 3:]], -1)


def flatten(rgba_premultiplied: np.ndarray, background: RGB) -> np.ndarray:
    """(H, W, 4) premultiplied float over an sRGB color (0..1 each) -> (H, W, 3) uint8."""
    rgba = _checked(rgba_premultiplied)
    return to_bytes(rgba[..., :3] + (1.0 - rgba[..., 3:]) * np.asarray(background, rgba.dtype))


def write_png(path: Path | str, picture: np.ndarray, texts: Mapping[str, str] | None = None) -> None:
    """A premultiplied float RGBA picture (H, W, 4), or ready bytes (H, W, 3 | 4), as an 8-bit PNG, written whole or not
    at all. texts: by key, packed into its head.

    Raises InputError for another shape or for values that are not finite, RetryError when the disk is full.
    """
    content = encode_png(picture if picture.dtype == np.uint8 else straight_rgba8(picture), texts)
    write_file(path, content)


def read_png(path: Path | str) -> np.ndarray:
    """The bytes of a picture file, (H, W, 3 | 4) uint8, straight alpha. InputError when it cannot be read."""
    return read_image(Path(path))


# ---- contact sheet ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """One picture of a contact sheet, with a short label below it. rgb8: (H, W, 3) uint8."""

    label: str
    rgb8: np.ndarray


@dataclass(frozen=True)
class SheetStyle:
    """columns: pictures per row · cell_px: width of a picture on the sheet · gap_px: space between and around ·
    background, ink: colors of the sheet and of the labels, sRGB 0..1."""

    columns: int = 6
    cell_px: int = 256
    gap_px: int = 14
    background: RGB = (0.955, 0.95, 0.94)
    ink: RGB = (0.28, 0.28, 0.28)


def contact_sheet(cells: Sequence[Cell], style: SheetStyle | None = None) -> np.ndarray:
    """The pictures in rows, left to right, each with its label: (H, W, 3) uint8. Pictures keep their proportions.

    Every row is as high as its highest picture. Raises InputError without pictures.
    """
    style = style or SheetStyle()
    if not cells:
        raise InputError("contact sheet", wanted="at least one picture", came="none")
    font = ImageFont.load_default(size=max(10, style.cell_px // 18))
    label_px = math.ceil(font.getbbox("Ag")[3] * 1.6)
    images = [_resized(cell.rgb8, style.cell_px) for cell in cells]
    rows = [list(zip(cells, images, strict=True))[i : i + style.columns] for i in range(0, len(cells), style.columns)]
    heights = [max(image.height for _, image in row) for row in rows]
    columns = min(style.columns, len(cells))
    width = columns * (style.cell_px + style.gap_px) + style.gap_px
    height = sum(heights) + len(rows) * (label_px + style.gap_px) + style.gap_px
    sheet = Image.new("RGB", (width, height), _color(style.background))
    draw = ImageDraw.Draw(sheet)
    top = style.gap_px
    for row, row_height in zip(rows, heights, strict=True):
        for column, (cell, image) in enumerate(row):
            left = style.gap_px + column * (style.cell_px + style.gap_px)
            sheet.paste(image, (left, top))
            middle = (left + style.cell_px / 2, top + row_height + label_px / 2)
            draw.text(middle, cell.label, fill=_color(style.ink), font=font, anchor="mm")
        top += row_height + label_px + style.gap_px
    return np.asarray(sheet)


def _resized(rgb8: np.ndarray, width_px: int) -> Image.Image:
    image = Image.fromarray(rgb8)
    size = (width_px, max(1, round(image.height * width_px / image.width)))
    return image if image.size == size else image.resize(size, Image.Resampling.LANCZOS)


def _color(color: RGB) -> tuple[int, int, int]:
    red, green, blue = to_bytes(np.asarray(color)).tolist()
    return red, green, blue


def _checked(rgba: np.ndarray) -> np.ndarray:
    if rgba.ndim != 3 or rgba.shape[2] != 4 or not np.issubdtype(rgba.dtype, np.floating):
        raise InputError("picture", wanted="shape (height, width, 4), floating", came=f"{rgba.shape} {rgba.dtype}")
    if not np.isfinite(rgba).all():
        count = int((~np.isfinite(rgba)).any(-1).sum())
        raise InputError("picture", wanted="finite values", came=f"{count} pixels that are not")
    return rgba
