# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered mode: the same pictures as in Solid, drawn by the render engine. Source: BLENDER 7.2 and 7.3.

What `view_draw` writes is scene-linear, and the scene's view transform is applied to it: under Standard the view shows
the engine's numbers, under AgX it does not.
"""

from __future__ import annotations

import bpy
import gpu

from ..render.samples import background
from . import views


class ViewportEngine:
    """What a `bpy.types.RenderEngine` needs to show hands in 3D views: inherit from both."""

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Something changed in the scene. Every draw looks for itself what there is to show."""

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Draws one 3D view: the world's color, unless the film is transparent, and the hands before it."""
        scene = depsgraph.scene_eval
        if not scene.render.film_transparent:
            gpu.state.active_framebuffer_get().clear(color=(*background(scene.world), 1.0))
        views.draw(context, lambda: depsgraph, views.RENDERED)
