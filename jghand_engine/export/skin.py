"""What of the skin's detail (avatar/detail.py) goes into files: a texture of meshes, and colors of Gaussians, which
hold less of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.detail import Detail, log_ratios
from jghand_engine.avatar.detail_mips import filled
from jghand_engine.avatar.nearest import nearest_centers
from jghand_engine.avatar.relighting import detail_power
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.texture import rasterize_uv, sample_bilinear

# texels along a side: of the built-in hand 0.7 mm wide, as its Gaussians are
TEXTURE_PX = 512
# Gaussians around a texel or a vertex whose mean color it gets
COLOR_NEIGHBORS = 4
# texels along a side whose detail Gaussians get: 512 bring 0.1 dB more and take four times as long
MEAN_PX = 256


def with_detail_in_colors(avatar: HandAvatar) -> HandAvatar:
    """The avatar without its texture, of which each Gaussian's color has the mean over the texels that it is near to.
    Gaussians below the skin, which are near to none, stay as they are."""
    detail = avatar.detail
    if detail is None:
        return avatar
    size = min(MEAN_PX, detail.size)
    points_m, covered = rasterize_uv(detail.face_uv, detail.position_m[detail.faces], size)
    near = nearest_centers(points_m[covered], avatar.position_m, COLOR_NEIGHBORS)
    ratios, part = log_ratios(filled(detail.texture, detail.skin)), detail.size // size
    means = ratios.reshape(size, part, size, part, 3).mean(axis=(1, 3))[covered]
    texels = np.maximum(np.bincount(near.ravel(), minlength=len(avatar)), 1)
    sums = [np.bincount(near.ravel(), channel.repeat(near.shape[1]), len(avatar)) for channel in means.T]
    rgb = avatar.rgb * np.exp(np.stack(sums, 1) / texels[:, None])
    return replace(avatar, rgb=rgb.clip(0, 1).astype(np.float32), detail=None)


def normal_map(detail: Detail) -> np.ndarray | None:
    """(S, S, 3) bytes of a detail's relief where joints are straight, as glTF has it: 128 + 127 times the unit normal
    along u, along v and outward; None without one. Texels count as of one size all over the skin."""
    if detail.relief is None:
        return None
    rise = detail.relief.rises_m(detail.skin) * np.float32(detail.density_per_m[1] / detail.size)
    # rows go down, v goes up
    normal = np.stack([-rise[..., 0], rise[..., 1], np.ones_like(rise[..., 0])], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.rint(128 + 127 * normal).clip(0, 255).astype(np.uint8)


class SkinTexture:
    """The texture of a hand's surface: means of the Gaussians nearest to each texel, times the avatar's detail,
    where it has one. template: the surface of the hand itself · rest_m: (N, 3) the Gaussians in its pose, meters"""

    def __init__(self, avatar: HandAvatar, template: HandTemplate, rest_m: np.ndarray) -> None:
        points_m, self._covered = rasterize_uv(template.face_uv, template.vertices_m[template.faces], TEXTURE_PX)
        self._nearest = nearest_centers(points_m[self._covered], rest_m, COLOR_NEIGHBORS)
        detail, self._ratio = avatar.detail, None
        if detail is not None:
            # beyond the islands the skin goes on, or filtering brings something else over their edges
            texture = filled(detail.texture, detail.skin)
            self._ratio = np.exp(detail_power(avatar, in_scene=False) * log_ratios(texture))

    def of_colors(self, rgb: np.ndarray) -> np.ndarray:
        """(S, S, 3) bytes, row 1 - v, of display-referred colors (N, 3), 0..1."""
        texels = np.zeros((TEXTURE_PX, TEXTURE_PX, 3), np.float32)
        texels[self._covered] = 255 * rgb[self._nearest].mean(axis=1)
        texels = filled(texels, self._covered)
        if self._ratio is None:
            return texels
        size = max(TEXTURE_PX, len(self._ratio))
        middles = (np.arange(size) + 0.5) / size
        smooth = sample_bilinear(texels, np.stack(np.meshgrid(middles, 1 - middles), -1))
        finer = size // len(self._ratio)
        return np.rint((smooth * self._ratio.repeat(finer, 0).repeat(finer, 1)).clip(0, 255)).astype(np.uint8)
