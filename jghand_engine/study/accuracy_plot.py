"""The plot of `jghand study accuracy`: what less time looks like, the front of all settings, where the time goes and
how it grows. Needs matplotlib."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jghand_engine.study.accuracy import LOOKS_SAME_DB, Accuracy, Row, pareto_front
from jghand_engine.study.accuracy_growth import PANELS, POSES, Growth
from jghand_engine.study.accuracy_variants import LIGHT, TOGETHER
from jghand_engine.study.report import HARMLESS, INK, OURS, PAGE, QUIET, STYLE, UNSEEN, USUAL, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# finger tips that are shown, and stages that have a color of their own
SHOWN = 5
STAGE_COLORS = ("#0b7a75", "#d1603d", "#e0b13c", "#5a78a8", "#8f6fa8", "#7d9c5c", "#b4b2ab")


def draw_figure(study: Accuracy) -> Figure:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(14, 14.5), facecolor=PAGE)
        grid = figure.add_gridspec(3, 1, height_ratios=[0.85, 1.35, 0.7], hspace=0.3, left=0.06, right=0.985,
                                   top=0.885, bottom=0.045)  # fmt: skip
        figure.text(0.05, 0.972, "What accuracy costs in time", fontsize=20, weight="bold")
        headline = textwrap.fill(study.headline, 150, break_on_hyphens=False)
        figure.text(0.05, 0.965, headline, fontsize=11, color=OURS, weight="bold", va="top", linespacing=1.4)
        busy = "    The machine was busy: the times are too long." if study.disturbed else ""
        figure.text(0.05, 0.927, f"{study.how_timed}.{busy}", fontsize=9, color=USUAL if busy else QUIET)
        shown = shown_rows(study)
        strip = grid[0].subgridspec(1, max(len(shown), 1), wspace=0.05)
        for index, row in enumerate(shown):
            _draw_crop(figure.add_subplot(strip[index]), row)
        # below the bars is room for their legend
        middle = grid[1].subgridspec(2, 2, width_ratios=[2.1, 1], height_ratios=[3, 1], wspace=0.2)
        _draw_front(figure.add_subplot(middle[:, 0]), study)
        _draw_stages(figure.add_subplot(middle[0, 1]), study)
        lower = grid[2].subgridspec(1, len(PANELS), wspace=0.3)
        for index, panel in enumerate(PANELS):
            points = [point for point in study.growth if point.panel == panel]
            _draw_growth(figure.add_subplot(lower[index]), panel, points)
    return figure


def shown_rows(study: Accuracy) -> list[Row]:
    """At most SHOWN of the front, spread over it, its ends among them; the fastest first."""
    front = [row for row in study.front if row.crop is not None]
    if len(front) <= SHOWN:
        return front
    return [front[index] for index in np.linspace(0, len(front) - 1, SHOWN).round().astype(int)]


def _draw_crop(axes: Axes, row: Row) -> None:
    if row.crop is not None:
        axes.imshow(row.crop, interpolation="lanczos")
    axes.set_axis_off()
    axes.set_title(f"{row.median_ms:.1f} ms", fontsize=16, weight="bold", loc="left", color=INK, pad=32)
    color = OURS if row.error.psnr_db >= LOOKS_SAME_DB else USUAL
    looks = textwrap.fill(row.looks, 30)
    axes.text(0, 1.02, looks, transform=axes.transAxes, fontsize=10.5, color=color, weight="bold")
    axes.text(0, -0.07, row.name, transform=axes.transAxes, fontsize=9, color=QUIET)


def _draw_front(axes: Axes, study: Accuracy) -> None:
    # in the light of a scene times and errors are others
    rows = [row for row in study.rows if row.axis != LIGHT]
    values = [row.error.psnr_db for row in rows]
    low, high = min(values) - 3, max(*values, LOOKS_SAME_DB) + 4
    axes.set_ylim(low, high)
    axes.axhspan(LOOKS_SAME_DB, high, color=UNSEEN, lw=0, zorder=0)
    axes.text(0.01, LOOKS_SAME_DB, "looks the same above", transform=axes.get_yaxis_transform(), fontsize=9.5,
              color=HARMLESS, va="bottom")  # fmt: skip
    for group, color, size in (
        ([row for row in rows if row.axis != TOGETHER], "#c9c7c1", 22),
        ([row for row in study.choices if not row.on_front], "#e2a48f", 46),
        (study.front, OURS, 80),
    ):
        axes.scatter([row.median_ms for row in group], [row.error.psnr_db for row in group], s=size, color=color, lw=0,
                     zorder=4)  # fmt: skip
    line = pareto_front((row.median_ms, row.error.psnr_db, row) for row in study.front)
    axes.step([row.median_ms for row in line], [row.error.psnr_db for row in line], where="post", color=OURS, lw=2.2)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _position: f"{value:g}")
    axes.xaxis.set_minor_formatter(lambda value, _position: f"{value:g}" if f"{value:g}"[0] in "235" else "")
    axes.set_xlabel("milliseconds per frame, median", fontsize=10)
    axes.set_ylabel("accuracy against float64, dB", fontsize=10)
    title(axes, "Every setting: to the left is faster, upwards is more exact")
    # more names would lie on each other; the table has all
    for row in [row for row in study.choices if row.preset or row in study.front[:1]]:
        color = OURS if row.on_front else "#a8664f"
        axes.annotate(row.name, (row.median_ms, row.error.psnr_db), xytext=(9, -11), textcoords="offset points",
                      fontsize=9.5, va="center", zorder=6, color=color, weight="bold" if row.preset else "normal",
                      bbox={"facecolor": "white", "alpha": 0.7, "lw": 0, "pad": 1})  # fmt: skip


def _draw_stages(axes: Axes, study: Accuracy) -> None:
    """Where the time of a frame goes, by preset."""
    rows = [row for row in study.choices if row.preset]
    names = list(dict.fromkeys(name for row in rows for name in row.stages_ms))
    names.sort(key=lambda name: -sum(row.stages_ms.get(name, 0) for row in rows))
    left = np.zeros(len(rows))
    for color, name in zip(STAGE_COLORS, names, strict=False):
        width = np.array([row.stages_ms.get(name, 0.0) for row in rows])
        axes.barh([row.name for row in rows], width, left=left, color=color, label=name, height=0.62)
        left += width
    rest = np.array([row.median_ms for row in rows]) - left
    axes.barh([row.name for row in rows], rest.clip(0), left=left, color="#dcdad3", label="rest", height=0.62)
    axes.legend(fontsize=8, frameon=False, ncols=3, loc="upper left", bbox_to_anchor=(-0.1, -0.18), handlelength=1)
    axes.invert_yaxis()
    title(axes, "Where the milliseconds go")


def _draw_growth(axes: Axes, panel: str, points: Sequence[Growth]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    if points:
        axes.plot([one.x for one in points], [one.median_ms for one in points], "o-", color=OURS, lw=2, ms=5)
        for one in (points[0], points[-1]):
            told = f"{one.median_ms:,.{0 if one.median_ms >= 100 else 1}f} ms"
            axes.annotate(told, (one.x, one.median_ms), xytext=(0, 7), ha="center", textcoords="offset points",
                          fontsize=8, color=INK)  # fmt: skip
        axes.set_xticks([one.x for one in points], [_short(one.x) for one in points])
        axes.minorticks_off()
        times = [one.median_ms for one in points]
        axes.set_ylim(min(times) / 1.6, max(times) * 2.2)
        axes.margins(x=0.12)
    axes.set_ylabel("ms per call" if panel == POSES else "ms per frame", fontsize=9)
    title(axes, f"{panel[0].upper()}{panel[1:]}")


def _short(count: int) -> str:
    for size, name in ((1e6, "M"), (1e3, "k")):
        if count >= size:
            return f"{count / size:.3g} {name}"
    return str(count)
