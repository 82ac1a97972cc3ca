"""The guard over the real training: a NaN at any of 20 tensors is caught in its step, dumped, repeated and undone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from painted_samples import painted_samples
from small_trainings import small_training

from jghand_engine import files
from jghand_engine.learn.checkpoint import load_checkpoint
from jghand_engine.learn.guard import find_non_finite, replay
from jghand_engine.learn.run import RunOptions, train
from jghand_engine.learn.schedule import Budget, Every

STAMP = {"seed": 0}
# the guard has a copy of step 2 by then
KEPT, FAULT, STEPS = 2, 4, 6
PLACES = 20


@pytest.fixture
def samples(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "sync", lambda path: None)
    return painted_samples(tmp_path, ("open", "fist"))


def faulty(monkeypatch, samples, name):
    """A training in whose step FAULT the gradient of one parameter gets a NaN, every time it comes there."""
    training = small_training(monkeypatch, samples)
    parameter = dict(training.hand.named_parameters())[name]
    step = training.step

    def poison(gradient):
        gradient = gradient.clone()
        gradient.view(-1)[-1] = math.nan
        return gradient

    def with_fault(number):
        handle = parameter.register_hook(poison) if number == FAULT else None
        try:
            return step(number)
        finally:
            if handle is not None:
                handle.remove()

    training.step = with_fault
    return training


@pytest.mark.parametrize("place", range(PLACES))
def test_a_nan_at_any_of_20_tensors_is_caught_dumped_repeated_and_left_behind(monkeypatch, samples, tmp_path, place):
    training = small_training(monkeypatch, samples)
    training.step(0)
    learned = list(training.gradients())
    assert len(learned) >= PLACES
    name = learned[np.linspace(0, len(learned) - 1, PLACES).round().astype(int)[place]]
    options = RunOptions(
        tmp_path / "hand.jghand", tmp_path / "work", STAMP, Budget(steps=STEPS), checkpoint=Every(steps=STEPS),
        preview=Every(steps=1000),
    )  # fmt: skip
    outcome = train(lambda: faulty(monkeypatch, samples, name), options)
    assert outcome.finished
    assert (outcome.course.skipped, outcome.course.recoveries) == ([FAULT], 1)
    last, _ = load_checkpoint(options.work / "checkpoints" / f"step_{STEPS:08d}.safetensors")
    assert all(tensor.isfinite().all() for tensor in last.tensors.values())
    dump = options.work / "failures" / f"step_{FAULT:08d}"
    before, _ = load_checkpoint(dump / "before.safetensors")
    assert before.course.step == KEPT
    again = replay(dump, faulty(monkeypatch, samples, name), STAMP)
    assert (again.step, again.findings) == (FAULT, again.first_time)
    # the gradient is named, and nothing has spread from it into the state: the update was not made
    assert [(one.kind, one.name) for one in again.findings if one.kind != "figure"] == [("gradient", name)]


@pytest.mark.parametrize("kind", ["parameter", "adam"])
def test_a_nan_in_any_tensor_of_the_state_is_seen_after_the_next_step(monkeypatch, samples, kind):
    """Parameters and Adam's moments, all of them: what is damaged from outside cannot hide for longer than a step."""
    training = small_training(monkeypatch, samples)
    training.step(0)
    good = {name: tensor.clone() for name, tensor in training.tensors().items()}
    names = [name for name in good if name.startswith("adam.") == (kind == "adam") and good[name].is_floating_point()]
    assert len(names) >= PLACES
    missed = []
    for name in names:
        training.tensors()[name].view(-1)[0] = math.nan
        if not find_non_finite(training.step(1), training):
            missed.append(name)
        training.load_tensors(good)
    assert missed == []
