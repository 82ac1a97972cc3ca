"""What other programs on the processors cost: steps of a training and frames per second with busy loops beside them.

    .envs/engine/bin/python scripts/benchmark_busy.py [--beside 0 1 2 4] [--rounds 6]

Each column has so many busy loops beside it; its figures are with as many threads as JGHand takes by itself, with one
thread alone, and their ratio: two processes that take turns, so that both meet the same machine. Threads that wait for
each other make the ratio fall far below 1 as soon as one of them has no processor.
"""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from other_programs import table

from jghand_engine.avatar.avatar import AvatarInfo
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.captures.sample import Sample
from jghand_engine.export.pictures import write_png
from jghand_engine.hand.joints import Handedness
from jghand_engine.native import threads
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset
from jghand_engine.render.subject import moving_subject
from jghand_engine.render.timing import frame_case, machine
from jghand_engine.template.builtin import load_template

SIZE_PX = 512, 334
# of the training: all Gaussians take part and pictures are whole in its second half
PLANNED_STEPS, FIRST_STEP = 10_000, 5_000
# poses that the training goes round, and where its cameras stand, meters to the side
POSES, ACROSS_M = 4, (-0.2, 0.0, 0.2)
# one sample lasts at least so long: several turns of the system's scheduler (some 3 ms each)
SAMPLE_S = 0.4
BUSY_LOOP = "print(flush=True)\nwhile True: pass"


def frames() -> Callable[[], object]:
    """Draws the built-in hand in motion, as a viewport does."""
    subject = moving_subject("builtin", load_builtin(handedness=Handedness.RIGHT), *SIZE_PX)
    return frame_case(subject, preset("viewport"), "").run


def steps() -> Callable[[], object]:
    """Learns from pictures of the painted hand, as `jghand train` does."""
    from jghand_engine.learn.options import TrainOptions
    from jghand_engine.learn.step import HandTraining, Material

    with tempfile.TemporaryDirectory() as folder:
        samples = list(_pictures(Path(folder)))
        info = AvatarInfo("busy", "builtin", "CC0-1.0")
        training = HandTraining(Material(samples, samples[:1], load_template(), info), TrainOptions())
        training.plan(PLANNED_STEPS)
        numbers = iter(range(FIRST_STEP, PLANNED_STEPS))
        for _ in range(2 * POSES):  # reads all pictures before their folder goes
            training.step(next(numbers))
    return lambda: training.step(next(numbers))


def _pictures(folder: Path) -> Iterator[Sample]:
    subject = moving_subject("painted", load_painted(handedness=Handedness.RIGHT), *SIZE_PX)
    renderer, (width, height) = HandRenderer(subject.avatar, preset("final")), SIZE_PX
    for frame, joints_m in enumerate(subject.poses[:: len(subject.poses) // POSES][:POSES]):
        middle_m = joints_m.mean(0)
        for side, across_m in enumerate(ACROSS_M):
            eye_m = middle_m + np.array([across_m, 0.0, 0.6])
            camera = Camera.looking_at(eye_m, middle_m, (0, 1, 0), width=width, height=height, focal_px=3.0 * height)
            path = folder / f"{frame}_{side}.png"
            write_png(path, renderer.render(joints_m, camera).rgba)
            yield Sample(path, camera, joints_m, Handedness.RIGHT, "busy", "motion", frame, str(side))


WORK = {"frames of 512 x 334": frames, "steps of a training": steps}


def work(what: str, count: int) -> None:
    """Takes a sample for every line on stdin and answers with how many there were per second."""
    if count:
        import torch

        threads.AUTOMATIC_THREADS = count
        torch.set_num_threads(count)
    once = WORK[what]()
    once()
    print("ready", flush=True)
    for _ in sys.stdin:
        begun, done = time.perf_counter(), 0
        while (took := time.perf_counter() - begun) < SAMPLE_S or not done:
            once()
            done += 1
        print(done / took, flush=True)


@contextlib.contextmanager
def worker(what: str, count: int) -> Iterator[Callable[[], float]]:
    """A process that works when it is told to: how often per second. count: threads, 0 for as many as it takes."""
    command = [sys.executable, __file__, "--work", what, "--threads", str(count)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        asked, answers = process.stdin, process.stdout
        if answers.readline() != "ready\n":
            raise SystemExit("A process that was to be measured has ended.")

        def per_second() -> float:
            asked.write("\n")
            return float(answers.readline())

        try:
            yield per_second
        finally:
            process.kill()


@contextlib.contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Other programs: so many processes that want all they can get."""
    loops = [subprocess.Popen([sys.executable, "-c", BUSY_LOOP], stdout=subprocess.PIPE) for _ in range(count)]
    for loop in loops:
        assert loop.stdout is not None
        loop.stdout.readline()  # it runs
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def measured(what: str, beside: list[int], rounds: int) -> dict[int, np.ndarray]:
    """(rounds, 2) per second beside each number of loops: with the threads that JGHand takes, and with one."""
    found = {count: np.empty((rounds, 2)) for count in beside}
    with worker(what, 0) as automatic, worker(what, 1) as one:
        sides = automatic, one
        for per_second in sides:  # warms up
            per_second()
        for turn in range(rounds):
            for count in beside:
                with busy_loops(count):
                    for side in (0, 1) if turn % 2 else (1, 0):
                        found[count][turn, side] = sides[side]()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--beside", type=int, nargs="+", default=[0, 1, 2, 4], help="busy loops of each column")
    parser.add_argument("--rounds", type=int, default=6, help="samples of each figure")
    parser.add_argument("--work", choices=WORK, help=argparse.SUPPRESS)
    parser.add_argument("--threads", type=int, default=0, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        return work(options.work, options.threads)
    rows = []
    for what in WORK:
        found = measured(what, options.beside, options.rounds)
        medians = [np.median(pairs, axis=0) for pairs in found.values()]
        rows.append([f"{what}, per second", *(f"{ours:.3g}, {alone:.3g}" for ours, alone in medians)])
        rows.append(["ratio", *(f"{np.median(pairs[:, 0] / pairs[:, 1]):.2f}" for pairs in found.values())])
    print(", ".join(f"{name} {value}" for name, value in machine(0).items()))
    print(table(["beside", *map(str, options.beside)], rows))


if __name__ == "__main__":
    main()
