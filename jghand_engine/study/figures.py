"""What the pictures of all studies share: colors, and figures as small files.

Needs matplotlib (the extra `study`).
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

from PIL import Image

from jghand_engine import limits
from jghand_engine.errors import InputError, install_extra

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OURS, USUAL, INK, QUIET, PAGE, UNSEEN = "#0b7a75", "#d1603d", "#2b2b2e", "#6b6b6e", "#faf9f6", "#e7f1e6"
# for matplotlib.rc_context
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans", "svg.fonttype": "path", "text.color": INK, "axes.labelcolor": QUIET,
    "xtick.color": QUIET, "ytick.color": QUIET, "axes.edgecolor": "#c9c7c1",
}  # fmt: skip


def check_matplotlib() -> None:
    """InputError where the extra is missing; asked before anything is measured."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        remedy = install_extra("study")
        raise InputError(
            "matplotlib, for the plot", wanted="an installed package", came="none", remedy=remedy
        ) from error


def png_of(figure: Figure) -> bytes:
    """The figure as a PNG of few colors, small enough for a repository."""
    plain = io.BytesIO()
    figure.savefig(plain, format="png", dpi=limits.PLOT_DPI, facecolor=PAGE)
    image = Image.open(plain).convert("RGB").quantize(limits.PLOT_COLORS, dither=Image.Dither.NONE)
    packed = io.BytesIO()
    image.save(packed, format="png", optimize=True)
    return packed.getvalue()


def svg_of(figure: Figure) -> str:
    """The figure as an SVG element, to stand in a page."""
    text = io.StringIO()
    figure.savefig(text, format="svg", facecolor=PAGE, metadata={"Date": None})
    svg = text.getvalue()
    return svg[svg.index("<svg") :]
