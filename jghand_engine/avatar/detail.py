"""What Gaussians cannot hold: creases, pores and nail edges, as a texture on a skinned surface.

A renderer draws the Gaussians, finds where the surface is hit at each pixel, and multiplies the color there by the
ratio that the texture has. What exports Gaussians gives them means of it (export/skin.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from jghand_engine.avatar.detail_correctives import DetailCorrectives
from jghand_engine.avatar.detail_mips import Mips, mips, skin_texels
from jghand_engine.avatar.relief import LIGHT_CHANGE_MAX, Relief, Slopes

# the log ratio of the bytes 1 and 255: colors are halved or doubled
LOG_RATIO_MAX = 0.7
# the byte that changes nothing, and the steps from it to LOG_RATIO_MAX
NO_RATIO, RATIO_STEPS = 128, 127
# of the surface the part whose texels are the largest, which is not looked at: slivers of the template's texture
LARGEST_PART = 0.01
# of the way from one level of the mips to the next, the part over which they are mixed (native/detail.cpp)
MIX_FROM, MIX_TO = 0.25, 0.75


@dataclass(frozen=True)
class Detail:
    """A surface of the canonical right hand and its texture. A left hand is the same, mirrored by its bones.

    Of a hand that learned in known light (`response`) ratios are of scene-linear light, of others of display-referred
    sRGB, in which those are blended.

    position_m:   (V, 3) float32, canonical, meters
    bone_weights: (V, 21) float32, rows sum to 1, column i = B_i
    faces:        (F, 3) int32, counterclockwise from outside; the skin alone, open at the wrist
    face_uv:      (F, 3, 2) float32, 0..1, of each corner: seams; the texture's row is 1 - v
    texture:      (S, S, 3) uint8, S a power of two of 4 to 4096:
                  log(color / color of the Gaussians) = (byte - 128) / 127 * 0.7
    depth_m:      how far the blended depth of the Gaussians lies below the surface
    relief:       what turns with the light, of as many texels; None for none
    correctives:  what the pose changes beyond skinning; None for nothing
    ends_hand:    whether the surface is so near the skin, in all poses, that pictures end where it does
    whole:        (V,) float32, 0..1, how much of the hand is shown there where it ends, -1 to -2 on a cap; None: all
    """

    position_m: np.ndarray
    bone_weights: np.ndarray
    faces: np.ndarray
    face_uv: np.ndarray
    texture: np.ndarray
    depth_m: float
    relief: Relief | None = None
    correctives: DetailCorrectives | None = None
    ends_hand: bool = False
    whole: np.ndarray | None = None

    @property
    def shown(self) -> np.ndarray:
        """(V,) `whole` of every vertex."""
        return np.ones(len(self.position_m), np.float32) if self.whole is None else self.whole

    @property
    def size(self) -> int:
        """S, texels along a side."""
        return self.texture.shape[0]

    @cached_property
    def skin(self) -> np.ndarray:
        """(S, S) bool, which texels show some."""
        return skin_texels(self.face_uv, self.size)

    @property
    def mips(self) -> Mips:
        """What is drawn of the texture, made once."""
        return self._levels[0]

    @cached_property
    def normals(self) -> np.ndarray:
        """(V, 3) unit, of the canonical skin; zero where no face is."""
        corners, total = self.position_m[self.faces].astype(np.float64), np.zeros(self.position_m.shape)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        for k in range(3):
            np.add.at(total, self.faces[:, k], across)
        return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)

    @property
    def slopes(self) -> Slopes | None:
        """What is drawn of the relief, made once."""
        return self._levels[1]

    @property
    def texels(self) -> np.ndarray:
        """(N, 2) uint32: those of the texture, each beside that of the relief; (N, 1) without one."""
        return self._levels[2]

    @cached_property
    def _levels(self) -> tuple[Mips, Slopes | None, np.ndarray]:
        ratios = mips(self.texture, self.skin)
        if self.relief is None:
            return ratios, None, ratios.texels[:, None]
        slopes = self.relief.slopes(self.skin)
        texels = np.stack([ratios.texels, slopes.texels], -1)
        # a view: they are tens of megabytes
        return replace(ratios, texels=texels[:, 0]), slopes, texels

    @property
    def texels_per_m(self) -> float:
        """On the canonical skin, where there are the fewest."""
        return self.density_per_m[0]

    @cached_property
    def density_per_m(self) -> tuple[float, float, float]:
        """Texels per meter of the canonical skin: where there are the fewest, in the mean, where there are the most;
        of each face the root of the mean square over all directions."""
        corners = self.position_m[self.faces].astype(np.float64)
        sides, uv_sides = (at[:, 1:] - at[:, :1] for at in (corners, self.face_uv.astype(np.float64)))
        metric = sides @ sides.swapaxes(1, 2)
        area = np.sqrt(np.maximum(np.linalg.det(metric), 0))
        # those of a cap have one texel
        good = (area > 0) & (np.abs(uv_sides).max((1, 2)) > 0)
        spread = np.einsum("fij,fik,fjk->f", uv_sides[good], uv_sides[good], np.linalg.inv(metric[good])) / 2
        if not len(spread):
            return math.inf, 0.0, 0.0
        order, area = np.argsort(spread), area[good]
        covered = np.cumsum(area[order])
        ends = np.searchsorted(covered, np.array([LARGEST_PART, 1 - LARGEST_PART]) * covered[-1])
        fewest, most = self.size * np.sqrt(spread[order[ends]])
        return float(fewest), float(self.size * (np.sqrt(spread) @ area) / area.sum()), float(most)

    def strongest(self, texels_per_px: float, power: float = 1.0, *, is_lit: bool = True) -> float:
        """The largest logarithm of a change that is left of texture and relief where a pixel spans so many texels, or
        more; of light from the side, which falls as steeply on the skin as the skin itself may be.

        power: of the texture's ratios, see `detail_power` · is_lit: whether light falls on the relief
        """
        ratio, change = self._most
        level = min(math.log2(max(texels_per_px, 1.0)), len(ratio) - 1.0)
        finer = int(level)
        coarser = min(finer + 1, len(ratio) - 1)
        # whole where one level serves
        part = min(max((level - finer - MIX_FROM) / (MIX_TO - MIX_FROM), 0.0), 1.0)
        left = power * (ratio[finer] + part * (ratio[coarser] - ratio[finer]))
        return left + (change[finer] + part * (change[coarser] - change[finer]) if is_lit else 0.0)

    @cached_property
    def _most(self) -> tuple[list[float], list[float]]:
        """Of each level the largest log ratio of the texture, and what the relief's steepest slope makes of light."""
        ratio = self.mips.most * (LOG_RATIO_MAX / RATIO_STEPS)
        if self.slopes is None:
            return ratio.tolist(), [0.0] * len(ratio)
        # along column and row at once
        steepest = math.sqrt(2) * self.slopes.most * (self.slopes.step_m * self.density_per_m[2] / self.size)
        return ratio.tolist(), np.log1p(np.minimum(steepest, LIGHT_CHANGE_MAX)).tolist()


def log_ratios(texels: np.ndarray) -> np.ndarray:
    """float32 of bytes of any shape."""
    return (texels.astype(np.float32) - NO_RATIO) * np.float32(LOG_RATIO_MAX / RATIO_STEPS)


def ratio_bytes(log_ratio: np.ndarray) -> np.ndarray:
    """uint8, the inverse of `log_ratios`; what is out of range is cut off."""
    steps = np.rint(np.asarray(log_ratio, np.float64) * (RATIO_STEPS / LOG_RATIO_MAX))
    return (NO_RATIO + np.clip(steps, -RATIO_STEPS, RATIO_STEPS)).astype(np.uint8)
