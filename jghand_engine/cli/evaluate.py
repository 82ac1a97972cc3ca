"""`jghand evaluate`: how good an avatar is on pictures that it did not learn from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jghand_engine.cli.console import progress, say, say_whole_table
from jghand_engine.cli.learning import forearm_note, hand_template
from jghand_engine.cli.options import File, PresetName
from jghand_engine.cli.picture_sets import PictureSetOptions
from jghand_engine.errors import InputError
from jghand_engine.json_files import write_json

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.captures.captures import Capture
    from jghand_engine.captures.sample import Sample
    from jghand_engine.learn.evaluate import Evaluation, Picturer
    from jghand_engine.learn.perceptual import PerceptualMetric
    from jghand_engine.learn.tables import Table
    from jghand_engine.render.settings import RenderSettings

DESCRIPTION = """Measure an avatar on pictures that it did not learn from: figures, tables beside the paper's, sheets.

Examples:
  jghand evaluate id3.jghand captures/id3 --split test --out id3_evaluation
  jghand evaluate id3.jghand captures/id3 --limit 20 --figures-only
  jghand evaluate id3.jghand captures/id3 --split lights --limit 6       of a capture with `--lights varied`
  jghand evaluate id3.jghand captures/id3 --beside id3_aniso.jghand      both, on poses between poses
  jghand evaluate id3.jghand captures/id3 --crops --beside captures/id3_again"""


@dataclass(frozen=True)
class CloseOptions:
    """What eyes see"""

    crops: bool = False
    """Also squares of 46 mm of hand, inside it and with its edges, with the power of their detail; and ST-LPIPS (LPIPS
    too, with its trunk) of them and of the pictures: some 5 seconds a picture."""
    lpips_trunk: File = None
    """Torchvision's checkpoint of vgg16, or of alexnet if its name says so, which exact LPIPS needs; nobody may ship
    it."""

    def metrics(self) -> list[PerceptualMetric]:
        """The metrics that there are; what is missing is said in a line. InputError for an unusable trunk."""
        from jghand_engine.learn import perceptual

        if not self.crops and self.lpips_trunk is None:
            say("Crops and perceptual metrics: off (--crops).")
            return []
        metrics, stand_in = [], perceptual.st_lpips()
        if stand_in is None:
            say(perceptual.ST_LPIPS_MISSING)
        else:
            metrics.append(stand_in)
        if self.lpips_trunk is None:
            say(perceptual.LPIPS_MISSING)
        else:
            metrics.append(perceptual.lpips(self.lpips_trunk))
        return metrics


@dataclass(frozen=True)
class Evaluate:
    avatar: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="AVATAR")]
    """A .jghand file, or a hand that comes with JGHand: builtin or painted."""
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
    """InterHand2.6M, HanCo, or what `jghand capture` made."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")] = None
    """For tables, figures and sheets. Left out: beside the avatar, id3.evaluation for id3.jghand."""
    split: Literal["test", "lights", "train", "all"] = "test"
    """Pictures that were held out, also by what of their known light is new, as `jghand ablate` has them; those that
    were learned, or both."""
    limit: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """At most so many pictures of each kind, evenly spread; 0 takes all."""
    preset: PresetName = "final"
    """How the avatar is drawn."""
    beside: Annotated[Path | None, tyro.conf.arg(metavar="FILE|FOLDER", help_behavior_hint="")] = None
    """Another avatar, shown beside the first on poses between poses: isotropic against anisotropic. With --crops also
    the folder of the same capture made again with other noise, which tells how good a figure can be."""
    template: File = None
    """The MANO file of an avatar that was trained on it: its silhouette stands in for masks that are not there."""
    figures_only: bool = False
    """Leave out the sheets of pictures."""
    close: CloseOptions = field(default_factory=CloseOptions)
    pictures: PictureSetOptions = field(default_factory=PictureSetOptions)

    def run(self) -> None:
        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.captures.splits import split_capture
        from jghand_engine.files import make_folder
        from jghand_engine.learn.ablation import light_categories
        from jghand_engine.learn.evaluate import categories_of, held_out
        from jghand_engine.learn.sheets import write_evaluation_sheets
        from jghand_engine.render.settings import preset

        if self.limit < 0:
            raise InputError("--limit", wanted="0 or more", came=str(self.limit))
        avatar, other, again = load_avatar_called(self.avatar), None, None
        template = hand_template(self.template)
        capture = self.pictures.open(self.folder, template)
        if self.beside is not None and self.beside.is_dir():
            if not self.close.crops:
                raise InputError("--beside", wanted="an avatar", came=f"the folder {self.beside}",
                                 remedy="Add --crops too: a capture with other noise is their ceiling.")  # fmt: skip
            again = self.pictures.open(self.beside, template)
        elif self.beside is not None:
            other = load_avatar_called(str(self.beside))
        projected = sum(sample.mask_source.is_projected for sample in capture.samples)
        if projected and template.identifier != avatar.info.template:
            say(f"Warning: {projected} pictures have no mask, and {template.identifier} stands in for it, while the "
                f"avatar was made on {avatar.info.template}: give that one's file with --template, or none where it "
                "is JGHand's own.")  # fmt: skip
        told = held_out(avatar, capture, split_capture(capture, to_learn=False))
        if told.warning:
            say(f"Warning: {told.warning}")
        # of an avatar that learned all of them, none was held out
        which = self.split if told.split.test else "train"
        if which == "lights":
            categories = light_categories(told.split, self.limit)
        else:
            categories = categories_of(told.split, which, self.limit)
        out, settings = make_folder(self.out or Path(self.avatar).with_suffix(".evaluation")), preset(self.preset)
        draw = _drawer(avatar, capture, settings)
        evaluation = self._measured(draw, capture, again, categories, told.split.origin)
        tables = self._tables(evaluation, avatar, capture)
        self._write(out, evaluation, tables, settings)
        if not self.figures_only:
            drawers = {Path(self.avatar).stem: draw}
            if other is not None and self.beside is not None:
                drawers[self.beside.stem] = _drawer(other, capture, settings)
            write_evaluation_sheets(out, evaluation, categories, drawers)
        say(f"\n{out}: tables.md, evaluation.json{'' if self.figures_only else ', sheets'}")

    def _measured(
        self,
        draw: Picturer,
        capture: Capture,
        again: Capture | None,
        categories: Mapping[str, tuple[Sample, ...]],
        origin: str,
    ) -> Evaluation:
        from jghand_engine.learn.evaluate import Evaluation, ceiling_crops, measure_pictures
        from jghand_engine.learn.metrics import FLIP_MISSING, flip_package

        if flip_package() is None:
            say(FLIP_MISSING)
        metrics, crops = self.close.metrics(), self.close.crops
        samples = [sample for group in categories.values() for sample in group]
        ceiling = ceiling_crops(samples, again, metrics) if again else ()
        with progress("Measuring", len(samples)) as bar:
            pictures = measure_pictures(categories, draw, perceptual=metrics, crops=crops, tick=bar.advance)
        return Evaluation(Path(self.avatar).stem, capture.name, origin, pictures, ceiling)

    def _tables(self, evaluation: Evaluation, avatar: HandAvatar, capture: Capture) -> list[Table]:
        from jghand_engine.learn.tables import crops_table, figures_table, flexion_table, rendering_table

        tables = [rendering_table([evaluation]), figures_table(evaluation, "full"), figures_table(evaluation, "box"),
                  flexion_table(evaluation)]  # fmt: skip
        if self.close.crops:
            tables.append(crops_table(evaluation))
        if note := forearm_note(capture, avatar.info.template):
            tables[0] = replace(tables[0], notes=(*tables[0].notes, note))
        for table in tables:
            say_whole_table(table)
        return tables

    def _write(self, out: Path, evaluation: Evaluation, tables: list[Table], settings: RenderSettings) -> None:
        from jghand_engine.files import write_file
        from jghand_engine.learn.metrics import BOX_RULE

        drawn = f"Drawn with preset {self.preset}."
        write_file(out / "tables.md", "\n".join([drawn, "", *(table.markdown() for table in tables)]))
        figures = {"command": "evaluate", "preset": self.preset, "settings": settings.as_dict(), "box": BOX_RULE}
        write_json(out / "evaluation.json", figures | evaluation.as_dict())


def _drawer(avatar: HandAvatar, capture: Capture, settings: RenderSettings) -> Picturer:
    """The renderer that users have; of an avatar that learned what the renderer does not know, what training draws."""
    from jghand_engine.learn.ablation import LiveHand, drawn_as_learned
    from jghand_engine.learn.evaluate import AvatarPicturer

    if drawn_as_learned(avatar):
        return AvatarPicturer(avatar, settings)
    say(f"{avatar.info.name} is drawn as it was learned, with a transform or a shadow that the renderer does not have.")
    return LiveHand(avatar.for_hand(capture.handedness), settings)
