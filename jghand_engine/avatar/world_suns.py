"""Suns of a world's picture: what is so bright and so small that it has to light skin as a lamp, with a shadow's edge.

    world, suns = take_suns(World(radiance, env_from_world))

Neither harmonics nor cells can hold them: with suns left in, a cell's mean direction jumps as the world turns, and no
finger throws an edge.
"""

from __future__ import annotations

import numpy as np

from jghand_engine.avatar.scene_light import Lamp, World
from jghand_engine.native.scene_light_task import LampKind

# a sun's pixels have more than so many times the mean radiance, and lie so near to the brightest of them
PEAK_RATIO, REACH_RAD = 25.0, np.radians(8)
# a sun has more than this part of the world's power; a world has so many at most, the brightest
LEAST_POWER, SUNS_MAX = 0.01, 4


def take_suns(world: World) -> tuple[World, tuple[Lamp, ...]]:
    """The world without its suns, and these as lamps: together as much light as before."""
    direction, light = (values.reshape(-1, 3).astype(np.float64) for values in world.samples)
    power = light.mean(1)
    radiance = world.radiance.reshape(-1, 3).mean(1, dtype=np.float64)
    candidates = np.flatnonzero(radiance > PEAK_RATIO * power.sum() / (4 * np.pi))
    suns, left = [], np.array(world.radiance).reshape(-1, 3)
    while len(candidates) and len(suns) < SUNS_MAX:
        brightest = candidates[radiance[candidates].argmax()]
        is_near = direction[candidates] @ direction[brightest] > np.cos(REACH_RAD)
        pixels, candidates = candidates[is_near], candidates[~is_near]
        if power[pixels].sum() > LEAST_POWER * power.sum():
            suns.append(_sun(direction[pixels], light[pixels], radiance[pixels]))
            left[pixels] = 0
    return (World(left.reshape(world.radiance.shape), world.env_from_world) if suns else world), tuple(suns)


def averaged(picture: np.ndarray, rows_max: int, columns_max: int) -> np.ndarray:
    """An equirectangular picture (H, W, C) of at most that size: each pixel the mean of its part of the sphere."""
    rows, columns = picture.shape[:2]
    # the height of a band of the sphere is its solid angle
    heights = [-np.sin(np.linspace(np.pi / 2, -np.pi / 2, n + 1)) for n in (rows, min(rows, rows_max))]
    around = [np.linspace(0, 1, n + 1) for n in (columns, min(columns, columns_max))]
    return _means(_means(picture, *heights).swapaxes(0, 1), *around).swapaxes(0, 1)


def _means(values: np.ndarray, edges: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Values (N, ...) of the spans between `edges` (N + 1,), averaged over those between `wanted`."""
    out = np.empty((len(wanted) - 1, *values.shape[1:]), np.float32)
    first = np.searchsorted(edges, wanted[:-1], "right") - 1
    last = np.searchsorted(edges, wanted[1:], "left")
    for span, (begin, end) in enumerate(zip(first, last, strict=True)):
        inside = np.clip(edges[begin : end + 1], wanted[span], wanted[span + 1])
        share = np.diff(inside) / (wanted[span + 1] - wanted[span])
        out[span] = np.tensordot(share.astype(np.float32), values[begin:end], 1)
    return out


def _sun(direction: np.ndarray, light: np.ndarray, radiance: np.ndarray) -> Lamp:
    """The lamp of pixels (N, 3) and (N, 3), (N,): as wide as an even disc whose power is as concentrated as theirs.

    The solid angle of all pixels would be that of their halo, and shadows twice as soft as they are.
    """
    power = light.mean(1)
    solid_angle = power.sum() ** 2 / (power * radiance).sum()
    return Lamp(
        LampKind.SUN,
        rgb=tuple(light.sum(0).tolist()),
        place_m=tuple((power @ direction).tolist()),
        angle_rad=float(2 * np.arccos(1 - solid_angle / (2 * np.pi))),
    )
