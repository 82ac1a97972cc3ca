"""A small thing that learns: it paints a picture by Adam, fast and in every way like the real one for the loop."""

import os
import signal
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_painted
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.progress import Status

SHAPES = {
    "planes.uv": (4, 6, 6),
    "planes.d": (4, 6),
    "decoder.weight": (3, 4),
    "decoder.bias": (3,),
    "log_sigma": (6, 6),
}


class StandIn:
    """Color = decoder(planes.uv + planes.d) · exp(log_sigma), compared with a random picture at noisy pixels.

    faults: step number -> name of a parameter whose gradient becomes NaN in that step, as arithmetic would do it.
    """

    def __init__(self, seed: int = 0, faults: Mapping[int, str] | None = None) -> None:
        self._seed, self._faults = seed, dict(faults or {})
        g = torch.Generator().manual_seed(seed)
        self._truth = torch.rand(3, 6, 6, generator=g)
        self._parameters = {
            name: (0.3 * torch.randn(shape, generator=g)).requires_grad_() for name, shape in SHAPES.items()
        }
        self._first = {name: torch.zeros(shape) for name, shape in SHAPES.items()}
        self._second = {name: torch.zeros(shape) for name, shape in SHAPES.items()}
        self._count, self._planned = 0, 1
        self.plans: list[int] = []

    def plan(self, steps: int) -> None:
        self._planned = steps
        self.plans.append(steps)

    def step(self, number: int) -> dict[str, float]:
        g = torch.Generator().manual_seed(self._seed * 1_000_003 + number)
        weight = torch.rand(6, 6, generator=g)
        for parameter in self._parameters.values():
            parameter.grad = None
        error = (weight * (self._picture() - self._truth)).square().mean()
        regular = self._parameters["log_sigma"].square().mean()
        loss = error + 0.01 * regular
        if number in self._faults:
            p = self._parameters[self._faults[number]]
            loss = loss + torch.sqrt(p - p).sum()  # value 0, gradient 0 · infinity
        loss.backward()
        self._update(1e-2 * 0.1 ** min(number / self._planned, 1.0))
        figures = {"loss": loss, "error": error, "regular": regular}
        return {name: float(value.detach()) for name, value in figures.items()} | {"gaussians": 36.0}

    def _picture(self) -> torch.Tensor:
        p = self._parameters
        features = p["planes.uv"] + p["planes.d"][:, :, None]
        return (
            torch.einsum("cf,fhw->chw", p["decoder.weight"], features) * p["log_sigma"].exp()
            + p["decoder.bias"][:, None, None]
        )

    def _update(self, rate: float) -> None:
        self._count += 1
        with torch.no_grad():
            for name, p in self._parameters.items():
                self._first[name].lerp_(p.grad, 0.1)
                self._second[name].lerp_(p.grad.square(), 0.001)
                first, second = (
                    self._first[name] / (1 - 0.9**self._count),
                    self._second[name] / (1 - 0.999**self._count),
                )
                p -= rate * first / (second.sqrt() + 1e-8)

    def tensors(self) -> dict[str, torch.Tensor]:
        parts = {"parameter": self._parameters, "first": self._first, "second": self._second}
        return {f"{part}.{name}": t for part, tensors in parts.items() for name, t in tensors.items()}

    def load_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        with torch.no_grad():
            for name, tensor in self.tensors().items():
                tensor.copy_(tensors[name])

    def scalars(self) -> dict[str, Any]:
        return {"count": self._count}

    def load_scalars(self, scalars: Mapping[str, Any]) -> None:
        self._count = scalars["count"]

    def gradients(self) -> dict[str, torch.Tensor]:
        return {name: p.grad for name, p in self._parameters.items() if p.grad is not None}

    def preview(self) -> np.ndarray:
        both = torch.cat([self._truth, self._picture().detach()], 2)
        return both.clamp(0, 1).permute(1, 2, 0).numpy()

    def fixed_psnr(self) -> float:
        return float(-10 * (self._picture().detach() - self._truth).square().mean().log10())

    def avatar(self) -> HandAvatar:
        small = load_painted(handedness=Handedness.RIGHT).prefix(50)
        mean = self._picture().detach().mean((1, 2)).clamp(0, 1)
        return replace(small, rgb=mean.expand(50, 3).numpy().copy())


class Stops(StandIn):
    """Asks the loop to stop, as Ctrl-C does, in the step with this number."""

    def __init__(self, at: int, **options: Any) -> None:
        super().__init__(**options)
        self._at = at

    def step(self, number: int) -> dict[str, float]:
        if number == self._at:
            os.kill(os.getpid(), signal.SIGINT)
        return super().step(number)


class Notes:
    """A display that keeps what it is told."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def update(self, status: Status) -> None: ...

    def note(self, sentence: str) -> None:
        self.notes.append(sentence)
