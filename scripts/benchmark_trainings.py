"""Accuracy against planned minutes of training and the number of Gaussians, and what drawing then costs.

    .envs/engine/bin/python scripts/benchmark_trainings.py CAPTURE --out FOLDER
    .envs/engine/bin/python scripts/benchmark_trainings.py CAPTURE --out FOLDER --minutes 1,4 --gaussians 10000

Every cell is a training of its own, whose schedule was planned for its minutes; the log of one long training says
nothing of a shorter one. All cells take an hour of a core. What is finished is kept and what was stopped goes on,
so the table can be made in parts: cells without a finished training are shown as not run. Minutes are those of the
processors, all threads together, and so are the milliseconds of drawing: other programs beside it take nothing from a
cell. With OMP_NUM_THREADS=1 they are those of one core. The steps that they made are told.

FOLDER gets the avatars, their trainings, and trainings.json, .png and .csv (scripts/quote_studies.py).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).parents[1]))

from jghand_engine.avatar.file import load_avatar
from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.captures import Capture
from jghand_engine.captures.splits import split_capture
from jghand_engine.cli.console import err, say, say_whole_table
from jghand_engine.cli.learning import hand_template, material
from jghand_engine.files import writing
from jghand_engine.learn.evaluate import AvatarPicturer
from jghand_engine.learn.options import TrainOptions
from jghand_engine.learn.progress import display
from jghand_engine.learn.run import RunOptions, train
from jghand_engine.learn.schedule import Budget
from jghand_engine.learn.step import HandTraining
from jghand_engine.learn.tables import Table, number
from jghand_engine.learn.work_folder import MARK, Start, stamp_of
from jghand_engine.render.settings import PRESETS
from jghand_engine.render.subject import moving_subject
from jghand_engine.render.timing import frame_case, measure
from jghand_engine.study.accuracy import TruthScore
from jghand_engine.study.accuracy_measures import ROUNDS, WARM_UP, held_out_truth, pictures_psnr_db
from jghand_engine.study.report import INK, PAGE, STYLE, Report, check_folder, title, write_report

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MINUTES, GAUSSIANS = (1.0, 4.0, 15.0), (10_000, 40_000, 160_000)
# pictures are judged and timed as `jghand evaluate` draws them
PRESET = "final"
NOT_RUN = "not run"
COLORS = ("#e0b13c", "#d1603d", "#0b7a75", "#5a78a8")


@dataclass(frozen=True)
class Cell:
    """One training. steps: that it made; None, as all behind it, until it is finished."""

    minutes: float
    gaussians: int
    steps: int | None = None
    truth: TruthScore | None = None
    draw_ms: float | None = None
    disturbed: bool = False

    def file(self, folder: Path) -> Path:
        """Its avatar."""
        return folder / f"{self.gaussians}_gaussians_{self.minutes:g}_minutes.jghand"

    def steps_file(self, folder: Path) -> Path:
        """How many steps its training made: written last, so that a cell with it is finished."""
        return self.file(folder).with_suffix(".training") / "steps.json"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="pictures to learn from")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--minutes", default="", help="run these alone, as 1,4; 0: run none, only measure")
    parser.add_argument("--gaussians", default="", help="run these alone, as 10000,40000")
    options = parser.parse_args()
    check_folder(options.out)
    options.out.mkdir(parents=True, exist_ok=True)
    minutes = [float(word) for word in options.minutes.split(",") if word] or list(MINUTES)
    gaussians = [int(word) for word in options.gaussians.split(",") if word] or list(GAUSSIANS)
    capture = open_capture(options.capture)
    cells = [Cell(one, count) for one in MINUTES for count in GAUSSIANS]
    for cell in cells:
        if cell.minutes in minutes and cell.gaussians in gaussians and not run(cell, capture, options.out):
            return 130
    done = measured(cells, options.capture, options.out)
    report = Report("trainings", headline(done), [table(done, capture.name)], {"cells": done}, draw_figure(done))
    say_whole_table(report.tables[0])
    say(report.headline)
    write_report(report, options.out)
    return 0


def run(cell: Cell, capture: Capture, folder: Path) -> bool:
    """Trains a cell, goes on with it, or leaves it as it is finished; False when somebody stopped it."""
    out = cell.file(folder)
    work = out.with_suffix(".training")
    if cell.steps_file(folder).is_file():
        return True
    split, options = split_capture(capture), TrainOptions()
    options = replace(options, model=replace(options.model, gaussians=cell.gaussians))
    start = Start.RESUME if (work / MARK).is_file() else Start.NEW
    budget = Budget(seconds=60 * cell.minutes)
    say(f"{cell.minutes:g} minutes, {cell.gaussians:,} Gaussians")

    def build() -> HandTraining:
        template = hand_template(None, forearm=capture.shows_forearm)
        return HandTraining(material(out.stem, capture.name, split, None, template), options)

    # a kill right behind the avatar leaves one that its training does not know as its own
    how = RunOptions(out, work, stamp_of(options, split.train), budget, start, overwrite=True, clock=time.process_time)
    with display(err()) as shown:
        outcome = train(build, how, shown)
    if outcome.finished:
        with writing(cell.steps_file(folder)) as temporary:
            temporary.write_text(json.dumps(outcome.state.step), encoding="utf-8")
    return outcome.finished


def measured(cells: Sequence[Cell], capture: Path, folder: Path) -> list[Cell]:
    """The cells, with what those that are finished are worth: drawn in turn, on the same held-out pictures."""
    finished = [cell for cell in cells if cell.steps_file(folder).is_file()]
    if not finished:
        return list(cells)
    avatars = [load_avatar(cell.file(folder)) for cell in finished]
    settings = replace(PRESETS[PRESET], reuse=False)
    truth = held_out_truth(avatars[0], capture, say)
    psnr_db = pictures_psnr_db([AvatarPicturer(avatar, settings) for avatar in avatars], truth)
    subjects = [moving_subject("hand", avatar, 512, 334) for avatar in avatars]
    cases = [frame_case(subject, settings, str(place)) for place, subject in enumerate(subjects)]
    times = {one.section: one for one in measure(cases, rounds=ROUNDS, warm_up=WARM_UP) if not one.name.startswith(" ")}
    known = {}
    for place, cell in enumerate(finished):
        steps = json.loads(cell.steps_file(folder).read_text(encoding="utf-8"))
        score, took = TruthScore.of(psnr_db[place], psnr_db[place]), times[str(place)]
        known[cell] = replace(cell, steps=steps, truth=score, draw_ms=took.cpu_ms, disturbed=took.disturbed)
    return [known.get(cell, cell) for cell in cells]


def table(cells: Sequence[Cell], capture: str) -> Table:
    """A row a cell."""
    rows = [
        (f"{cell.minutes:g}", f"{cell.gaussians:,}", f"{cell.steps:,}", f"{cell.truth.psnr_db:.2f}",
         f"{cell.truth.error_db:.2f}", f"{number(cell.draw_ms, 1)}{' ✗' if cell.disturbed else ''}")
        if cell.truth is not None
        else (f"{cell.minutes:g}", f"{cell.gaussians:,}", *[NOT_RUN] * 4)
        for cell in cells
    ]  # fmt: skip
    columns = ("Processor minutes", "Gaussians", "Steps", "PSNR dB", "±", "Processor ms a frame")
    notes = (f"PSNR: mean and standard error over held-out pictures of {capture}, whole picture over black, preset "
             f"{PRESET}; ms: 512 x 334, the same preset, nothing reused. Every row is a training of its own.",
             "✗: the machine had other work while frames were timed.")  # fmt: skip
    return Table("Accuracy against the time of training", columns, tuple(rows), notes)


def headline(cells: Sequence[Cell]) -> str:
    """The best of each time that was run."""
    best: dict[float, Cell] = {}
    for cell in cells:
        held = best.get(cell.minutes)
        if cell.truth and (held is None or held.truth is None or cell.truth.psnr_db > held.truth.psnr_db):
            best[cell.minutes] = cell
    told = [
        f"{cell.minutes:g} min: {cell.truth.psnr_db:.1f} dB ({cell.gaussians // 1000}k Gaussians)"
        for cell in best.values()
        if cell.truth
    ]
    missing = sum(cell.truth is None for cell in cells)
    return "; ".join(told or ["No training is finished"]) + (f"; {missing} of {len(cells)} not run" if missing else "")


def draw_figure(cells: Sequence[Cell]) -> Figure:
    """PSNR against minutes of training, and against milliseconds of drawing; a line for each number of Gaussians."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 4.4), facecolor=PAGE, layout="constrained")
        for axes, name, text in zip(
            figure.subplots(1, 2, sharey=True),
            ("minutes", "draw_ms"),
            ("processor minutes of training", "processor ms a frame"),
            strict=True,
        ):
            for color, count in zip(COLORS, GAUSSIANS, strict=False):
                done = [cell for cell in cells if cell.gaussians == count and cell.truth is not None]
                axes.errorbar(
                    [getattr(cell, name) for cell in done], [cell.truth.psnr_db for cell in done if cell.truth],
                    [cell.truth.error_db for cell in done if cell.truth], fmt="o-", color=color, lw=2, capsize=3,
                    label=f"{count:,} Gaussians",
                )  # fmt: skip
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter(lambda value, _position: f"{value:g}")
            axes.xaxis.set_minor_formatter(lambda value, _position: f"{value:g}" if f"{value:g}"[0] in "235" else "")
            axes.set_xlabel(text, fontsize=10)
            axes.set_ylabel("PSNR of held-out pictures, dB", fontsize=10)
            title(axes, f"Against {text}")
        axes.legend(fontsize=9, frameon=False, labelcolor=INK)
    return figure


if __name__ == "__main__":
    sys.exit(main())
