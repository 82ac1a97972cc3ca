"""`jghand study`: parts of the method, measured by themselves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jghand_engine.cli.console import progress, say, say_whole_table
from jghand_engine.cli.options import File, FormatOptions, pixels

if TYPE_CHECKING:
    from jghand_engine.study.report import Report

DESCRIPTION = """Measure parts of the method by themselves: accuracy against time, numerical stability, effects skipped.

Every study prints its tables and writes them as JSON and CSV, with a plot, into a folder.

Examples:
  jghand study accuracy builtin --capture captures/id3
  jghand study accuracy --quick
  jghand study stability
  jghand study effects builtin --motion motion.json"""


@dataclass(frozen=True)
class Study:
    name: Annotated[Literal["accuracy", "stability", "effects"], tyro.conf.Positional]
    """accuracy: what every setting costs in time and accuracy; `jghand render --budget-ms` chooses from it.
    stability: hard hands and pictures (singular poses, units, distances, opacities), ours beside the usual formulas.
    effects: what is skipped on a motion, how wrong that is and what it saves."""
    avatar: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[AVATAR]")] = "builtin"
    """accuracy and effects: a .jghand file, builtin or painted."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("study")
    """Folder for tables and plot."""
    motion: File = None
    """effects: a motion of JGHand's own. Left out: named poses with ways between them."""
    capture: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")] = None
    """accuracy: folder of a capture whose held-out pictures are compared with, too."""
    size: Annotated[str, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = "512x334"
    """accuracy and effects: pixels of the pictures."""
    quick: bool = False
    """For a first look. accuracy: a tenth of the frames and pictures, two poses in double precision, short
    curves; effects: the
    first quarter of the motion."""

    def run(self) -> None:
        from jghand_engine.study.report import check_folder, write_report

        check_folder(self.out)
        report = {"accuracy": self._accuracy, "stability": self._stability, "effects": self._effects}[self.name]()
        for table in report.tables:
            say_whole_table(table)
        say(report.headline)
        files = write_report(report, self.out)
        say(f"Written to {self.out}: {', '.join(file.name for file in files)}")

    def _accuracy(self) -> Report:
        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.study import accuracy_measures as measures
        from jghand_engine.study.accuracy_growth import QUICK_REACH
        from jghand_engine.study.accuracy_plot import draw_figure
        from jghand_engine.study.report import Report

        size_px = pixels(self.size)
        avatar = load_avatar_called(self.avatar)
        pictures = measures.QUICK_PICTURES if self.quick else measures.PICTURES
        truth = None if self.capture is None else measures.held_out_truth(avatar, self.capture, say, pictures)
        plan = measures.Plan(avatar, self.avatar, size_px, truth=truth)
        if self.quick:
            plan = replace(plan, rounds=measures.QUICK_ROUNDS, reach=QUICK_REACH, poses=measures.QUICK_POSES)
        study = measures.measure_accuracy(plan, say)
        return Report("accuracy", study.headline, study.tables(), study, draw_figure(study))

    def _stability(self) -> Report:
        from jghand_engine.study import stability, stability_plot
        from jghand_engine.study.report import Report

        with progress("Measuring", stability.COUNT) as bar:
            study = stability.measure_stability(bar.advance)
        figure = stability_plot.draw_figure(study.curves, stability_plot.view_pairs())
        return Report("stability", study.headline, study.tables(), study, figure)

    def _effects(self) -> Report:
        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.cli.inputs import read_sequence
        from jghand_engine.render.framing import framing_camera
        from jghand_engine.render.settings import preset
        from jghand_engine.render.subject import Subject
        from jghand_engine.study import effects
        from jghand_engine.study.effects_plot import draw_figure
        from jghand_engine.study.report import Report

        width, height = pixels(self.size)
        avatar, name = load_avatar_called(self.avatar), "named poses with ways between them"
        if self.motion is None:
            poses = effects.named_motion(avatar)
        else:
            sequence = read_sequence(self.motion, FormatOptions()).with_gaps_held().with_constant_bone_lengths()
            poses, avatar, name = sequence.joints_m, avatar.for_hand(sequence.handedness), self.motion.name
        if self.quick:
            poses = poses[: max(2, round(effects.QUICK_PART * len(poses)))]
        camera = framing_camera(poses, avatar.handedness, "quarter", width=width, height=height)
        with progress("Measuring", len(poses)) as bar:
            subject, settings = Subject(name, avatar, poses, camera), preset("viewport")
            study = effects.measure_effects(subject, settings, bar.advance)
        return Report("effects", study.headline, study.tables(), study, draw_figure(study))
