# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds for this user and machine: where the engine is, and how long it may take."""

from __future__ import annotations

import bpy

from . import manual
from .core import limits


def _look_again(_preferences: bpy.types.AddonPreferences, _context: bpy.types.Context) -> None:
    from .renderer import runtime  # here: it needs the preferences

    runtime.look_again()


class JGHandPreferences(bpy.types.AddonPreferences):
    """Preferences of the extension."""

    bl_idname = __package__

    engine_python: bpy.props.StringProperty(
        name="Renderer's Python",
        description="A Python that has another JGHand installed. Empty: the renderer that comes with the extension",
        subtype="FILE_PATH",
        update=_look_again,
    )  # type: ignore[valid-type]
    render_timeout_s: bpy.props.FloatProperty(
        name="Render Timeout",
        description="How long one rendered frame may take before the render fails with a report",
        default=limits.REQUEST_S,
        min=1.0,
        soft_max=600.0,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )  # type: ignore[valid-type]

    show_training: bpy.props.BoolProperty(
        name="Show Training",
        description="Show the panel for learning avatars in the JGHand tab",
    )  # type: ignore[valid-type]

    def draw(self, context: bpy.types.Context) -> None:
        """The page in Blender's preferences."""
        column = self.layout.column()
        column.use_property_split = True
        column.prop(self, "engine_python")
        column.prop(self, "render_timeout_s")
        column.prop(self, "show_training")
        # here: what draws needs what is kept, which needs the preferences
        from .renderer.panel import draw_status, draw_tools

        box = self.layout.box()
        draw_status(box, context)
        row = box.row(align=True)
        row.operator("jghand.restart_engine", icon="FILE_REFRESH")
        row.operator("jghand.show_log", icon="TEXT")
        draw_tools(self.layout)
        self.layout.operator("wm.url_open", text="Manual", icon="HELP").url = manual.page()


def preferences() -> JGHandPreferences | None:
    """The user's preferences; None while the package is used without being enabled as an extension."""
    addon = bpy.context.preferences.addons.get(__package__)
    return addon.preferences if addon is not None else None


CLASSES = (JGHandPreferences,)
