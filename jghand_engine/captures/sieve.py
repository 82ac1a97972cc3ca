"""What a reading of a data set leaves out: counted, so that no picture vanishes unsaid."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from jghand_engine.errors import InputError

# is told what is wrong, and the reading goes on without it
Report = Callable[[InputError], None]


class Sieve:
    """Counts dropped pictures by reason; raises what is broken, or hands it to `report` and goes on."""

    def __init__(self, report: Report | None = None) -> None:
        self._counts: Counter[str] = Counter()
        self._report = report

    def drop(self, reason: str, count: int = 1) -> None:
        """Notes that `count` pictures are left out."""
        if count:
            self._counts[reason] += count

    def broken(self, error: InputError) -> None:
        """A picture, or what belongs to it, cannot be used: raises `error`, unless there is somebody to report to."""
        self.wrong(error)
        self.drop("broken or missing")

    def wrong(self, error: InputError) -> None:
        """Something is wrong with the whole: raises `error`, unless there is somebody to report to."""
        if self._report is None:
            raise error
        self._report(error)

    @property
    def dropped(self) -> tuple[tuple[str, int], ...]:
        """Reasons and numbers, sorted."""
        return tuple(sorted(self._counts.items()))
