"""Says in plain sentences what is wrong with a stage, ours or anybody's, in every variant.

USD's own validators look at structure; none of them looks at splats: logarithms as scales, opacity 2, no extent, a
skeleton that got lost all pass. So the rules for data are here (EXPORT 9, 10), beside USD's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, UsdUtils

from jghand_engine.errors import InputError
from jghand_engine.export.splats.cloud import SH_C0
from jghand_engine.export.usd.splats import DEFAULT, DEGREE, EXTENT_SIGMA, HARMONICS
from jghand_engine.export.usd.stage import SPLAT_TYPE
from jghand_engine.motion.usd import reading

PURPOSES = [UsdGeom.Tokens.default_, UsdGeom.Tokens.render, UsdGeom.Tokens.proxy, UsdGeom.Tokens.guide]
# USD's names of what our own rules say in a sentence
SAID_BY_US = ("MissingDefaultPrim",)
NO_SPLATS = "there are no Gaussian splats in it: most of our rules are about those"
# how far a Gaussian may stick out of its bound (meters, round-off of float32 at 100 m), how far a quaternion's length
# (that of NVIDIA's rule VG.035) and a point's weights may be from 1 (at 1 m from the origin it then moves by 1 mm), and
# how far an opacity may be out of 0..1 (some steps of float32)
EXTENT_TOLERANCE_M, QUATERNION_TOLERANCE, WEIGHT_TOLERANCE, OPACITY_TOLERANCE = 1e-5, 1e-3, 1e-3, 1e-6
# share of the values that must be impossible before they are called logarithms or logits: a few are a slip
GUESS_SHARE = 0.5
# a median size above which nobody meant meters
SIGMA_SANE_M = 1.0
# variants of a stage that are looked at: each opens the stage anew
VARIANTS_MAX = 32
_STORED = ("positions", "orientations", "scales", "opacities", HARMONICS)


@dataclass(frozen=True)
class Finding:
    """What is wrong.

    variant: in which it shows, or '' for all
    site: path of the prim, or ''
    sentence: what it is; of what is wrong at many times with their number
    is_error: some reader shows something else than was meant; else: look at it
    """

    variant: str
    site: str
    sentence: str
    is_error: bool = True

    def __str__(self) -> str:
        where = " ".join(part for part in (f"[{self.variant}]" if self.variant else "", self.site) if part)
        return f"{where}: {self.sentence}" if where else self.sentence


@dataclass(frozen=True)
class Examination:
    """What was looked at, and what is wrong with it.

    gaussians: the most that a variant shows
    variants: how many were looked at, 0 without any
    frames: how many times the splats have samples of
    findings: errors first
    """

    gaussians: int
    variants: int
    frames: int
    findings: list[Finding]


def check_usd(path: Path | str) -> list[Finding]:
    """Everything that is wrong with the stage at `path`, in each of its variants, errors first; empty when nothing is.

    Raises InputError when the file cannot be opened as a stage.
    """
    return examine_usd(path).findings


def examine_usd(path: Path | str) -> Examination:
    """The same, with what was looked at: variants within variants only as the file chooses them."""
    path = Path(path)
    with reading(path):
        offered = _variants(_open(path))
        looks = [_Look(path, *choice) for choice in list(offered.items())[:VARIANTS_MAX] or [(("", ""), [])]]
    several_sets = len({variant_set for variant_set, _ in offered}) > 1
    seen: dict[Finding, list[str]] = {}
    for look in looks:
        label = f"{look.variant_set}={look.name}" if several_sets else look.name
        for finding in dict.fromkeys(look.findings):
            seen.setdefault(finding, []).append(label)
    # what shows in every variant has nothing to do with them
    findings = [replace(one, variant="" if len(of) == len(looks) else ", ".join(of)) for one, of in seen.items()]
    if len(offered) > len(looks):
        findings.append(Finding("", "", f"only {len(looks)} of {len(offered)} variants were looked at", False))
    if not any(look.splats for look in looks):
        findings.append(Finding("", "", NO_SPLATS, False))
    return Examination(
        max(look.gaussians for look in looks), min(len(offered), VARIANTS_MAX), max(look.frames for look in looks),
        sorted(findings, key=lambda finding: not finding.is_error),
    )  # fmt: skip


def stage_facts(path: Path) -> dict[str, Any]:
    """What a stage holds: times, units, variants, prims of each type, layers, and what is wrong with it, as plain data.
    InputError when it cannot be opened."""
    findings = check_usd(path)
    with reading(path):
        stage = _open(path)
        names = [prim.GetTypeName() or "untyped" for prim in stage.TraverseAll()]
        variants = {
            f"{prim.GetPath()} {name}": list(prim.GetVariantSets().GetVariantSet(name).GetVariantNames())
            for prim in stage.TraverseAll()
            for name in prim.GetVariantSets().GetNames()
        }
        layers = {Path(one.realPath or one.identifier).name for one in stage.GetUsedLayers() if not one.anonymous}
        return {
            "default_prim": str(stage.GetDefaultPrim().GetPath()) if stage.HasDefaultPrim() else "none",
            "frames": [stage.GetStartTimeCode(), stage.GetEndTimeCode()],
            "fps": stage.GetTimeCodesPerSecond(),
            "meters_per_unit": UsdGeom.GetStageMetersPerUnit(stage),
            "up_axis": str(UsdGeom.GetStageUpAxis(stage)),
            "prims": {name: names.count(name) for name in sorted(set(names))},
            "splats": names.count(SPLAT_TYPE),
            "variants": variants,
            "layers": sorted(layers),
            "findings": [str(finding) for finding in findings],
        }


def _open(path: Path) -> Usd.Stage:
    stage = Usd.Stage.Open(str(path))
    if stage is None:
        raise InputError(f"USD file {path}", wanted="a stage that opens", came="nothing")
    return stage


def _variants(stage: Usd.Stage) -> dict[tuple[str, str], list[Sdf.Path]]:
    """(Variant set, variant) -> the prims that offer it; several hands are switched together."""
    offered: dict[tuple[str, str], list[Sdf.Path]] = {}
    for prim in stage.Traverse():
        sets = prim.GetVariantSets()
        for variant_set in sets.GetNames():
            for name in sets.GetVariantSet(variant_set).GetVariantNames():
                offered.setdefault((variant_set, name), []).append(prim.GetPath())
    return offered


class _Look:
    """What is found in one variant of a stage."""

    def __init__(self, path: Path, choice: tuple[str, str], prims: list[Sdf.Path]) -> None:
        self.variant_set, self.name = choice
        self.splats = self.gaussians = self.frames = 0
        delegate = UsdUtils.CoalescingDiagnosticDelegate()
        stage = _open(path)
        stage.SetEditTarget(stage.GetSessionLayer())
        for prim in prims:
            stage.GetPrimAtPath(prim).GetVariantSet(self.variant_set).SetVariantSelection(self.name)
        self.findings = [*_usd_findings(stage), *self._of_prims(stage), *self._of_stage(stage)]
        warnings = delegate.TakeUncoalescedDiagnostics()
        self.findings += [Finding("", "", f"USD warns: {item.commentary}") for item in warnings]

    def _of_prims(self, stage: Usd.Stage) -> Iterator[Finding]:
        seen = set()
        for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
            # what is instanced once, in the first of its instances
            shared = prim.GetPrimInPrototype().GetPath() if prim.IsInstanceProxy() else prim.GetPath()
            if shared in seen:
                continue
            seen.add(shared)
            notes = _Notes(str(prim.GetPath()))
            if prim.GetTypeName() == SPLAT_TYPE:
                self.splats += 1
                self.gaussians += _look_at_splats(prim, notes)
                self.frames = max(self.frames, len(_times(prim, "positions")) - 1)
            if prim.IsA(UsdGeom.PointBased):
                _look_at_points(prim, notes)
            yield from notes.findings()

    def _of_stage(self, stage: Usd.Stage) -> Iterator[Finding]:
        if self.splats and SPLAT_TYPE not in (stage.GetMetadata("fallbackPrimTypes") or {}):
            text = f"the root layer names no fallbackPrimTypes for {SPLAT_TYPE}: a USD before 26.03 shows nothing"
            yield Finding("", "", text, False)
        root = stage.GetDefaultPrim()
        if not root:
            yield Finding("", "", "there is no default prim: a reference to this file brings nothing")
        elif (
            UsdGeom.BBoxCache(stage.GetStartTimeCode(), PURPOSES)
            .ComputeWorldBound(root)
            .ComputeAlignedRange()
            .IsEmpty()
        ):
            yield Finding("", str(root.GetPath()), "the world bound is empty: viewers cannot frame the hand")


def _usd_findings(stage: Usd.Stage) -> Iterator[Finding]:
    """What USD's own validators say, where this USD has them."""
    try:
        from pxr import UsdValidation
    except ImportError:
        return
    registry = UsdValidation.ValidationRegistry()
    for error in UsdValidation.ValidationContext(registry.GetOrLoadAllValidators()).Validate(stage):
        if error.GetName() not in SAID_BY_US:
            sites = [str(site.GetPrim().GetPath()) for site in error.GetSites() if site.IsPrim()]
            is_error = error.GetType() == UsdValidation.ValidationErrorType.Error
            yield Finding("", sites[0] if sites else "", f"{error.GetName()}: {error.GetMessage()}", is_error)


class _Notes:
    """What is found in one prim. What is wrong at many times is one finding: {when} stands for the times in a sentence,
    {what} for what was seen at the first of them."""

    def __init__(self, site: str) -> None:
        self._site = site
        self._seen: dict[tuple[str, bool], list[tuple[Usd.TimeCode | None, object]]] = {}

    def error(self, sentence: str, time: Usd.TimeCode | None = None, what: object = "") -> None:
        self._seen.setdefault((sentence, True), []).append((time, what))

    def advice(self, sentence: str, time: Usd.TimeCode | None = None, what: object = "") -> None:
        self._seen.setdefault((sentence, False), []).append((time, what))

    def findings(self) -> Iterator[Finding]:
        for (sentence, is_error), moments in self._seen.items():
            time, what = moments[0]
            first = "Default time" if time is None or time.IsDefault() else f"time {time.GetValue():g}"
            when = f"at {first}" if len(moments) == 1 else f"at {len(moments)} times (first {first})"
            text = sentence.replace("{when}", when).replace("{what}", str(what))
            yield Finding("", self._site, text, is_error)


def _look_at_splats(prim: Usd.Prim, notes: _Notes) -> int:
    """One ParticleField3DGaussianSplat at Default time and at every time sample; float attributes win over their half
    twins, as in USD. Gives how many Gaussians it has."""
    first = _values(prim, "positions")
    if first is None:
        notes.error("positions have no Default value: several readers show nothing")
        return 0
    if not len(first):
        notes.advice("there are no Gaussians in it")
        return 0
    _look_at_prim(prim, notes)
    degree = _degree(prim, notes)
    scale = UsdGeom.GetStageMetersPerUnit(prim.GetStage())
    rules: dict[str, tuple[str, Callable[[np.ndarray, Usd.TimeCode], None]]] = {
        "scales": (
            "every Gaussian would be 1 unit wide",
            lambda values, time: _look_at_scales(values, scale, time, notes),
        ),
        "opacities": ("everything would be opaque", lambda values, time: _look_at_opacities(values, time, notes)),
        "orientations": ("", lambda values, time: _look_at_orientations(values, time, notes)),
    }
    if degree is not None:
        rules[HARMONICS] = (
            "everything would be gray",
            lambda values, time: _look_at_colors(values, degree, time, notes),
        )
    before, sampled = len(first), {name: set(_times(prim, name)) for name in (*_STORED, "extent")}
    for time in sorted(set().union(*sampled.values())):
        positions = _values(prim, "positions", time)
        count = 0 if positions is None else len(positions)
        changes, before = count != before, count
        if changes:
            notes.advice("the number of positions changes {when}: readers do not interpolate there", time)
        for name, (instead, rule) in rules.items():
            if not changes and time not in sampled[name]:
                continue
            values, label = _values(prim, name, time), "spherical harmonics" if name == HARMONICS else name
            each = (degree + 1) ** 2 if name == HARMONICS and degree is not None else 1
            if values is None:
                if instead and time.IsDefault():
                    notes.error(f"{label} have no Default value: {instead}")
                elif instead:
                    notes.error(f"{label} have no value {{when}}: {instead}", time)
            elif len(values) != count * each:
                label = f"{label} of degree {degree}" if name == HARMONICS else label
                wanted = f"wanted {count * each}{' vectors' if name == HARMONICS else ''}, got {len(values)}"
                notes.error(f"{label}: {{what}} {{when}}; readers drop them all", time, wanted)
            elif not np.isfinite(values).all():
                notes.error(f"{label} hold NaN or infinity {{when}}", time)
            elif len(values):
                rule(values, time)
        if changes or any(time in sampled[name] for name in ("positions", "scales", "extent")):
            _look_at_bound(prim, positions, time, notes)
    return len(first)


def _look_at_scales(scales: np.ndarray, meters_per_unit: float, time: Usd.TimeCode, notes: _Notes) -> None:
    if (scales < 0).any():
        guess = "they are probably logarithms, USD wants lengths (exp of them)"
        text = "scales are not all above 0 {when}, but {what}: "
        notes.error(text + (guess if (scales < 0).mean() > GUESS_SHARE else "USD wants lengths"), time, _range(scales))
        return
    if not (scales > 0).all():
        text = "scales hold 0 {when}: {what} Gaussians are flat, which NVIDIA's rule VG.035 refuses"
        notes.advice(text, time, (scales <= 0).any(axis=1).sum())
    if (median_m := float(np.median(scales)) * meters_per_unit) > SIGMA_SANE_M:
        text = "half of the Gaussians are wider than {what} {when}: the scales, or metersPerUnit, are probably wrong"
        notes.advice(text, time, f"{median_m:.3g} m")


def _look_at_opacities(opacities: np.ndarray, time: Usd.TimeCode, notes: _Notes) -> None:
    outside = (opacities < -OPACITY_TOLERANCE) | (opacities > 1 + OPACITY_TOLERANCE)
    if outside.any():
        guess = ": they are probably logits, USD wants 1 / (1 + exp(-x)) of them"
        text = "opacities are not all from 0 to 1 {when}, but {what}"
        notes.error(text + (guess if outside.mean() > GUESS_SHARE else ""), time, _range(opacities))


def _look_at_orientations(orientations: np.ndarray, time: Usd.TimeCode, notes: _Notes) -> None:
    if not np.abs(np.linalg.norm(orientations, axis=1) - 1).max() <= QUATERNION_TOLERANCE:
        notes.error("orientations are not unit quaternions {when}", time)
    elif len(orientations) > 1 and (np.abs(orientations - [1.0, 0.0, 0.0, 0.0]) < QUATERNION_TOLERANCE).all():
        # numpy gives x, y, z, w
        text = "every Gaussian is turned half about x {when}: w, x, y, z was probably written where x, y, z, w is read"
        notes.advice(text, time)


def _degree(prim: Usd.Prim, notes: _Notes) -> int | None:
    """The degree of the harmonics; None where it is missing or none."""
    degree = prim.GetAttribute(DEGREE)
    if not (degree and degree.HasAuthoredValue()):
        notes.error(
            "the degree of the spherical harmonics is not authored: it falls back to 3 and the colors are dropped"
        )
        return None
    number = degree.Get()
    if number not in range(4):
        notes.error(f"the degree of the spherical harmonics: wanted 0 to 3, got {number}")
        return None
    attr, each = _attribute(prim, HARMONICS), (number + 1) ** 2
    if attr is not None and (attr.GetMetadata("interpolation"), attr.GetMetadata("elementSize")) != ("vertex", each):
        notes.error(
            f"spherical harmonics lack the metadata interpolation vertex and elementSize {each}: NVIDIA's rule VG.035 "
            "wants them"
        )
    return number


def _look_at_colors(coefficients: np.ndarray, degree: int, time: Usd.TimeCode, notes: _Notes) -> None:
    first = coefficients[:: (degree + 1) ** 2]
    if first.min() >= 0 and first.max() <= 1 and float(first.std()) > 0:
        notes.advice(
            "all first coefficients of the spherical harmonics are from 0 to 1 {when}: they are probably colors, "
            f"USD wants (color - 0.5) / {SH_C0:.4f}",
            time,
        )


def _look_at_prim(prim: Usd.Prim, notes: _Notes) -> None:
    """What does not change in time: color space, precision, what stands above the splats."""
    both = [name for name in _STORED if _authored(prim, name) and _authored(prim, f"{name}h")]
    halves = [name for name in _STORED if _authored(prim, f"{name}h") and not _authored(prim, name)]
    if both:
        notes.advice(f"{', '.join(both)} are there in float and in half precision: readers take the floats")
    if halves:
        notes.advice(f"{', '.join(halves)} are there in half precision alone: NVIDIA's rule VG.035 wants floats")
    if prim.HasAttribute("primvars:skel:jointWeights"):
        notes.error(
            "there are joint weights on the splats: nothing skins splats, they stay at rest (points are skinned)"
        )
    space, defined, above = None, set[str](), prim
    while above:
        if space is None and above.HasAPI(Usd.ColorSpaceAPI):
            space = Usd.ColorSpaceAPI(above).GetColorSpaceNameAttr().Get()
        defined |= {str(one.GetNameAttr().Get()) for one in Usd.ColorSpaceDefinitionAPI.GetAll(above)}
        if above.GetTypeName() == "SkelRoot":
            text = (
                f"the splats lie below the SkelRoot {above.GetPath()}, whose bound leaves them out: viewers cull them"
            )
            notes.error(text)
        above = above.GetParent()
    if space is None:
        notes.advice("no color space is said (ColorSpaceAPI): some readers take the colors for linear light")
    elif not Gf.ColorSpace.IsValid(space) and space not in defined:
        notes.error(f"the color space {space!r} is unknown to USD: readers have to guess")


def _look_at_bound(prim: Usd.Prim, positions: np.ndarray | None, time: Usd.TimeCode, notes: _Notes) -> None:
    extent = prim.GetAttribute("extent").Get(time)
    if positions is None or not len(positions):
        return  # there is nothing to bound
    if not np.isfinite(positions).all():
        notes.error("positions hold NaN or infinity {when}", time)
    if extent is None:
        notes.error("there is no extent {when}: no viewer can compute one for splats", time)
        return
    if not _is_box(extent, time, notes):
        return
    scales = _values(prim, "scales", time)
    sound = scales is not None and len(scales) == len(positions) and bool((scales >= 0).all())
    radii = EXTENT_SIGMA * scales.max(axis=1, keepdims=True) if scales is not None and sound else 0.0
    low, high = np.asarray(extent, np.float32)

    def sticks_out(points: np.ndarray) -> bool:
        # not >: an extent of NaN holds nothing
        return not max((low - points.min(axis=0)).max(), (points.max(axis=0) - high).max()) <= EXTENT_TOLERANCE_M

    if sticks_out(positions):
        notes.error("the extent {when} does not hold the Gaussians: they get culled", time)
    elif sticks_out(positions - radii) or sticks_out(positions + radii):
        notes.advice("the extent {when} holds the centers, not 3 standard deviations: edges may get culled", time)


def _is_box(extent: Any, time: Usd.TimeCode, notes: _Notes) -> bool:
    if len(extent) != 2:
        notes.error("the extent {when} has {what} vectors: wanted 2, the corners of a box", time, len(extent))
    return len(extent) == 2


def _look_at_points(prim: Usd.Prim, notes: _Notes) -> None:
    """Points, meshes and curves, and their skin."""
    attr = UsdGeom.PointBased(prim).GetPointsAttr()
    if attr.GetNumTimeSamples() and attr.Get() is None:
        notes.error("points have time samples but no Default value: several readers show nothing")
    for time in (DEFAULT, *map(Usd.TimeCode, attr.GetTimeSamples())):
        points, extent = attr.Get(time), UsdGeom.Boundable(prim).GetExtentAttr().Get(time)
        if points is None or not len(points):
            continue
        if not np.isfinite(np.asarray(points)).all():
            notes.error("points hold NaN or infinity {when}", time)
        if extent is None:
            notes.error("there is no extent {when}", time)
        else:
            _is_box(extent, time, notes)
    if not prim.HasAPI(UsdSkel.BindingAPI):
        return
    binding = UsdSkel.BindingAPI(prim)
    if not binding.GetInheritedSkeleton():
        notes.error("skel:skeleton has no target: the skeleton got lost, the skin will not move")
        return
    weights = binding.GetJointWeightsPrimvar().Get()
    size = binding.GetJointWeightsPrimvar().GetElementSize()
    if weights is None:
        return
    if size < 1 or len(weights) % size:
        notes.error(f"{len(weights)} joint weights are not {size} for every point: readers drop them all")
    elif not np.abs(np.asarray(weights).reshape(-1, size).sum(axis=1) - 1).max(initial=0) <= WEIGHT_TOLERANCE:
        notes.error("joint weights of a point do not sum to 1: it will shrink towards the origin")


def _range(values: np.ndarray) -> str:
    return f"from {values.min():.7g} to {values.max():.7g}"


def _times(prim: Usd.Prim, name: str) -> list[Usd.TimeCode]:
    """Default time and every time sample of an attribute."""
    attr = _attribute(prim, name)
    return [DEFAULT, *map(Usd.TimeCode, attr.GetTimeSamples() if attr is not None else ())]


def _authored(prim: Usd.Prim, name: str) -> bool:
    attr = prim.GetAttribute(name)
    return bool(attr) and attr.HasAuthoredValue()


def _attribute(prim: Usd.Prim, name: str) -> Usd.Attribute | None:
    return next((prim.GetAttribute(one) for one in (name, f"{name}h") if _authored(prim, one)), None)


def _values(prim: Usd.Prim, name: str, time: Usd.TimeCode = DEFAULT) -> np.ndarray | None:
    attr = _attribute(prim, name)
    value = attr.Get(time) if attr else None
    return None if value is None else np.asarray(value, np.float32)
