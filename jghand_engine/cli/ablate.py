"""`jghand ablate`: what each part of the method is worth, on the user's own pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jghand_engine.cli.console import err, progress, say, say_whole_table, write_json
from jghand_engine.cli.evaluate import framing_cameras
from jghand_engine.cli.failures import STOPPED
from jghand_engine.cli.picture_sets import PictureSetOptions
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.captures.splits import Split
    from jghand_engine.learn.ablation import Build, Measured, TestPictures
    from jghand_engine.learn.options import TrainOptions
    from jghand_engine.learn.schedule import Budget

DESCRIPTION = """Train with parts of the method taken out, one at a time, and print the paper's ablation table.

Examples:
  jghand ablate captures/id3 --steps 4000 --out id3_ablation
  jghand ablate captures/id3 --steps 4000 --out id3_ablation --variants "w/o shadow" full

It can be stopped with Ctrl-C; the same command goes on where it stood."""

# variants that are shown beside each other on poses between poses: where ellipsoids are said to fail (PAPER 4)
SHAPES = {"full": "isotropic", "w/o iso": "anisotropic"}


@dataclass(frozen=True)
class Ablate:
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
    """InterHand2.6M, HanCo, or what `jghand capture` made."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """For trainings, avatars, the table and a sheet of pictures."""
    steps: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 4000
    """Steps of each training, the same for all."""
    variants: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: all)")] = ()
    """Only these rows of the table, such as "w/o shadow" and full."""
    preset: Literal["default", "paper-faithful"] = "default"
    """What the parts are taken out of."""
    seed: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """The same seed gives the same avatars on the same machine."""
    limit: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """Measure at most so many pictures of each kind, evenly spread; 0 takes all."""
    pictures: PictureSetOptions = field(default_factory=PictureSetOptions)

    def run(self) -> int:
        """0 when all variants are trained and measured, the exit code of a stop when somebody stopped."""
        from jghand_engine.captures.splits import split_capture
        from jghand_engine.cli.learning import device_called, material, train_options
        from jghand_engine.learn.ablation import TestPictures, chosen_variants
        from jghand_engine.learn.evaluate import categories_of
        from jghand_engine.learn.schedule import Budget
        from jghand_engine.learn.step import HandTraining

        for name, value, least in (("--steps", self.steps, 1), ("--limit", self.limit, 0)):
            if value < least:
                raise InputError(name, wanted=f"{least} or more", came=str(value))
        device = device_called("auto")
        full, perceptual = train_options(self.preset, self.seed, device)
        variants = chosen_variants(full, self.variants)
        capture = self.pictures.open(self.folder)
        split = split_capture(capture)
        tested = TestPictures(categories_of(split, "test", self.limit), capture.name, split.origin)
        results = {}

        def build(options: TrainOptions) -> HandTraining:
            return HandTraining(material("ablation", capture.name, split, perceptual), options, device)

        for name, options in variants.items():
            say(f"\n{name}")
            avatar = self._trained(name, options, split, build, Budget(self.steps))
            if avatar is None:
                say("Stopped. Nothing is lost: the same command goes on.")
                return STOPPED
            results[name] = measured(name, avatar, tested)
        self._show(results, tested)
        return 0

    def _trained(
        self, name: str, options: TrainOptions, split: Split, build: Build, budget: Budget
    ) -> HandAvatar | None:
        from jghand_engine.learn.ablation import train_variant, variant_folder
        from jghand_engine.learn.progress import display
        from jghand_engine.learn.run import RunOptions
        from jghand_engine.learn.work_folder import Start, stamp_of

        place = variant_folder(self.out, name)
        run = RunOptions(
            out=place.with_suffix(".jghand"),
            work=place,
            stamp=stamp_of(options, split.train),
            budget=budget,
            start=Start.RESUME if place.is_dir() and any(place.iterdir()) else Start.NEW,
        )
        with display(err()) as shown:
            return train_variant(build, options, run, shown)

    def _show(self, results: Mapping[str, Measured], tested: TestPictures) -> None:
        from jghand_engine.export.pictures import write_png
        from jghand_engine.files import writing
        from jghand_engine.learn import sheets
        from jghand_engine.learn.tables import ablation_table

        table = ablation_table({name: one.evaluation for name, one in results.items()})
        say_whole_table(table)
        with writing(self.out / "ablation.md") as temporary:
            temporary.write_text(
                f"{self.steps} steps each, preset {self.preset}.\n\n{table.markdown()}", encoding="utf-8"
            )
        figures = {
            "command": "ablate", "preset": self.preset, "steps": self.steps, "seed": self.seed,
            "variants": {name: one.evaluation.as_dict() for name, one in results.items()},
        }  # fmt: skip
        write_json(self.out / "ablation.json", figures)
        everything = [sample for group in tested.categories.values() for sample in group]
        samples = sheets.varied_samples(everything, 6)
        drawers = {name: one.draw for name, one in results.items()}
        write_png(self.out / "ablation.png", sheets.variant_sheet(samples, drawers, f"Ablation on {tested.capture}"))
        shapes = {shown: drawers[name] for name, shown in SHAPES.items() if name in drawers}
        if len(shapes) > 1 and len({sample.pose for sample in everything}) > 1:
            title = f"Poses in between, on {tested.capture}"
            between = sheets.between_sheet(sheets.pairs_of(everything, 3), framing_cameras, shapes, title)
            write_png(self.out / "isotropic_anisotropic.png", between)
        say(f"\n{self.out}: ablation.md, ablation.json, sheets, the avatars and their trainings")


def measured(name: str, avatar: HandAvatar, tested: TestPictures) -> Measured:
    """Figures of a trained variant, behind a bar of progress."""
    from jghand_engine.learn.ablation import measure_variant

    with progress("Measuring", sum(map(len, tested.categories.values()))) as bar:
        task = bar.task_ids[0]
        return measure_variant(name, avatar, tested, lambda: bar.advance(task))
