"""What the commands that learn a hand share: from a preset and a seed, and from pictures, to a training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from jghand_engine.cli.console import say
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    import torch

    from jghand_engine.captures.captures import Capture
    from jghand_engine.captures.splits import Split
    from jghand_engine.learn.options import TrainOptions
    from jghand_engine.learn.perceptual import PerceptualMetric
    from jghand_engine.learn.step import Material
    from jghand_engine.template.mesh import HandTemplate

# held-out views by which a training is judged while it runs: one alone can fall while their mean rises. Drawing one
# takes some 100 ms, once a minute
JUDGED_VIEWS = 8


DeviceName = Literal["auto", "cpu", "cuda", "mps"]


def device_called(name: DeviceName) -> torch.device:
    """The device of that name. auto is the CPU: no training was tried on another one yet. InputError when torch has it
    not."""
    import torch

    if name == "auto":
        return torch.device("cpu")
    there = {"cpu": True, "cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
    if not there[name]:
        raise InputError("--device", wanted=f"one that torch {torch.__version__} can use here", came=name,
                         remedy="Take --device cpu, or install a torch for that device.")  # fmt: skip
    return torch.device(name)


def train_options(
    preset: str, seed: int, device: torch.device | None = None, lpips_trunk: Path | None = None
) -> tuple[TrainOptions, PerceptualMetric | None]:
    """What is learned, and the perceptual metric where the preset wants one: LPIPS with the user's own trunk, else
    ST-LPIPS, which a line says.

    Where there is none, a line says so, and the options have no such term: they are what a training is known by.
    InputError for a seed below 0, an unusable trunk, or one that the preset has no use for.
    """
    from jghand_engine.learn import perceptual
    from jghand_engine.learn.options import PRESETS

    if seed < 0:
        raise InputError("--seed", wanted="0 or more", came=str(seed))
    options = replace(PRESETS[preset], seed=seed)
    if not options.loss.perceptual:
        if lpips_trunk is not None:
            raise InputError("--lpips-trunk", wanted="a preset that learns by LPIPS", came=preset,
                             remedy="Take --preset paper-faithful, or leave --lpips-trunk out.")  # fmt: skip
        return options, None
    if lpips_trunk is not None:
        return options, perceptual.lpips(lpips_trunk, device=device)
    metric = perceptual.st_lpips(device)
    if metric is None:
        say(f"{perceptual.ST_LPIPS_MISSING} The training goes without the perceptual term.")
        options = replace(options, loss=replace(options.loss, perceptual=0.0))
    else:
        say("The perceptual term is ST-LPIPS, which stands in for the paper's LPIPS.")
    return options, metric


def hand_template(mano: Path | None, *, forearm: bool = False) -> HandTemplate:
    """The surface on which a hand is learned: that of the user's own MANO file, or else the built-in one. InputError

    forearm: whether the pictures show it: the built-in hand has one then, and MANO's never"""
    if mano is None:
        from jghand_engine.template.builtin import load_template, load_template_with_forearm

        return load_template_with_forearm() if forearm else load_template()
    from jghand_engine.template.mano import load_mano

    return load_mano(mano)


def forearm_note(capture: Capture, template: str) -> str | None:
    """What it means that the pictures, or a hand on that template, go on behind the wrist and the other does not."""
    from jghand_engine.avatar.avatar import FOREARM_SUFFIX

    has_one = template.endswith(FOREARM_SUFFIX)
    if capture.shows_forearm == has_one:
        return None
    if has_one:
        return f"{capture.name} ends at the wrist: all of the avatar's forearm counts as an error."
    return f"{capture.name} shows the forearm, and a hand on {template} has none: all of it counts as an error."


def material(
    name: str, capture: str, split: Split, perceptual: PerceptualMetric | None, template: HandTemplate | None = None
) -> Material:
    """The pictures of `capture` for an avatar called `name`; progress is judged by some that are held out, or else
    by some that are learned. template: where the Gaussians start; None: on the built-in hand."""
    from jghand_engine.avatar.avatar import AvatarInfo, LearnedFrom
    from jghand_engine.avatar.validation import as_text
    from jghand_engine.captures.sample import image_digest, pixel_at_hand_m
    from jghand_engine.learn.step import Material

    choice = split.test or split.train
    count = min(len(choice), JUDGED_VIEWS)
    # the middle of each of so many equal parts
    judged = [choice[(2 * part + 1) * len(choice) // (2 * count)] for part in range(count)]
    template = template or hand_template(None)
    digest, pixel_m = image_digest(split.train), pixel_at_hand_m(split.train, template.joints_m)
    learned_from = LearnedFrom(as_text(capture), as_text(split.origin), len(split.train), digest, pixel_m)
    license = as_text(f"that of the pictures: {capture}")
    info = AvatarInfo(as_text(name), template="", license=license, learned_from=learned_from)
    return Material(split.train, judged, template, info, perceptual)
