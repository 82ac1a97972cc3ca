"""What the training loop needs to know of the thing that learns: the protocol between the loop and the model.

The loop (`run.py`), the checkpoints, the guard and the previews know nothing of hands, losses or optimizers; they see
numbered steps and named tensors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar

# the entry of a step's figures that is minimized; the others are its terms and whatever is worth a curve
LOSS = "loss"
# the entry that says how many Gaussians the step drew, where there is one
GAUSSIANS = "gaussians"


class Trainable(Protocol):
    """Something that learns in numbered steps and carries nothing random from one to the next.

    What a step does follows from `tensors`, `scalars`, its number and the planned number of steps alone: that is what
    makes a resumed training bit-identical to an uninterrupted one, and a failed step repeatable.
    """

    def plan(self, steps: int) -> None:
        """Says how many steps the whole training will have, for schedules. Under a time budget it is an estimate and
        may change between two steps."""
        ...

    def step(self, number: int) -> dict[str, float]:
        """One step of optimization, counted from 0 over the whole training; its figures, `LOSS` among them.

        Whatever it draws comes from a generator seeded by (seed, number).
        """
        ...

    def tensors(self) -> dict[str, torch.Tensor]:
        """Every tensor that makes up the state, by a flat name: parameters and the optimizer's moments. Not copies."""
        ...

    def load_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Takes over the values of `tensors`, which have the names, shapes and types of `tensors()`."""
        ...

    def scalars(self) -> dict[str, Any]:
        """The rest of the state, as JSON can hold it: the optimizer's step count, counters."""
        ...

    def load_scalars(self, scalars: Mapping[str, Any]) -> None: ...

    def gradients(self) -> dict[str, torch.Tensor]:
        """The gradients of the last step, by the name of their parameter, as the update used them."""
        ...

    def preview(self) -> np.ndarray:
        """(H, W, 3) sRGB 0..1: a fixed view, the truth beside ours."""
        ...

    def fixed_psnr(self) -> float:
        """Mean PSNR of some fixed views, that one among them, dB."""
        ...

    def avatar(self) -> HandAvatar:
        """What has been learned so far, ready to be drawn and saved."""
        ...
