# SPDX-License-Identifier: GPL-3.0-or-later
"""The page that explains the panels; it comes with the extension, so that it fits it and needs no network."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..bridge.classes import register_classes, unregister_classes
from .common import PLUMBING

PAGE = Path(__file__).resolve().parents[1] / "assets" / "help.html"


class OpenHelp(bpy.types.Operator):
    """Operator: a section of the page in the browser."""

    bl_idname = "jghand.open_help"
    bl_label = "Help"
    bl_description = "Read about this panel in the browser"
    bl_options = PLUMBING

    section: bpy.props.StringProperty(options={"SKIP_SAVE", "HIDDEN"})  # type: ignore[valid-type]

    def execute(self, _context: bpy.types.Context) -> set[str]:
        return bpy.ops.wm.url_open(url=f"{PAGE.as_uri()}#{self.section}")


def register() -> None:
    """Adds the operator."""
    register_classes((OpenHelp,))


def unregister() -> None:
    """Takes it away."""
    unregister_classes((OpenHelp,))
