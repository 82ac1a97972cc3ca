# SPDX-License-Identifier: GPL-3.0-or-later
"""For how long playing ever blocks Blender, with an engine that is well, slow, hung, or killed.

    .envs/blender/bin/python scripts/benchmark_playing.py [--trials 50] [--frames 24]

Needs bpy, and no window: a stand-in engine speaks the real protocol and misbehaves from its third picture on. Each
trial plays a waving hand at 24 frames a second in a view that wants every frame; measured is how long each frame's look
at the engine took, waiting included. A look of more than 50 ms counts as a freeze.
"""

from __future__ import annotations

import argparse
import importlib
import statistics
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
FREEZE_S = 0.05
FRAME_S = 1 / 24
FAULTS = {"well": (), "slow": ("slow:3",), "hung": ("frozen:3",), "killed": ("killed:3",)}


def addon(name: str) -> ModuleType:
    """A module of the extension in this checkout."""
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
    return importlib.import_module(f"blender_addon.{name}")


def view_on_hand() -> Any:
    """A view of 512 x 334 pixels from above the hand."""
    views, view_camera = addon("viewport.views"), addon("viewport.view_camera")
    window = np.diag([2.0, 3.07, -1.0, 0.0])
    window[2, 3], window[3, 2] = -0.02, -1.0
    looking_down = np.eye(4)
    looking_down[:3, 3] = (0.0, -0.09, -0.5)
    view = views.View(1, views.SOLID)
    region = SimpleNamespace(width=512, height=334)
    view.camera = view_camera.view_camera(region, SimpleNamespace(window_matrix=window, view_matrix=looking_down), 1.0)
    return view


def play(hand: bpy.types.Object, link: Any, frames: int) -> tuple[list[float], int]:
    """Seconds of every frame's look, and how many were late."""
    views, pacing = addon("viewport.views"), addon("core.pacing")
    view = view_on_hand()
    bone, taken = hand.pose.bones["index1"], []
    for frame in range(frames):
        began = time.monotonic()
        bone.rotation_quaternion = (1.0, 0.05 * (frame % 10), 0.0, 0.0)
        bpy.context.view_layer.update()
        views.read_again(view, [hand], bpy.context.evaluated_depsgraph_get())
        now = time.monotonic()
        moment = pacing.DrawMoment(now, pacing.Activity.PLAYING, FRAME_S, now, link.status.state == "ready")
        started = time.perf_counter()
        views.look(view, moment, drawing=True)
        taken.append(time.perf_counter() - started)
        views.end_turn()  # as Blender's event loop does before the next frame
        time.sleep(max(0.0, FRAME_S - (time.monotonic() - began)))
    return taken, view.pace.late


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=50, help="of each kind (default 50)")
    parser.add_argument("--frames", type=int, default=24, help="per trial (default 24)")
    options = parser.parse_args()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    registration, runtime = addon("registration"), addon("renderer.runtime")
    registration.register()
    joints_m = addon("core.posing").rest_joints_m("right")
    hand = addon("hand.armature").build_armature(bpy.context, "hand", joints_m, "right")
    stand_in = [sys.executable, "-I", str(ROOT / "tests" / "service" / "stand_in_engine.py")]
    print("engine    freezes   longest ms   median ms   late of frames")
    for name, fault in FAULTS.items():
        taken, late = [], 0
        for _ in range(options.trials):
            link = addon("renderer.link").EngineLink(lambda fault=fault: [*stand_in, *fault])
            runtime.use_link(link)
            link.start()
            link.wait_until_ready()
            times, missed = play(hand, link, options.frames)
            taken, late = taken + times, late + missed
            runtime.use_link(None)
        freezes = sum(seconds > FREEZE_S for seconds in taken)
        longest, median = 1e3 * max(taken), 1e3 * statistics.median(taken)
        print(f"{name:8} {freezes:8} {longest:12.1f} {median:11.1f} {late:10} of {len(taken)}", flush=True)
    registration.unregister()


if __name__ == "__main__":
    main()
