"""`jghand ablate`: what each part of the method is worth, on the user's own pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jghand_engine.cli.console import err, progress, say, say_whole_table, write_json
from jghand_engine.cli.failures import STOPPED
from jghand_engine.cli.picture_sets import PictureSetOptions
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    import torch

    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.captures.sample import Sample
    from jghand_engine.learn.ablation import LiveHand
    from jghand_engine.learn.evaluate import Evaluation
    from jghand_engine.learn.options import TrainOptions
    from jghand_engine.learn.step import Material

DESCRIPTION = """Train with parts of the method taken out, one at a time, and print the paper's ablation table.

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
    preset: Literal["default", "paper-faithful"] = "default"
    """What the parts are taken out of."""
    seed: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """The same seed gives the same avatars on the same machine."""
    limit: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """Measure at most so many pictures of each kind, evenly spread; 0 takes all."""
    pictures: PictureSetOptions = field(default_factory=PictureSetOptions)

    def run(self) -> int:
        """0 when all variants are trained and measured, the exit code of a stop when somebody stopped."""
        from jghand_engine.captures.known_light import refuse_known_light
        from jghand_engine.captures.splits import split_capture
        from jghand_engine.cli.learning import device_called, material, train_options
        from jghand_engine.learn.ablation import LiveHand, chosen_variants
        from jghand_engine.learn.evaluate import Evaluation, categories_of, measure_pictures
        from jghand_engine.render.settings import preset

        for name, value, least in (("--steps", self.steps, 1), ("--limit", self.limit, 0)):
            if value < least:
                raise InputError(name, wanted=f"{least} or more", came=str(value))
        device = device_called("auto")
        full, perceptual = train_options(self.preset, self.seed, device)
        variants = chosen_variants(full, self.variants)
        capture = self.pictures.open(self.folder)
        split = split_capture(capture)
        refuse_known_light(split.train, "an ablation")
        categories = categories_of(split, "test", self.limit)
        learned_from = material("ablation", capture.name, split, perceptual)
        drawers, results = {}, {}
        for name, options in variants.items():
            say(f"\n{name}")
            avatar = self._trained(name, options, learned_from, device)
            if avatar is None:
                say("Stopped. Nothing is lost: the same command resumes it.")
                return STOPPED
            drawers[name] = LiveHand(avatar, preset("final"))
            with progress("Measuring", sum(map(len, categories.values()))) as bar:
                tick = partial(bar.advance, bar.task_ids[0])
                scores = measure_pictures(categories, drawers[name], tick=tick)
            results[name] = Evaluation(name, capture.name, split.origin, scores)
        self._show(capture.name, [sample for group in categories.values() for sample in group], drawers, results)
        return 0

    def _trained(
        self, name: str, options: TrainOptions, learned_from: Material, device: torch.device
    ) -> HandAvatar | None:
        from jghand_engine.learn.ablation import train_variant, variant_folder
        from jghand_engine.learn.progress import display
        from jghand_engine.learn.run import RunOptions
        from jghand_engine.learn.schedule import Budget
        from jghand_engine.learn.step import HandTraining
        from jghand_engine.learn.work_folder import MARK, Start, stamp_of

        work = variant_folder(self.out, name)
        run = RunOptions(
            out=work.with_suffix(".jghand"),
            work=work,
            stamp=stamp_of(options, learned_from.train),
            budget=Budget(self.steps),
            start=Start.RESUME if (work / MARK).is_file() else Start.NEW,
        )
        with display(err()) as shown:
            return train_variant(lambda: HandTraining(learned_from, options, device), run, shown)

    def _show(
        self,
        capture: str,
        everything: Sequence[Sample],
        drawers: Mapping[str, LiveHand],
        results: Mapping[str, Evaluation],
    ) -> None:
        from jghand_engine.export.pictures import write_png
        from jghand_engine.files import writing
        from jghand_engine.learn import sheets
        from jghand_engine.learn.tables import ablation_table

        table = ablation_table(results)
        say_whole_table(table)
        with writing(self.out / "ablation.md") as temporary:
            temporary.write_text(
                f"{self.steps} steps each, preset {self.preset}.\n\n{table.markdown()}", encoding="utf-8"
            )
        figures = {
            "command": "ablate", "preset": self.preset, "steps": self.steps, "seed": self.seed,
            "variants": {name: one.as_dict() for name, one in results.items()},
        }  # fmt: skip
        write_json(self.out / "ablation.json", figures)
        samples = sheets.varied_samples(everything, 6)
        write_png(self.out / "ablation.png", sheets.variant_sheet(samples, drawers, f"Ablation on {capture}"))
        shapes = {shown: drawers[name] for name, shown in SHAPES.items() if name in drawers}
        if len(shapes) > 1 and len({sample.pose for sample in everything}) > 1:
            title = f"Poses in between, on {capture}"
            between = sheets.between_sheet(sheets.pairs_of(everything, 3), shapes, title)
            write_png(self.out / "isotropic_anisotropic.png", between)
        say(f"\n{self.out}: ablation.md, ablation.json, sheets, the avatars and their trainings")
