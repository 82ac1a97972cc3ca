"""Does the library compute what it should on this very machine? A tiny picture with known sums, in about a millisecond.

It guards against what no test of ours can see: a processor that misreports its abilities, a damaged file, another
compiler's mistake.
"""

from __future__ import annotations

import numpy as np

from jghand_engine.errors import RetryError
from jghand_engine.native.binding import Library, new_team
from jghand_engine.native.rasteriser import GaussianArrays, NativeRasteriser, View, job_bytes

_COUNT, _SIZE, _TOLERANCE = 200, 32, 1e-4
# means of the planes R G B A D, and of the gradients with respect to position, sigma, opacity and colour when every
# pixel of every plane has gradient 1 / pixels; from the float64 reference (tests/native recomputes them)
EXPECTED_PLANES = (0.29586, 0.37901, 0.284323, 0.596285, 0.319804)
EXPECTED_GRADIENTS = (0.117767, 1.950287, 0.009067, 0.002981)


def sample_gaussians() -> GaussianArrays:
    """200 Gaussians without a random generator, half a metre in front of the camera; number 7 is NaN."""
    i = np.arange(_COUNT, dtype=np.float64)

    def spread(step: float) -> np.ndarray:
        return (i * step) % 1.0

    position = np.stack([spread(0.618034) * 0.1 - 0.05, spread(0.754878) * 0.1 - 0.05, 0.5 + spread(0.569840) * 0.1], 1)
    rgb = np.stack([spread(0.245122), spread(0.430160), spread(0.850651)], 1)
    position[7] = np.nan
    arrays = (position, 0.002 + 0.004 * spread(0.381966), 0.2 + 0.7 * spread(0.324718), rgb)
    return GaussianArrays(*(np.ascontiguousarray(array, np.float32) for array in arrays))


def sample_view() -> View:
    return View(_SIZE, _SIZE, 150.0, 150.0, _SIZE / 2, _SIZE / 2, np.eye(3, 4))


def check(library: Library) -> None:
    """RetryError when the library's structures or results are not what this Python expects."""
    sizes = (library.call.jg_raster_job_bytes(), library.call.jg_team_bytes())
    expected = (job_bytes(), new_team().nbytes)
    if sizes != expected:
        raise _failure(library, f"structures of {expected} bytes", str(sizes))
    rasteriser = NativeRasteriser(library, threads=1)
    planes = rasteriser.forward(sample_gaussians(), sample_view())
    if rasteriser.invalid != 1:
        raise _failure(library, "one invalid Gaussian left out", str(rasteriser.invalid))
    gradients = rasteriser.backward(np.full_like(planes, 1.0 / _SIZE**2))
    parts = (gradients.position_m, gradients.sigma_m, gradients.opacity, gradients.rgb)
    came = np.array([*planes.mean((1, 2)), *(np.abs(part).mean() for part in parts)])
    wanted = np.array([*EXPECTED_PLANES, *EXPECTED_GRADIENTS])
    if not (np.abs(came - wanted) <= _TOLERANCE * np.maximum(1.0, np.abs(wanted))).all():
        raise _failure(library, f"sums {wanted.round(5).tolist()}", str(came.round(5).tolist()))


def _failure(library: Library, wanted: str, came: str) -> RetryError:
    remedy = "Build it anew with `python -m jghand_engine.native.build`."
    return RetryError(f"self-test of {library.path.name}", wanted=wanted, came=came, remedy=remedy)
