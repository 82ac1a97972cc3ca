"""What other programs on the processors cost: steps of a training and frames per second with busy loops beside them.

    python scripts/benchmark_busy.py [--beside 0,1,2,4] [--rounds 12] [--only frames,steps] [--json FILE]

Each number of loops is a row: as many threads as JGHand takes by itself, and one thread alone, in two processes that
take turns, so that both meet the same machine. The last column is what matters: threads that wait for each other make
it fall far below 1 as soon as one of them has no processor.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from jghand_engine.captures.sample import Sample
from jghand_engine.cli.console import progress, say, say_table
from jghand_engine.files import writing
from jghand_engine.native import threads
from jghand_engine.render.timing import machine

WIDTH_PX, HEIGHT_PX = 512, 334
# of the training: all Gaussians take part and pictures are whole in its second half
PLANNED_STEPS, FIRST_STEP = 10_000, 5_000
# poses that the training goes round; each has three pictures
POSES = 4
# one sample lasts at least so long: several turns of the system's scheduler (some 3 ms each)
SAMPLE_S = 0.4
BUSY_LOOP = "while True: pass"


@dataclass(frozen=True)
class Row:
    """what:   frames or steps
    beside:    busy loops
    automatic: per second, median, with the threads that JGHand takes by itself
    one:       the same with one thread
    ratio:     automatic / one, the median of the rounds
    """

    what: str
    beside: int
    automatic: float
    one: float
    ratio: float


# ---- a process that works when it is told to -------------------------------------------------------------------------


def frames() -> Callable[[], object]:
    """Draws the built-in hand in motion, as a viewport does."""
    from jghand_engine.avatar.builtin import load_builtin
    from jghand_engine.hand.joints import Handedness
    from jghand_engine.render.settings import preset
    from jghand_engine.render.subject import moving_subject
    from jghand_engine.render.timing import frame_case

    subject = moving_subject("trained", load_builtin(handedness=Handedness.RIGHT), WIDTH_PX, HEIGHT_PX)
    return frame_case(subject, preset("viewport"), "").run


def steps() -> Callable[[], object]:
    """Learns from pictures of the painted hand, as `jghand train` does."""
    from jghand_engine.avatar.avatar import AvatarInfo
    from jghand_engine.learn.options import TrainOptions
    from jghand_engine.learn.step import HandTraining, Material
    from jghand_engine.template.builtin import load_template

    with tempfile.TemporaryDirectory() as folder:
        samples = list(pictures(Path(folder)))
        training = HandTraining(
            Material(samples, samples[:1], load_template(), AvatarInfo("busy", "builtin", "CC0-1.0")), TrainOptions()
        )
        training.plan(PLANNED_STEPS)
        numbers = iter(range(FIRST_STEP, PLANNED_STEPS))
        for _ in range(2 * POSES):  # reads all pictures before their folder goes
            training.step(next(numbers))
    return lambda: training.step(next(numbers))


def pictures(folder: Path) -> Iterator[Sample]:
    """Three pictures of each pose, by cameras side by side."""
    from jghand_engine.avatar.builtin import load_painted
    from jghand_engine.export.pictures import write_png
    from jghand_engine.hand.joints import Handedness
    from jghand_engine.render.camera import Camera
    from jghand_engine.render.renderer import HandRenderer
    from jghand_engine.render.settings import preset
    from jghand_engine.render.subject import moving_subject

    subject = moving_subject("painted", load_painted(handedness=Handedness.RIGHT), WIDTH_PX, HEIGHT_PX)
    renderer = HandRenderer(subject.avatar, preset("final"))
    for frame in range(POSES):
        joints_m = subject.poses[frame * len(subject.poses) // POSES]
        for side, across_m in enumerate((-0.2, 0.0, 0.2)):
            middle_m = joints_m.mean(0)
            camera = Camera.looking_at(
                middle_m + np.array([across_m, 0.0, 0.6]), middle_m, (0.0, 1.0, 0.0),
                width=WIDTH_PX, height=HEIGHT_PX, focal_px=3.0 * HEIGHT_PX,
            )  # fmt: skip
            path = folder / f"{frame}_{side}.png"
            write_png(path, renderer.render(joints_m, camera).rgba)
            yield Sample(path, camera, joints_m, Handedness.RIGHT, "busy", "motion", frame, str(side))


def work(what: str, count: int) -> None:
    """Takes a sample for every line on stdin and answers with how many there were per second."""
    if count:
        threads.AUTOMATIC_THREADS = count
        if what == "steps":
            import torch

            torch.set_num_threads(count)
    once = {"frames": frames, "steps": steps}[what]()
    once()
    print("ready", flush=True)
    for _ in sys.stdin:
        begun, done = time.perf_counter(), 0
        while (took := time.perf_counter() - begun) < SAMPLE_S or not done:
            once()
            done += 1
        print(done / took, flush=True)


class Worker:
    """One such process; 0 threads: as many as it takes by itself."""

    def __init__(self, what: str, count: int) -> None:
        command = [sys.executable, __file__, "--work", what, "--threads", str(count)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._answer()

    def per_second(self) -> float:
        """Takes a sample."""
        assert self._process.stdin
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return float(self._answer())

    def _answer(self) -> str:
        assert self._process.stdout
        if not (line := self._process.stdout.readline()):
            raise SystemExit("A process that was measured has ended.")
        return line

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()


# ---- rows ------------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Other programs: so many processes that want all they can get."""
    loops = [subprocess.Popen([sys.executable, "-c", BUSY_LOOP]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def measured(what: str, beside: list[int], rounds: int, tick: Callable[[], None]) -> Iterator[Row]:
    with Worker(what, 0) as automatic, Worker(what, 1) as one:
        pairs: dict[int, list[tuple[float, float]]] = {count: [] for count in beside}
        for turn in range(rounds + 1):  # the first warms up
            for count in beside:
                with busy_loops(count):
                    first, second = (automatic, one) if turn % 2 else (one, automatic)
                    rates = {id(worker): worker.per_second() for worker in (first, second)}
                    if turn:
                        pairs[count].append((rates[id(automatic)], rates[id(one)]))
                    tick()
    for count, seen in pairs.items():
        ours, alone = np.array(seen).T
        yield Row(what, count, float(np.median(ours)), float(np.median(alone)), float(np.median(ours / alone)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--beside", default="0,1,2,4", help="busy loops of each row")
    parser.add_argument("--rounds", type=int, default=12, help="samples of each row and side")
    parser.add_argument("--only", default="frames,steps")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    parser.add_argument("--work", choices=("frames", "steps"), help=argparse.SUPPRESS)
    parser.add_argument("--threads", type=int, default=0, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        return work(options.work, options.threads)
    beside, what = [int(count) for count in options.beside.split(",")], options.only.split(",")
    facts = machine(0)
    say(", ".join(f"{name} {value}" for name, value in facts.items()))
    with progress("Measuring", len(what) * len(beside) * (options.rounds + 1)) as bar:
        rows = [
            row for one in what for row in measured(one, beside, options.rounds, lambda: bar.advance(bar.task_ids[0]))
        ]
    head = ("per second", "busy loops beside", f"{facts['threads']} threads", "one thread", "ratio")
    cells = [(r.what, str(r.beside), f"{r.automatic:.2f}", f"{r.one:.2f}", f"{r.ratio:.2f}") for r in rows]
    say_table("On a busy machine", head, cells)
    if options.json:
        with writing(options.json) as temporary:
            content = {"machine": facts, "rows": [asdict(row) for row in rows]}
            temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
