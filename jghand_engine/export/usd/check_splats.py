"""The rules for the data of one splat prim, as sentences."""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Iterator

import numpy as np
from pxr import Gf, Usd, UsdGeom

from jghand_engine.export.usd.check_said import WHAT, WHEN, Advice, Said, extent_finding
from jghand_engine.export.usd.splats import DEFAULT, DEGREE, HARMONICS
from jghand_engine.limits import (
    SH_C0,
    SPLAT_SIGMA_SANE_M,
    USD_EXTENT_TOLERANCE_M,
    USD_GUESS_SHARE,
    USD_OPACITY_TOLERANCE,
    USD_QUATERNION_TOLERANCE,
    USD_SPLAT_EXTENT_SIGMA,
)

HALVES = ("positions", "orientations", "scales", "opacities", HARMONICS)
DEGREES = range(4)


class _Counts:
    """How many Gaussians there are at each time: as many as positions. changes: when it becomes another number."""

    def __init__(self, prim: Usd.Prim, at_default: int) -> None:
        self._at_default = at_default
        self._times: list[float] = []
        self._numbers: list[int] = []
        self.changes: list[Usd.TimeCode] = []
        before = at_default
        for time in _times(prim, "positions")[1:]:
            positions = _values(prim, "positions", time)
            number = 0 if positions is None else len(positions)
            self._times.append(time.GetValue())
            self._numbers.append(number)
            if number != before:
                self.changes.append(time)
            before = number

    def at(self, time: Usd.TimeCode) -> int:
        """USD does not interpolate between arrays of two lengths: the earlier one holds."""
        if time.IsDefault() or not self._times:
            return self._at_default
        return self._numbers[max(bisect.bisect_right(self._times, time.GetValue()) - 1, 0)]


def splat_findings(prim: Usd.Prim) -> Iterator[str | Said]:
    """What is wrong with one ParticleField3DGaussianSplat, at Default time, at every time sample of each attribute, and
    where the number of Gaussians changes; float attributes win over their half twins, as in USD."""
    positions = _values(prim, "positions")
    if positions is None:
        yield "positions have no Default value: several readers show nothing"
        return
    if not len(positions):
        yield Advice("there are no Gaussians in it")
        return
    counts = _Counts(prim, len(positions))
    for time in counts.changes:
        yield Said(Advice(f"the number of positions changes {WHEN}: readers do not interpolate there"), time)
    meters_per_unit = UsdGeom.GetStageMetersPerUnit(prim.GetStage())
    for time, scales in _moments(prim, "scales", counts):
        yield from _scale_findings(scales, counts.at(time), meters_per_unit, time)
    for time, opacities in _moments(prim, "opacities", counts):
        yield from _opacity_findings(opacities, counts.at(time), time)
    yield from _degree_findings(prim, counts)
    yield from _color_space_findings(prim)
    for time, orientations in _moments(prim, "orientations", counts):
        if orientations is not None:
            yield from _orientation_findings(orientations, counts.at(time), time)
    yield from _prim_findings(prim)
    for time in sorted({*_times(prim, "positions", "scales", "extent"), *counts.changes}):
        yield from _bound_findings(prim, time)


def splat_size(prim: Usd.Prim) -> tuple[int, int]:
    """How many Gaussians there are in a prim, and at how many times they have positions of their own."""
    positions = _values(prim, "positions")
    return 0 if positions is None else len(positions), len(_times(prim, "positions")) - 1


def _scale_findings(
    scales: np.ndarray | None, count: int, meters_per_unit: float, time: Usd.TimeCode
) -> Iterator[str | Said]:
    if scales is None:
        yield _nothing("scales", "every Gaussian would be 1 unit wide", time)
    elif len(scales) != count:
        yield _too_many("scales", count, len(scales), time)
    elif not count:
        return
    elif not np.isfinite(scales).all():
        yield Said(f"scales hold NaN or infinity {WHEN}", time)
    elif (scales < 0).any():
        guess = "they are probably logarithms, USD wants lengths (exp of them)"
        text = f"scales are not all above 0 {WHEN}, but {WHAT}: "
        text += guess if (scales < 0).mean() > USD_GUESS_SHARE else "USD wants lengths"
        yield Said(text, time, _range(scales))
    else:
        if not (scales > 0).all():
            text = f"scales hold 0 {WHEN}: {WHAT} Gaussians are flat, which NVIDIA's rule VG.035 refuses"
            yield Said(Advice(text), time, str((scales <= 0).any(axis=1).sum()))
        if (median_m := float(np.median(scales)) * meters_per_unit) > SPLAT_SIGMA_SANE_M:
            text = (
                f"half of the Gaussians are wider than {WHAT} {WHEN}: the scales, or metersPerUnit, are probably wrong"
            )
            yield Said(Advice(text), time, f"{median_m:.3g} m")


def _opacity_findings(opacities: np.ndarray | None, count: int, time: Usd.TimeCode) -> Iterator[str | Said]:
    if opacities is None:
        yield _nothing("opacities", "everything would be opaque", time)
        return
    outside = (opacities < -USD_OPACITY_TOLERANCE) | (opacities > 1 + USD_OPACITY_TOLERANCE)
    if len(opacities) != count:
        yield _too_many("opacities", count, len(opacities), time)
    elif not np.isfinite(opacities).all():
        yield Said(f"opacities hold NaN or infinity {WHEN}", time)
    elif outside.any():
        text = f"opacities are not all from 0 to 1 {WHEN}, but {WHAT}"
        if outside.mean() > USD_GUESS_SHARE:
            text += ": they are probably logits, USD wants 1 / (1 + exp(-x)) of them"
        yield Said(text, time, _range(opacities))


def _degree_findings(prim: Usd.Prim, counts: _Counts) -> Iterator[str | Said]:
    degree = prim.GetAttribute(DEGREE)
    if not (degree and degree.HasAuthoredValue()):
        yield "the degree of the spherical harmonics is not authored: it falls back to 3 and the colors are dropped"
        return
    number = degree.Get()
    if number not in DEGREES:
        yield f"the degree of the spherical harmonics: wanted {DEGREES[0]} to {DEGREES[-1]}, got {number}"
        return
    each = (number + 1) ** 2
    attr = _attribute(prim, HARMONICS)
    if attr is not None and (attr.GetMetadata("interpolation"), attr.GetMetadata("elementSize")) != ("vertex", each):
        yield (
            f"spherical harmonics lack the metadata interpolation vertex and elementSize {each}: NVIDIA's rule VG.035 "
            "wants them"
        )
    for time, coefficients in _moments(prim, HARMONICS, counts):
        yield from _color_findings(coefficients, counts.at(time), number, time)


def _color_findings(
    coefficients: np.ndarray | None, count: int, degree: int, time: Usd.TimeCode
) -> Iterator[str | Said]:
    each = (degree + 1) ** 2
    if coefficients is None:
        yield _nothing("spherical harmonics", "everything would be gray", time)
        return
    if len(coefficients) != count * each:
        text = f"spherical harmonics of degree {degree}: {WHAT} {WHEN}"
        yield Said(text, time, f"wanted {count * each} vectors, got {len(coefficients)}")
        return
    if not np.isfinite(coefficients).all():
        yield Said(f"spherical harmonics hold NaN or infinity {WHEN}", time)
        return
    first = coefficients[::each]
    if len(first) and first.min() >= 0 and first.max() <= 1 and float(first.std()) > 0:
        text = (
            f"all first coefficients of the spherical harmonics are from 0 to 1 {WHEN}: they are probably colors, "
            f"USD wants (color - 0.5) / {SH_C0:.4f}"
        )
        yield Said(Advice(text), time)


def _color_space_findings(prim: Usd.Prim) -> Iterator[str]:
    """The name may be said, and the space defined, on any prim above."""
    name, defined = None, set[str]()
    while prim:
        if name is None and prim.HasAPI(Usd.ColorSpaceAPI):
            name = Usd.ColorSpaceAPI(prim).GetColorSpaceNameAttr().Get()
        defined |= {str(one.GetNameAttr().Get()) for one in Usd.ColorSpaceDefinitionAPI.GetAll(prim)}
        prim = prim.GetParent()
    if name is None:
        yield Advice("no color space is said (ColorSpaceAPI): some readers take the colors for linear light")
    elif not Gf.ColorSpace.IsValid(name) and name not in defined:
        yield f"the color space {name!r} is unknown to USD: readers have to guess"


def _orientation_findings(orientations: np.ndarray, count: int, time: Usd.TimeCode) -> Iterator[Said]:
    if len(orientations) != count:
        yield _too_many("orientations", count, len(orientations), time)
    elif not np.abs(np.linalg.norm(orientations, axis=1) - 1).max(initial=0) <= USD_QUATERNION_TOLERANCE:
        yield Said(f"orientations are not unit quaternions {WHEN}", time)
    elif count > 1 and (np.abs(orientations - [1.0, 0.0, 0.0, 0.0]) < USD_QUATERNION_TOLERANCE).all():
        # numpy gives x, y, z, w
        text = f"every Gaussian is turned half about x {WHEN}: w, x, y, z was probably written where x, y, z, w is read"
        yield Said(Advice(text), time)


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


def _bound_findings(prim: Usd.Prim, time: Usd.TimeCode) -> Iterator[Said]:
    """Positions and bound at a time."""
    positions, extent = _values(prim, "positions", time), prim.GetAttribute("extent").Get(time)
    if positions is None or not len(positions):
        return  # there is nothing to bound
    if not np.isfinite(positions).all():
        yield Said(f"positions hold NaN or infinity {WHEN}", time)
    if extent is None:
        yield Said(f"there is no extent {WHEN}: no viewer can compute one for splats", time)
        return
    if len(extent) != 2:
        yield extent_finding(len(extent), time)
        return
    scales = _values(prim, "scales", time)
    sound = scales is not None and len(scales) == len(positions) and bool((scales >= 0).all())
    radii = USD_SPLAT_EXTENT_SIGMA * scales.max(axis=1, keepdims=True) if scales is not None and sound else 0.0
    low, high = np.asarray(extent, np.float32)
    # not <=: an extent of NaN holds nothing
    if not _sticks_out(positions, low, high) <= USD_EXTENT_TOLERANCE_M:
        yield Said(f"the extent {WHEN} does not hold the Gaussians: they get culled", time)
    elif not max(_sticks_out(positions - radii, low, high), _sticks_out(positions + radii, low, high)) <= (
        USD_EXTENT_TOLERANCE_M
    ):
        text = f"the extent {WHEN} holds the centers, not 3 standard deviations: edges may get culled"
        yield Said(Advice(text), time)


def _sticks_out(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """How far the farthest of points (N, 3) is outside of a box."""
    return float(max((low - points.min(axis=0)).max(), (points.max(axis=0) - high).max()))


def _nothing(name: str, instead: str, time: Usd.TimeCode) -> str | Said:
    if time.IsDefault():
        return f"{name} have no Default value: {instead}"
    return Said(f"{name} have no value {WHEN}: {instead}", time)


def _too_many(name: str, count: int, came: int, time: Usd.TimeCode) -> Said:
    return Said(f"{name}: {WHAT} {WHEN}; readers drop them all", time, f"wanted {count}, got {came}")


def _range(values: np.ndarray) -> str:
    return f"from {values.min():.7g} to {values.max():.7g}"


def _times(prim: Usd.Prim, *names: str) -> list[Usd.TimeCode]:
    """Default time and every time sample of these attributes."""
    attributes = (_attribute(prim, name) for name in names)
    samples: set[float] = set()
    samples.update(*(attr.GetTimeSamples() for attr in attributes if attr is not None))
    return [DEFAULT, *map(Usd.TimeCode, sorted(samples))]


def _moments(prim: Usd.Prim, name: str, counts: _Counts) -> Iterable[tuple[Usd.TimeCode, np.ndarray | None]]:
    """The values of an attribute at each of its times, and where there must be another number of them, one by one."""
    return ((time, _values(prim, name, time)) for time in sorted({*_times(prim, name), *counts.changes}))


def _authored(prim: Usd.Prim, name: str) -> bool:
    attr = prim.GetAttribute(name)
    return bool(attr) and attr.HasAuthoredValue()


def _attribute(prim: Usd.Prim, name: str) -> Usd.Attribute | None:
    for candidate in (name, f"{name}h"):
        if _authored(prim, candidate):
            return prim.GetAttribute(candidate)
    return None


def _values(prim: Usd.Prim, name: str, time: Usd.TimeCode = DEFAULT) -> np.ndarray | None:
    attr = _attribute(prim, name)
    value = attr.Get(time) if attr else None
    return None if value is None else np.asarray(value, np.float32)
