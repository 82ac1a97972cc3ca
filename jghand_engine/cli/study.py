"""`jghand study`: studies that need no pictures; so far the table of the transform from joints to skin."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from jghand_engine.cli.console import progress, say, say_whole_table, write_json
from jghand_engine.cli.options import ReportOptions
from jghand_engine.errors import InputError

DESCRIPTION = """Measure parts of the method by themselves: transform compares ways from joints to skin.

Examples:
  jghand study transform
  jghand study transform --identities 1 3 --poses 40 --out transform.md"""


@dataclass(frozen=True)
class Study:
    name: Annotated[Literal["transform"], tyro.conf.Positional]
    """transform: naive, HALO-like and our transform, on hands of other proportions, beside the paper's table."""
    identities: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ("1", "2")
    """Hands that give the truth, by name or number, as `jghand capture` takes them."""
    poses: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 30
    """Varied poses of each hand."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Also write the table to this file, as Markdown."""
    report: ReportOptions = field(default_factory=ReportOptions)

    def run(self) -> None:
        from jghand_engine.capture.identities import load_identity
        from jghand_engine.files import writing
        from jghand_engine.studies.transform_table import measure_transforms, transform_table

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
