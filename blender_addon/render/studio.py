# SPDX-License-Identifier: GPL-3.0-or-later
"""The HDRI of Material Preview as light: what a 3D view stands in that does not show the world of the scene.

How it lies was found in a window (run, 5.2.2): at rotation 0 as an environment texture, a positive rotation turns its
light clockwise as seen from above, and without World Space Lighting it turns with the view, forward for +y.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import bpy
import numpy as np

from ..core.pacing import digest
from ..core.worlds import WorldLight
from ..errors import JGHandFailure
from . import worlds
from .world_nodes import Unread

# pictures of HDRIs by their paths, None for one that Blender cannot read; some MB each
_pictures: dict[str, np.ndarray | None] = {}
# the one that a view waits for
_wanted = ""


def light_of(space: bpy.types.SpaceView3D) -> WorldLight | None:
    """The light of a view's HDRI; None where it has none that can be read, and until `tend` has read it."""
    global _wanted
    shading = space.shading
    path = shading.selected_studio_light.path if shading.selected_studio_light is not None else ""
    if path not in _pictures:
        _wanted = path
        return None
    if _pictures[path] is None:
        return None
    cosine, sine = np.cos(shading.studiolight_rotate_z), np.sin(shading.studiolight_rotate_z)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    if not shading.use_studiolight_view_rotation:
        right, up, back = np.array(space.region_3d.view_matrix)[:3, :3]
        turn = turn @ np.stack([right, -back, up])
    return replace(_light(path, shading.studiolight_intensity), env_from_blender=turn)


@lru_cache(maxsize=4)
def _light(path: str, intensity: float) -> WorldLight:
    picture = _pictures[path]
    assert picture is not None  # `light_of` has checked it
    return WorldLight(picture * np.float32(intensity), key=digest([path, repr(intensity)]))


def tend() -> bool:
    """For the timer: reads the HDRI that a view waits for; says whether there was one."""
    global _wanted
    path, _wanted = _wanted, ""
    if not path:
        return False
    image = None
    try:
        image = bpy.data.images.load(path)
        _pictures[path] = worlds.picture_of(image)
    except (RuntimeError, JGHandFailure, Unread):  # no such file, or none that can be read
        _pictures[path] = None
    finally:
        if image is not None:
            bpy.data.images.remove(image)
    return True
