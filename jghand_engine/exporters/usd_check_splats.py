"""The rules for the data of one splat prim, as sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pxr import Gf, Usd, UsdGeom

from jghand_engine.limits import (
    SPLAT_SIGMA_SANE_M,
    USD_EXTENT_TOLERANCE_M,
    USD_QUATERNION_TOLERANCE,
    USD_SPLAT_EXTENT_SIGMA,
)

DEGREE = "radiance:sphericalHarmonicsDegree"
COEFFICIENTS = "radiance:sphericalHarmonicsCoefficients"
HALVES = ("positions", "orientations", "scales", "opacities", COEFFICIENTS)
DEGREES = range(4)


class Advice(str):
    """A sentence about what is no error: look at it."""

    __slots__ = ()


def splat_findings(prim: Usd.Prim) -> Iterator[str]:
    """Sentences about one ParticleField3DGaussianSplat; float attributes win over their half twins, as in USD."""
    positions = _values(prim, "positions")
    if positions is None:
        yield "positions have no Default value: several readers show nothing"
        return
    count = len(positions)
    if not count:
        yield Advice("there are no Gaussians in it")
        return
    scales = _values(prim, "scales")
    yield from _scale_findings(scales, count, UsdGeom.GetStageMetersPerUnit(prim.GetStage()))
    yield from _opacity_findings(_values(prim, "opacities"), count)
    yield from _degree_findings(prim, count)
    yield from _colour_space_findings(prim)
    yield from _orientation_findings(_values(prim, "orientations"), count)
    yield from _prim_findings(prim)
    yield from _sample_findings(prim, scales, count)


def _scale_findings(scales: np.ndarray | None, count: int, metres_per_unit: float) -> Iterator[str]:
    if scales is None:
        yield "scales have no Default value: every Gaussian would be 1 unit wide"
    elif len(scales) != count:
        yield f"scales: wanted {count}, got {len(scales)}; readers drop them all"
    elif not np.isfinite(scales).all():
        yield "scales hold NaN or infinity"
    elif (scales < 0).mean() > 0.5:
        yield "most scales are below 0: they are probably logarithms, USD wants lengths (exp of them)"
    elif not (scales > 0).all():
        yield "scales are not all above 0: they are probably logarithms, USD wants lengths"
    elif (median_m := float(np.median(scales)) * metres_per_unit) > SPLAT_SIGMA_SANE_M:
        yield Advice(
            f"half of the Gaussians are wider than {median_m:.3g} m: the scales, or metersPerUnit, are probably wrong"
        )


def _opacity_findings(opacities: np.ndarray | None, count: int) -> Iterator[str]:
    if opacities is None:
        yield "opacities have no Default value: everything would be opaque"
    elif len(opacities) != count:
        yield f"opacities: wanted {count}, got {len(opacities)}; readers drop them all"
    elif not np.isfinite(opacities).all():
        yield "opacities hold NaN or infinity"
    elif not ((opacities >= 0) & (opacities <= 1)).all():
        yield "opacities are not all from 0 to 1: they are probably logits, USD wants 1 / (1 + exp(-x)) of them"


def _degree_findings(prim: Usd.Prim, count: int) -> Iterator[str]:
    degree = prim.GetAttribute(DEGREE)
    if not (degree and degree.HasAuthoredValue()):
        yield "the degree of the spherical harmonics is not authored: it falls back to 3 and the colours are dropped"
        return
    number = degree.Get()
    if number not in DEGREES:
        yield f"the degree of the spherical harmonics: wanted {DEGREES[0]} to {DEGREES[-1]}, got {number}"
        return
    each = (number + 1) ** 2
    coefficients = _values(prim, COEFFICIENTS)
    if coefficients is None:
        yield "spherical harmonics have no Default value: everything would be grey"
        return
    if len(coefficients) != count * each:
        yield f"spherical harmonics of degree {number}: wanted {count * each} vectors, got {len(coefficients)}"
        return
    yield from _colour_findings(prim, coefficients, each)


def _colour_findings(prim: Usd.Prim, coefficients: np.ndarray, each: int) -> Iterator[str]:
    if not np.isfinite(coefficients).all():
        yield "spherical harmonics hold NaN or infinity"
        return
    attr = _attribute(prim, COEFFICIENTS)
    if attr is not None and (attr.GetMetadata("interpolation"), attr.GetMetadata("elementSize")) != ("vertex", each):
        yield (
            f"spherical harmonics lack the metadata interpolation vertex and elementSize {each}: NVIDIA's rule VG.035 "
            "wants them"
        )
    first = coefficients[::each]
    if first.min() >= 0 and first.max() <= 1 and float(first.std()) > 0:
        yield Advice(
            "all first coefficients of the spherical harmonics are from 0 to 1: they are probably colours, USD wants "
            "(colour - 0.5) / 0.2821"
        )


def _colour_space_findings(prim: Usd.Prim) -> Iterator[str]:
    name = Usd.ColorSpaceAPI(prim).GetColorSpaceNameAttr().Get() if prim.HasAPI(Usd.ColorSpaceAPI) else None
    if name is None:
        yield Advice("no colour space is said (ColorSpaceAPI): some readers take the colours for linear light")
    elif not Gf.ColorSpace.IsValid(name):
        yield f"the colour space {name!r} is unknown to USD: readers have to guess"


def _orientation_findings(orientations: np.ndarray | None, count: int) -> Iterator[str]:
    if orientations is None:
        return
    if len(orientations) != count:
        yield f"orientations: wanted {count}, got {len(orientations)}; readers drop them all"
    elif not np.abs(np.linalg.norm(orientations, axis=1) - 1).max(initial=0) <= USD_QUATERNION_TOLERANCE:
        yield "orientations are not unit quaternions"
    elif count > 1 and (np.abs(orientations - [1.0, 0.0, 0.0, 0.0]) < USD_QUATERNION_TOLERANCE).all():
        # numpy gives x, y, z, w
        yield Advice("every Gaussian is turned half about x: w, x, y, z was probably written where x, y, z, w is read")


def _prim_findings(prim: Usd.Prim) -> Iterator[str]:
    both = [name for name in HALVES if _authored(prim, name) and _authored(prim, f"{name}h")]
    halves = [name for name in HALVES if _authored(prim, f"{name}h") and not _authored(prim, name)]
    if both:
        yield Advice(f"{', '.join(both)} are there in float and in half precision: readers take the floats")
    if halves:
        yield Advice(f"{', '.join(halves)} are there in half precision alone: NVIDIA's rule VG.035 wants floats")
    if prim.HasAttribute("primvars:skel:jointWeights"):
        yield "there are joint weights on the splats: nothing skins splats, they stay at rest (points are skinned)"
    above = prim.GetParent()
    while above and above.GetTypeName() != "SkelRoot":
        above = above.GetParent()
    if above:
        yield f"the splats lie below the SkelRoot {above.GetPath()}, whose bound leaves them out: viewers cull them"


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
        known = now is not None and len(now) == count
        radii = USD_SPLAT_EXTENT_SIGMA * now.max(axis=1, keepdims=True) if now is not None and known else 0.0
        low, high = np.asarray(extent, np.float32)
        # not <=: an extent of NaN holds nothing
        if not _sticks_out(positions, low, high) <= USD_EXTENT_TOLERANCE_M:
            yield f"the extent at {name} does not hold the Gaussians: they get culled"
        elif not max(_sticks_out(positions - radii, low, high), _sticks_out(positions + radii, low, high)) <= (
            USD_EXTENT_TOLERANCE_M
        ):
            yield Advice(f"the extent at {name} holds the centres, not 3 standard deviations: edges may get culled")


def _sticks_out(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """How far the farthest of points (N, 3) is outside of a box."""
    return float(max((low - points.min(axis=0)).max(), (points.max(axis=0) - high).max()))


def _authored(prim: Usd.Prim, name: str) -> bool:
    attr = prim.GetAttribute(name)
    return bool(attr) and attr.HasAuthoredValue()


def _attribute(prim: Usd.Prim, name: str) -> Usd.Attribute | None:
    for candidate in (name, f"{name}h"):
        if _authored(prim, candidate):
            return prim.GetAttribute(candidate)
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
