"""Whole frames of the trained hand by this checkout and by another one, in one run, by stages.

    git worktree add ../before COMMIT        and build its kernels: python -m jghand_engine.native.build
    python scripts/compare_frames.py ../before [--rounds 10] [--threads 1] [--sizes 512x334,1920x1080]
    python scripts/compare_frames.py --details none,texture,relief --hands 1 --sizes 1920x1080 --stages

Each checkout draws in a process of its own; the two take turns, frames by frames, so that a neighbor's load meets both.
So do hands that have none of their detail, its texture alone, and all of it; a last column is over the first of them.
Figures are milliseconds of processor time, medians, the other checkout first; of several threads, of all of them, but
stages of the first thread alone.
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
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parents[1]
# frames of a turn; the first of each find caches that the other checkout filled, and do not count
FRAMES, UNCOUNTED = 10, 2
PRESETS, HANDS, LIGHTS = ("viewport", "final"), ("1", "2"), ("own", "scene", "lamps")
# of what the hand has of its own: nothing, the texture, and the relief too
DETAILS = ("none", "texture", "relief")
# of two hands, from the middle between them, meters
ASIDE_M = 0.08
SUN_W_M2 = 3.0


def renderer_of(
    preset_name: str, hands: int, light: str, width: int, height: int, detail: str, threads: int
) -> Callable[[], Any]:
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
    avatars = [load_builtin(handedness=side) for side in sides]
    if detail == "none":
        avatars = [replace(avatar, detail=None) for avatar in avatars]
    if detail == "texture":
        avatars = [replace(avatar, detail=replace(avatar.detail, relief=None)) for avatar in avatars if avatar.detail]
    subjects = [moving_subject("trained", avatar, width, height) for avatar in avatars]
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
            if len(kept) == len(DETAILS):
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


def row(cells: Sequence[str | float]) -> str:
    return f"| {' | '.join(cell if isinstance(cell, str) else f'{cell:.2f}' for cell in cells)} |"


def ratio(part: float, whole: float) -> float:
    return part / whole if whole else 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, nargs="?", help="folder of the other checkout")
    parser.add_argument("--rounds", type=int, default=10, help=f"turns of {FRAMES} frames")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--sizes", default="512x334,1024x1024,1920x1080,3840x2160")
    for name, every in (("presets", PRESETS), ("hands", HANDS), ("lights", LIGHTS)):
        parser.add_argument(f"--{name}", default=",".join(every), help=f"some of {','.join(every)}")
    parser.add_argument("--details", default=DETAILS[-1], help=f"some of {','.join(DETAILS)}")
    parser.add_argument("--stages", action="store_true", help="a row for every stage")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        return work()
    details = options.details.split(",")
    if options.before is None and len(details) == 1:
        parser.error("the folder of another checkout is wanted, or several details")
    checkouts = [Checkout(folder.resolve()) for folder in (options.before, HERE) if folder]
    columns = ["before", "now", "ratio"] if options.before else ["now"]
    heads = ["preset", "hands", "light", "size", "detail", *columns, *([f"over {details[0]}"] if details[1:] else [])]
    print(row(heads), "|" + "---|" * len(heads), sep="\n")
    sizes = [[int(side) for side in size.split("x")] for size in options.sizes.split(",")]
    kinds = itertools.product(*(chosen.split(",") for chosen in (options.lights, options.hands, options.presets)))
    for (width, height), (light, hands, name) in itertools.product(sizes, list(kinds)):
        cases = [[name, int(hands), light, width, height, detail, options.threads] for detail in details]
        found: list[list[list[dict[str, float]]]] = [[[] for _ in checkouts] for _ in cases]
        for turn in range(options.rounds + 1):
            for case, of_case in zip(cases, found, strict=True):
                for checkout, frames in zip(checkouts, of_case, strict=True):
                    frames += checkout.frames(case) if turn else checkout.frames(case)[:0]
        every = [[medians(frames) for frames in of_case] for of_case in found]
        stages = list(dict.fromkeys(stage for of_case in every for one in of_case for stage in one))
        for stage, (detail, of_case) in itertools.product(
            stages if options.stages else ["frame"], zip(details, every, strict=True)
        ):
            times = [one.get(stage, 0.0) for one in of_case]
            head = [name, hands, light, f"{width} x {height}"] if stage == "frame" else [f"· {stage}", "", "", ""]
            over = [ratio(times[-1], every[0][-1].get(stage, 0.0))] if details[1:] else []
            versus = [ratio(times[-1], times[0])] if options.before else []
            print(row([*head, detail, *times, *versus, *over]), flush=True)


if __name__ == "__main__":
    main()
