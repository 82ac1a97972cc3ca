"""The picture of `jghand study accuracy`: what less time looks like, the front of all settings, where the time goes and
how it grows.

Needs matplotlib (the extra `study`).
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jghand_engine import limits
from jghand_engine.render.profile import pareto_front
from jghand_engine.study.accuracy import Accuracy, Row
from jghand_engine.study.accuracy_growth import PANELS, POSES, Growth
from jghand_engine.study.accuracy_variants import TOGETHER
from jghand_engine.study.figures import INK, OURS, PAGE, QUIET, STYLE, UNSEEN, USUAL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SHOWN = 5
_PIE = ("#0b7a75", "#d1603d", "#e0b13c", "#5a78a8", "#8f6fa8", "#7d9c5c", "#b4b2ab", "#c98a9b")


def draw_figure(study: Accuracy) -> Figure:
    """The whole picture."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(14, 14.5), facecolor=PAGE)
        outer = figure.add_gridspec(
            3, 1, height_ratios=[0.85, 1.35, 0.7], hspace=0.3, left=0.06, right=0.985, top=0.885, bottom=0.045
        )
        _draw_head(figure, study)
        shown = shown_rows(study)
        strip = outer[0].subgridspec(1, max(len(shown), 1), wspace=0.05)
        for place, row in enumerate(shown):
            _draw_crop(figure.add_subplot(strip[place]), row)
        middle = outer[1].subgridspec(2, 2, width_ratios=[2.1, 1], wspace=0.2, hspace=0.75)
        _draw_front(figure.add_subplot(middle[:, 0]), study)
        if study.learning:
            _draw_stages(figure.add_subplot(middle[0, 1]), study)
            _draw_learning(figure.add_subplot(middle[1, 1]), study)
        else:
            _draw_stages(figure.add_subplot(middle[:, 1]), study)
        lower = outer[2].subgridspec(1, len(PANELS), wspace=0.3)
        for place, panel in enumerate(PANELS):
            points = [point for point in study.growth if point.panel == panel]
            _draw_growth(figure.add_subplot(lower[place]), panel, points)
    return figure


def shown_rows(study: Accuracy) -> list[Row]:
    """At most five of the front, spread over it, its ends among them; the fastest first."""
    front = [row for row in study.front if row.crop is not None]
    if len(front) <= _SHOWN:
        return front
    return [front[place] for place in np.linspace(0, len(front) - 1, _SHOWN).round().astype(int)]


def _draw_head(figure: Figure, study: Accuracy) -> None:
    figure.text(0.05, 0.972, "What accuracy costs in time", fontsize=20, weight="bold")
    figure.text(
        0.05, 0.953, study.headline, fontsize=13 if len(study.headline) < 110 else 10.5, color=OURS, weight="bold"
    )
    busy = "    THE MACHINE WAS BUSY: the times are too long." if study.disturbed else ""
    figure.text(0.05, 0.936, f"{study.how_timed}.{busy}", fontsize=9, color=USUAL if busy else QUIET)


def _draw_crop(axes: Axes, row: Row) -> None:
    if row.crop is not None:
        axes.imshow(row.crop, interpolation="lanczos")
    axes.set_axis_off()
    axes.set_title(f"{row.median_ms:.1f} ms", fontsize=16, weight="bold", loc="left", color=INK, pad=32)
    axes.text(
        0,
        1.02,
        textwrap.fill(row.looks, 30),
        transform=axes.transAxes,
        fontsize=10.5,
        color=_color(row),
        weight="bold",
    )
    axes.text(0, -0.07, row.name, transform=axes.transAxes, fontsize=9, color=QUIET)


def _color(row: Row) -> str:
    return OURS if row.error.psnr_db >= limits.LOOKS_SAME_DB else USUAL


def _draw_front(axes: Axes, study: Accuracy) -> None:
    rows = [row for row in study.rows if row.axis == TOGETHER and row.median_ms is not None]
    others = [row for row in study.rows if row.axis != TOGETHER and row.median_ms is not None]
    low, high = _ends([row.error.psnr_db for row in rows + others])
    axes.set_ylim(low, high)
    axes.axhspan(limits.LOOKS_SAME_DB, high, color=UNSEEN, lw=0, zorder=0)
    axes.text(0.01, limits.LOOKS_SAME_DB, "looks the same above", transform=axes.get_yaxis_transform(), fontsize=9.5,
              color="#5c8a58", va="bottom")  # fmt: skip
    _scatter(axes, others, "#c9c7c1", 22)
    _scatter(axes, [row for row in rows if not row.on_front], "#e2a48f", 46)
    front = study.front
    line = pareto_front((row.median_ms or 0, row.error.psnr_db, row) for row in front)
    axes.step(
        [row.median_ms or 0 for row in line],
        [row.error.psnr_db for row in line],
        where="post",
        color=OURS,
        lw=2.2,
        zorder=3,
    )
    _scatter(axes, front, OURS, 80)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _place: f"{value:g}")
    axes.xaxis.set_minor_formatter(lambda value, _place: f"{value:g}" if f"{value:g}"[0] in "235" else "")
    axes.set_title("Every setting: to the left is faster, upwards is more exact", **_TITLE)
    axes.set_xlabel("milliseconds per frame, median", fontsize=10)
    axes.set_ylabel("accuracy against float64, dB", fontsize=10)
    _plain(axes)
    # more names would lie on each other; the page shows all
    _label(axes, [row for row in rows if row.preset or row in front[:1]])


def _scatter(axes: Axes, rows: Sequence[Row], color: str, size: float) -> None:
    axes.scatter([row.median_ms or 0 for row in rows], [row.error.psnr_db for row in rows], s=size, color=color, lw=0,
                 zorder=4)  # fmt: skip


def _label(axes: Axes, rows: Sequence[Row]) -> None:
    """Names below and right of their points, edged so that the line stays behind them."""
    from matplotlib.patheffects import withStroke

    for row in rows:
        axes.annotate(
            row.name, (row.median_ms or 0, row.error.psnr_db), xytext=(9, -11), textcoords="offset points",
            fontsize=9.5, va="center", zorder=6, weight="bold" if row.preset else "normal",
            color=OURS if row.on_front else "#a8664f", path_effects=[withStroke(linewidth=3, foreground="white")],
        )  # fmt: skip


def _draw_stages(axes: Axes, study: Accuracy) -> None:
    """Where the time of a frame goes, by preset."""
    rows = [row for row in study.rows if row.preset]
    names = list(dict.fromkeys(name for row in rows for name in row.stages_ms))
    names.sort(key=lambda name: -sum(row.stages_ms.get(name, 0) for row in rows))
    left = np.zeros(len(rows))
    rest = np.array([(row.median_ms or 0) - sum(row.stages_ms.values()) for row in rows]).clip(0)
    kept = names[: len(_PIE) - 1]
    for color, name in zip(_PIE, kept, strict=False):
        width = np.array([row.stages_ms.get(name, 0.0) for row in rows])
        axes.barh([row.name for row in rows], width, left=left, color=color, label=name, height=0.62)
        left += width
    rest += np.array([sum(row.stages_ms.get(name, 0) for name in names[len(kept) :]) for row in rows])
    axes.barh([row.name for row in rows], rest, left=left, color="#dcdad3", label="rest", height=0.62)
    axes.legend(
        fontsize=8,
        frameon=False,
        ncols=3,
        loc="upper left",
        bbox_to_anchor=(-0.1, -0.18 if study.learning else -0.08),
        handlelength=1,
    )
    axes.invert_yaxis()
    axes.set_title("Where the milliseconds go", **_TITLE)
    _plain(axes)


def _draw_learning(axes: Axes, study: Accuracy) -> None:
    minutes, psnr_db = zip(*study.learning, strict=True)
    axes.plot(minutes, psnr_db, color=OURS, lw=2)
    axes.set_title("Training: accuracy against minutes", **_TITLE)
    axes.set_xlabel(f"minutes, {study.learned_from}" if study.learned_from else "minutes", fontsize=9)
    axes.set_ylabel("held out, cut to the hand, dB", fontsize=8)
    _plain(axes)


def _draw_growth(axes: Axes, panel: str, points: Sequence[Growth]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    if points:
        axes.plot([one.x for one in points], [one.median_ms for one in points], "o-", color=OURS, lw=2, ms=5)
        for one in (points[0], points[-1]):
            told = f"{one.median_ms:,.{0 if one.median_ms >= 100 else 1}f} ms"
            axes.annotate(told, (one.x, one.median_ms), xytext=(0, 7), ha="center",
                          textcoords="offset points", fontsize=8, color=INK)  # fmt: skip
        axes.set_xticks([one.x for one in points], [_many(one.x) for one in points], fontsize=8)
        axes.minorticks_off()
        low, high = (f([one.median_ms for one in points]) for f in (min, max))
        axes.set_ylim(low / 1.6, high * 2.2)
        axes.margins(x=0.12)
    axes.set_title(f"{panel[0].upper()}{panel[1:]}", **_TITLE)
    axes.set_ylabel("ms per call" if panel == POSES else "ms per frame", fontsize=9)
    _plain(axes)


_TITLE = {"fontsize": 12.5, "weight": "bold", "loc": "left", "color": INK}


def _plain(axes: Axes) -> None:
    axes.tick_params(labelsize=8.5, length=2, which="both")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _many(count: int) -> str:
    for size, name in ((1e6, "M"), (1e3, "k")):
        if count >= size:
            return f"{count / size:.3g} {name}"
    return str(count)


def _ends(values: Sequence[float]) -> tuple[float, float]:
    return min(values) - 3, max(max(values), limits.LOOKS_SAME_DB) + 4
