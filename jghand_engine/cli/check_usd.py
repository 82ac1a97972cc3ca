"""`jghand check-usd`: what is wrong with anybody's USD file of splats."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from jghand_engine.cli.console import say, write_figures
from jghand_engine.cli.options import FiguresFile
from jghand_engine.errors import InputError

DESCRIPTION = """Look at a USD file with Gaussian splats, anybody's, in every variant and frame, and say what is wrong.
Variants within variants are looked at as the file chooses them.

USD's own validators run too; they do not look at splats. What they miss: logarithms as scales, logits as opacity, no
extent, the degree of the harmonics left out, colors as harmonics, a lost skeleton and more. Ends with 0 when there is
no error, with 2 when there is one.

Examples:
  jghand check-usd usd/hand.usda
  jghand check-usd somebodys_splats.usdz --json findings.json"""

BAD_FILE = InputError.exit_code


@dataclass(frozen=True)
class CheckUsd:
    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """.usda, .usdc, .usd or .usdz."""
    json: FiguresFile = None

    def run(self) -> int:
        """0 when there is no error, the exit code of bad input when there is one."""
        from jghand_engine.export.usd.check import examine_usd

        done = examine_usd(self.file)
        findings = done.findings
        for finding in findings:
            say(f"{'ERROR' if finding.is_error else 'note'}: {finding}")
        errors = [str(finding) for finding in findings if finding.is_error]
        notes = [str(finding) for finding in findings if not finding.is_error]
        if not errors:
            say("No error was found." if notes else "Nothing is wrong.")
        say(f"Looked at: {done.gaussians} Gaussians, variants {done.variants}, frames {done.frames}.")
        write_figures(self.json, {
            "command": "check-usd", "file": str(self.file), "errors": errors, "notes": notes,
            "gaussians": done.gaussians, "variants": done.variants, "frames": done.frames,
        })  # fmt: skip
        return BAD_FILE if errors else 0
