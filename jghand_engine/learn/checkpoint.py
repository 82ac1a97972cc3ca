"""Checkpoints: a training between two steps as one file, safetensors with a JSON description. Reading runs no code.

The metadata holds one key, `jghand_training`, a JSON object: format_version, jghand_version, stamp (the options that
decide what is learned; they must agree when the training goes on), scalars (the model's) and state (the loop's).
"""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch

from jghand_engine import __version__
from jghand_engine.errors import InputError
from jghand_engine.files import write_file
from jghand_engine.learn.trainable import Trainable

# checkpoints that are kept, beside the one with the best fixed views: one more than the last, should that be damaged
CHECKPOINTS_KEPT = 2

FORMAT_VERSION = 5
METADATA_KEY = "jghand_training"
RESTART = "Restart with --fresh."

Stamp = Mapping[str, Any]


def save_checkpoint(path: Path, snapshot: Snapshot, stamp: Stamp) -> None:
    """Writes the file, whole or not at all. InputError or RetryError when the disk does not let it."""
    description = {
        "format_version": FORMAT_VERSION,
        "jghand_version": __version__,
        "stamp": stamp,
        "scalars": snapshot.scalars,
        "state": asdict(snapshot.state),
    }
    tensors = {name: tensor.cpu().contiguous() for name, tensor in snapshot.tensors.items()}
    content = safetensors.torch.save(tensors, {METADATA_KEY: json.dumps(description, allow_nan=False)})
    write_file(path, content)


def load_checkpoint(path: Path) -> tuple[Snapshot, Stamp]:
    """What `save_checkpoint` wrote. InputError names the file and what is wrong with it."""
    try:
        with safetensors.safe_open(path, framework="pt") as content:
            description = json.loads((content.metadata() or {})[METADATA_KEY])
            _check_version(path, description)
            tensors = {name: content.get_tensor(name) for name in content.keys()}  # noqa: SIM118
        return Snapshot(tensors, description["scalars"], LoopState(**description["state"])), description["stamp"]
    except (safetensors.SafetensorError, OSError, ValueError, KeyError, TypeError) as error:
        came = f"{type(error).__name__}: {error}"[:200]
        raise InputError(f"{path}", wanted="a checkpoint of a training", came=came, remedy=RESTART) from error


def _check_version(path: Path, description: Mapping[str, Any]) -> None:
    if description["format_version"] != FORMAT_VERSION:
        raise InputError(
            f"{path}: format version", wanted=str(FORMAT_VERSION), came=repr(description["format_version"])[:50],
            remedy=f"Resume with JGHand {description['jghand_version']}, which wrote it, or restart with --fresh.",
        )  # fmt: skip


def check_stamp(found: Stamp, wanted: Stamp, thing: str) -> None:
    """InputError that names the first option in which the checkpoint `thing` differs from this run."""
    before, now = dict(_flat(found)), dict(_flat(wanted))
    for name in [*now, *(name for name in before if name not in now)]:
        # an option that an older JGHand did not know was off
        if (before.get(name) or False) != (now.get(name) or False):
            raise InputError(
                f"{thing}: {name}", wanted=f"{before.get(name)!r}, as this training began", came=repr(now.get(name)),
                remedy="Resume with the options it began with, or restart with --fresh.",
            )  # fmt: skip


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Nested options as (name.of.option, value); values as JSON gives them back."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, json.loads(json.dumps(value))


class CheckpointFolder:
    """The checkpoints of one training, named by their step: the last two, and the one with the best fixed views."""

    def __init__(self, folder: Path, stamp: Stamp) -> None:
        self._folder, self._stamp = folder, stamp

    def save(self, snapshot: Snapshot) -> Path:
        path = self._folder / f"step_{snapshot.state.step:08d}.safetensors"
        save_checkpoint(path, snapshot, self._stamp)
        self._forget_old(snapshot.state)
        return path

    def newest(self) -> tuple[Snapshot | None, list[InputError]]:
        """The newest checkpoint that can be read, None without any, and an error for each newer one that cannot.

        InputError when there are some and none is whole, or when the options differ from those of this run.
        """
        damaged: list[InputError] = []
        for _, path in reversed(self._numbered()):
            try:
                snapshot, stamp = load_checkpoint(path)
            except InputError as error:
                damaged.append(error)
                continue
            check_stamp(stamp, self._stamp, str(path))
            return snapshot, damaged
        if damaged:
            raise damaged[0]
        return None, []

    def clear(self) -> None:
        for _, path in self._numbered():
            path.unlink()

    def _forget_old(self, state: LoopState) -> None:
        # a newer one can only be damaged: it was passed over when the training went on from an older one
        own = [(step, path) for step, path in self._numbered() if step <= state.step]
        for step, path in own[:-CHECKPOINTS_KEPT]:
            if step != state.best_step:
                path.unlink(missing_ok=True)

    def _numbered(self) -> list[tuple[int, Path]]:
        found = ((re.fullmatch(r"step_(\d+)\.safetensors", path.name), path) for path in self._folder.glob("step_*"))
        return sorted((int(match[1]), path) for match, path in found if match)


@dataclass
class LoopState:
    """Where the loop stands; JSON can hold it.

    step:          steps done; the next one has this number
    planned_steps: steps that the whole training is expected to have
    seconds:       time spent so far, over all sessions
    skipped:       numbers of steps that are left out because they gave values that are not finite
    best_step, best_psnr: the checkpoint with the best fixed views, dB
    sums, summed:  the figures since the last line of the log, added up, and how many steps they are of
    """

    step: int = 0
    planned_steps: int = 1
    seconds: float = 0.0
    skipped: list[int] = field(default_factory=list)
    best_step: int | None = None
    best_psnr: float | None = None
    sums: dict[str, float] = field(default_factory=dict)
    summed: int = 0


@dataclass(frozen=True)
class Snapshot:
    """A copy of everything a training is between two steps; nothing in it changes any more."""

    tensors: dict[str, torch.Tensor]
    scalars: dict[str, Any]
    state: LoopState

    @classmethod
    def of(cls, training: Trainable, state: LoopState) -> Snapshot:
        tensors = {name: tensor.detach().clone() for name, tensor in training.tensors().items()}
        return cls(tensors, copy.deepcopy(training.scalars()), copy.deepcopy(state))

    def restore(self, training: Trainable) -> LoopState:
        """Puts `training` back into this state; returns the loop's part, to go on with."""
        training.load_tensors(self.tensors)
        training.load_scalars(copy.deepcopy(self.scalars))
        training.plan(self.state.planned_steps)
        return copy.deepcopy(self.state)


def check_fits(tensors: Mapping[str, torch.Tensor], training: Trainable, thing: str) -> None:
    """InputError when `tensors`, which errors call `thing`, are not those of `training`: by name, shape and type."""

    def form(tensor: torch.Tensor | None) -> str:
        return "none" if tensor is None else f"{str(tensor.dtype).removeprefix('torch.')} {tuple(tensor.shape)}"

    wanted = training.tensors()
    for name in {**wanted, **tensors}:
        want, came = form(wanted.get(name)), form(tensors.get(name))
        if want != came:
            remedy = "It belongs to another model: restart with --fresh."
            raise InputError(f"{thing}: {name}", wanted=want, came=came, remedy=remedy)
