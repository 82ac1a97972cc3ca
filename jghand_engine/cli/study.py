"""`jghand study`: parts of the method, measured by themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jghand_engine.cli.console import progress, say, say_whole_table, write_json
from jghand_engine.cli.options import File, FormatOptions, ReportOptions, pixels
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from jghand_engine.study.report import Report

DESCRIPTION = """Measure parts of the method by themselves: accuracy against time, numerical stability, effects skipped.

Every study prints its tables and writes them as JSON and CSV, with a plot, into a folder.

Examples:
  jghand study accuracy builtin --capture captures/id3
  jghand study stability
  jghand study effects builtin --motion motion.json
  jghand study transform --out study"""

# hands whose proportions differ from the template's: the truth of `transform`
TRANSFORM_HANDS = ("1", "2")
TRANSFORM_POSES = 30


@dataclass(frozen=True)
class Study:
    name: Annotated[Literal["accuracy", "stability", "effects", "transform"], tyro.conf.Positional]
    """accuracy: what every setting costs in time and accuracy; `jghand render --budget-ms` chooses from it.
    stability: hard hands and pictures (singular poses, units, distances, opacities), ours beside the usual formulas.
    effects: what is skipped on a motion, how wrong that is and what it saves.
    transform: naive, HALO-like and our transform, on hands of other proportions, beside the paper's table."""
    avatar: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[AVATAR]")] = "builtin"
    """accuracy and effects: a .jghand file, builtin or painted."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("study")
    """Folder for tables and plot."""
    motion: File = None
    """effects: a motion of JGHand's own. Left out: named poses with ways between them."""
    capture: File = None
    """accuracy and effects: folder of a capture whose held-out pictures are compared with, too."""
    size: Annotated[str, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = "512x334"
    """accuracy and effects: pixels of the pictures."""
    rounds: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 150
    """accuracy: frames of every setting."""
    threads: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """accuracy: threads of the renderer; 0 chooses."""
    report: ReportOptions = field(default_factory=ReportOptions)

    def run(self) -> None:
        from jghand_engine.study.report import check_folder, write_report

        studies: dict[str, Callable[[], Report]] = {
            "accuracy": self._accuracy, "stability": self._stability, "effects": self._effects,
            "transform": self._transform,
        }  # fmt: skip
        check_folder(self.out, plots=self.name != "transform")
        report = studies[self.name]()
        for table in report.tables:
            say_whole_table(table)
        say(report.headline)
        files = write_report(report, self.out)
        say(f"Written to {self.out}: {', '.join(file.name for file in files)}")
        if self.report.json is not None:
            write_json(self.report.json, report.as_dict())

    def _accuracy(self) -> Report:
        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.native.threads import thread_count
        from jghand_engine.render.budget import write_profile
        from jghand_engine.study.accuracy_measures import Plan, held_out_truth, measure_accuracy, profile_of
        from jghand_engine.study.accuracy_plot import draw_figure
        from jghand_engine.study.report import Report

        if self.rounds < 1:
            raise InputError("--rounds", wanted="1 or more", came=str(self.rounds))
        size_px = pixels(self.size)
        avatar = load_avatar_called(self.avatar)
        truth = None if self.capture is None else held_out_truth(avatar, self.capture, say)
        log = Path(self.avatar).with_suffix(".training") / "log.jsonl"
        plan = Plan(avatar, self.avatar, size_px, self.threads, truth, self.rounds, log=log if log.is_file() else None)
        study = measure_accuracy(plan, say)
        kept = write_profile(avatar, size_px, thread_count(self.threads), profile_of(study, plan))
        say("`jghand render --budget-ms` chooses from this." if kept else "The profile could not be kept.")
        return Report("accuracy", study.headline, study.tables(), study.as_dict(), draw_figure(study))

    def _stability(self) -> Report:
        from jghand_engine.study import stability
        from jghand_engine.study.report import Report
        from jghand_engine.study.stability_plot import draw_figure
        from jghand_engine.study.stability_views import view_pairs

        with progress("Measuring", stability.COUNT) as bar:
            study = stability.measure_stability(lambda: bar.advance(bar.task_ids[0]))
        figure = draw_figure(study.curves, view_pairs())
        return Report("stability", study.headline, study.tables(), study.as_dict(), figure)

    def _effects(self) -> Report:
        from dataclasses import replace

        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.captures.capture_folder import open_capture
        from jghand_engine.cli.inputs import read_sequence
        from jghand_engine.render.framing import framing_camera
        from jghand_engine.render.settings import preset
        from jghand_engine.render.subject import Subject
        from jghand_engine.study.effects_plot import draw_figure
        from jghand_engine.study.effects_study import measure_effects, named_motion
        from jghand_engine.study.report import Report

        width, height = pixels(self.size)
        capture = None if self.capture is None else open_capture(self.capture)
        avatar, name = load_avatar_called(self.avatar), "named poses with ways between them"
        if self.motion is None:
            poses = named_motion(avatar)
        else:
            sequence = read_sequence(self.motion, FormatOptions()).with_gaps_held().with_constant_bone_lengths()
            poses, avatar, name = sequence.joints_m, avatar.for_hand(sequence.handedness), self.motion.name
        camera = framing_camera(poses, avatar.handedness, "quarter", width=width, height=height)
        with progress("Measuring", len(poses)) as bar:
            study = measure_effects(
                Subject(name, avatar, poses, camera), capture, lambda: bar.advance(bar.task_ids[0]),
                replace(preset("viewport"), antialias=True),
            )  # fmt: skip
        return Report("effects", study.headline, study.tables(), study.as_dict(), draw_figure(study))

    def _transform(self) -> Report:
        from jghand_engine.captures.making.rig import load_identity
        from jghand_engine.study.report import Report
        from jghand_engine.study.transform_table import figures, headline, measure_transforms, transform_table

        names = [load_identity(identity).name for identity in TRANSFORM_HANDS]
        with progress("Measuring", TRANSFORM_POSES * len(names)) as bar:
            scores = {
                name: measure_transforms(name, TRANSFORM_POSES, tick=lambda: bar.advance(bar.task_ids[0]))
                for name in names
            }
        table = transform_table(scores, TRANSFORM_POSES)
        return Report("transform", headline(scores), [table], figures(scores, TRANSFORM_POSES))
