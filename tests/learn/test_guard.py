"""The guard: whatever stops being finite is found in the same step, and undone."""

import math
from dataclasses import replace

import pytest
import torch
from small_trainings import read_log
from stand_in import Notes, StandIn

from jghand_engine import files
from jghand_engine.errors import JGHandError
from jghand_engine.learn.checkpoint import load_checkpoint
from jghand_engine.learn.guard import GUARD_RECOVERIES_MAX, find_non_finite
from jghand_engine.learn.run import RunOptions, train
from jghand_engine.learn.schedule import Budget, Every

STAMP = {"seed": 0}
STATE, PARAMETERS = list(StandIn().tensors()), list(StandIn().tensors())[:5]
# a step that fails, and the copy of the state that the guard has by then
FAULT, KEPT, STEPS = 13, 10, 30


@pytest.fixture
def options(tmp_path, monkeypatch):
    """Beyond the first copies that the guard keeps; nobody waits for the disk."""
    monkeypatch.setattr(files, "sync", lambda path: None)
    return RunOptions(
        tmp_path / "hand.jghand", tmp_path / "work", STAMP, Budget(steps=STEPS), log_steps=4,
        checkpoint=Every(steps=10), preview=Every(steps=1000),
    )  # fmt: skip


class Broken(StandIn):
    """Something outside the arithmetic damages one value, once, after the step FAULT: of the state or of a gradient."""

    def __init__(self, where: str, name: str, value: float) -> None:
        super().__init__()
        self._where, self._name, self._value = where, name, value
        self.numbers: list[int] = []

    def step(self, number):
        figures = super().step(number)
        first_time = number == FAULT and number not in self.numbers
        self.numbers.append(number)
        if first_time and self._where == "figure":
            return {**figures, self._name: self._value}
        if first_time:
            tensors = self.gradients() if self._where == "gradient" else self.tensors()
            with torch.no_grad():
                tensors[self._name].view(-1)[-1] = self._value
        return figures


PLACES = [
    *(("state", name) for name in STATE),
    *(("gradient", name.removeprefix("parameter.")) for name in PARAMETERS),
    ("figure", "loss"),
    ("figure", "regular"),
]


@pytest.mark.parametrize(
    ("where", "name", "value"),
    [
        *((*place, math.nan) for place in PLACES[::3]),
        (*PLACES[0], math.inf),
        (*PLACES[7], -math.inf),
        (*PLACES[-1], math.inf),
    ],
)
def test_one_bad_value_anywhere_is_caught_in_its_step_and_the_training_goes_on(where, name, value, options):
    shown, made = Notes(), Broken(where, name, value)
    outcome = train(lambda: made, options, shown)
    assert made.numbers[: FAULT + 1] == list(range(FAULT + 1)), "no step was done with it"
    assert made.numbers[FAULT + 1 :] == [*range(KEPT, FAULT), *range(FAULT + 1, STEPS)], (
        "back to the copy, without the step"
    )
    assert outcome.finished
    assert outcome.state.skipped == [FAULT]
    assert any(f"{where} {name}" in note for note in shown.notes)
    last, _ = load_checkpoint(options.work / "checkpoints" / "step_00000030.safetensors")
    assert all(tensor.isfinite().all() for tensor in last.tensors.values())


def test_tensors_of_several_types_are_looked_at_together():
    class Mixed(StandIn):
        extra = torch.tensor([1.0, math.nan], dtype=torch.float64)

        def tensors(self):
            return {**super().tensors(), "count": torch.arange(3), "extra": self.extra}

    model = Mixed()
    (found,) = find_non_finite(model.step(0), model)
    assert found == "state extra (1 NaN)"


def test_the_log_says_what_happened(options):
    train(lambda: Broken("gradient", "planes.uv", math.nan), options)
    (line,) = [line for line in read_log(options.work / "log.jsonl") if "not_finite" in line]
    assert (line["step"], line["skipped"], line["not_finite"]) == (KEPT, FAULT, "gradient planes.uv (1 NaN)")
    steps = [line["step"] for line in read_log(options.work / "log.jsonl") if "loss" in line]
    assert steps == [*range(4, STEPS, 4), STEPS], "no line twice"


def test_the_best_checkpoint_stays_known_when_the_training_goes_back(options):
    class BestAt12(StandIn):
        def fixed_psnr(self):
            return 30.0 if self.scalars()["count"] == 12 else 20.0

    train(lambda: BestAt12(faults={FAULT: "planes.d"}), replace(options, checkpoint=Every(steps=3)))
    kept = [path.name for path in sorted((options.work / "checkpoints").iterdir())]
    assert kept == [f"step_000000{n}.safetensors" for n in (12, 27, 30)]


def test_a_training_that_keeps_failing_gives_up_and_names_what_failed(options):
    class Hopeless(StandIn):
        def step(self, number):
            figures = super().step(number)
            return {**figures, "loss": math.nan} if number >= KEPT else figures

    with pytest.raises(JGHandError, match=rf"{GUARD_RECOVERIES_MAX + 1} steps.*figure loss \(nan\)"):
        train(Hopeless, options)
    assert not options.out.exists()
