"""The whole state of a training between two steps: what the model is, and where the loop stands."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch

from jghand_engine.errors import InputError
from jghand_engine.learn.trainable import Trainable


@dataclass
class Course:
    """Where the loop stands; JSON can hold it.

    step:          steps done; the next one has this number
    planned_steps: steps that the whole training is expected to have
    seconds:       time spent so far, over all sessions
    skipped:       numbers of steps that are left out because they gave values that are not finite
    recoveries:    how often the guard had to go back
    best_step, best_psnr: the checkpoint with the best fixed views, dB
    sums, summed:  the figures since the last line of the log, added up, and how many steps they are of
    """

    step: int = 0
    planned_steps: int = 1
    seconds: float = 0.0
    skipped: list[int] = field(default_factory=list)
    recoveries: int = 0
    best_step: int | None = None
    best_psnr: float | None = None
    sums: dict[str, float] = field(default_factory=dict)
    summed: int = 0


@dataclass(frozen=True)
class Snapshot:
    """A copy of everything a training is between two steps; nothing in it changes any more."""

    tensors: dict[str, torch.Tensor]
    scalars: dict[str, Any]
    course: Course

    @classmethod
    def of(cls, trainable: Trainable, course: Course) -> Snapshot:
        tensors = {name: tensor.detach().clone() for name, tensor in trainable.tensors().items()}
        return cls(tensors, copy.deepcopy(trainable.scalars()), copy.deepcopy(course))

    def restore(self, trainable: Trainable) -> Course:
        """Puts `trainable` back into this state; returns the loop's part, to go on with."""
        trainable.load_tensors(self.tensors)
        trainable.load_scalars(copy.deepcopy(self.scalars))
        trainable.plan(self.course.planned_steps)
        return copy.deepcopy(self.course)


def check_fits(tensors: Mapping[str, torch.Tensor], trainable: Trainable, thing: str) -> None:
    """InputError when `tensors`, which errors call `thing`, are not those of `trainable`: by name, shape and type."""
    wanted = trainable.tensors()
    if tensors.keys() != wanted.keys():
        missing, unknown = sorted(wanted.keys() - tensors.keys()), sorted(tensors.keys() - wanted.keys())
        raise _other_model(
            f"{thing}: its tensors", "those of this model", f"missing {missing}, unknown {unknown}"[:300]
        )
    for name, tensor in wanted.items():
        want, came = _form(tensor), _form(tensors[name])
        if want != came:
            raise _other_model(f"{thing}: {name}", want, came)


def _form(tensor: torch.Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {tuple(tensor.shape)}"


def _other_model(thing: str, wanted: str, came: str) -> InputError:
    return InputError(thing, wanted=wanted, came=came, remedy="It belongs to another model: start anew with --fresh.")
