"""A skin from an image: reflectance and a relief in the template's UV (row = 1 - v), without any light.

Outside the hand's island the nearest skin goes on,
else filters would pull foreign color over the seams; the wrist's cut gets the color of the skin around it.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt, gaussian_filter

from jghand_engine.errors import InputError
from jghand_engine.template.builtin import ASSETS, load_template
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.texture import rasterize_uv, sample_bilinear

# edge of the baked texture: 0.4 mm of skin per texel, finer than a pixel of a whole hand at 334 x 512 (0.5 mm)
SKIN_PX = 1024
# edges that a skin image may have, pixels
TEXTURE_PX = (64, 8192)
# skin this far above the lower edge gives the wrist's cut its color, meters
WRIST_BAND_M = 0.012
# mottling that a coarse image cannot hold: (cell in meters, amount), and how strongly it darkens red, green, blue
MOTTLING = ((0.0026, 0.022), (0.0011, 0.022))
MOTTLING_RGB = (0.55, 1.0, 1.0)
# depth of a furrow that an image shows as a dark line, meters, and the shade (sRGB) at which it is nearly reached
RELIEF_M = 0.00022
RELIEF_SHADE = 0.035
# grain of skin that no image holds: its height and its cells, meters; finer ones are lost between texels
GRAIN_M = 0.000012
GRAIN_CELL_M = 0.0009


@dataclass(frozen=True)
class CaptureSkin:
    """rgb8 (S, S, 3) sRGB reflectance, relief_m (S, S) height in meters, nail (S, S) 0..1; row = 1 - v."""

    rgb8: np.ndarray
    relief_m: np.ndarray
    nail: np.ndarray


def make_skin(texture: Path, seed: int = 0) -> CaptureSkin:
    """InputError for a file that is no usable image."""
    texels = _Texels.of(load_template(), SKIN_PX)
    rgb, relief_m = _photographic(texels, read_texture(texture), seed)
    rgb, relief_m, nail = (texels.spread(values) for values in (rgb, relief_m, texels.nail))
    rgb[texels.cap] = rgb[texels.wrist].mean(axis=0)
    relief_m[texels.cap] = 0
    return CaptureSkin(np.clip(np.rint(255 * rgb), 0, 255).astype(np.uint8), relief_m, nail)


def read_texture(path: Path) -> np.ndarray:
    """(H, W, 3) sRGB 0..1 of a square image file. InputError says what is wrong with it."""
    thing = f"skin {path}"
    try:
        with warnings.catch_warnings(), Image.open(path) as image:
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            width, height = image.size
            if width != height or not TEXTURE_PX[0] <= width <= TEXTURE_PX[1]:
                low, high = TEXTURE_PX
                wanted = f"a square image of {low} to {high} pixels in the template's UV"
                raise InputError(thing, wanted=wanted, came=f"{width}x{height}")
            return np.asarray(image.convert("RGB"), dtype=np.float64) / 255
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise InputError(thing, wanted="an image that opens", came=str(error)[:200]) from error


def png_bytes(pixels: np.ndarray) -> bytes:
    """(H, W) uint8 or uint16, or (H, W, 3) uint8, as a PNG file."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG")
    return stream.getvalue()


@dataclass(frozen=True)
class _Texels:
    """The texels of the hand's island as points of its skin, and which are the wrist's cut and what is around it.

    covered:    (size, size) texels of the island; N of them
    position_m: (N, 3) meters, in the template's canonical frame
    nail:       (N,) 0..1, how far the point lies on a nail
    uv:         (N, 2)
    cap, wrist: (size, size)
    """

    size: int
    covered: np.ndarray
    position_m: np.ndarray
    nail: np.ndarray
    uv: np.ndarray
    cap: np.ndarray
    wrist: np.ndarray

    @classmethod
    def of(cls, template: HandTemplate, size: int) -> _Texels:
        skin = template.faces[: template.skin_face_count]
        skin_uv, cap_uv = template.face_uv[: len(skin)], template.face_uv[len(skin) :]
        position, covered = rasterize_uv(skin_uv, template.vertices_m[skin], size)
        position_m = position[covered]
        row, column = np.nonzero(covered)
        uv = np.stack([(column + 0.5) / size, 1 - (row + 0.5) / size], axis=1)
        with (ASSETS / "nails.png").open("rb") as stream, Image.open(stream) as image:
            nails = np.asarray(image.convert("L"), dtype=np.float64)[..., None] / 255
        nail = sample_bilinear(nails, uv)[:, 0]
        # a texel of margin, so that filtering at the edge of the disk sees nothing else
        radius = np.linalg.norm(cap_uv - cap_uv[0, 2], axis=-1).max() + 2 / size
        grid = (np.arange(size) + 0.5) / size
        cap = (grid[None] - cap_uv[0, 2, 0]) ** 2 + (1 - grid[:, None] - cap_uv[0, 2, 1]) ** 2 <= radius**2
        wrist = np.zeros_like(covered)
        wrist[covered] = position_m[:, 1] <= template.vertices_m[:, 1].min() + WRIST_BAND_M
        return cls(size, covered, position_m, nail, uv, cap & ~covered, wrist)

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Values of the texels (N,) or (N, C) -> the whole square; outside the island the nearest one goes on."""
        square = np.zeros((self.size, self.size, *values.shape[1:]))
        square[self.covered] = values
        nearest = np.asarray(distance_transform_edt(~self.covered, return_distances=False, return_indices=True))
        return square[nearest[0], nearest[1]]


def _photographic(texels: _Texels, image: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The same from an image: smoothly enlarged, with the fine mottling that it is too coarse to hold, and a relief
    from its own fine shades (a darker line is a furrow)."""
    large = _enlarged(image, texels.size)
    rgb = sample_bilinear(large, texels.uv)
    fine = sum(part * noise(texels.position_m, cell, seed + 11 + k) for k, (cell, part) in enumerate(MOTTLING))
    pigment = np.array(MOTTLING_RGB) * np.asarray(fine)[:, None] * (1 - texels.nail)[:, None]
    gray = texels.spread(rgb.mean(axis=1))
    px = texels.size / SKIN_PX
    detail = gaussian_filter(gray, 1.2 * px) - gaussian_filter(gray, 7 * px)
    relief = RELIEF_M * np.tanh(detail[texels.covered] / RELIEF_SHADE)
    relief = relief + GRAIN_M * noise(texels.position_m, GRAIN_CELL_M, seed + 17)
    return np.clip(rgb * np.exp(-pigment), 0, 1), relief * (1 - texels.nail)


def _enlarged(image: np.ndarray, size: int) -> np.ndarray:
    """The image at size x size, channel by channel in floating point: no steps of 8 bit in soft shades."""
    if image.shape[0] >= size:
        return image
    channels = [Image.fromarray(channel.astype(np.float32)) for channel in np.moveaxis(image, -1, 0)]
    return np.stack([np.asarray(c.resize((size, size), Image.Resampling.BICUBIC)) for c in channels], -1).astype(float)


def noise(position_m: np.ndarray, cell_m: float, seed: int) -> np.ndarray:
    """(N,) smooth noise of about zero mean and unit spread, features of about `cell_m` meters, the same every run.

    Another one than of persons' skins (captures/skin/noise.py): captures with a picture of skin keep their bits."""
    lattice = np.random.default_rng(seed).normal(size=(32, 32, 32))
    q = position_m / cell_m
    low = np.floor(q).astype(int)
    t = q - low
    t = t * t * (3 - 2 * t)
    total = np.zeros(len(position_m))
    for corner in np.ndindex(2, 2, 2):
        share = np.where(np.array(corner) == 1, t, 1 - t).prod(1)
        i, j, k = ((low + corner) % 32).T
        total += share * lattice[i, j, k]
    return 1.6 * total
