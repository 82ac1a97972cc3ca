"""The paper's ablation on any capture: the same training with a part of the method taken out, each time (PAPER 3).

Every variant has the same pictures, seed and budget, and is drawn by the same code (`LiveHand`), so that the rows
differ in nothing but what their name says. A variant has a folder of its own, with checkpoints: an ablation that was
stopped goes on where it stood.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.captures.sample import Sample
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.evaluate import Evaluation, Picturer, measure_pictures
from jghand_engine.learn.options import TrainOptions, ablations
from jghand_engine.learn.progress import Display
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.run import RunOptions, train
from jghand_engine.learn.shadow import darken
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.learn.trainable import Trainable
from jghand_engine.native.library import load
from jghand_engine.native.threads import thread_count
from jghand_engine.render.camera import Camera
from jghand_engine.render.gate import ShadowGate, extent_px, fade, fade_with_size
from jghand_engine.render.settings import RenderSettings, ShadowMode, preset
from jghand_engine.render.shadow import ShadowStyle

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


class LiveHand:
    """A Picturer (learn.evaluate). avatar: what was learned; its bones follow the joints as it names it."""

    def __init__(self, avatar: HandAvatar, settings: RenderSettings) -> None:
        self._avatar, self._transform, self._settings = avatar, transform_of(avatar), settings
        self._gate = ShadowGate(avatar.canonical_joints_m)
        self._library = load(settings.backend)

    def __call__(self, joints_m: np.ndarray, handedness: Handedness, camera: Camera) -> np.ndarray:
        """(21, 3) world joints -> (H, W, 4) float32 premultiplied sRGB. InputError for the other hand."""
        if handedness is not self._transform.handedness:
            raise InputError("hand to draw", wanted=self._transform.handedness, came=handedness)
        with torch.no_grad():
            bones = self._transform.bones(torch.from_numpy(np.ascontiguousarray(joints_m)).float())
            gaussians = pose_gaussians(self._avatar, bones, frames=bones.frames, eye_m=torch.from_numpy(camera.eye_m))
            picture = rasterize(gaussians, camera, self._settings)
            planes = torch.cat([picture.rgb.permute(2, 0, 1), picture.alpha[None], picture.depth_sum[None]])
            look = ShadowLook() if self._avatar.learned is None else self._avatar.learned.shadow
            strength = self._shadow_strength(joints_m, float(bones.scale), camera)
            if look is not None and strength > 0:
                style = ShadowStyle(
                    samples=self._settings.shadow_samples,
                    strength=strength,
                    radius_m=self._settings.shadow_radius_m,
                    gain=look.gain,
                    tint=look.tint,
                )
                rgb = darken(planes, camera, style, library=self._library, threads=thread_count(self._settings.threads))
                planes = torch.cat([rgb, planes[3:]])
            return planes[:4].permute(1, 2, 0).contiguous().numpy()

    def _shadow_strength(self, joints_m: np.ndarray, scale: float, camera: Camera) -> float:
        """As `splat.frame`: colors that were learned under a shadow that fades have in them what it leaves out."""
        if self._settings.shadow is ShadowMode.OFF:
            return 0.0
        always = self._settings.shadow is ShadowMode.ALWAYS
        if always and self._avatar.learned is None:
            return self._settings.shadow_strength
        large = 1.0 if always else fade_with_size(extent_px(*camera.project(joints_m), camera))
        return self._settings.shadow_strength * large * fade(self._gate.score(joints_m, scale))
