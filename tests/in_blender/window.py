# SPDX-License-Identifier: GPL-3.0-or-later
"""What a step does with Blender's window: a real pointer and real keys (xdotool), real pictures of the screen.

Places on the screen are in Blender's way: pixels from the window's lower left corner.
"""

import importlib
import subprocess
from collections.abc import Generator
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy
import numpy as np

from in_blender.pictures import read_ppm, write_png

Waits = Generator[Any, None, None]


# by its name xdotool takes the level of the key that wants Alt too
F12 = "96"


class Window:
    """The one window of the Blender under test. out: folder for pictures and files; archive: the zip; addon: the
    extension's package, None before it is installed."""

    def __init__(self, out: Path, archive: Path) -> None:
        self.out, self.archive = out, archive
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

    def press(self) -> Waits:
        """The left button goes down, and stays."""
        _xdotool("mousedown", 1)
        yield 0.3

    def drag(self, x: float, y: float) -> Waits:
        """Moves a pointer whose button is down."""
        _xdotool("mousemove", round(x), round(self.window.height - y))
        yield 0.15

    def release(self) -> Waits:
        _xdotool("mouseup", 1)
        yield 0.4

    def point_at_view(self) -> Waits:
        """Keys go to the area below the pointer."""
        region = self.region()
        yield from self.move(region.x + region.width * 0.5, region.y + region.height * 0.25)

    def key(self, name: str) -> Waits:
        """Presses a key, such as F12, Escape, ctrl+z."""
        _xdotool("key", name.replace("F12", F12))
        yield 0.5

    # ---- things that many steps want ----

    def f12(self, name: str = "f12") -> Waits:
        """Renders the image, until it is on the screen, of which that is a picture."""
        done: list[bool] = []
        bpy.app.handlers.render_complete.append(lambda *_: done.append(True))
        yield from self.point_at_view()
        yield from self.key("F12")
        yield lambda: done
        yield 2.0
        self.picture(name)

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

    def look_at(self, center, distance: float, turn: tuple[float, float, float] = (1.35, 0.0, 0.3)) -> Waits:
        """Turns the view: center in Blender units, Euler angles."""
        from mathutils import Euler

        view = self.space().region_3d
        view.view_perspective = "PERSP"
        view.view_location, view.view_distance = center, distance
        view.view_rotation = Euler(turn).to_quaternion()
        self.redraw()
        yield 0.5

    def call(self, operator: str, **properties: object) -> set[str]:
        """Calls an operator (`jghand.add_hand`) as a button of the side bar does."""
        family, _, action = operator.partition(".")
        with self.override():
            return getattr(getattr(bpy.ops, family), action)(
                "INVOKE_DEFAULT", True, **properties
            )  # True: can be undone

    def add_hand(self, side: str = "right") -> None:
        """A hand with a camera, framed in the view."""
        self.call("jghand.add_hand", handedness=side)
        self.call("jghand.add_camera")
        self.call("view3d.view_selected")

    def modal(self, name: str) -> bpy.types.Operator | None:
        """The operator of this name (`JGHAND_OT_import_motion`) that works in turns now; None where none does."""
        return next((one for one in self.window.modal_operators if one.bl_idname == name), None)

    def choose_file(self, operator: str, path: Path) -> Waits:
        """Calls an operator that asks for a file, and chooses this one in Blender's browser."""
        bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
        self.call(operator)
        yield from self.in_browser(path)

    def in_browser(self, path: Path) -> Waits:
        """Chooses a file in the browser that opens."""
        yield lambda: any(area.type == "FILE_BROWSER" for area in self.window.screen.areas)
        yield 0.7
        area = self.area("FILE_BROWSER")
        area.spaces.active.params.directory = str(path.parent).encode()
        area.spaces.active.params.filename = path.name
        with self.override(area):
            bpy.ops.file.execute("INVOKE_DEFAULT")

    def module(self, name: str) -> ModuleType:
        """A module of the installed extension, such as `viewport.views`."""
        assert self.addon is not None
        return importlib.import_module(f"{self.addon.__name__}.{name}")

    def runtime(self) -> ModuleType:
        """The extension's module of that name, with the link to the engine."""
        return self.module("renderer.runtime")

    def ready(self) -> Waits:
        """Waits until the engine runs; AssertionError says why it does not."""
        yield lambda: self.runtime().link().status.state in ("ready", "failed")
        status = self.runtime().link().status
        assert status.state == "ready", status.failure

    def settle(self) -> Waits:
        """Waits until every view shows the picture that it wants in the end, and half a second more."""
        yield from self.ready()
        views, pacing = self.module("viewport.views"), self.module("core.pacing")
        quiet = 0

        def rests() -> bool:
            nonlocal quiet
            shown = list(views.all_views())
            mistakes = [str(view.failure) for view in shown if view.failure and view.failure.kind == "internal"]
            assert not mistakes, mistakes  # asked again it would be the same
            done = shown and not any(
                pacing.is_open(view.pace) or view.pace.shown is None or pacing.due_s(view.pace, view.settings) < 1e9
                for view in shown
            )
            quiet = quiet + 1 if done and not self.runtime().link().status.busy else 0
            return quiet >= 10

        yield rests
        self.redraw()
        yield 0.3

    def hide_overlays(self, hide: bool = True) -> None:
        """Bones, grid and gizmos away, so that nothing but the picture is there."""
        space = self.space()
        space.overlay.show_overlays = not hide
        space.show_gizmo = not hide


def _xdotool(*arguments: object) -> None:
    subprocess.run(["xdotool", *map(str, arguments)], capture_output=True, check=True)
