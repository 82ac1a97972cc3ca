"""`jghand check-data`: what is wrong with a folder of pictures to learn from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jghand_engine.cli.console import progress, say, write_figures
from jghand_engine.cli.learning import hand_template
from jghand_engine.cli.options import FiguresFile, File
from jghand_engine.cli.picture_sets import PictureSetOptions
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from jghand_engine.captures.check_data import DataReport

DESCRIPTION = """Look at a folder of pictures to learn from, and say what is wrong with it.

Examples:
  jghand check-data captures/id3
  jghand check-data InterHand2.6M_5fps_batch1/images/test/Capture0 --sequences ROM04_RT_Occlusion
  jghand check-data InterHand2.6M_5fps_batch1 --protocol test-capture0
  jghand check-data HanCo --sequences 0191"""

BAD_DATA = InputError.exit_code
# pictures that the overlay shows
SHOWN = 12
# more pictures than any set has
ALL = 2**31


@dataclass(frozen=True)
class CheckData:
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
    """InterHand2.6M, HanCo, or what `jghand capture` made."""
    pictures: PictureSetOptions = field(default_factory=PictureSetOptions)
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("check_data.png")
    """Picture with joints and bones drawn over a dozen of the pictures, a third of them those that fit worst."""
    template: File = None
    """Your own MANO_RIGHT.pkl or MANO_LEFT.pkl: its silhouette stands in for masks that are not there, as it will with
    `jghand train --template`."""
    all: bool = False
    """Look at every picture; else at 400, evenly spread."""
    json: FiguresFile = None

    def run(self) -> int:
        """0 when the data can be learned from, the exit code of bad input when not."""
        from jghand_engine.captures.check_data import CHECK_IMAGES, check_data, facts

        with progress("Looking at pictures", 1) as bar:
            checked = check_data(
                self.folder,
                protocol=self.pictures.protocol,
                choice=self.pictures.choice(),
                template=None if self.template is None else hand_template(self.template),
                most=ALL if self.all else CHECK_IMAGES,
                tick=bar.reach,
            )
        named = facts(checked)
        width = max((len(name) for name in named), default=0)
        for name, value in named.items():
            say(f"{name:<{width}}  {value}")
        self._say(checked)
        shown = self._overlay(checked)
        write_figures(self.json, {
            "command": "check-data", "folder": str(self.folder), "usable": checked.is_usable,
            "errors": [finding.text for finding in checked.findings if finding.is_error],
            "warnings": [finding.text for finding in checked.findings if not finding.is_error],
            "overlay": shown, **named,
        })  # fmt: skip
        return 0 if checked.is_usable else BAD_DATA

    def _say(self, checked: DataReport) -> None:
        for finding in checked.findings:
            say(str(finding))
        for note in checked.capture.notes if checked.capture else ():
            say(f"Note: {note}")
        say(f"The data {'can be learned from.' if checked.is_usable else 'cannot be learned from like this.'}")

    def _overlay(self, checked: DataReport) -> str | None:
        """Writes the picture and says so; its name, or None when there is nothing to show."""
        from jghand_engine.captures.projection import overlay
        from jghand_engine.export.pictures import Cell, SheetStyle, contact_sheet, write_png

        pictures = checked.worst_and_typical(SHOWN)
        if not pictures:
            return None
        cells = [
            Cell(f"{one.sample.frame} · {one.sample.camera_name} · {100 * one.on_mask:.0f} %", overlay(one.sample))
            for one in pictures
        ]
        write_png(self.out, contact_sheet(cells, SheetStyle(columns=4, cell_px=320)))
        say(f"Joints over {len(cells)} pictures, the worst first: {self.out}")
        return str(self.out)
