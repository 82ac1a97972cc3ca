"""What is drawn of an image: a rectangle of it, with depth and coverage of each hand where somebody wants them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jghand_engine.native import contract


class Box(NamedTuple):
    """A rectangle of the image, pixels."""

    left: int
    top: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)


@dataclass(frozen=True)
class Image:
    """What was drawn.

    box:     where it lies in the whole image
    rgba:    (h, w, 4) float32 premultiplied, display-referred or, in the light of a scene, scene-linear
    depth_m: (h, w) meters, 0 where there is none; None unless wanted
    weights: (h, w, hands) how much of a pixel each hand covers; None unless wanted
    """

    box: Box
    rgba: np.ndarray
    depth_m: np.ndarray | None = None
    weights: np.ndarray | None = None

    def laid_out(self, width: int, height: int) -> Image:
        """The whole image, empty around the box. It is this one when the box is all of it."""
        whole = Box(0, 0, width, height)
        if self.box == whole:
            return self

        def placed(values: np.ndarray) -> np.ndarray:
            out = np.zeros((height, width, *values.shape[2:]), np.float32)
            out[self.box.slices] = values
            return out

        depth_m, weights = (None if each is None else placed(each) for each in (self.depth_m, self.weights))
        return Image(whole, placed(self.rgba), depth_m, weights)

    def averaged_down(self, factor: int) -> Image:
        """At the size of its box, of an image that was drawn `factor` times larger."""

        def pooled(values: np.ndarray) -> np.ndarray:
            # one axis after the other: each is a sum of slices, which NumPy does fast
            high = sum(values[step::factor] for step in range(factor))
            both = sum(high[:, step::factor] for step in range(factor))  # type: ignore[index]
            return np.asarray(both, np.float32) / (factor * factor)

        depth_m = None
        if self.depth_m is not None:
            alpha = self.rgba[..., 3] * (self.depth_m > 0)
            depth_m = mean_depth(pooled(alpha * self.depth_m), pooled(alpha))
        weights = None if self.weights is None else pooled(self.weights)
        return Image(self.box, pooled(self.rgba), depth_m, weights)


def mean_depth(depth_sum: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """The mean depth of what covers a pixel, from the sums of coverage times depth and of coverage, as the rasterizer
    has it: 0 where hardly anything does."""
    valid = covered > contract.DEPTH_ALPHA_MIN
    return np.where(valid, depth_sum / np.where(valid, covered, 1), 0).astype(np.float32)
