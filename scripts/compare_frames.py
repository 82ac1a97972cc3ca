"""Whole frames of the trained hand by this checkout and by another one, in one run, by stages.

    git worktree add ../before COMMIT        and build its kernels: python -m jghand_engine.native.build
    python scripts/compare_frames.py ../before [--rounds 10] [--threads 1] [--sizes 512x334,1920x1080]

Each checkout draws in a process of its own; the two take turns, frames by frames, so that a neighbor's load meets both.
Figures are milliseconds of processor time, medians, the other checkout first; of several threads, of all of them.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parents[1]
# frames of a turn; the first of each find caches that the other checkout filled, and do not count
FRAMES, UNCOUNTED = 10, 2
PRESETS, HANDS, LIGHTS = ("viewport", "final"), (1, 2), ("own", "scene", "lamps")
# of two hands, from the middle between them, meters
ASIDE_M = 0.08
SUN_W_M2 = 3.0


def renderer_of(preset_name: str, hands: int, light: str, width: int, height: int, threads: int) -> Callable[[], Any]:
    """What draws the next frame and returns its receipt."""
    from jghand_engine.avatar.builtin import load_builtin
    from jghand_engine.avatar.relighting import studio
    from jghand_engine.avatar.scene_light import Lamp, LampKind, SceneLight
    from jghand_engine.hand.joints import Handedness
    from jghand_engine.render.renderer import SceneRenderer
    from jghand_engine.render.settings import preset
    from jghand_engine.render.subject import moving_subject
    from jghand_engine.study.effects_in_light import LAMPS

    sides = (Handedness.RIGHT, Handedness.LEFT)[:hands]
    subjects = [moving_subject("trained", load_builtin(handedness=side), width, height) for side in sides]
    sun = Lamp(LampKind.SUN, (SUN_W_M2, SUN_W_M2, SUN_W_M2), (0.3, 1.0, 0.5), angle_rad=0.01)
    lit = {"own": None, "scene": SceneLight(studio(), (sun,)), "lamps": SceneLight(studio(), LAMPS)}[light]
    settings = replace(preset(preset_name), threads=threads)
    renderer = SceneRenderer([subject.avatar for subject in subjects], settings, lit)
    aside = (0.0,) if hands == 1 else (ASIDE_M, -ASIDE_M)
    moved = [subject.poses + np.array([x_m, 0.0, 0.0]) for subject, x_m in zip(subjects, aside, strict=True)]
    poses = itertools.cycle(list(zip(*moved, strict=False)))
    return lambda: renderer.render(next(poses), subjects[0].camera).report


def work() -> None:
    """Draws what each line of the input names, and answers with times of the frames."""
    kept: dict[str, Callable[[], Any]] = {}
    # stages of receipts are processor time too: of the thread that draws alone, or first
    time.perf_counter = time.thread_time
    for line in sys.stdin:
        if line not in kept:
            kept.clear()
            kept[line] = renderer_of(*json.loads(line))
        found = []
        for _ in range(FRAMES):
            started = time.process_time()
            report = kept[line]()
            found.append({"frame": 1e3 * (time.process_time() - started), **report.stages})
        print(json.dumps(found[UNCOUNTED:]), flush=True)


class Checkout:
    """A process that draws with the code of a folder."""

    def __init__(self, folder: Path) -> None:
        environment = {**os.environ, "PYTHONPATH": str(folder)}
        command = [sys.executable, __file__, "--work"]
        self._process = subprocess.Popen(
            command, cwd=folder, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def frames(self, case: list[Any]) -> list[dict[str, float]]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps(case), file=self._process.stdin, flush=True)
        return json.loads(self._process.stdout.readline())


def medians(frames: list[dict[str, float]]) -> dict[str, float]:
    names = dict.fromkeys(name for frame in frames for name in frame)
    return {name: statistics.median(frame.get(name, 0.0) for frame in frames) for name in names}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, nargs="?", help="folder of the other checkout")
    parser.add_argument("--rounds", type=int, default=10, help=f"turns of {FRAMES} frames")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--sizes", default="512x334,1024x1024,1920x1080,3840x2160")
    parser.add_argument("--lights", default=",".join(LIGHTS), help=f"some of {','.join(LIGHTS)}")
    parser.add_argument("--stages", action="store_true", help="a row for every stage")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        return work()
    if options.before is None:
        parser.error("the folder of another checkout is wanted")
    both = [Checkout(options.before.resolve()), Checkout(HERE)]
    print("| preset | hands | light | size | before | now | ratio |\n|---|---|---|---|---|---|---|")
    sizes = [[int(side) for side in size.split("x")] for size in options.sizes.split(",")]
    kinds = itertools.product(options.lights.split(","), HANDS, PRESETS)
    for (width, height), (light, hands, name) in itertools.product(sizes, list(kinds)):
        case = [name, hands, light, width, height, options.threads]
        found: list[list[dict[str, float]]] = [[], []]
        for turn in range(options.rounds + 1):
            for one, frames in zip(both, found, strict=True):
                frames += one.frames(case) if turn else one.frames(case)[:0]
        before, now = map(medians, found)
        shown = list(dict.fromkeys([*before, *now])) if options.stages else ["frame"]
        for stage in shown:
            was, is_now = before.get(stage, 0.0), now.get(stage, 0.0)
            head = f"| {name} | {hands} | {light} | {width} x {height} |" if stage == "frame" else f"| · {stage} ||||"
            print(f"{head} {was:.2f} | {is_now:.2f} | {is_now / was if was else 0:.2f} |", flush=True)


if __name__ == "__main__":
    main()
