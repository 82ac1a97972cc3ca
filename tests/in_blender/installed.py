# SPDX-License-Identifier: GPL-3.0-or-later
"""The zip is in, and the window shows it."""

from __future__ import annotations

import bpy


def step_the_extension_is_enabled(window):
    assert "bl_ext.user_default.jghand" in bpy.context.preferences.addons
    assert bpy.context.scene.jghand.render_preset == "final"


def step_the_side_bar_has_its_tab(window):
    yield from window.open_sidebar("JGHand")
    assert window.region("UI").active_panel_category == "JGHand"
    window.picture("side_bar")
