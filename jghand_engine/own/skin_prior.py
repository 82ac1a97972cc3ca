"""Skin that no picture shows: what is known of skins, drawn towards what was seen of this one.

The mean of procedural persons and its principal components (scripts/build_skin_prior.py), at every Gaussian's texture
coordinates. Those that fit what was seen say what the rest is like; near what was seen, what the fit lacks goes on.
Nothing is sudden: an edge would be seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import cg
from scipy.spatial import KDTree

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.npz_files import read_arrays
from jghand_engine.template.builtin import ASSETS
from jghand_engine.template.texture import sample_bilinear

# pictures that must show a Gaussian, or so much of what the best tenth has if that is less; from twice as many on they
# are believed wholly. A few of many are bent fingers behind an outline that does not fit: a wall, or another finger
SEEN, SEEN_PART, BEST_PART = 2.0, 0.1, 0.9
# how far components may go from the mean, against how far they fit: variance of what no component holds. A shift of
# each channel, which the strength and the white of the light leave open, is hardly held
FIT_VARIANCE, SHIFT_SPREAD = 0.02, 10.0
# neighbors of a Gaussian; over how far what the fit lacks is a mean of what was seen, and how far from there it fades,
# meters; Gaussians are no nearer than this to one another
AROUND, NEAR_M, FADE_M, APART_M = 16, 0.003, 0.020, 0.0003
# hardly seen, and unlike what is around: seen through a gap, or in a fold. Of the neighbors' mean; logarithm
HARDLY_PART, UNLIKE = 0.6, 0.2


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

    def fitted(self, log_albedo: np.ndarray, belief: np.ndarray) -> np.ndarray:
        """(N, 3) the skin that is most likely, where some of it is believed, see `believed`."""
        count, known = len(self.components), belief > 0
        if not known.any():
            return self.mean
        weight = np.sqrt(belief[known])[:, None, None]
        shifts = np.broadcast_to(np.eye(3), (int(known.sum()), 3, 3))
        columns = np.concatenate([self.components[:, known].transpose(1, 2, 0), shifts], -1)
        matrix = (weight * columns).reshape(-1, count + 3)
        right = (weight[..., 0] * (log_albedo - self.mean)[known]).reshape(-1)
        held = np.append(np.ones(count), np.full(3, SHIFT_SPREAD**-2)) * FIT_VARIANCE * 3 * belief.sum()
        amount = np.linalg.solve(matrix.T @ matrix + np.diag(held), matrix.T @ right)
        return self.mean + np.tensordot(amount[:count], self.components, 1) + amount[count:]


def believed(seen: np.ndarray) -> np.ndarray:
    """(N,) 0..1 how much of each Gaussian's skin is the film's; the rest is invented. seen: (N,) in pictures"""
    least = min(SEEN, SEEN_PART * float(np.quantile(seen, BEST_PART)))
    return (seen / max(least, 1e-6) - 1).clip(0, 1)


def whole_skin(avatar: HandAvatar, albedo: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(N, 3) the albedo everywhere, nowhere sudden. albedo: (N, 3), where it was seen · seen: (N,) in pictures"""
    place_m, belief = avatar.position_m.astype(np.float64), believed(seen)
    distance_m, nearest = map(np.asarray, KDTree(place_m).query(place_m, k=min(AROUND, len(place_m))))
    log_albedo = _like_its_neighbors(np.log(albedo.astype(np.float64)), seen, nearest)
    likely = SkinPrior.at(avatar).fitted(log_albedo, belief)
    rest = likely + _going_on(log_albedo - likely, belief, distance_m, nearest)
    return np.exp(rest + belief[:, None] * (log_albedo - rest))


def _like_its_neighbors(log_albedo: np.ndarray, seen: np.ndarray, nearest: np.ndarray) -> np.ndarray:
    """What was hardly seen and is unlike all around takes the mean of that. nearest: (N, AROUND)"""
    weight = np.square(seen)[nearest][..., None] + 1e-6
    mean = (weight * log_albedo[nearest]).sum(1) / weight.sum(1)
    wrong = (np.abs(log_albedo - mean).max(1) > UNLIKE) & (seen < HARDLY_PART * seen[nearest].mean(1))
    return np.where(wrong[:, None], mean, log_albedo)


def _going_on(lacking: np.ndarray, belief: np.ndarray, distance_m: np.ndarray, nearest: np.ndarray) -> np.ndarray:
    """(N, 3) smooth f that is what the fit lacks (N, 3) where it is believed, and fades to 0 elsewhere:
    belief^2 (f - lacking) / NEAR_M^2 + f / FADE_M^2 = f's Laplacian, by differences between neighbors (N, AROUND)."""
    count, around = nearest.shape
    rows = np.repeat(np.arange(count), around)
    # on a plane the mean of 4 (f' - f) / distance^2 around is the Laplacian; each pair counts from both sides
    weight = 2 / around / np.maximum(distance_m, APART_M).ravel() ** 2 * (rows != nearest.ravel())
    one_way = coo_array((weight, (rows, nearest.ravel())), (count, count)).tocsr()
    between = one_way + one_way.T
    held = (belief / NEAR_M) ** 2
    scale = 1 / (between.sum(1) + held + FADE_M**-2)
    matrix = diags_array(1 / scale) - between
    right, jacobi = held[:, None] * lacking, diags_array(scale)
    return np.stack([cg(matrix, right[:, channel], rtol=1e-5, M=jacobi)[0] for channel in range(3)], -1)


@cache
def _asset() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (S, S, 3), components (K, S, S, 3) in steps, and these (K,)."""
    arrays = read_arrays(ASSETS / "skin_prior.npz", ("mean", "component", "step"), "the skins that come with JGHand")
    return (
        arrays["mean"].astype(np.float32),
        arrays["component"].astype(np.float32),
        arrays["step"].astype(np.float32),
    )
