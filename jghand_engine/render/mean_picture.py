"""Pictures of parts of the frame, and the mean of several."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine import limits
from jghand_engine.render.effect_plan import Box


@dataclass(frozen=True)
class Drawn:
    """What was drawn of a picture. box: where it lies in it

    rgba: (h, w, 4) premultiplied · depth_m: (h, w), 0 where there is none; None unless wanted · weights: (h, w, hands)
    how much of a pixel each hand covers; None unless wanted
    """

    box: Box
    rgba: np.ndarray
    depth_m: np.ndarray | None = None
    weights: np.ndarray | None = None

    def laid_out(self, width: int, height: int) -> Drawn:
        """The whole picture, empty around the box. It is this one when the box is the picture."""
        whole = Box(0, 0, width, height)
        if self.box == whole:
            return self

        def placed(values: np.ndarray) -> np.ndarray:
            out = np.zeros((height, width, *values.shape[2:]), np.float32)
            out[_rows_and_columns(self.box)] = values
            return out

        depth_m, weights = (None if each is None else placed(each) for each in (self.depth_m, self.weights))
        return Drawn(whole, placed(self.rgba), depth_m, weights)


class MeanPicture:
    """The mean of pictures of one size, with weights that sum to 1. Depth is the mean of what covers a pixel, as the
    rasterizer has it."""

    def __init__(self, width: int, height: int) -> None:
        self._box = Box(0, 0, width, height)
        self._sums: dict[str, np.ndarray] = {}

    def add(self, drawn: Drawn, weight: float) -> None:
        """Adds one picture."""
        self._add("rgba", drawn.box, weight * drawn.rgba)
        if drawn.weights is not None:
            self._add("weights", drawn.box, weight * drawn.weights)
        if drawn.depth_m is not None:
            alpha = weight * drawn.rgba[..., 3] * (drawn.depth_m > 0)
            self._add("covered", drawn.box, alpha)
            self._add("depth_sum", drawn.box, alpha * drawn.depth_m)

    def _add(self, name: str, box: Box, values: np.ndarray) -> None:
        if name not in self._sums:
            shape = (self._box.height, self._box.width, *values.shape[2:])
            self._sums[name] = np.zeros(shape, np.float32)
        self._sums[name][_rows_and_columns(box)] += values

    def drawn(self) -> Drawn:
        """The mean."""
        depth_m = None
        if "covered" in self._sums:
            depth_m = _mean_depth(self._sums["depth_sum"], self._sums["covered"])
        return Drawn(self._box, self._sums["rgba"], depth_m, self._sums.get("weights"))


def averaged_down(large: Drawn, factor: int) -> Drawn:
    """A picture that was drawn `factor` times larger than its box, at the size of the box."""

    def pooled(values: np.ndarray) -> np.ndarray:
        # one axis after the other: each is a sum of slices, which NumPy does fast
        high = sum(values[step::factor] for step in range(factor))
        both = sum(high[:, step::factor] for step in range(factor))  # type: ignore[index]
        return np.asarray(both, np.float32) / (factor * factor)

    depth_m = None
    if large.depth_m is not None:
        alpha = large.rgba[..., 3] * (large.depth_m > 0)
        depth_m = _mean_depth(pooled(alpha * large.depth_m), pooled(alpha))
    weights = None if large.weights is None else pooled(large.weights)
    return Drawn(large.box, pooled(large.rgba), depth_m, weights)


def _mean_depth(depth_sum: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """depth_sum: sum of coverage times depth. 0 where hardly anything covers the pixel."""
    valid = covered > limits.DEPTH_ALPHA_MIN
    return np.where(valid, depth_sum / np.where(valid, covered, 1), 0).astype(np.float32)


def _rows_and_columns(box: Box) -> tuple[slice, slice]:
    return slice(box.top, box.top + box.height), slice(box.left, box.left + box.width)
