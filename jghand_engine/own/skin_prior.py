"""Skin that no picture shows: what is known of skins, drawn towards what was seen of this one.

The mean of procedural persons and its principal components (scripts/build_skin_prior.py), at every Gaussian's texture
coordinates. Those that fit what was seen say what the rest is like; near what was seen, what the fit lacks goes on.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial import KDTree

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.npz_files import read_arrays
from jghand_engine.template.builtin import ASSETS
from jghand_engine.template.texture import sample_bilinear

# pictures from which on a Gaussian counts as seen, or so much of what the best tenth has if that is less; no more than
# so many count. A few pictures of many are bent fingers behind an outline that does not fit: a wall, or another finger
SEEN, SEEN_PART, BEST_PART, SEEN_MOST = 2.0, 0.1, 0.9, 3.0
# how far components may go from the mean, against how far they fit: variance of what no component holds. A shift of
# each channel, which the strength and the white of the light leave open, is hardly held
FIT_VARIANCE, SHIFT_SPREAD = 0.02, 10.0
# seen Gaussians around one that was not seen; spread of their weight, and how far what was seen goes on, meters
NEAREST, NEAR_M, FADE_M = 24, 0.006, 0.020
# hardly seen, and unlike what is around: seen through a gap, or in a fold. Gaussians around; of their mean; logarithm
AROUND, HARDLY_PART, UNLIKE = 16, 0.6, 0.2


@dataclass(frozen=True)
class SkinPrior:
    """Logarithms of linear albedos at N Gaussians. mean: (N, 3) · components: (K, N, 3) of spread 1"""

    mean: np.ndarray
    components: np.ndarray

    @classmethod
    def at(cls, avatar: HandAvatar) -> SkinPrior:
        """At the Gaussians of an avatar on the built-in template, with or without a forearm."""
        mean, component, step = _asset()
        uv = avatar.uvd[:, :2].astype(np.float64)
        looked_up = [sample_bilinear(one, uv) * size for one, size in zip(component, step, strict=True)]
        return cls(sample_bilinear(mean, uv), np.stack(looked_up))

    def fitted(self, log_albedo: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """(N, 3) the skin that is most likely, where (N,) pictures show some of it."""
        count, known = len(self.components), seen > seen_from(seen)
        if not known.any():
            return self.mean
        weight = np.sqrt(np.minimum(seen[known], SEEN_MOST))[:, None, None]
        shifts = np.broadcast_to(np.eye(3), (int(known.sum()), 3, 3))
        columns = np.concatenate([self.components[:, known].transpose(1, 2, 0), shifts], -1)
        matrix = (weight * columns).reshape(-1, count + 3)
        right = (weight[..., 0] * (log_albedo - self.mean)[known]).reshape(-1)
        held = np.append(np.ones(count), np.full(3, SHIFT_SPREAD**-2)) * FIT_VARIANCE * len(right)
        amount = np.linalg.solve(matrix.T @ matrix + np.diag(held), matrix.T @ right)
        return self.mean + np.tensordot(amount[:count], self.components, 1) + amount[count:]


def seen_from(seen: np.ndarray) -> float:
    """Pictures from which on one of (N,) Gaussians counts as seen."""
    return min(SEEN, SEEN_PART * float(np.quantile(seen, BEST_PART)))


def whole_skin(avatar: HandAvatar, albedo: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(N, 3) the albedo everywhere. albedo: (N, 3), where it was seen · seen: (N,) in pictures"""
    least = seen_from(seen)
    place_m, known = avatar.position_m.astype(np.float64), seen > least
    log_albedo = _like_its_neighbors(np.log(albedo.astype(np.float64)), seen, place_m)
    likely = SkinPrior.at(avatar).fitted(log_albedo, seen)
    if not known.any():
        return np.exp(likely)
    lacking = (log_albedo - likely)[known]
    distance_m, nearest = _nearest(place_m[known], place_m, NEAREST)
    weight = np.exp(-np.square(distance_m / NEAR_M)) + 1e-9
    spread = (weight[..., None] * lacking[nearest]).sum(1) / weight.sum(1, keepdims=True)
    rest = likely + np.exp(-np.square(distance_m[:, :1] / FADE_M)) * spread
    share = np.where(known, np.square(seen) / (np.square(seen) + least**2 + 1e-9), 0)[:, None]
    return np.exp(share * log_albedo + (1 - share) * rest)


def _like_its_neighbors(log_albedo: np.ndarray, seen: np.ndarray, place_m: np.ndarray) -> np.ndarray:
    """What was hardly seen and is unlike all around takes the mean of that."""
    _, nearest = _nearest(place_m, place_m, AROUND)
    weight = np.square(seen)[nearest][..., None] + 1e-6
    mean = (weight * log_albedo[nearest]).sum(1) / weight.sum(1)
    wrong = (np.abs(log_albedo - mean).max(1) > UNLIKE) & (seen < HARDLY_PART * seen[nearest].mean(1))
    return np.where(wrong[:, None], mean, log_albedo)


def _nearest(points_m: np.ndarray, at_m: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances and numbers (M, count) of the nearest points; fewer where there are fewer."""
    distance_m, nearest = KDTree(points_m).query(at_m, k=list(range(1, min(count, len(points_m)) + 1)))  # pyright: ignore[reportArgumentType]
    return np.asarray(distance_m), np.asarray(nearest)


@cache
def _asset() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (S, S, 3), components (K, S, S, 3) in steps, and these (K,)."""
    arrays = read_arrays(ASSETS / "skin_prior.npz", ("mean", "component", "step"), "the skins that come with JGHand")
    return (
        arrays["mean"].astype(np.float32),
        arrays["component"].astype(np.float32),
        arrays["step"].astype(np.float32),
    )
