"""What ran and what did not: the first frame's receipt line by line, and the sum over an animation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from jghand_engine.cli.console import say, say_table
from jghand_engine.render.report import EffectSums

if TYPE_CHECKING:
    from jghand_engine.render.report import FrameReport


class Receipts:
    """Collects the receipts of frames."""

    def __init__(self) -> None:
        self._first: list[str] = []
        self._sums = EffectSums()

    def add(self, report: FrameReport) -> None:
        """Adds one frame's."""
        self._first = self._first or report.lines()
        self._sums.add(report)

    def figures(self) -> dict[str, dict[str, Any]]:
        """See EffectSums."""
        return self._sums.figures()

    def show(self) -> None:
        """Prints the first frame's receipt and the table of all."""
        say("The first frame:")
        for line in self._first:
            say(f"  {line}")
        rows = [
            (name, str(one["ran"]), str(one["skipped"]), f"{one['saved_ms']:.1f}", one["reason"])
            for name, one in self.figures().items()
        ]
        say_table("All frames", ("effect", "ran", "skipped", "saved, about ms", "skipped last because"), rows)
