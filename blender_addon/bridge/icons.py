# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that are computed as icons of panels and menus."""

from __future__ import annotations

import bpy.utils.previews
import numpy as np


def store_picture(icons: bpy.utils.previews.ImagePreviewCollection, key: str, picture: np.ndarray) -> None:
    """Puts an (H, W, 4) picture of straight sRGB, 0 to 1, top row first, into a collection, in place of one before."""
    icon = icons[key] if key in icons else icons.new(key)
    icon.image_size = icon.icon_size = (picture.shape[1], picture.shape[0])
    pixels = np.ascontiguousarray(picture[::-1], np.float32).ravel()
    icon.image_pixels_float.foreach_set(pixels)
    icon.icon_pixels_float.foreach_set(pixels)
