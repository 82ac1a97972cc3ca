# SPDX-License-Identifier: GPL-3.0-or-later
"""What a step does with Blender's window: a real pointer and real keys (xdotool), real pictures of the screen.

Places on the screen are in Blender's way: pixels from the window's lower left corner.
"""

from __future__ import annotations

import subprocess
from collections.abc import Generator
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy
import numpy as np

from in_blender.pictures import read_ppm, write_png

Waits = Generator[Any, None, None]


class Window:
    """The one window of the Blender under test. out: folder for pictures and files; addon: the extension's package."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.addon: ModuleType | None = None
        self._shots = 0

    # ---- where things are ----

    @property
    def window(self) -> bpy.types.Window:
        return bpy.context.window_manager.windows[0]

    def area(self, kind: str = "VIEW_3D") -> bpy.types.Area:
        """The largest area of a kind."""
        return max((a for a in self.window.screen.areas if a.type == kind), key=lambda a: a.width * a.height)

    def region(self, kind: str = "WINDOW", area: bpy.types.Area | None = None) -> bpy.types.Region:
        return next(region for region in (area or self.area()).regions if region.type == kind)

    def space(self) -> bpy.types.SpaceView3D:
        return self.area().spaces.active

    def override(self, area: bpy.types.Area | None = None, **more: object):
        """Context in which operators work as in the 3D view."""
        area = area or self.area()
        return bpy.context.temp_override(
            window=self.window, screen=self.window.screen, area=area, region=self.region(area=area), **more
        )

    def redraw(self) -> None:
        for area in self.window.screen.areas:
            area.tag_redraw()

    # ---- pictures ----

    def screen(self) -> np.ndarray:
        """(H, W, 3) uint8, top row first: what is on the screen now."""
        done = subprocess.run(["import", "-window", "root", "-depth", "8", "ppm:-"], capture_output=True, check=True)
        return read_ppm(done.stdout)

    def picture(self, name: str) -> np.ndarray:
        """The screen, kept as OUT/NN_name.png too."""
        self._shots += 1
        pixels = self.screen()
        write_png(self.out / f"{self._shots:02d}_{name}.png", pixels)
        return pixels

    def crop(self, pixels: np.ndarray, region: bpy.types.Region | None = None) -> np.ndarray:
        """The part of a picture of the screen that a region shows; without one the 3D view, between its side bars."""
        region = region or self.region()
        left, right = region.x, region.x + region.width
        if region.type == "WINDOW":
            for kind, sign in (("TOOLS", 1), ("UI", -1)):
                bar = self.region(kind)
                if bar.width > 1:
                    left, right = (left + bar.width, right) if sign > 0 else (left, right - bar.width)
        top = self.window.height - (region.y + region.height)
        return pixels[top : top + region.height, left:right]

    # ---- pointer and keys ----

    def move(self, x: float, y: float) -> Waits:
        _xdotool("mousemove", round(x), round(self.window.height - y))
        yield 0.3
        _xdotool("mousemove_relative", "--", 1, 1)  # Blender looks at what lies below a pointer that moves
        yield 0.2

    def click(self, x: float, y: float) -> Waits:
        yield from self.move(x, y)
        _xdotool("click", 1)
        yield 0.6

    def point_at_view(self) -> Waits:
        """Keys go to the area below the pointer."""
        region = self.region()
        yield from self.move(region.x + region.width * 0.5, region.y + region.height * 0.25)

    def key(self, name: str) -> Waits:
        """Presses a key, such as F12, Escape, ctrl+z."""
        _xdotool("key", name)
        yield 0.5

    # ---- things that many steps want ----

    def open_sidebar(self, tab: str = "JGHand", width_px: int | None = None) -> Waits:
        """Shows the side bar of the 3D view with one tab in front."""
        self.space().show_region_ui = True
        self.redraw()
        yield 0.7  # the tab can be chosen once the bar was drawn
        self.region("UI").active_panel_category = tab
        self.redraw()
        yield 0.7

    def shading(self, kind: str) -> Waits:
        """SOLID, MATERIAL or RENDERED."""
        self.space().shading.type = kind
        self.redraw()
        yield 1.0

    def look_at(self, centre, distance: float, turn: tuple[float, float, float] = (1.35, 0.0, 0.3)) -> Waits:
        """Turns the view: centre in Blender units, Euler angles."""
        from mathutils import Euler

        view = self.space().region_3d
        view.view_perspective = "PERSP"
        view.view_location, view.view_distance = centre, distance
        view.view_rotation = Euler(turn).to_quaternion()
        self.redraw()
        yield 0.5

    def runtime(self):
        """The extension's own module of that name."""
        import importlib

        assert self.addon is not None
        return importlib.import_module(".runtime", self.addon.__name__)


def _xdotool(*arguments: object) -> None:
    subprocess.run(["xdotool", *map(str, arguments)], capture_output=True, check=True)
