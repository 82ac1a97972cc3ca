# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds for this user and machine: the renderer and how long it may take; and the manual."""

from __future__ import annotations

from pathlib import Path

import bpy

from .renderer.state import REQUEST_S

# what is behind Blender's Online Manual (F1 over a button, or its context menu): a page that comes with the extension,
# so that it fits it and needs no network
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


def _look_again(_preferences: bpy.types.AddonPreferences, _context: bpy.types.Context) -> None:
    from .renderer import runtime  # here: it needs the preferences

    runtime.look_again()


class JGHandPreferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    engine_python: bpy.props.StringProperty(
        name="Renderer's Python",
        description="A Python that has another JGHand installed. Empty: the renderer that comes with the extension",
        subtype="FILE_PATH",
        update=_look_again,
    )
    render_device: bpy.props.EnumProperty(
        name="Render Device",
        description="What draws the hands. Graphics cards want a renderer's Python with the extra jghand[gpu]",
        items=(
            ("AUTO", "Automatic", "The processor, or a graphics card that `jghand bench --backend gpu` found faster"),
            ("GPU", "Graphics Card", "By Vulkan, Metal or Direct3D 12; an error where there is none"),
        ),
        update=_look_again,
    )
    render_timeout_s: bpy.props.FloatProperty(
        name="Render Timeout",
        description="How long one rendered frame may take before the render fails with a report",
        default=REQUEST_S,
        min=1.0,
        soft_max=600.0,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )

    show_training: bpy.props.BoolProperty(
        name="Show Training", description="Show the panel for learning avatars in the JGHand tab"
    )

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column()
        column.use_property_split = True
        column.prop(self, "engine_python")
        # here: what draws needs what is kept, which needs the preferences
        from .renderer import runtime
        from .renderer.panel import draw_status, draw_tools

        row = column.row()
        row.active = runtime.offers_graphics_card()
        row.prop(self, "render_device")
        column.prop(self, "render_timeout_s")
        column.prop(self, "show_training")
        box = self.layout.box()
        draw_status(box, context, buttons=False)
        row = box.row(align=True)
        row.operator("jghand.restart_engine", icon="FILE_REFRESH")
        row.operator("jghand.show_log", icon="TEXT")
        draw_tools(self.layout, context)
        self.layout.operator("wm.url_open", text="Manual", icon="HELP").url = PAGE.as_uri()


def preferences() -> JGHandPreferences | None:
    """The user's preferences; None while the package is used without being enabled as an extension."""
    addon = bpy.context.preferences.addons.get(__package__)
    return addon.preferences if addon is not None else None


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


CLASSES = (JGHandPreferences,)


def register() -> None:
    bpy.utils.register_manual_map(manual_map)


def unregister() -> None:
    bpy.utils.unregister_manual_map(manual_map)
