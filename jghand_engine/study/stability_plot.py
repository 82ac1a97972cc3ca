"""The plot of the stability study: hands drawn both ways, and error against distance to each singularity.

Needs matplotlib.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.relighting import in_studio
from jghand_engine.export.pictures import flatten
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.render.camera import Camera
from jghand_engine.study.report import HARMLESS, INK, OURS, PAGE, QUIET, STYLE, UNSEEN, USUAL, title
from jghand_engine.study.stability_curves import Curve
from jghand_engine.study.stability_hands import NUDGE_M, abducted, bent_finger, posed
from jghand_engine.study.stability_measures import random_nudges
from jghand_engine.study.stability_pictures import converted
from jghand_engine.study.stability_usual import UsualTransform

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


# ---- hands drawn both ways ------------------------------------------------------------------------------------------

# side of the hands drawn both ways
VIEW_PX = 300

_GROUND = (0.925, 0.92, 0.905)


@dataclass(frozen=True)
class ViewPair:
    """title: what is wrong with the joints · usual, ours: (H, W, 3) uint8"""

    title: str
    usual: np.ndarray
    ours: np.ndarray


def view_pairs() -> list[ViewPair]:
    """The pairs of the study's picture."""
    base = posed("flat")
    straight = base
    for finger in range(1, 5):
        straight = bent_finger(straight, finger, 0.0)
    nudge = NUDGE_M * random_nudges(8)[5]
    sideways = abducted(posed("open"), 4, math.radians(0.3), side=-1)
    far = posed("relaxed") + torch.tensor([2e4, 1.6e4, 1.6e4], dtype=torch.float64)
    return [
        _pair("Straight fingers, joints 0.5 mm off", straight + nudge, crossed=True),
        _pair("A finger sideways, joints 0.5 mm off", sideways + nudge),
        _pair("30 km from the scene's origin", far),
    ]


def _pair(title: str, joints_m: Tensor, *, crossed: bool = False) -> ViewPair:
    avatar = in_studio(load_builtin(handedness=Handedness.RIGHT))
    canonical_m = avatar.canonical_joints_m
    way = UsualTransform(canonical_m, handedness=Handedness.RIGHT, crossed=crossed)

    # what the pose changes beyond the bones is the same in both pictures
    bones = transform_of(avatar).bones((joints_m - joints_m[:1]).float())

    ours = pose_gaussians(avatar, bones, frames=bones.frames)
    usual = pose_gaussians(avatar, way.bones(joints_m.float()), frames=bones.frames)
    usual = replace(usual, position_m=usual.position_m - joints_m[0].float())
    return ViewPair(title, _drawn(usual), _drawn(ours))


def _drawn(gaussians: Gaussians) -> np.ndarray:
    """(H, W, 3) uint8 of a hand with its wrist at the origin, from the back, where the nails are."""
    side_px = VIEW_PX
    middle = np.array([0.01, 0.085, 0.0])
    eye = middle + np.array([-0.12, 0.1, -0.6])
    camera = Camera.looking_at(eye, middle, (0.0, 1.0, 0.0), width=side_px, height=side_px, focal_px=2.9 * side_px)
    with torch.no_grad():
        picture = rasterize(converted(gaussians, torch.float32), camera)
    rgba = torch.cat([picture.rgb, picture.alpha[..., None]], -1).numpy()
    return flatten(rgba, _GROUND)
