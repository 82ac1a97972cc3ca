"""`jghand train`: an avatar from pictures of one hand."""

from __future__ import annotations

import math
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jghand_engine.cli.console import err, say, write_figures
from jghand_engine.cli.failures import STOPPED
from jghand_engine.cli.learning import DeviceName
from jghand_engine.cli.options import FiguresFile, File
from jghand_engine.cli.picture_sets import PictureSetOptions
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from jghand_engine.learn.run import Outcome, RunOptions
    from jghand_engine.learn.schedule import Budget

# how long `jghand train` trains when it is not told, minutes; with the paper's configuration rounds of all pictures
TRAINING_MINUTES = 60.0
PAPER_ROUNDS = 30

DESCRIPTION = """Learn a hand from pictures of it: `jghand capture` makes them, InterHand2.6M and HanCo have them.

Examples:
  jghand train captures/id3 --out id3.jghand --minutes 60
  jghand train captures/id3 --out id3.jghand --resume
  jghand train InterHand2.6M_5fps --protocol test-capture0 --out capture0.jghand --preset paper-faithful
  jghand train captures/id3 --out id3.jghand --template MANO_RIGHT.pkl

It can be stopped at any time with Ctrl-C, or be killed, and goes on with --resume. The line of progress shows the PSNR
of one picture, held out where any is, cut to the hand: some decibels below that of whole pictures with their
background, which `jghand evaluate` prints first."""

_Number = tyro.conf.arg(metavar="NUMBER", help_behavior_hint="")


@dataclass(frozen=True)
class StartOptions:
    """Beginning and going on"""

    work: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")] = None
    """Checkpoints, log and previews. Left out: beside --out, id3.training for id3.jghand."""
    resume: bool = False
    """Go on where the training in that folder stands. Give the options that it began with: others are refused, but
    for --steps and --minutes, which may change; left out, it lasts as long as it was to."""
    fresh: bool = False
    """Forget the training that the folder holds, and begin anew."""
    overwrite: bool = False
    """Replace --out even if it is not the result of this training."""


@dataclass(frozen=True)
class Train:
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
    """InterHand2.6M, HanCo, or what `jghand capture` made."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.jghand")]
    """The avatar."""
    preset: Literal["default", "paper-faithful"] = "default"
    """What is learned, and how: our best, or as close to the paper as it says."""
    minutes: Annotated[float | None, _Number] = None
    """Train for so long, all sessions together. Left out, and no --steps: 60, or 30 rounds of all pictures with
    paper-faithful. How many steps that makes depends on the machine; --steps does not."""
    steps: Annotated[int | None, _Number] = None
    """Train for so many steps; with --minutes: until the first of both."""
    seed: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """The same seed and --steps give the same avatar on the same machine."""
    all_pictures: bool = False
    """Learn from the held-out pictures too: for an avatar that is used, not for one that is judged."""
    device: DeviceName = "auto"
    """Where torch's part runs; pictures are drawn on the CPU. auto is the CPU: cuda and mps have never been
    tried. A training that was stopped can be resumed on another device, though not to the same bits."""
    template: File = None
    """Your own MANO_RIGHT.pkl or MANO_LEFT.pkl: the hand is learned on MANO's surface and joints. Left out: on
    JGHand's own. MANO's texture layout (MANO_UV_right.obj) counts where it lies beside it."""
    lpips_trunk: File = None
    """With paper-faithful: torchvision's checkpoint of vgg16, or of alexnet if its name says so, and the loss has exact
    LPIPS instead of ST-LPIPS; nobody may ship it."""
    start: StartOptions = field(default_factory=StartOptions)
    pictures: PictureSetOptions = field(default_factory=PictureSetOptions)
    json: FiguresFile = None

    def run(self) -> int:
        """0 when the training is finished, the exit code of a stop when somebody stopped it."""
        from jghand_engine.captures.splits import split_capture
        from jghand_engine.cli.learning import device_called, forearm_note, hand_template, material, train_options
        from jghand_engine.cli.progress_json import JsonTraining, json_lines
        from jghand_engine.learn.options import in_known_light
        from jghand_engine.learn.progress import display
        from jghand_engine.learn.run import check_places, train
        from jghand_engine.learn.step import HandTraining
        from jghand_engine.learn.work_folder import stamp_of

        # what can be refused is refused before the pictures are looked at, of which there may be many
        self.check()
        run = self._run_options()
        device = device_called(self.device)
        options, perceptual = train_options(self.preset, self.seed, device, self.lpips_trunk)
        if perceptual is not None and self.lpips_trunk is None:
            say("LPIPS itself needs its trunk (--lpips-trunk).")
        template = hand_template(self.template)
        check_places(run)
        capture = self.pictures.open(self.folder, template)
        if self.template is None:
            template = hand_template(None, forearm=capture.shows_forearm)
        elif note := forearm_note(capture, template.identifier):
            say(note)
        split = split_capture(capture)
        split = split.all_learned() if self.all_pictures else split
        if split.train and split.train[0].light is not None:
            options = in_known_light(options)
            say("The light of every picture is known: the hand learns how it answers light.")
        stamp = stamp_of(options, split.train)
        if self.template is not None or capture.shows_forearm:
            stamp["template"] = template.identifier
        if perceptual is not None:
            stamp["perceptual"] = f"{perceptual.name}, {perceptual.note}"
        run = replace(run, stamp=stamp, budget=self._budget(len(split.train)))
        say(f"{capture.name}: {len(split.train)} of {len(capture)} pictures to learn from ({split.origin})")

        def build() -> HandTraining:
            say("Placing the Gaussians …")
            return HandTraining(material(self.out.stem, capture.name, split, perceptual, template), options, device)

        lines = json_lines()
        with nullcontext(JsonTraining(lines)) if lines else display(err()) as shown_progress:
            outcome = train(build, run, shown_progress)
        self._say(outcome, run)
        return 0 if outcome.finished else STOPPED

    # ---- options -----------------------------------------------------------------------------------------------------

    def check(self) -> None:
        """InputError for options that make no sense, as far as they can be judged without looking at files. A list of
        trainings asks it for each, and so it waits for no imports."""
        if self.out.suffix != ".jghand":
            raise InputError("--out", wanted="a file that ends with .jghand", came=str(self.out))
        if self.start.resume and self.start.fresh:
            raise InputError("--resume and --fresh", wanted="one of them", came="both")
        if self.minutes is not None and not 0 < self.minutes < math.inf:
            raise InputError("--minutes", wanted="more than 0", came=f"{self.minutes:g}")
        if self.steps is not None and self.steps < 1:
            raise InputError("--steps", wanted="1 or more", came=str(self.steps))
        if self.seed < 0:
            raise InputError("--seed", wanted="0 or more", came=str(self.seed))
        self.pictures.check()

    def _run_options(self) -> RunOptions:
        """How the training runs; its stamp is added when the pictures are known."""
        from jghand_engine.learn.run import RunOptions
        from jghand_engine.learn.work_folder import Start

        return RunOptions(
            out=self.out,
            work=self._work,
            stamp={},
            budget=self._budget(),
            start=Start.RESUME if self.start.resume else Start.FRESH if self.start.fresh else Start.NEW,
            overwrite=self.start.overwrite,
        )

    @property
    def _work(self) -> Path:
        return self.start.work or self.out.with_suffix(".training")

    def _budget(self, pictures: int = 1) -> Budget:
        """How long to train on so many pictures."""
        from jghand_engine.learn.schedule import Budget
        from jghand_engine.learn.work_folder import remembered_budget

        if self.steps is None and self.minutes is None:
            if self.start.resume and (begun := remembered_budget(self._work)) is not None:
                return begun
            if self.preset == "paper-faithful":
                return Budget(steps=PAPER_ROUNDS * pictures)
            return Budget(seconds=60.0 * TRAINING_MINUTES)
        return Budget(self.steps, None if self.minutes is None else 60.0 * self.minutes)

    # ---- results -----------------------------------------------------------------------------------------------------

    def _say(self, outcome: Outcome, run: RunOptions) -> None:
        from jghand_engine.learn.progress import duration

        state = outcome.state
        done = f"{state.step} steps in {duration(state.seconds)}"
        if outcome.finished:
            say(f"{run.out}: {outcome.psnr:.2f} dB on the fixed views, cut to the hand, after {done}.")
            say(f"Log and pictures: {run.work}")
            template = "" if self.template is None else f" --template {self.template}"
            say(f"How good it is: jghand evaluate {run.out} {self.folder}{template}")
        else:
            say(f"Stopped after {done}. Nothing is lost: the same command with --resume goes on.")
        if state.skipped:
            say(f"Left out, because they gave values that are not finite: steps {state.skipped}")
        write_figures(self.json, {
            "command": "train", "folder": str(self.folder), "out": str(run.out), "work": str(run.work),
            "finished": outcome.finished, "steps": state.step, "seconds": state.seconds,
            "fixed_view_psnr_db": outcome.psnr, "skipped_steps": state.skipped, "stamp": dict(run.stamp),
        })  # fmt: skip
