# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training leaves in its folder, read while it runs and after Blender was started anew. Does not use bpy.

training.json   there is a training, and it can go on     pictures/step_00000500.png   truth beside the avatar
log.jsonl       figures, a line per interval              preview.jghand               the avatar so far
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.panel_text import Translate

_SUFFIX = ".training"
# of the log, read at a time
_READ_BYTES = 2**20
# of the picture of a loss: air around it, thickness of the line in pixels; sRGB and alpha of ground and line
_MARGIN_PX, _LINE_PX = 4, 2
_GROUND, _LINE = (0.12, 0.12, 0.12, 1.0), (0.85, 0.62, 0.35, 1.0)


@dataclass(frozen=True)
class Curve:
    """One figure of the log."""

    # of the same length, steps ascending
    steps: tuple[int, ...] = ()
    values: tuple[float, ...] = ()


@dataclass(frozen=True)
class TrainingFolder:
    """What lies in it."""

    path: Path
    # whether it holds a training
    can_go_on: bool = False
    loss: Curve = Curve()
    # of the fixed view, dB
    psnr: Curve = Curve()
    # the newest preview and avatar, None where there is none yet
    picture: Path | None = None
    avatar: Path | None = None

    def sentence(self, translate: Translate = str) -> str:
        """Where it stands, for a panel; "" before the first line of its log."""
        parts = []
        if self.loss.steps:
            template = translate("step {step}, loss {loss:.4f}")
            parts.append(template.format(step=self.loss.steps[-1], loss=self.loss.values[-1]))
        if self.psnr.steps:
            template = translate("fixed view {psnr:.2f} dB (best {best:.2f})")
            parts.append(template.format(psnr=self.psnr.values[-1], best=max(self.psnr.values)))
        return ", ".join(parts)

    def lost_sentence(self, translate: Translate = str) -> str:
        """What beginning anew takes away."""
        parts = [translate("{count} steps").format(count=self.loss.steps[-1] if self.loss.steps else 0)]
        if self.psnr.steps:
            parts.append(translate("fixed view {best:.2f} dB").format(best=max(self.psnr.values)))
        return ", ".join(parts)


def folder_of(out: Path) -> Path:
    """Where the training of an avatar file keeps its work; as `jghand train` chooses it."""
    return out.with_suffix(_SUFFIX)


def capture_words(out: Path, settings: Any, motion: Path | None = None) -> tuple[str, ...]:
    """`jghand capture`; the same words again go on where it was stopped. settings: as `scene.jghand.training`; motion:
    its poses instead of made-up ones."""
    width, height = settings.size
    return (
        *("capture", "--out", str(out), "--identity", settings.identity),
        *("--cameras", str(settings.cameras), "--poses", str(settings.poses)),
        *("--size", f"{width}x{height}", "--samples", str(settings.samples), "--seed", str(settings.seed)),
        *(("--motion", str(motion)) if motion is not None else ()),
    )


def train_words(pictures: Path, out: Path, settings: Any, start: str = "", *, overwrite: bool) -> tuple[str, ...]:
    """`jghand train`. start: "resume" goes on, "fresh" forgets what there is; overwrite: an avatar file that is not of
    this training."""
    return (
        *("train", str(pictures), "--out", str(out), "--preset", settings.preset),
        *("--minutes", f"{settings.time_s / 60:g}", "--seed", str(settings.seed)),
        *(("--all-pictures",) if settings.all_pictures else ()),
        *(("--overwrite",) if overwrite else ()),
        *((f"--{start}",) if start else ()),
    )


class TrainingReader:
    """Reads one folder again and again; of the log only what is new."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read, self._rest = 0, b""
        self._loss: list[tuple[int, float]] = []
        self._psnr: list[tuple[int, float]] = []

    def look(self) -> TrainingFolder:
        """What is there now. A folder that cannot be read is one without a training."""
        self._read_log()
        pictures = sorted((self.path / "pictures").glob("step_*.png"))
        avatar = self.path / "preview.jghand"
        return TrainingFolder(
            self.path,
            can_go_on=(self.path / "training.json").is_file(),
            loss=_curve(self._loss),
            psnr=_curve(self._psnr),
            picture=pictures[-1] if pictures else None,
            avatar=avatar if avatar.is_file() else None,
        )

    def _read_log(self) -> None:
        path = self.path / "log.jsonl"
        try:
            size = path.stat().st_size
            if size < self._read:  # a training that goes on cuts its log first
                self._read, self._rest = 0, b""
                self._loss.clear()
                self._psnr.clear()
            with path.open("rb") as stream:
                stream.seek(self._read)
                new = stream.read(_READ_BYTES)
        except OSError:
            return
        self._read += len(new)
        *lines, self._rest = (self._rest + new).split(b"\n")
        for line in lines:
            self._take(line)

    def _take(self, line: bytes) -> None:
        try:
            content = json.loads(line)
            step = content["step"]
        except (ValueError, TypeError, KeyError, RecursionError):
            return
        if not isinstance(step, int):
            return
        for name, curve in (("loss", self._loss), ("psnr", self._psnr)):
            value = content.get(name)
            if isinstance(value, (int, float)) and math.isfinite(value):
                # after going back to a checkpoint, what came later did not happen
                while curve and curve[-1][0] >= step:
                    curve.pop()
                curve.append((step, float(value)))


def _curve(points: list[tuple[int, float]]) -> Curve:
    return Curve(tuple(step for step, _ in points), tuple(value for _, value in points))


def curve_picture(curve: Curve, width: int, height: int) -> np.ndarray:
    """(H, W, 4) float32 sRGB, top row first: a curve over its steps, on a logarithmic scale where it is above 0
    throughout. Transparent without points."""
    picture = np.zeros((height, width, 4), np.float32)
    if not curve.steps:
        return picture
    picture[...] = _GROUND
    values = np.array(curve.values, dtype=np.float64)
    values = np.log(values) if values.min() > 0 else values
    steps = np.array(curve.steps, dtype=np.float64)
    low, high = values.min(), values.max()
    margin = _MARGIN_PX
    columns = np.arange(margin, width - margin)
    at = np.linspace(steps[0], steps[-1], len(columns)) if steps[-1] > steps[0] else np.full(len(columns), steps[0])
    heights = np.interp(at, steps, values)
    part = (heights - low) / (high - low) if high > low else np.full(len(columns), 0.5)
    rows = np.rint((height - 1 - margin) - part * (height - 1 - 2 * margin)).astype(int)
    for index, column in enumerate(columns):
        before = rows[max(index - 1, 0)]
        top, bottom = sorted((before, rows[index]))
        picture[top : bottom + _LINE_PX, column] = _LINE
    return picture
