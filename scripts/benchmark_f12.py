# SPDX-License-Identifier: GPL-3.0-or-later
# This script imports blender_addon (GPL-3.0-or-later) and bpy (GPL), so it is under the GPL too: blender_addon/LICENSE.
"""What F12 costs over the engine's own time.

    .envs/blender/bin/python scripts/benchmark_f12.py [--size 512x334] [--frames 40] [--engine-python PATH]

Every frame another pose; the picture is rendered, not written. Printed are medians and 95 % of: the whole of F12, the
engine's own time as its receipt says, the difference of the two (wanted: at most 50 ms), and of that difference what
Blender's evaluation takes and what the way to the engine and back does. Figures of a busy machine mean nothing: the
load is printed too. Exit code 1 when the median is above what is wanted.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import statistics
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OVERHEAD_MS = 50.0
WARM_UP = 3


def main() -> int:
    options = _parser().parse_args()
    if importlib.util.find_spec("bpy") is None:
        print("This needs a Python with bpy: run it with .envs/blender/bin/python.", file=sys.stderr)
        return 2
    sys.path.insert(0, str(ROOT))
    width, height = (int(side) for side in options.size.split("x"))
    rows = _measured(width, height, options.frames + WARM_UP, options.engine_python)[WARM_UP:]
    print(f"{width} x {height}, {len(rows)} frames, {os.cpu_count()} processors, load {os.getloadavg()[0]:.2f}")
    for name in rows[0]:
        values = sorted(row[name] for row in rows)
        late = values[min(len(values) - 1, int(0.95 * len(values)))]
        print(f"{name:32}median {statistics.median(values):8.2f} ms   95 % below {late:8.2f} ms")
    overhead_ms = statistics.median(row["F12 over the engine"] for row in rows)
    print("ok" if overhead_ms <= OVERHEAD_MS else f"MISSED: wanted at most {OVERHEAD_MS:g} ms over the engine")
    return 0 if overhead_ms <= OVERHEAD_MS else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="512x334", metavar="WIDTHxHEIGHT")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--engine-python", metavar="PATH")
    return parser


def _measured(width: int, height: int, frames: int, engine_python: str | None) -> list[dict[str, float]]:
    """Milliseconds of every frame, by what they are of."""
    import bpy  # pyright: ignore[reportMissingImports]

    from blender_addon import registration
    from blender_addon.core import posing
    from blender_addon.hand import armature
    from blender_addon.render import camera
    from blender_addon.renderer import runtime
    from blender_addon.renderer.link import EngineLink
    from blender_addon.renderer.process import engine_command

    registration.register()
    words = engine_command(engine_python, checkout=ROOT)
    runtime.use_link(EngineLink(lambda: words))
    try:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        joints_m = posing.rest_joints_m("right")
        hand = armature.build_armature(bpy.context, "right", joints_m, "right")
        camera.set_picture_size(scene.render, width, height)
        scene.camera = camera.add_framing_camera(bpy.context, "CamPalm", joints_m[None], "right")
        scene.render.engine, scene.render.film_transparent = "JGHAND", True
        scene.view_settings.view_transform = "Standard"
        rows = []
        for frame in range(frames):
            for finger in ("index", "middle", "ring", "pinky"):
                hand.pose.bones[f"{finger}2"].rotation_quaternion = (1.0, 0.4 * frame / frames, 0.0, 0.0)
            bpy.context.view_layer.update()
            rows.append(_frame(bpy, runtime))
        return rows
    finally:
        runtime.use_link(None)
        registration.unregister()


def _frame(bpy, runtime) -> dict[str, float]:
    started = time.perf_counter()
    bpy.ops.render.render()
    whole_ms = 1e3 * (time.perf_counter() - started)
    note = runtime.render_note
    engine_ms = sum(report["total_ms"] for report in note.reports)
    return {
        "F12": whole_ms,
        "the engine's own time": engine_ms,
        "F12 over the engine": whole_ms - engine_ms,
        "  evaluating, reading": note.evaluate_ms,
        "  there and back": note.request_ms - engine_ms,
        "  passes, Blender": whole_ms - note.evaluate_ms - note.request_ms,
    }


if __name__ == "__main__":
    sys.exit(main())
