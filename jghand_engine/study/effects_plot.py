"""The picture of the effects study. Needs matplotlib (the extra `study`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jghand_engine.study.effects import EffectsStudy
from jghand_engine.study.report import INK, OURS, PAGE, QUIET, STYLE, UNSEEN, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_figure(study: EffectsStudy) -> Figure:
    """Above: what ran on each frame of the motion. Below: milliseconds saved."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11, 8.4), facecolor=PAGE)
        grid = figure.add_gridspec(2, 1, height_ratios=(1.25, 1), hspace=0.38, left=0.17, right=0.97, top=0.86,
                                   bottom=0.09)  # fmt: skip
        figure.text(0.02, 0.955, "Only what the scene calls for", fontsize=20, weight="bold", color=INK)
        figure.text(
            0.02, 0.92, "Each column is a frame; a filled cell is work that was done.", fontsize=11.5, color=QUIET
        )
        figure.text(0.02, 0.895, study.subject, fontsize=9.5, color=QUIET)
        _draw_strip(figure.add_subplot(grid[0]), study)
        _draw_savings(figure.add_subplot(grid[1]), study)
    return figure


def _draw_strip(axes: Axes, study: EffectsStudy) -> None:
    from matplotlib.colors import ListedColormap

    effects = list(study.strip)
    ran = np.array([study.strip[effect] for effect in effects], float)
    axes.imshow(ran, aspect="auto", cmap=ListedColormap([UNSEEN, OURS]), vmin=0, vmax=1, interpolation="nearest")
    axes.set_yticks(range(len(effects)), [str(effect) for effect in effects], fontsize=9.5, color=INK)
    axes.set_xlabel("frame", fontsize=9.5)
    axes.tick_params(length=0)
    axes.set_yticks(np.arange(len(effects) - 1) + 0.5, minor=True)
    axes.grid(which="minor", axis="y", color=PAGE, lw=3)
    for side in axes.spines.values():
        side.set_visible(False)


def _draw_savings(axes: Axes, study: EffectsStudy) -> None:
    rows = [row for row in study.effects if row.saved_median_ms is not None and row.saved_median_ms > 0]
    rows.sort(key=lambda row: row.saved_median_ms or 0)
    axes.barh([str(row.effect) for row in rows], [row.saved_median_ms or 0 for row in rows], color=OURS, height=0.62)
    axes.set_xscale("log")
    for index, row in enumerate(rows):
        worst = 255 * max(row.errors, default=0.0)
        told = f", off by up to {worst:.1f} of 255" if worst >= 0.05 else ", no difference" if row.errors else ""
        saved_ms = row.saved_median_ms or 0
        figures = f"{saved_ms:.1f}" if saved_ms < 10 else f"{saved_ms:.0f}"
        axes.text(saved_ms, index, f" {figures} ms{told}", va="center", fontsize=8.5)
    axes.set_xlim(right=6 * max((row.saved_median_ms or 1 for row in rows), default=1))
    title(axes, "Saved on a frame that skips it")
    axes.set_xlabel("milliseconds", fontsize=9.5)
