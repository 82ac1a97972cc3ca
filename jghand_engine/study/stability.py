"""`jghand study stability`: all measurements of the study together, as tables and as plain data.

hands       stability_hands      measured by stability_measures
pictures    stability_scenes     measured by stability_pictures
curves      stability_curves     ours beside the usual way (stability_usual)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from jghand_engine.learn.tables import NONE, Table
from jghand_engine.study.stability_curves import CURVES, Curve
from jghand_engine.study.stability_hands import GRADIENT_MAX, NUDGE_M, hand_cases
from jghand_engine.study.stability_measures import FEW, SIGNS_MAX_M, SKIN_MAX_M, HandRow, correctives_row, hand_row
from jghand_engine.study.stability_pictures import PIXEL_MAX, PictureRow
from jghand_engine.study.stability_scenes import SCENES, scene_row

# hands that the trained avatar never saw anything like, for its correctives
FAR_OUTSIDE = (
    "ordinary: relaxed",
    "ordinary: fist",
    "index folded back at its knuckle",
    "middle finger sideways, +90 degrees",
    "palm collapsed to a line",
    "bones +50 % and -50 % in turn",
    "random points that are no hand",
)
COUNT = len(hand_cases()) + len(FAR_OUTSIDE) + len(SCENES) + len(CURVES)


@dataclass(frozen=True)
class Stability:
    """Everything that was measured."""

    hands: list[HandRow]
    correctives: list[HandRow]
    pictures: list[PictureRow]
    curves: list[Curve]

    def tables(self) -> list[Table]:
        return [_hand_table([*self.hands, *self.correctives]), _picture_table(self.pictures)]

    @property
    def headline(self) -> str:
        """How many cases are finite and meet every bound, how steady the hand is that ships, and what the formulas buy
        on a straight finger."""
        hands = [*self.hands, *self.correctives]
        finite = sum(row.ours.finite for row in hands)
        finite += sum(row.error.finite and row.gradient_finite for row in self.pictures)
        missed = sum(bool(row.missed) for row in [*hands, *self.pictures])
        total = len(hands) + len(self.pictures)
        bare, shipped = (
            max(row.ours.signs_mm for row in rows if "ordinary" in row.name) for rows in (self.hands, self.correctives)
        )
        twist = next(curve for curve in self.curves if curve.name == "straight_twist")
        return (
            f"{finite} of {total} hard cases have finite values and gradients; "
            f"{total - missed} meet every bound, {missed} miss one. On ordinary poses joints that are "
            f"{1e3 * NUDGE_M:g} mm off along every axis, with the worst of all signs, move the skin of the built-in "
            f"hand by up to {shipped:.1f} mm, and by {bare:.1f} mm where nothing but the bones moves it. A "
            f"straightened finger whose joints are 0.5 mm off twists by {twist.ours[-1]:.1f} degrees, by the usual "
            f"cross products {twist.usual[-1]:.0f}."
        )


_Row = TypeVar("_Row")


def measure_stability(tick: Callable[[], None] = lambda: None) -> Stability:
    """Measures everything; `tick` is called after each of COUNT pieces."""

    def done(row: _Row) -> _Row:
        tick()
        return row

    return Stability(
        hands=[done(hand_row(case)) for case in hand_cases().values()],
        correctives=[done(correctives_row(hand_cases()[name])) for name in FAR_OUTSIDE],
        pictures=[done(scene_row(case)) for case in SCENES.values()],
        curves=[done(curve()) for curve in CURVES],
    )


# ---- tables ---------------------------------------------------------------------------------------------------------


def _hand_table(rows: list[HandRow]) -> Table:
    nudge = f"{1e3 * NUDGE_M:g} mm"
    columns = ("Hand", "Gradient", "usual", "float32, mm", "usual", f"{nudge} nudge, mm", "usual", "worst signs, mm",
               "usual", "Misses", "Says")  # fmt: skip
    notes = (
        "All values and gradients are finite, in float32 and float64, of the hand and of 100 hands beside it "
        f"(trained: {FEW}), where no column says otherwise.",
        f"Gradient: the largest, times the size of the hand; bound {GRADIENT_MAX:.0e}. "
        "float32: how far the skin is from where float64 has it.",
        f"Nudge: how far the skin moves when every joint is off by {nudge} in directions of chance, and by as much on "
        "every axis with the worst of all signs (trained: all Gaussians, in the tier that is shown); bounds "
        f"{1e3 * SKIN_MAX_M:g} and {1e3 * SIGNS_MAX_M:.1f} mm, except where the transform itself says that the hand "
        "has no certain frame (last column). A forearm goes on where the palm points, like a lever: its skin is moved "
        "by that and once more for each palm's length behind the wrist.",
        "usual: angles by acos, frames by normalized cross products, |b| + 1e-8, absolute coordinates; written for "
        "this study (study/stability_usual.py). Lengths are as on a hand of ordinary size.",
        "The JSON also has the difference of a picture from float64.",
    )
    return Table("Hard hands", columns, tuple(_hand_cells(row) for row in rows), notes)


def _hand_cells(row: HandRow) -> tuple[str, ...]:
    cells = []
    for name in ("gradient", "precision_mm", "nudged_mm", "signs_mm"):
        cells.append(short(getattr(row.ours, name)) if row.ours.finite else "not finite")
        cells.append(NONE if row.usual is None else short(getattr(row.usual, name)))
    return (row.name, *cells, "; ".join(row.missed) or NONE, "; ".join(row.flags) or NONE)


def _picture_table(rows: list[PictureRow]) -> Table:
    columns = ("Picture", "Finite", "Gradient", "Against float64, 8-bit steps", "1 µm nudge, 8-bit steps", "Drawn",
               "Left out", "Missed")  # fmt: skip
    cells = tuple(
        (
            row.name, "yes" if row.error.finite and row.gradient_finite else "no ✗", short(row.gradient),
            short(255 * row.error.worst), short(row.nudged), str(row.error.visible), str(row.error.invalid),
            "; ".join(row.missed) or NONE,
        )
        for row in rows
    )  # fmt: skip
    return Table(
        "Hard pictures",
        columns,
        cells,
        (
            "Finite: color, alpha, depth, self-shadow, and all gradients. Gradient: the largest, times the natural "
            "size of what it is for (hand, radius, 1).",
            "Against float64: the compiled kernel's float32 picture beside the reference; promise 3 of RENDERING 13 "
            f"allows {255 * PIXEL_MAX:.2g} steps, and 1 where a contribution falls on the other side "
            "of the cut.",
            "Left out: Gaussians that cannot be drawn are counted, never drawn wrong.",
        ),
    )


def short(value: float) -> str:
    """A number with two digits that somebody can read."""
    if value != value or value in (float("inf"), float("-inf")):
        return "not finite"
    if value == 0:
        return "0"
    if 0.001 <= abs(value) < 100_000:
        return f"{value:.2g}" if abs(value) < 100 else f"{value:.0f}"
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")
