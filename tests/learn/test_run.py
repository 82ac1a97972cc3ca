"""The loop: it goes on bit for bit, loses little to a kill, and never writes over anybody's work."""

import os
import random
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from small_trainings import read_log
from stand_in import Notes, StandIn, Stops

from jghand_engine import files
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.file import load_avatar
from jghand_engine.errors import InputError, RetryError
from jghand_engine.export.pictures import read_png
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import NO_FIST
from jghand_engine.learn.checkpoint import Snapshot, load_checkpoint
from jghand_engine.learn.run import RunOptions, train
from jghand_engine.learn.schedule import Budget, Every
from jghand_engine.learn.work_folder import Start
from jghand_engine.lock import locked


@pytest.fixture
def options(tmp_path, monkeypatch):
    """60 steps, everything often; nobody waits for the disk, which only a loss of power would ask for."""
    monkeypatch.setattr(files, "sync", lambda path: None)
    return RunOptions(
        out=tmp_path / "hand.jghand", work=tmp_path / "work", stamp={"seed": 0, "model": {"planes": 4}},
        budget=Budget(steps=60), log_steps=5, checkpoint=Every(steps=7), preview=Every(steps=20),
    )  # fmt: skip


def newest(work: Path) -> Snapshot:
    return load_checkpoint(sorted((work / "checkpoints").glob("*.safetensors"))[-1])[0]


def curve(work: Path) -> list[tuple[int, float, float]]:
    """What the log says of the figures, without times."""
    return [(line["step"], line["loss"], line["error"]) for line in read_log(work / "log.jsonl") if "loss" in line]


def same_state(a: Snapshot, b: Snapshot) -> bool:
    return a.scalars == b.scalars and all(torch.equal(a.tensors[name], b.tensors[name]) for name in a.tensors)


# ---- what it leaves --------------------------------------------------------------------------------------------------


def test_a_finished_training_leaves_avatar_log_previews_and_checkpoints(options):
    outcome = train(StandIn, options)
    assert outcome.finished
    assert outcome.state.step == 60
    assert len(load_avatar(options.out)) == 50
    assert [step for step, *_ in curve(options.work)] == list(range(5, 61, 5))
    assert [path.name for path in sorted((options.work / "pictures").iterdir())] == [
        f"step_000000{n}.png" for n in (20, 40, 60)
    ]
    assert read_png(options.work / "pictures" / "step_00000060.png").shape == (6, 12, 3)
    assert len(load_avatar(options.work / "preview.jghand")) == 50
    first, *_, last = (line["psnr"] for line in read_log(options.work / "log.jsonl") if "psnr" in line)
    assert last > first + 1, "it learns"


def test_a_finished_avatar_has_the_fist_that_its_skin_wants(options, monkeypatch):
    builtin = load_builtin(handedness=Handedness.RIGHT).prefix(50)
    monkeypatch.setattr(StandIn, "avatar", lambda _: replace(builtin, fist=NO_FIST))
    train(StandIn, replace(options, budget=Budget(steps=1)))
    np.testing.assert_allclose(load_avatar(options.out).fist.turns_deg, builtin.fist.turns_deg, atol=2e-3)


def test_the_last_two_checkpoints_and_the_best_are_kept(options):
    class BestAt14(StandIn):
        def fixed_psnr(self):
            return 30.0 if self.scalars()["count"] == 14 else 20.0

    train(BestAt14, options)
    kept = [path.name for path in sorted((options.work / "checkpoints").iterdir())]
    assert kept == [f"step_000000{n}.safetensors" for n in (14, 56, 60)]


def test_a_log_line_averages_the_steps_since_the_last(options):
    train(StandIn, replace(options, log_steps=1))
    single = {step: loss for step, loss, _ in curve(options.work)}
    train(StandIn, replace(options, start=Start.FRESH))
    step, loss, _ = curve(options.work)[2]
    assert step == 15
    assert loss == pytest.approx(sum(single[n] for n in range(11, 16)) / 5, rel=1e-12)


# ---- going on --------------------------------------------------------------------------------------------------------


def test_a_finished_training_can_be_given_more_steps(options):
    train(StandIn, options)
    outcome = train(StandIn, replace(options, start=Start.RESUME, budget=Budget(steps=80)))
    assert outcome.state.step == 80
    assert [step for step, *_ in curve(options.work)] == list(range(5, 81, 5))


def test_a_damaged_newest_checkpoint_is_passed_over_and_named(options):
    train(lambda: Stops(30), options)
    last = sorted((options.work / "checkpoints").iterdir())[-1]
    last.write_bytes(last.read_bytes()[:500])
    shown = Notes()
    assert train(StandIn, replace(options, start=Start.RESUME), shown).finished
    assert any(last.name in note and "Passed over" in note for note in shown.notes)
    assert any("step 28" in note for note in shown.notes)


# ---- a time budget ---------------------------------------------------------------------------------------------------


class Clock:
    """A step takes 1/128 s by it, later ones 1/64 s."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s


class Timed(StandIn):
    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock

    def step(self, number):
        self._clock.now_s += 2**-7 if number < 100 else 2**-6
        return super().step(number)


def test_a_time_budget_ends_the_training_and_its_schedule(options):
    clock = Clock()
    made = Timed(clock)
    outcome = train(lambda: made, replace(options, budget=Budget(seconds=3.125), clock=clock.monotonic, log_steps=1))
    assert outcome.finished
    assert outcome.state.seconds == 3.125
    assert outcome.state.step == 250
    speeds = [line["steps_per_s"] for line in read_log(options.work / "log.jsonl") if "loss" in line]
    assert speeds[:2] == [None, 128]
    assert speeds[-1] == 64, "of the steps just done"
    assert made.plans[0] == 10_000, "nothing is known yet"
    assert made.plans[2] == 400, "after a few steps the speed is"
    # planned after 250 steps, where it ends
    assert made.plans[-2:] == [267, 250], "with three quarters of the time, three quarters of the schedule are spent"


def test_time_spent_counts_over_all_sessions(options):
    train(StandIn, options)
    spent = newest(options.work).state.seconds
    assert spent > 0
    outcome = train(StandIn, replace(options, start=Start.RESUME, budget=Budget(seconds=spent)))
    assert outcome.state.step == 60, "nothing is left"


# ---- being killed ----------------------------------------------------------------------------------------------------


@contextmanager
def in_a_process(options: RunOptions) -> Iterator[tuple[int, int]]:
    """Trains in a process of its own; gives its number and a pipe on which it says every step before it does it."""
    reads, writes = os.pipe()
    child = os.fork()
    if child == 0:

        class Tells(StandIn):
            def step(self, number):
                os.write(writes, b"%d\n" % number)
                return super().step(number)

        try:
            torch.set_num_threads(1)
            train(Tells, options)
            os.write(writes, b"finished\n")
        finally:
            os._exit(0)
    os.close(writes)
    try:
        yield child, reads
    finally:
        os.waitpid(child, 0)
        os.close(reads)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_kill_9_at_any_moment_loses_at_most_one_interval(options, tmp_path):
    """Killed again and again at random moments; the state ends as if nothing had happened."""
    every = 10
    options = replace(options, budget=Budget(steps=120), checkpoint=Every(steps=every), log_steps=3)
    rng, start, reached = random.Random(3), Start.NEW, 0
    for _ in range(5):
        with in_a_process(replace(options, start=start)) as (child, pipe), os.fdopen(os.dup(pipe)) as lines:
            wanted = reached + rng.randrange(1, 25)
            for line in lines:
                if int(line) >= wanted:
                    time.sleep(rng.random() * 0.02)
                    os.kill(child, signal.SIGKILL)
                    break
            said = [line, *lines]
        reached = max([reached, *map(int, said)])
        found = newest(options.work).state.step
        assert reached - every <= found <= reached + 1, f"step {reached} was begun, the checkpoint has {found}"
        start = Start.RESUME
    assert train(StandIn, replace(options, start=start)).finished
    straight = replace(options, work=tmp_path / "straight", out=tmp_path / "straight.jghand")
    train(StandIn, straight)
    assert same_state(newest(options.work), newest(straight.work))
    assert curve(options.work) == curve(straight.work)
    leftovers = [path.name for path in (options.work / "checkpoints").iterdir() if path.name.startswith(".")]
    assert not leftovers, "temporary files of killed saves are removed"


# ---- refusals --------------------------------------------------------------------------------------------------------


def never():
    raise AssertionError("refused too late: the model was built")


def test_a_folder_with_other_things_is_refused(options):
    options.work.mkdir()
    (options.work / "thesis.tex").write_text("years of work")
    for start in (Start.NEW, Start.FRESH):
        with pytest.raises(InputError, match=r"thesis\.tex"):
            train(never, replace(options, start=start))
    assert [path.name for path in options.work.iterdir()] == ["thesis.tex"]


def test_fresh_removes_only_what_trainings_leave(options):
    train(StandIn, options)
    (options.work / "notes.txt").write_text("mine")
    (options.work / "pictures" / "mine.png").write_text("mine")
    train(StandIn, replace(options, start=Start.FRESH, budget=Budget(steps=5)))
    assert (options.work / "notes.txt").exists()
    assert (options.work / "pictures" / "mine.png").exists()
    assert not (options.work / "pictures" / "step_00000060.png").exists()


def test_two_trainings_do_not_share_a_folder(options):
    options.work.mkdir()
    with locked(options.work / "lock"), pytest.raises(RetryError, match=f"process {os.getpid()}"):
        train(never, options)
    assert train(StandIn, options).finished, "the lock is gone"


@pytest.mark.parametrize(
    ("stamp", "name"),
    [
        ({"seed": 1, "model": {"planes": 4}}, "seed: wanted 0"),
        ({"seed": 0, "model": {"planes": 8}}, "model.planes: wanted 4"),
        ({"seed": 0, "model": {}}, "model.planes"),
        ({"seed": 0, "model": {"planes": 4}, "extra": True}, "extra"),
    ],
)
def test_going_on_with_other_options_names_the_difference(options, stamp, name):
    train(StandIn, options)
    with pytest.raises(InputError, match=name):
        train(StandIn, replace(options, start=Start.RESUME, stamp=stamp))
