"""A training that takes milliseconds a step: painted pictures, 300 Gaussians."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from small_hands import INFO, SMALL_MODEL, small_points, stirred

from jghand_engine.captures.sample import Sample
from jghand_engine.learn import step
from jghand_engine.learn.options import Schedule, TrainOptions
from jghand_engine.learn.perceptual import PerceptualMetric
from jghand_engine.learn.step import HandTraining, Material
from jghand_engine.template.builtin import load_template

SMALL = TrainOptions(model=SMALL_MODEL, schedule=Schedule(views=2), shadow_samples=4)


def small_training(
    monkeypatch,
    samples: Sequence[Sample],
    options: TrainOptions = SMALL,
    *,
    moved: bool = True,
    perceptual: PerceptualMetric | None = None,
    device: torch.device = step.CPU,
) -> HandTraining:
    """moved: as if it had learned something, all Gaussians taking part."""
    monkeypatch.setattr(step, "place_points", lambda template, count, **how: small_points(count))
    training = HandTraining(Material(samples, samples[:1], load_template(), INFO, perceptual), options, device)
    if moved:
        stirred(training.hand)
        training.load_scalars({"count": options.model.gaussians})
    return training


def parameters_of(training: HandTraining) -> dict[str, torch.Tensor]:
    """Copies of all parameters by name."""
    return {name: parameter.detach().clone() for name, parameter in training.hand.named_parameters()}


def read_log(path: Path) -> list[dict[str, Any]]:
    """The lines of a training's log."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
