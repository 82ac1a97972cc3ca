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
# what is stored for every Gaussian, and what is shown where it is not there
_STORED = {
    "scales": "every Gaussian would be 1 unit wide",
    "opacities": "everything would be opaque",
    "orientations": "",
    HARMONICS: "everything would be gray",
}


def _outside(opacities: np.ndarray) -> np.ndarray:
    return (opacities < -OPACITY_TOLERANCE) | (opacities > 1 + OPACITY_TOLERANCE)


# when values are wrong, and what is said then: the first that holds
_RULES: dict[str, tuple[tuple[Callable[[np.ndarray], Any], str], ...]] = {
    "scales": (
        (
            lambda scales: (scales < 0).mean() > GUESS_SHARE,
            "scales are not all above 0 {when}, but {what}: they are probably logarithms, USD wants lengths",
        ),
        (lambda scales: (scales < 0).any(), "scales are not all above 0 {when}, but {what}: USD wants lengths"),
    ),
    "opacities": (
        (
            lambda opacities: _outside(opacities).mean() > GUESS_SHARE,
            "opacities are not all from 0 to 1 {when}, but {what}: they are probably logits",
        ),
        (lambda opacities: _outside(opacities).any(), "opacities are not all from 0 to 1 {when}, but {what}"),
    ),
    "orientations": (
        (
            lambda turns: not np.abs(np.linalg.norm(turns, axis=1) - 1).max() <= QUATERNION_TOLERANCE,
            "orientations are not unit quaternions {when}",
        ),
    ),
    HARMONICS: (
        (
            lambda colors: colors.min() >= 0 and colors.max() <= 1 and colors.std() > 0,
            "spherical harmonics are all from 0 to 1 {when}: they are probably colors, USD wants "
            f"(color - 0.5) / {SH_C0:.4f}",
        ),
    ),
}


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
    InputError when the file cannot be opened as a stage."""
    return examine_usd(path).findings


def examine_usd(path: Path | str) -> Examination:
    """The same, with what was looked at: variants within variants only as the file chooses them."""
    path = Path(path)
    with reading(path):
        offered = _variants(_open(path))
        looks = [_Look(path, *choice) for choice in offered.items() or [(("", ""), [])]]
    several_sets = len({variant_set for variant_set, _ in offered}) > 1
    seen: dict[Finding, list[str]] = {}
    for look in looks:
        for finding in dict.fromkeys(look.findings):
            seen.setdefault(finding, []).append(f"{look.variant_set}={look.name}" if several_sets else look.name)
    # what shows in every variant has nothing to do with them
    findings = [replace(one, variant="" if len(of) == len(looks) else ", ".join(of)) for one, of in seen.items()]
    if not any(look.gaussians for look in looks):
        findings.append(Finding("", "", NO_SPLATS, False))
    return Examination(
        max(look.gaussians for look in looks), len(offered), max(look.frames for look in looks),
        sorted(findings, key=lambda finding: not finding.is_error),
    )  # fmt: skip


def stage_facts(path: Path) -> dict[str, Any]:
    """What a stage holds: times, units, variants, prims of each type, layers, and what is wrong with it, as plain data.
    InputError when it cannot be opened."""
    findings = check_usd(path)
    with reading(path):
        stage = _open(path)
        names = [prim.GetTypeName() or "untyped" for prim in stage.TraverseAll()]
        variants: dict[str, list[str]] = {}
        for (variant_set, name), prims in _variants(stage).items():
            for prim in prims:
                variants.setdefault(f"{prim} {variant_set}", []).append(name)
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
        self.gaussians = self.frames = 0
        delegate = UsdUtils.CoalescingDiagnosticDelegate()
        stage = _open(path)
        stage.SetEditTarget(stage.GetSessionLayer())
        for prim in prims:
            stage.GetPrimAtPath(prim).GetVariantSet(self.variant_set).SetVariantSelection(self.name)
        self.findings = [*_usd_findings(stage), *self._of_prims(stage), *_of_stage(stage, bool(self.gaussians))]
        warnings = delegate.TakeUncoalescedDiagnostics()
        self.findings += [Finding("", "", f"USD warns: {item.commentary}") for item in warnings]

    def _of_prims(self, stage: Usd.Stage) -> Iterator[Finding]:
        for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
            notes = _Notes(str(prim.GetPath()))
            if prim.GetTypeName() == SPLAT_TYPE:
                self.gaussians += _look_at_splats(prim, notes)
                self.frames = max(self.frames, len(_times(prim, "positions")))
            if prim.IsA(UsdGeom.PointBased):
                _look_at_points(prim, notes)
            yield from notes.findings()


def _of_stage(stage: Usd.Stage, has_splats: bool) -> Iterator[Finding]:
    if has_splats and SPLAT_TYPE not in (stage.GetMetadata("fallbackPrimTypes") or {}):
        text = f"the root layer names no fallbackPrimTypes for {SPLAT_TYPE}: a USD before 26.03 shows nothing"
        yield Finding("", "", text, False)
    root = stage.GetDefaultPrim()
    if not root:
        yield Finding("", "", "there is no default prim: a reference to this file brings nothing")
        return
    bound = UsdGeom.BBoxCache(stage.GetStartTimeCode(), PURPOSES).ComputeWorldBound(root)
    if bound.ComputeAlignedRange().IsEmpty():
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
        self._seen: dict[tuple[str, bool], list[tuple[Usd.TimeCode, object]]] = {}

    def add(self, text: str, time: Usd.TimeCode = DEFAULT, what: object = "", *, is_error: bool = True) -> None:
        self._seen.setdefault((text, is_error), []).append((time, what))

    def findings(self) -> Iterator[Finding]:
        for (text, is_error), seen in self._seen.items():
            time, what = seen[0]
            first = "Default time" if time.IsDefault() else f"time {time.GetValue():g}"
            when = f"at {first}" if len(seen) == 1 else f"at {len(seen)} times (first {first})"
            sentence = text.replace("{when}", when).replace("{what}", str(what))
            yield Finding("", self._site, sentence, is_error)


# ---- splats ----------------------------------------------------------------------------------------------------------


def _look_at_splats(prim: Usd.Prim, notes: _Notes) -> int:
    """One ParticleField3DGaussianSplat at Default time and at every time sample; float attributes win over their half
    twins, as in USD. Gives how many Gaussians it has."""
    first = _values(prim, "positions")
    if first is None or not len(first):
        notes.add("positions have no Default value: several readers show nothing")
        return 0
    _look_above(prim, notes)
    degree = _degree(prim, notes)
    names = [name for name in _STORED if name != HARMONICS or degree is not None]
    sampled = {name: {DEFAULT, *_times(prim, name)} for name in ("positions", "extent", *names)}
    before = len(first)
    for time in sorted(set().union(*sampled.values())):
        positions = _values(prim, "positions", time)
        count = 0 if positions is None else len(positions)
        changes, before = count != before, count
        if changes:
            text = "the number of positions changes {when}: readers do not interpolate there"
            notes.add(text, time, is_error=False)
        for name in names:
            if changes or time in sampled[name]:
                _look_at_values(prim, name, count * (((degree or 0) + 1) ** 2 if name == HARMONICS else 1), time, notes)
        if (
            positions is not None
            and count
            and (changes or any(time in sampled[name] for name in ("positions", "scales", "extent")))
        ):
            _look_at_bound(prim, positions, time, notes)
    return len(first)


def _look_at_values(prim: Usd.Prim, name: str, wanted: int, time: Usd.TimeCode, notes: _Notes) -> None:
    values, label = _values(prim, name, time), "spherical harmonics" if name == HARMONICS else name
    if values is None:
        if _STORED[name]:
            notes.add(f"{label} have no value {{when}}: {_STORED[name]}", time)
    elif len(values) != wanted:
        notes.add(f"{label}: {{what}} {{when}}; readers drop them all", time, f"wanted {wanted}, got {len(values)}")
    elif not np.isfinite(values).all():
        notes.add(f"{label} hold NaN or infinity {{when}}", time)
    elif len(values):
        wrong = next((text for is_wrong, text in _RULES[name] if is_wrong(values)), None)
        if wrong is not None:
            notes.add(wrong, time, f"from {values.min():.7g} to {values.max():.7g}", is_error=name != HARMONICS)


def _degree(prim: Usd.Prim, notes: _Notes) -> int | None:
    """The degree of the harmonics; None where it is missing or none."""
    if not _authored(prim, DEGREE):
        notes.add(
            "the degree of the spherical harmonics is not authored: it falls back to 3 and the colors are dropped"
        )
        return None
    degree = prim.GetAttribute(DEGREE).Get()
    if degree not in range(4):
        notes.add(f"the degree of the spherical harmonics: wanted 0 to 3, got {degree}")
        return None
    attr, each = _attribute(prim, HARMONICS), (degree + 1) ** 2
    if attr is not None and (attr.GetMetadata("interpolation"), attr.GetMetadata("elementSize")) != ("vertex", each):
        notes.add(f"spherical harmonics lack interpolation vertex and elementSize {each}, which NVIDIA's VG.035 wants")
    return degree


def _look_above(prim: Usd.Prim, notes: _Notes) -> None:
    """What does not change in time: skin, color space, and what stands above the splats."""
    if prim.HasAttribute("primvars:skel:jointWeights"):
        notes.add("there are joint weights on the splats: nothing skins splats, they stay at rest (points are skinned)")
    space, above = None, prim
    while above:
        if space is None and above.HasAPI(Usd.ColorSpaceAPI):
            space = Usd.ColorSpaceAPI(above).GetColorSpaceNameAttr().Get()
        if above.GetTypeName() == "SkelRoot":
            text = (
                f"the splats lie below the SkelRoot {above.GetPath()}, whose bound leaves them out: viewers cull them"
            )
            notes.add(text)
        above = above.GetParent()
    if space is None:
        text = "no color space is declared (ColorSpaceAPI): some readers take the colors for linear light"
        notes.add(text, is_error=False)
    elif not Gf.ColorSpace.IsValid(space):
        notes.add(f"the color space {space!r} is unknown to USD: readers have to guess")


def _look_at_bound(prim: Usd.Prim, positions: np.ndarray, time: Usd.TimeCode, notes: _Notes) -> None:
    if not np.isfinite(positions).all():
        notes.add("positions hold NaN or infinity {when}", time)
    box = _box(prim, time, notes)
    if box is None:
        return
    scales = _values(prim, "scales", time)
    is_sound = scales is not None and len(scales) == len(positions) and bool((scales >= 0).all())
    radii = EXTENT_SIGMA * scales.max(axis=1, keepdims=True) if scales is not None and is_sound else 0.0

    def sticks_out(low: np.ndarray, high: np.ndarray) -> bool:
        # not >: an extent of NaN holds nothing
        return not max((box[0] - low.min(axis=0)).max(), (high.max(axis=0) - box[1]).max()) <= EXTENT_TOLERANCE_M

    if sticks_out(positions, positions):
        notes.add("the extent {when} does not hold the Gaussians: they get culled", time)
    elif sticks_out(positions - radii, positions + radii):
        text = "the extent {when} holds the centers, not 3 standard deviations: edges may get culled"
        notes.add(text, time, is_error=False)


# ---- points, meshes and curves ---------------------------------------------------------------------------------------


def _look_at_points(prim: Usd.Prim, notes: _Notes) -> None:
    attr = UsdGeom.PointBased(prim).GetPointsAttr()
    if attr.GetNumTimeSamples() and attr.Get() is None:
        notes.add("points have time samples but no Default value: several readers show nothing")
    for time in (DEFAULT, *map(Usd.TimeCode, attr.GetTimeSamples())):
        points = attr.Get(time)
        if points is not None and len(points):
            if not np.isfinite(np.asarray(points)).all():
                notes.add("points hold NaN or infinity {when}", time)
            _box(prim, time, notes)
    if not prim.HasAPI(UsdSkel.BindingAPI):
        return
    binding = UsdSkel.BindingAPI(prim)
    if not binding.GetInheritedSkeleton():
        notes.add("skel:skeleton has no target: the skeleton got lost, the skin will not move")
        return
    weights = binding.GetJointWeightsPrimvar().Get()
    size = binding.GetJointWeightsPrimvar().GetElementSize()
    if weights is not None and (size < 1 or len(weights) % size):
        notes.add(f"{len(weights)} joint weights are not {size} for every point: readers drop them all")
    elif weights is not None:
        sums = np.asarray(weights).reshape(-1, size).sum(axis=1)
        if not np.abs(sums - 1).max(initial=0) <= WEIGHT_TOLERANCE:
            notes.add("joint weights of a point do not sum to 1: it will shrink towards the origin")


def _box(prim: Usd.Prim, time: Usd.TimeCode, notes: _Notes) -> np.ndarray | None:
    """Both corners of a prim's bound, None where it has none."""
    extent = prim.GetAttribute("extent").Get(time)
    if extent is None:
        notes.add("there is no extent {when}: viewers cannot know how large it is", time)
    elif len(extent) != 2:
        notes.add("the extent {when} has {what} vectors: wanted 2, the corners of a box", time, len(extent))
    else:
        return np.asarray(extent, np.float32)
    return None


def _times(prim: Usd.Prim, name: str) -> list[Usd.TimeCode]:
    attr = _attribute(prim, name)
    return [] if attr is None else [Usd.TimeCode(time) for time in attr.GetTimeSamples()]


def _authored(prim: Usd.Prim, name: str) -> bool:
    attr = prim.GetAttribute(name)
    return bool(attr) and attr.HasAuthoredValue()


def _attribute(prim: Usd.Prim, name: str) -> Usd.Attribute | None:
    return next((prim.GetAttribute(one) for one in (name, f"{name}h") if _authored(prim, one)), None)


def _values(prim: Usd.Prim, name: str, time: Usd.TimeCode = DEFAULT) -> np.ndarray | None:
    attr = _attribute(prim, name)
    value = attr.Get(time) if attr else None
    return None if value is None else np.asarray(value, np.float32)
