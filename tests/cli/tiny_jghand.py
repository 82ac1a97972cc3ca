"""The command jghand with trainings that take little: of a model of 300 Gaussians, or that only count (--counting, its
first word), for tests of what goes on around them.

JGHAND_TINY_STEP_S: seconds that a step takes besides, from the fifth on of a training that is not gone on with.
"""

import contextlib
import itertools
import json
import os
import sys
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from jghand_engine.errors import STOPPED, RetryError
from jghand_engine.files import make_folder, writing
from jghand_engine.lock import locked

QUICK_STEPS = 4
# those of learn/work_folder.py, which brings torch
LOCK, MARK = "lock", "training.json"
SLOW_S = 0.0 if "--resume" in sys.argv else float(os.environ.get("JGHAND_TINY_STEP_S", "0"))


def wait_in(step: int) -> None:
    if step >= QUICK_STEPS:
        time.sleep(SLOW_S)


def make_trainings_small() -> None:
    from small_hands import small_points
    from small_trainings import SMALL

    from jghand_engine.learn import options, step

    whole_step = step.HandTraining.step

    def slow_step(self, number):
        wait_in(number)
        return whole_step(self, number)

    step.place_points = lambda template, count, **how: small_points(count)
    step.HandTraining.step = slow_step
    options.PRESETS["default"] = SMALL


def count(words: list[str]) -> int:
    """`jghand train` as its job sees it: lock, mark, checkpoint, lines of progress, stop, avatar."""
    given = dict(itertools.pairwise(words))
    out, steps = Path(given["--out"]), int(given["--steps"])
    work = make_folder(out.with_suffix(".training"))
    # an older one of its own it replaces, as `jghand train` does
    if out.exists() and "--overwrite" not in words and not out.read_text().startswith("a hand of"):
        say("error", text="wanted a new file. Replace that one with --overwrite.")
        return 2
    told = threading.Event()
    threading.Thread(target=lambda: (os.read(0, 1), told.set()), daemon=True).start()
    try:
        with locked(work / LOCK):
            (work / MARK).touch()
            done = int((work / "checkpoint").read_text()) if "--resume" in words else 0
            say("note", text=f"Resuming at step {done}.")
            while done < steps and not told.is_set():
                wait_in(done)
                done += 1
                say("training", text=f"step {done} of {steps}")
            with writing(work / "checkpoint") as temporary:
                temporary.write_text(str(done))
            if done < steps:
                return STOPPED
            out.write_text(f"a hand of {steps} steps")
            return 0
    except RetryError as error:
        say("error", text=str(error))
        return 3


def say(kind: str, **content: object) -> None:
    # its job may have been killed
    with contextlib.suppress(OSError):
        print(json.dumps({"jghand": kind, **content}), file=sys.stderr, flush=True)


if __name__ == "__main__":
    program, words = [sys.executable, __file__], sys.argv[1:]
    counting = words[0] == "--counting"
    if counting:
        program.append(words.pop(0))
    if words[0] == "train" and counting:
        sys.exit(count(words))
    if words[0] == "train":
        make_trainings_small()
    # trainings that only count need not wait for it
    from jghand_engine.cli import main, train_many

    train_many.PROGRAM = tuple(program)
    sys.exit(main(words))
