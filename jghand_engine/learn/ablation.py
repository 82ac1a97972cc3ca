"""The paper's ablation on any capture: the same training with a part of the method taken out, each time (METHOD 6.2).

Every variant has the same pictures, seed and budget, and is drawn by the same code (`training.live`), so that the rows
differ in nothing but what their name says. A variant has a folder of its own, with checkpoints: an ablation that was
stopped goes on where it stood.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.captures.sample import Sample
from jghand_engine.errors import InputError
from jghand_engine.learn.evaluate import Evaluation, Picturer, measure_pictures
from jghand_engine.learn.live import LiveHand
from jghand_engine.learn.options import TrainOptions, ablations
from jghand_engine.learn.progress import Display
from jghand_engine.learn.run import RunOptions, train
from jghand_engine.learn.trainable import Trainable
from jghand_engine.render.settings import preset

Build = Callable[[TrainOptions], Trainable]


@dataclass(frozen=True)
class Measured:
    """A variant that is trained and measured."""

    evaluation: Evaluation
    draw: Picturer


@dataclass(frozen=True)
class TestPictures:
    """What the variants are judged by. categories: pictures by kind · capture, origin: of the split, for the tables."""

    # no test class, whatever its name begins with
    __test__ = False

    categories: Mapping[str, tuple[Sample, ...]]
    capture: str
    origin: str


def chosen_variants(options: TrainOptions, names: tuple[str, ...]) -> dict[str, TrainOptions]:
    """The rows of the table by name, in the paper's order; none named: all. InputError lists them."""
    known = ablations(options)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError("variant", wanted=f"one of {', '.join(known)}", came=unknown[0])
    return {name: value for name, value in known.items() if not names or name in names}


def variant_folder(folder: Path, name: str) -> Path:
    """Where the training of a variant lies: `w/o trans` in without_trans."""
    return folder / name.replace("w/o ", "without_").replace("/", "_").replace(" ", "_")


def train_variant(build: Build, options: TrainOptions, run: RunOptions, display: Display | None) -> HandAvatar | None:
    """Trains one variant, or goes on with it; None when somebody stopped it. Errors as `training.run.train`."""
    made: list[Trainable] = []

    def make() -> Trainable:
        made.append(build(options))
        return made[-1]

    try:
        outcome = train(make, run, display)
    except InputError as error:
        if "--fresh" not in (error.remedy or ""):
            raise
        remedy = "Take the options and pictures that it began with, or name another folder with --out."
        raise InputError(error.thing, wanted=error.wanted, came=error.came, remedy=remedy) from error
    return made[-1].avatar() if outcome.finished else None


def measure_variant(name: str, avatar: HandAvatar, pictures: TestPictures, tick: Callable[[], None]) -> Measured:
    """Figures of a trained variant on the test pictures, as preset final draws it. tick: called after each picture."""
    draw = LiveHand(avatar, preset("final"))
    scores = measure_pictures(pictures.categories, draw, tick=tick)
    return Measured(Evaluation(name, pictures.capture, pictures.origin, scores), draw)
