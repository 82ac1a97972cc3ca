"""`jghand study`: parts of the method, measured by themselves."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from jghand_engine.cli.console import progress, say, say_whole_table, write_json
from jghand_engine.cli.options import AvatarOptions, File, FormatOptions, ReportOptions
from jghand_engine.cli.study_accuracy import AccuracyOptions, AccuracyRequest, run_accuracy
from jghand_engine.cli.study_effects import EffectsRequest, run_effects
from jghand_engine.cli.study_files import Places
from jghand_engine.cli.study_stability import run_stability
from jghand_engine.errors import InputError

DESCRIPTION = """Measure parts of the method by themselves: ways from joints to skin, numerical stability.

Examples:
  jghand study transform
  jghand study transform --identities 1 3 --poses 40 --out transform.md
  jghand study stability --out study/
  jghand study effects --out study/
  jghand study accuracy builtin --capture captures/id3 --out study/"""


@dataclass(frozen=True)
class Study:
    name: Annotated[Literal["transform", "stability", "effects", "accuracy"], tyro.conf.Positional]
    """transform: naive, HALO-like and our transform, on hands of other proportions, beside the paper's table.
    stability: hard hands and pictures (singular poses, units, distances, opacities), ours beside the usual formulas.
    effects: what is skipped on a motion, how wrong that is and what it saves.
    accuracy: what every setting costs in time and accuracy; `jghand render --budget-ms` chooses from it."""
    of: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[AVATAR]", help_behavior_hint="")] = None
    """accuracy: a .jghand file, builtin or painted, as with --avatar."""
    identities: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ("1", "2")
    """transform: hands that give the truth, by name or number, as `jghand capture` takes them."""
    poses: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 30
    """transform: varied poses of each hand."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """transform: also write the table to this file, as Markdown. Other studies: folder of its pages, else study/."""
    checkout: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")] = None
    """Also renew the study's part of docs/ and README in this checkout of JGHand (not of transform)."""
    avatar: AvatarOptions = field(default_factory=AvatarOptions)
    motion: File = None
    """effects: joint positions over time. Left out: named poses with ways between them."""
    format: FormatOptions = field(default_factory=FormatOptions)
    capture: File = None
    """Folder of a capture. effects: its pictures tell what the shadow's gate may skip. accuracy: also compare with the
    held-out ones."""
    accuracy: AccuracyOptions = field(default_factory=AccuracyOptions)
    report: ReportOptions = field(default_factory=ReportOptions)

    def run(self) -> None:
        places = Places(self.out, self.checkout, self.report.json)
        if self.name == "effects":
            run_effects(EffectsRequest(self.avatar.avatar, self.motion, self.format, self.capture, places))
        elif self.name == "accuracy":
            run_accuracy(AccuracyRequest(self.of or self.avatar.avatar, self.capture, places, self.accuracy))
        elif self.name == "stability":
            run_stability(places)
        else:
            self._run_transform()

    def _run_transform(self) -> None:
        from jghand_engine.captures.making.identities import load_identity
        from jghand_engine.files import writing
        from jghand_engine.study.transform_table import measure_transforms, transform_table

        if not self.identities:
            raise InputError("--identities", wanted="at least one hand", came="none")
        names = [load_identity(identity).name for identity in self.identities]
        with progress("Measuring", self.poses * len(names)) as bar:
            task = bar.task_ids[0]
            scores = {name: measure_transforms(name, self.poses, tick=lambda: bar.advance(task)) for name in names}
        table = transform_table(scores, self.poses)
        say_whole_table(table)
        if self.out is not None:
            with writing(self.out) as temporary:
                temporary.write_text(table.markdown(), encoding="utf-8")
            say(f"{self.out} written")
        if self.report.json is not None:
            figures = {
                hand: {name: score.as_dict() for name, score in by_transform.items()}
                for hand, by_transform in scores.items()
            }
            write_json(self.report.json, {"command": "study transform", "poses": self.poses, "scores": figures})
