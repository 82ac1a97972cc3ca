"""The table of trainings: each cell its own plan, what was not run is shown as that, what is finished is kept."""

import json
import sys
import time
from dataclasses import replace

import benchmark_trainings as script
import pytest
from learn.small_capture import write_small_capture
from small_avatars import small_avatar

from jghand_engine.avatar.file import save_avatar
from jghand_engine.learn.checkpoint import LoopState
from jghand_engine.learn.run import Outcome
from jghand_engine.learn.work_folder import Start

pytest.importorskip("matplotlib")


@pytest.fixture
def trainings(tmp_path, monkeypatch):
    """Runs the script on two cells; what was trained. A training leaves a small avatar, or stops at the first try."""
    for name, value in {"MINUTES": (0.5,), "GAUSSIANS": (200, 400), "ROUNDS": 2, "WARM_UP": 1}.items():
        monkeypatch.setattr(script, name, value)
    words = ["", str(write_small_capture(tmp_path / "capture", poses=5)), "--out", str(tmp_path / "table")]
    trained: list[tuple[int, float, Start]] = []

    def train(build, options, _display):
        count = int(options.out.name.split("_")[0])
        trained.append((count, options.budget.seconds, options.start))
        assert options.clock is time.process_time, "what else runs takes nothing from a cell"
        options.work.mkdir(exist_ok=True)
        (options.work / "training.json").touch()
        finished = len(trained) > 1
        if finished:
            save_avatar(options.out, small_avatar(count))
        return Outcome(finished, LoopState(step=7), 20.0)

    def run(*more: str) -> int:
        monkeypatch.setattr(sys, "argv", [*words, *more])
        return script.main()

    monkeypatch.setattr(script, "train", train)
    return run, trained


def test_cells_without_a_training_are_not_run_and_finished_ones_are_kept(trainings, tmp_path):
    run, trained = trainings
    assert run("--gaussians", "200") == 130
    assert not (tmp_path / "table" / "trainings.json").exists()
    assert run("--gaussians", "200") == run("--gaussians", "200") == 0
    # stopped, gone on with, and kept; half a minute was planned
    assert trained == [(200, 30.0, Start.NEW), (200, 30.0, Start.RESUME)]
    content = json.loads((tmp_path / "table" / "trainings.json").read_text())
    one, other = content["cells"]
    assert one["steps"] == 7
    assert one["truth"]["psnr_db"] > 5
    assert one["draw_ms"] > 0
    assert (other["steps"], other["truth"], other["draw_ms"]) == (None, None, None)
    assert content["tables"][0]["rows"][1] == ["0.5", "400", *[script.NOT_RUN] * 4]
    assert content["headline"].endswith("1 of 2 not run")
    assert (tmp_path / "table" / "trainings.png").is_file()


def test_the_headline_is_of_the_best_of_each_time():
    score = script.TruthScore(0.0, 0.1, 0.0, 0.0)
    figures = ((1.0, 10_000, 27.0), (1.0, 40_000, 26.0), (4.0, 40_000, 28.5))
    cells = [script.Cell(minutes, count, 10, replace(score, psnr_db=db), 3.0) for minutes, count, db in figures]
    said = "1 min: 27.0 dB (10k Gaussians); 4 min: 28.5 dB (40k Gaussians)"
    assert script.headline(cells) == said
    assert script.headline([*cells, script.Cell(60.0, 40_000)]) == f"{said}; 1 of 4 not run"
