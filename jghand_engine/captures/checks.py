"""What every loader of pictures does with what it reads: joints are looked at, and what is left out is counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.orders import (
    HAND_LENGTH_MAX_M,
    HAND_LENGTH_MIN_M,
    METERS_PER_UNIT,
    JointOrder,
    check_order,
    hand_length,
)

# is told what is wrong, and the reading goes on without it
Report = Callable[[InputError], None]


def check_joints(joints_m: np.ndarray, order: JointOrder, unit: str, source: str) -> None:
    """Raises InputError when the joints of a data set cannot be a hand. METHOD 2.1, on medians over the poses.

    joints_m: (P, 21, 3) level order, meters, NaN where not known · order, unit: as the data set's layout has them ·
    source: the file to name. Poses with missing joints are ignored; without any whole one nothing can be said.
    """
    whole = joints_m[np.isfinite(joints_m).all(axis=(1, 2))]
    if not len(whole):
        return
    length_m = hand_length(whole)
    if not HAND_LENGTH_MIN_M <= length_m <= HAND_LENGTH_MAX_M:
        raise InputError(
            f"joints in {source}",
            wanted=f"a hand of {HAND_LENGTH_MIN_M:g} to {HAND_LENGTH_MAX_M:g} m, in {unit}",
            came=f"{length_m:.3g} m from wrist to middle tip",
            remedy=_unit_remedy(length_m, unit),
        )
    try:
        check_order(whole, order)
    except InputError as error:
        raise InputError(
            f"joints in {source} ({error.thing})", wanted=error.wanted, came=error.came, remedy=error.remedy
        ) from error


def _unit_remedy(length_m: float, unit: str) -> str:
    for name, meters in METERS_PER_UNIT.items():
        likely_m = length_m / METERS_PER_UNIT[unit] * meters
        if HAND_LENGTH_MIN_M <= likely_m <= HAND_LENGTH_MAX_M:
            return f"They look like {name}; this layout has {unit}: convert them, or take the original file."
    return "Take the original file, or scale the hand to its real size."


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
