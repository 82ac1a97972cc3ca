"""The plot of the stability study: hands drawn both ways, and error against distance to each singularity.

Needs matplotlib.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jghand_engine.study.report import HARMLESS, INK, OURS, PAGE, QUIET, STYLE, UNSEEN, USUAL, title
from jghand_engine.study.stability_curves import Curve
from jghand_engine.study.stability_views import ViewPair

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 4


def draw_figure(curves: Sequence[Curve], views: Sequence[ViewPair]) -> Figure:
    """Views above, curves below."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        rows = -(-len(curves) // COLUMNS)
        figure = Figure(figsize=(14, 4.0 + 3.4 * rows), facecolor=PAGE)
        grid = figure.add_gridspec(1 + rows, 1, height_ratios=[0.8, *[1.0] * rows], hspace=0.5, left=0.055,
                                   right=0.985, top=0.885, bottom=0.06)  # fmt: skip
        figure.text(0.05, 0.968, "Hard cases of a hand, and what the careful formulas buy", fontsize=19, weight="bold")
        figure.text(0.05, 0.945, "Above: the same joints, drawn both ways. Below: the nearer to the trouble "
                    "(to the right), the larger the error (upwards).", fontsize=11.5, color=QUIET)  # fmt: skip
        for x, color, name in ((0.79, USUAL, "the usual way"), (0.925, OURS, "JGHand")):
            figure.text(x, 0.968, f"● {name}", fontsize=13, color=color, weight="bold", va="center")
        upper = grid[0].subgridspec(1, len(views), wspace=0.05)
        for index, view in enumerate(views):
            _draw_view(figure.add_subplot(upper[index]), view)
        cells = [grid[1 + row].subgridspec(1, COLUMNS, wspace=0.3) for row in range(rows)]
        for index, curve in enumerate(curves):
            _draw_curve(figure.add_subplot(cells[index // COLUMNS][index % COLUMNS]), curve)
    return figure


def _draw_view(axes: Axes, view: ViewPair) -> None:
    gap = np.full((view.usual.shape[0], 4, 3), 250, np.uint8)
    axes.imshow(np.concatenate([view.usual, gap, view.ours], 1), interpolation="lanczos")
    axes.set_axis_off()
    axes.set_anchor("NW")
    axes.set_title(view.title, fontsize=12.5, loc="left", weight="bold", color=INK, pad=6)
    for x, color, name in ((0.03, USUAL, "usual"), (0.53, OURS, "JGHand")):
        axes.text(x, 0.04, name, transform=axes.transAxes, fontsize=11, color=color, weight="bold")


def _draw_curve(axes: Axes, curve: Curve) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    low, high = _range(curve)
    axes.set_ylim(low, high)
    axes.set_xlim(*(curve.distance[[0, -1]]))
    if curve.visible is not None:
        axes.axhspan(low, curve.visible, color=UNSEEN, lw=0, zorder=0)
        axes.text(0.02, curve.visible, " harmless below", transform=axes.get_yaxis_transform(), fontsize=8.5,
                  color=HARMLESS, va="top")  # fmt: skip
    for values, color in ((curve.usual, USUAL), (curve.ours, OURS)):
        shown = np.clip(values, low * 1.15, high / 1.15)
        axes.plot(curve.distance, shown, color=color, lw=2.6, solid_capstyle="round", zorder=3)
        lost = ~np.isfinite(values)
        if lost.any():
            axes.plot(curve.distance[lost], np.full(lost.sum(), high / 1.6), "x", color=color, ms=7, mew=2, zorder=4)
            axes.text(curve.distance[lost][-1], high / 4, "no number at all ", color=color, fontsize=8.5, ha="right",
                      va="top")  # fmt: skip
    title(axes, curve.title, below=curve.below)
    axes.set_xlabel(f"{curve.x}  →", fontsize=9.5)
    axes.set_ylabel(curve.y, fontsize=9.5)
    axes.text(0.98, 0.03, f"usual: {curve.way}", transform=axes.transAxes, fontsize=7.8, color=USUAL, ha="right",
              bbox={"facecolor": "white", "alpha": 0.75, "lw": 0, "pad": 1.5}, zorder=5)  # fmt: skip


def _range(curve: Curve) -> tuple[float, float]:
    """Limits of the y axis: whole powers of ten around everything above zero, at most ten of them."""
    values = np.concatenate([curve.ours, curve.usual])
    values = values[np.isfinite(values) & (values > 0)]
    high = 10.0 ** np.ceil(np.log10(max(values.max(), curve.visible or 0)) + 0.3)
    low = 10.0 ** np.floor(np.log10(values.min()) - 0.9)
    return max(low, high * 1e-10), high
