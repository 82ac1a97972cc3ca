# SPDX-License-Identifier: GPL-3.0-or-later
"""Has areas drawn anew after something changed that Blender does not know of."""

from __future__ import annotations

import bpy

# where panels of ours stand: the sidebar, render settings, the preferences
PANELS = ("VIEW_3D", "PROPERTIES", "PREFERENCES")


def redraw(*kinds: str) -> None:
    """All areas of these types, in every window; without any: views and their sidebars."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in (kinds or ("VIEW_3D",)):
                area.tag_redraw()
