"""The rules for the data of one splat prim, as sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pxr import Usd

from jghand_engine.limits import (
    USD_EXTENT_TOLERANCE_M,
    USD_QUATERNION_TOLERANCE,
    USD_SPLAT_EXTENT_SIGMA,
)

DEGREE = "radiance:sphericalHarmonicsDegree"
COEFFICIENTS = "radiance:sphericalHarmonicsCoefficients"


def splat_findings(prim: Usd.Prim) -> Iterator[str]:
    """Sentences about one ParticleField3DGaussianSplat; float attributes win over their half twins, as in USD."""
    positions = _values(prim, "positions")
    if positions is None:
        yield "positions have no Default value: several readers show nothing"
        return
    count = len(positions)
    scales = _values(prim, "scales")
    yield from _scale_findings(scales, count)
    yield from _opacity_findings(_values(prim, "opacities"), count)
    yield from _colour_findings(prim, count)
    orientations = _values(prim, "orientations")
    if orientations is not None:
        if len(orientations) != count:
            yield f"orientations: wanted {count}, got {len(orientations)}; readers drop them all"
        elif np.abs(np.linalg.norm(orientations, axis=1) - 1).max(initial=0) > USD_QUATERNION_TOLERANCE:
            yield "orientations are not unit quaternions"
    yield from _sample_findings(prim, scales, count)


def _scale_findings(scales: np.ndarray | None, count: int) -> Iterator[str]:
    if scales is None:
        yield "scales have no Default value: every Gaussian would be 1 m wide"
    elif len(scales) != count:
        yield f"scales: wanted {count}, got {len(scales)}; readers drop them all"
    elif not (scales > 0).all():
        yield "scales are not all above 0: they are probably logarithms, USD wants metres"


def _opacity_findings(opacities: np.ndarray | None, count: int) -> Iterator[str]:
    if opacities is None:
        yield "opacities have no Default value: everything would be opaque"
    elif len(opacities) != count:
        yield f"opacities: wanted {count}, got {len(opacities)}; readers drop them all"
    elif not ((opacities >= 0) & (opacities <= 1)).all():
        yield "opacities are not all from 0 to 1: they are probably logits"


def _colour_findings(prim: Usd.Prim, count: int) -> Iterator[str]:
    degree = prim.GetAttribute(DEGREE)
    if not (degree and degree.HasAuthoredValue()):
        yield "the degree of the spherical harmonics is not authored: it falls back to 3 and the colours are dropped"
        return
    wanted = count * (degree.Get() + 1) ** 2
    coefficients = _values(prim, COEFFICIENTS)
    if coefficients is None:
        yield "spherical harmonics have no Default value: everything would be grey"
    elif len(coefficients) != wanted:
        yield f"spherical harmonics of degree {degree.Get()}: wanted {wanted} vectors, got {len(coefficients)}"
    elif not np.isfinite(coefficients).all():
        yield "spherical harmonics hold NaN or infinity"


def _sample_findings(prim: Usd.Prim, scales: np.ndarray | None, count: int) -> Iterator[str]:
    """Positions, sizes and bounds of every time sample."""
    authored = _attribute(prim, "positions")
    times = authored.GetTimeSamples() if authored else []
    for time in (Usd.TimeCode.Default(), *times):
        name = time_name(time)
        positions, extent = _values(prim, "positions", time), prim.GetAttribute("extent").Get(time)
        if positions is None or len(positions) != count:
            yield f"the number of positions changes at {name}"
            continue
        if not np.isfinite(positions).all():
            yield f"positions hold NaN or infinity at {name}"
        if extent is None:
            yield f"there is no extent at {name}: no viewer can compute one for splats"
            continue
        if len(extent) != 2:
            yield extent_sentence(len(extent), time)
            continue
        now = _values(prim, "scales", time)
        now = scales if now is None else now
        if now is not None and len(now) == count:
            radius = USD_SPLAT_EXTENT_SIGMA * now.max(axis=1, keepdims=True)
            low, high = np.asarray(extent, np.float32)
            below, above = low - (positions - radius).min(axis=0), (positions + radius).max(axis=0) - high
            # not <=: an extent of NaN holds nothing
            if not max(below.max(), above.max()) <= USD_EXTENT_TOLERANCE_M:
                yield f"the extent at {name} does not hold the Gaussians to 3 standard deviations: they get culled"


def _attribute(prim: Usd.Prim, name: str) -> Usd.Attribute | None:
    for candidate in (name, f"{name}h"):
        attr = prim.GetAttribute(candidate)
        if attr and attr.HasAuthoredValue():
            return attr
    return None


def _values(prim: Usd.Prim, name: str, time: Usd.TimeCode | float | None = None) -> np.ndarray | None:
    attr = _attribute(prim, name)
    value = attr.Get(Usd.TimeCode.Default() if time is None else time) if attr else None
    return None if value is None else np.asarray(value, np.float32)


def extent_sentence(count: int, time: Usd.TimeCode | float) -> str:
    """What is wrong with an extent of `count` vectors."""
    return f"the extent at {time_name(time)} has {count} vectors: wanted 2, the corners of a box"


def time_name(time: Usd.TimeCode | float) -> str:
    """A time for a sentence."""
    code = Usd.TimeCode(time)
    return "Default time" if code.IsDefault() else f"time {code.GetValue():g}"
