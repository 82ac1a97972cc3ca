# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a change of pose takes to become a new picture in Blender's viewport, besides Blender's own work.

    python scripts/benchmark_viewport.py [--out FOLDER]

Runs in a real Blender window (scripts/test_in_blender.py says what that needs) with the real engine. For each pose, in
ms: `ask` reading the evaluated hands and sending the request; `engine` from then until the answer is there, with the
way to the engine and back; `show` making textures and drawing them (on a machine without a graphics card the software
driver does part of that later, in Blender's own drawing). `picture` is their sum. Evaluating the pose and drawing the
rest of the view are Blender's own and left out; the timer that looks for the answer is too, it adds up to 5 ms.
Besides: what a redraw costs in which nothing changed, and a tick of the timer.

Medians of warm poses; the pictures are those of something that moves: of one hand in a small view, of two in one of
1920 x 1080, which has a tenth of its pixels while they move, and of the same with all of them. The file is also the
story that Blender runs.
"""

from __future__ import annotations

import importlib
import json
import statistics
import sys
import time
from pathlib import Path
from typing import Any

WARM_UP, POSES = 10, 100
# a screen with room for the largest view beside Blender's panels
SCREEN = "2560x1440"


def step_one(window):
    yield from _case(window, hands=1, size=(512, 334))


def step_two(window):
    yield from _case(window, hands=2, size=(1920, 1080))


def step_two_sharp(window):
    yield from _case(window, hands=2, size=(1920, 1080), is_sharp=True)


def _case(window, hands, size, is_sharp=False):
    """Writes OUT/viewport-CASE.json."""
    import bpy

    part: dict[str, Any] = {name: importlib.import_module(f".{name}", window.addon.__name__) for name in _MODULES}
    views = part["viewport.views"]
    for thing in [thing for thing in bpy.context.scene.objects if thing.type == "MESH" or "jghand_handedness" in thing]:
        bpy.data.objects.remove(thing)
    for side in ("right", "left")[:hands]:
        bpy.ops.jghand.add_hand(handedness=side)
    things = [thing for thing in bpy.context.scene.objects if "jghand_handedness" in thing]
    for index, thing in enumerate(things):
        thing.location.x += 0.16 * (index - (hands - 1) / 2)
    yield from window.look_at((0.0, 0.09, 0.0), 0.4, (0.6, 0.0, 0.3))
    yield lambda: views.all_views() and views.all_views()[0].pace.shown
    _fix_the_size(part, size)
    if is_sharp:
        part["core.pacing"].MOVING_PIXELS_MAX = size[0] * size[1]
    window.redraw()
    yield 2.0
    times = _measure(bpy, part, window, things, size)
    window.picture("measured")
    file = window.out / f"viewport-{hands}{'-sharp' if is_sharp else ''}.json"
    file.write_text(json.dumps({"size": size, "times": times}), encoding="utf-8")


_MODULES = ("viewport.views", "viewport.handlers", "core.view", "core.pacing", "renderer.runtime")


def _fix_the_size(part, size) -> None:
    """Every picture is of the same part of the view, the one around the hands' middle."""
    seen_part = part["core.view"]

    def fixed(view, hands):
        seen = seen_part.part_with(view, hands)
        if seen is None:
            return None
        left = max(0, min(view.width - size[0], (seen.left + seen.right - size[0]) // 2))
        top = max(0, min(view.height - size[1], (seen.top + seen.bottom - size[1]) // 2))
        return seen_part.Part(left, top, left + size[0], top + size[1])

    part["viewport.views"].part_with = fixed


def _measure(bpy, part, window, hands, size) -> dict[str, list[float]]:
    views, runtime = part["viewport.views"], part["renderer.runtime"]
    times = {name: [] for name in ("evaluate", "ask", "engine", "show", "picture", "redraw", "still", "tick")}
    show, inside = views.show, []

    def timed(*args) -> None:
        started = time.perf_counter()
        show(*args)
        inside.append(time.perf_counter() - started)

    views.show = timed
    (view,) = views.all_views()
    bones = [hand.pose.bones["index1"] for hand in hands]
    scene, layer, space = bpy.context.scene, bpy.context.view_layer, window.space()
    things = part["viewport.views"].seen_hands.hands_in(scene, layer, space, switched_on_only=True)
    with window.override():
        for index in range(WARM_UP + POSES):
            started = time.perf_counter()
            angle = 0.3 + 0.01 * (index % 40)
            for bone in bones:
                bone.rotation_quaternion = (1.0, angle, 0.0, 0.0)
            layer.update()
            posed = time.perf_counter()
            views.read_again(view, things, bpy.context.evaluated_depsgraph_get(), space)
            views.look(view, views.moment_of(scene), drawing=False)
            asked = time.perf_counter()
            answer = runtime.link().wait(view.slot, view.pace.asks[-1].tag, 10.0)
            answered = time.perf_counter()
            assert answer is not None
            assert answer.failure is None, answer.failure
            inside.clear()
            bpy.ops.wm.redraw_timer(type="DRAW_WIN", iterations=1)
            drawn = time.perf_counter()
            shown = max(inside)
            if index < WARM_UP:
                continue
            row = {"evaluate": posed - started, "ask": asked - posed, "engine": answered - asked, "show": shown}
            row |= {"picture": asked - posed + answered - asked + shown, "redraw": drawn - answered}
            for name, seconds in row.items():
                times[name].append(1e3 * seconds)
        for _ in range(10):
            inside.clear()
            bpy.ops.wm.redraw_timer(type="DRAW_WIN", iterations=1)
            times["still"].append(1e3 * max(inside))
    for _ in range(200):
        started = time.perf_counter()
        part["viewport.handlers"].tick()
        times["tick"].append(1e3 * (time.perf_counter() - started))
    views.show = show
    assert view.came is None
    assert (view.picture.width, view.picture.height) == size
    return times


def main() -> int:
    import argparse

    sys.path.insert(0, str(Path(__file__).parent))
    import test_in_blender

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=test_in_blender.ROOT / "build" / "benchmark_viewport")
    options = parser.parse_args()
    sys.argv = [sys.argv[0], str(Path(__file__).resolve()), "--out", str(options.out), "--screen", SCREEN]
    code = test_in_blender.main()
    for file in sorted((options.out / Path(__file__).stem).glob("viewport-*.json")):
        figures = json.loads(file.read_text(encoding="utf-8"))
        width, height = figures["size"]
        print(f"\n{file.stem}: part of the view {width} x {height}, ms\n{'median':>27}{'p95':>9}")
        for name, values in figures["times"].items():
            print(f"  {name:12} {statistics.median(values):12.2f} {sorted(values)[int(0.95 * len(values))]:8.2f}")
    return code


if __name__ == "__main__":
    sys.exit(main())
