"""`jghand ablate`: what each part of the method is worth, on the user's own pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jghand_engine.cli.console import err, progress, say, say_whole_table
from jghand_engine.cli.failures import STOPPED
from jghand_engine.cli.picture_sets import PictureSetOptions
from jghand_engine.errors import InputError
from jghand_engine.json_files import write_json

if TYPE_CHECKING:
    from jghand_engine.captures.sample import Sample
    from jghand_engine.learn.evaluate import Evaluation, Picturer
    from jghand_engine.learn.options import TrainOptions
    from jghand_engine.learn.run import RunOptions
    from jghand_engine.learn.step import Material
    from jghand_engine.learn.tables import Table

DESCRIPTION = """Train with parts of the method taken out, one at a time, and print the paper's ablation table. Of a
capture in known light (`jghand capture --lights varied`) parts of the light are taken out.

Examples:
  jghand ablate captures/id3 --steps 4000 --out id3_ablation
  jghand ablate captures/id3 --steps 4000 --out id3_ablation --variants "w/o screen shadow" full

It can be stopped with Ctrl-C; the same command resumes it."""

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
    """Only these rows of the table, such as "w/o screen shadow" and full."""
    seed: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """The same seed gives the same avatars on the same machine."""
    limit: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """Measure at most so many pictures of each kind, evenly spread; 0 takes all."""
    pictures: PictureSetOptions = field(default_factory=PictureSetOptions)

    def run(self) -> int:
        """0 when all variants are trained and measured, the exit code of a stop when somebody stopped."""
        from jghand_engine.captures.splits import split_capture
        from jghand_engine.cli.learning import device_called, hand_template, material, train_options
        from jghand_engine.learn.ablation import (
            SHARED,
            LiveHand,
            chosen_variants,
            light_categories,
            light_drawers,
            train_variant,
        )
        from jghand_engine.learn.evaluate import Evaluation, categories_of, measure_pictures
        from jghand_engine.learn.progress import display
        from jghand_engine.learn.step import HandTraining
        from jghand_engine.learn.tables import ablation_table, light_table
        from jghand_engine.render.settings import preset

        for name, value, least in (("--steps", self.steps, 1), ("--limit", self.limit, 0)):
            if value < least:
                raise InputError(name, wanted=f"{least} or more", came=str(value))
        device = device_called("auto")
        full, perceptual = train_options("default", self.seed, device)
        capture = self.pictures.open(self.folder)
        split = split_capture(capture)
        known_light = any(sample.light is not None for sample in split.train)
        variants = chosen_variants(full, self.variants, known_light=known_light)
        categories = light_categories(split, self.limit) if known_light else categories_of(split, "test", self.limit)
        template = hand_template(None, forearm=capture.shows_forearm)
        learned_from = material("ablation", capture.name, split, perceptual, template)
        drawers, results, first = {}, {}, None
        for name, options in variants.items():
            say(f"\n{name}")
            run = self._run(name, options, learned_from)
            with display(err()) as shown:
                build = partial(HandTraining, learned_from, options, device)
                avatar = train_variant(build, run, shown, first if options.model.known_light else None)
            if avatar is None:
                say("Stopped. Nothing is lost: the same command resumes it.")
                return STOPPED
            if name == SHARED:
                first = run
                continue
            new = light_drawers(name, avatar, options) if known_light else {name: LiveHand(avatar, preset("final"))}
            for row, draw in new.items():
                with progress("Measuring", sum(map(len, categories.values()))) as bar:
                    scores = measure_pictures(categories, draw, tick=bar.advance)
                drawers[row], results[row] = draw, Evaluation(row, capture.name, split.origin, scores)
        self._show(capture.name, categories, drawers, results, light_table if known_light else ablation_table)
        return 0

    def _run(self, name: str, options: TrainOptions, learned_from: Material) -> RunOptions:
        from jghand_engine.learn.ablation import SHARED, SHARED_PART, variant_folder
        from jghand_engine.learn.run import RunOptions
        from jghand_engine.learn.schedule import Budget
        from jghand_engine.learn.work_folder import MARK, Start, stamp_of

        work, until = variant_folder(self.out, name), round(SHARED_PART * self.steps) if name == SHARED else None
        return RunOptions(
            out=work.with_suffix(".jghand"),
            work=work,
            stamp=stamp_of(options, learned_from.train),
            budget=Budget(self.steps, until=until),
            start=Start.RESUME if (work / MARK).is_file() else Start.NEW,
        )

    def _show(
        self,
        capture: str,
        categories: Mapping[str, Sequence[Sample]],
        drawers: Mapping[str, Picturer],
        results: Mapping[str, Evaluation],
        table_of: Callable[[Mapping[str, Evaluation]], Table],
    ) -> None:
        from jghand_engine.export.pictures import write_png
        from jghand_engine.files import write_file
        from jghand_engine.learn import sheets

        table = table_of(results)
        say_whole_table(table)
        write_file(self.out / "ablation.md", f"{self.steps} steps each.\n\n{table.markdown()}")
        figures = {
            "command": "ablate", "steps": self.steps, "seed": self.seed,
            "variants": {name: one.as_dict() for name, one in results.items()},
        }  # fmt: skip
        write_json(self.out / "ablation.json", figures)
        everything = [sample for group in categories.values() for sample in group]
        # of known light one of each kind, which differ in their light
        kinds = [group[len(group) // 2] for group in categories.values()]
        samples = kinds if everything[0].light is not None else sheets.varied_samples(everything, 6)
        write_png(self.out / "ablation.png", sheets.variant_sheet(samples, drawers, f"Ablation on {capture}"))
        shapes = {shown: drawers[name] for name, shown in SHAPES.items() if name in drawers}
        if len(shapes) > 1 and len({sample.pose for sample in everything}) > 1:
            title = f"Poses in between, on {capture}"
            between = sheets.between_sheet(sheets.pairs_of(everything, 3), shapes, title)
            write_png(self.out / "isotropic_anisotropic.png", between)
        say(f"\n{self.out}: ablation.md, ablation.json, sheets, the avatars and their trainings")
