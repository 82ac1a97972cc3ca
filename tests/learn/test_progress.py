"""What a training shows: a live line in a terminal, plain lines elsewhere."""

import io

from rich.console import Console

from jghand_engine.learn.checkpoint import LoopState
from jghand_engine.learn.progress import Status, display
from jghand_engine.learn.schedule import Budget, Every, Timer

STATUS = Status(120, 4000, loss=0.01234, psnr=31.456, gaussians=15000, steps_per_s=2.5, seconds_left=1552)


def test_without_a_terminal_there_are_plain_lines_now_and_then():
    stream = io.StringIO()
    with display(Console(file=stream)) as shown:
        for step in range(50):
            shown.update(Status(step, 60))
        shown.note("Preview: [a].png")
        shown.update(Status(60, 60))
    assert stream.getvalue().splitlines() == ["step 0 of 60", "Preview: [a].png", "step 60 of 60"]


def test_a_terminal_shows_a_live_line():
    stream = io.StringIO()
    with display(Console(file=stream, force_terminal=True, width=140)) as shown:
        shown.update(STATUS)
        shown.note("Preview: a.png")
    assert "31.46 dB" in stream.getvalue()
    assert "Preview: a.png" in stream.getvalue()


# ---- schedule --------------------------------------------------------------------------------------------------------


def test_the_first_time_may_come_earlier():
    timer = Timer(Every(seconds=100.0, first_s=20.0), 0, 1000.0)
    assert [t for t in range(1001, 1300) if timer.is_due(0, float(t))] == [1020, 1120, 1220]


def test_a_time_budget_plans_by_the_part_of_time_that_is_spent():
    budget = Budget(seconds=60.0)
    assert budget.planned_steps(LoopState(step=100, seconds=6.0)) == 1000
    assert budget.planned_steps(LoopState(step=900, seconds=61.0)) == 900
    assert Budget(steps=500, seconds=60.0).planned_steps(LoopState(step=100, seconds=6.0)) == 500
    assert Budget(steps=500).planned_steps(LoopState(step=100, seconds=6.0)) == 500


def test_the_budget_that_is_spent_first_ends_it():
    budget = Budget(steps=500, seconds=60.0)
    assert not budget.is_spent(LoopState(step=499, seconds=59.0))
    assert budget.is_spent(LoopState(step=500, seconds=1.0))
    assert budget.is_spent(LoopState(step=1, seconds=60.0))
    assert budget.seconds_left(LoopState(step=100, seconds=40.0), 40.0) == 10.0
    assert budget.seconds_left(LoopState(step=100, seconds=40.0), None) == 20.0
