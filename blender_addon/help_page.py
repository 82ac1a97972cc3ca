# SPDX-License-Identifier: GPL-3.0-or-later
"""The page that explains the panels; it comes with the extension, so that it fits it and needs no network."""

from __future__ import annotations

from pathlib import Path

import bpy

from .ops import PLUMBING

PAGE = Path(__file__).resolve().parent / "assets" / "help.html"


class OpenHelp(bpy.types.Operator):
    """Operator: a section of the page in the browser."""

    bl_idname = "jghand.open_help"
    bl_label = "Help"
    bl_description = "Read about this panel in the browser"
    bl_options = PLUMBING

    section: bpy.props.StringProperty(options={"SKIP_SAVE", "HIDDEN"})  # type: ignore[valid-type]

    def execute(self, _context: bpy.types.Context) -> set[str]:
        return bpy.ops.wm.url_open(url=f"{PAGE.as_uri()}#{self.section}")


CLASSES = (OpenHelp,)
