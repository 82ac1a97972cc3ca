# SPDX-License-Identifier: GPL-3.0-or-later
"""The manual behind Blender's *Online Manual* (F1 over a button, or its context menu): a page that comes with the
extension, so that it fits it and needs no network."""

from __future__ import annotations

from pathlib import Path

import bpy

PAGE = Path(__file__).resolve().parent / "assets" / "help.html"
# the page's section about what a module adds
_SECTIONS = {
    "hand.ops": "hand",
    "hand.ops_pose": "pose",
    "hand.ops_motion": "motion",
    "renderer.ops": "engine",
    "render.ops": "view",
    "export.ops": "export",
    "train.ops": "training",
}
# settings by their class; Blender writes all names small
_SETTINGS = (
    ("bpy.types.jghandpreferences.*", "engine"),
    ("bpy.types.jghandscenesettings.*", "quality"),
    ("bpy.types.jghandoutputsettings.*", "export"),
    ("bpy.types.jghandtrainingsettings.*", "training"),
    ("bpy.types.jghand*", "hand"),
)


def page(section: str = "") -> str:
    """Address of a section, or of the whole page."""
    return f"{PAGE.as_uri()}#{section}" if section else PAGE.as_uri()


def manual_map() -> tuple[str, tuple[tuple[str, str], ...]]:
    """What Blender asks for: the page, and the section of everything that is ours."""
    from . import registration  # here: it needs this module

    operators = (
        (f"bpy.ops.{each.bl_idname}", _SECTIONS.get(".".join(each.__module__.split(".")[-2:]), "hand"))
        for module in registration.WITH_CLASSES
        for each in module.CLASSES
        if issubclass(each, bpy.types.Operator)
    )
    return PAGE.as_uri(), tuple((name, f"#{section}") for name, section in (*operators, *_SETTINGS))


def register() -> None:
    """Tells Blender of the page."""
    bpy.utils.register_manual_map(manual_map)


def unregister() -> None:
    """Takes it away."""
    bpy.utils.unregister_manual_map(manual_map)
