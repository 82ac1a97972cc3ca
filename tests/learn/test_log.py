"""The log: whole lines, cut where a training goes on."""

import math

from small_trainings import read_log

from jghand_engine.learn.checkpoint import LoopState
from jghand_engine.learn.run import Log, add_figures, take_means


def test_lines_after_the_step_and_half_written_ones_are_cut(tmp_path):
    path = tmp_path / "log.jsonl"
    log = Log(path)
    for step in (5, 10, 15):
        log.write(step, {"loss": 1 / step}, seconds=1.5)
    with open(path, "a") as stream:
        stream.write('{"step": 20, "lo')
    log.cut_after(10)
    log.write(15, {"loss": 0.5})
    assert [line["step"] for line in read_log(path)] == [5, 10, 15]
    assert read_log(path)[1] == {"step": 10, "loss": 0.1, "seconds": 1.5}
    assert path.read_text().count("\n") == 3


def test_figures_that_json_cannot_hold_are_null(tmp_path):
    path = tmp_path / "log.jsonl"
    Log(path).write(1, {"psnr": math.inf})
    assert read_log(path) == [{"step": 1, "psnr": None}]


def test_means_are_taken_once():
    state = LoopState()
    for value in (1.0, 2.0, 6.0):
        add_figures(state, {"loss": value})
    assert take_means(state) == {"loss": 3.0}
    assert take_means(state) == {}
