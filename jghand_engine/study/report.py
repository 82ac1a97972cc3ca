"""What a study leaves behind: its tables and figures as JSON and CSV, its plot as PNG, all in one folder.

Plots need matplotlib (the extra `study`).
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from jghand_engine.errors import InputError, package
from jghand_engine.files import make_folder, write_file
from jghand_engine.learn.tables import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OURS, USUAL, INK, QUIET, PAGE, UNSEEN = "#0b7a75", "#d1603d", "#2b2b2e", "#6b6b6e", "#faf9f6", "#e7f1e6"
HARMLESS = "#5c8a58"
# for matplotlib.rc_context
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans", "text.color": INK, "axes.labelcolor": QUIET, "xtick.color": QUIET,
    "ytick.color": QUIET, "axes.edgecolor": "#c9c7c1", "axes.spines.top": False, "axes.spines.right": False,
}  # fmt: skip
# resolution and colors of a plot's file: below 300 kB together
PLOT_DPI = 110
PLOT_COLORS = 128


@dataclass(frozen=True)
class Report:
    """A finished study."""

    # name of the study and of its files
    name: str
    # the result in a sentence or two
    headline: str
    tables: list[Table]
    # everything that was measured, a dataclass
    study: Any
    plot: Figure = field(repr=False)

    def as_dict(self) -> dict[str, Any]:
        tables = [vars(table) for table in self.tables]
        return {"command": f"study {self.name}", "headline": self.headline, "tables": tables, **plain(self.study)}


def plain(value: Any) -> Any:
    """Dataclasses, arrays and numbers as JSON knows them: None for what is not finite; pictures (uint8) are left
    out."""
    if is_dataclass(value) and not isinstance(value, type):
        value = {each.name: getattr(value, each.name) for each in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items() if getattr(one, "dtype", None) != np.uint8}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def check_folder(folder: Path) -> None:
    """InputError, before anything is measured, for an output folder that is a file and for missing matplotlib."""
    if folder.exists() and not folder.is_dir():
        raise InputError("--out", wanted="a folder", came=f"the file {folder}")
    package("matplotlib", "plots", "study")


def write_report(report: Report, folder: Path) -> list[Path]:
    """Writes NAME.json, NAME.png, and every table as NAME_TITLE.csv; returns their paths."""
    content = {
        f"{report.name}.json": json.dumps(report.as_dict(), indent=2, allow_nan=False).encode() + b"\n",
        f"{report.name}.png": png_of(report.plot),
    }
    for table in report.tables:
        title = re.sub(r"\W+", "_", table.title.split(",")[0].lower()).strip("_")
        # the notes are in the JSON
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([table.columns, *table.rows])
        content[f"{report.name}_{title}.csv"] = text.getvalue().encode()
    make_folder(folder)
    for name, data in content.items():
        write_file(folder / name, data)
    return [folder / name for name in content]


def png_of(figure: Figure) -> bytes:
    """The figure as a PNG of few colors, small enough for a repository."""
    plain = io.BytesIO()
    figure.savefig(plain, format="png", dpi=PLOT_DPI, facecolor=PAGE)
    image = Image.open(plain).convert("RGB").quantize(PLOT_COLORS, dither=Image.Dither.NONE)
    packed = io.BytesIO()
    image.save(packed, format="png", optimize=True)
    return packed.getvalue()


def title(axes: Axes, text: str, *, below: str = "") -> None:
    """The title of a panel, at its left edge. below: a smaller line under it"""
    axes.set_title(f"{text}\n" if below else text, fontsize=12.5, weight="bold", loc="left", color=INK)
    if below:
        axes.text(0, 1.035, below, transform=axes.transAxes, fontsize=9, color=QUIET)
    axes.tick_params(labelsize=8.5, which="both", length=2)
