"""Says in plain sentences what is wrong with a stage, ours or anybody's, in every variant.

USD's own validators look at structure; none of them looks at splats: logarithms as scales, opacity 2, no extent, a
skeleton that got lost all pass. So the rules for data are here (EXPORT 9, 10), beside USD's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, UsdSkel, UsdUtils

from jghand_engine.errors import InputError
from jghand_engine.exporters.usd_check_files import check_file
from jghand_engine.exporters.usd_check_splats import Advice, extent_sentence, splat_findings, time_name
from jghand_engine.exporters.usd_layers import SPLAT_TYPE
from jghand_engine.limits import USD_CHECK_VARIANTS_MAX, USD_WEIGHT_SUM_TOLERANCE

PURPOSES = [UsdGeom.Tokens.default_, UsdGeom.Tokens.render, UsdGeom.Tokens.proxy, UsdGeom.Tokens.guide]

# USD's names of what our own rules say in a sentence, also where USD has no validators
SAID_BY_US = ("MissingDefaultPrim",)


@dataclass(frozen=True)
class Finding:
    """variant: in which it shows, or '' for all · site: path of the prim, or '' · sentence: what is wrong · is_error:
    some reader shows something else than was meant; else: look at it."""

    variant: str
    site: str
    sentence: str
    is_error: bool = True

    def __str__(self) -> str:
        where = " ".join(part for part in (f"[{self.variant}]" if self.variant else "", self.site) if part)
        return f"{where}: {self.sentence}" if where else self.sentence


@dataclass(frozen=True)
class _Choice:
    """One variant, and the prims that offer it; several hands are switched together. An empty one chooses nothing."""

    variant_set: str = ""
    name: str = ""
    prims: tuple[Sdf.Path, ...] = ()


def check_usd(path: Path | str) -> list[Finding]:
    """Everything that is wrong with the stage at `path`, in each of its variants, errors first; empty when nothing is.

    Raises InputError when the file cannot be opened as a stage.
    """
    path = Path(path)
    check_file(path)
    choices = _choices(path)
    seen: dict[tuple[str, str], list[str]] = {}
    looked_at = choices[:USD_CHECK_VARIANTS_MAX] or [_Choice()]
    sets = {choice.variant_set for choice in choices}
    for choice in looked_at:
        label = choice.name if len(sets) < 2 else f"{choice.variant_set}={choice.name}"
        for site, sentence in _findings_of(path, choice):
            variants = seen.setdefault((site, sentence), [])
            if label not in variants:
                variants.append(label)
    if len(choices) > len(looked_at):
        text = f"only {len(looked_at)} of {len(choices)} variants were looked at"
        seen["", Advice(text)] = [""] * len(looked_at)
    findings = [
        # what shows in every variant has nothing to do with them
        Finding("" if len(variants) == len(looked_at) else ", ".join(variants), site, sentence,
                not isinstance(sentence, Advice))
        for (site, sentence), variants in seen.items()
    ]  # fmt: skip
    return sorted(findings, key=lambda finding: not finding.is_error)


def _findings_of(path: Path, choice: _Choice) -> list[tuple[str, str]]:
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    stage = _open(path)
    stage.SetEditTarget(stage.GetSessionLayer())
    for prim_path in choice.prims:
        stage.GetPrimAtPath(prim_path).GetVariantSet(choice.variant_set).SetVariantSelection(choice.name)
    found = [*_usd_findings(stage), *_stage_findings(stage)]
    found += [("", f"USD warns: {item.commentary}") for item in delegate.TakeUncoalescedDiagnostics()]
    return found


def _open(path: Path) -> Usd.Stage:
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise InputError(f"USD file {path}", wanted="a stage that opens", came=f"an error of USD: {error}") from error
    if stage is None:
        raise InputError(f"USD file {path}", wanted="a stage that opens", came="nothing")
    return stage


def _choices(path: Path) -> list[_Choice]:
    """Every variant on the stage."""
    stage = _open(path)
    offered: dict[tuple[str, str], list[Sdf.Path]] = {}
    for prim in stage.Traverse():
        sets = prim.GetVariantSets()
        for variant_set in sets.GetNames():
            for name in sets.GetVariantSet(variant_set).GetVariantNames():
                offered.setdefault((variant_set, name), []).append(prim.GetPath())
    return [_Choice(variant_set, name, tuple(prims)) for (variant_set, name), prims in offered.items()]


def _usd_findings(stage: Usd.Stage) -> Iterator[tuple[str, str]]:
    """What USD's own validators say, where this USD has them."""
    try:
        from pxr import UsdValidation
    except ImportError:
        return
    registry = UsdValidation.ValidationRegistry()
    for error in UsdValidation.ValidationContext(registry.GetOrLoadAllValidators()).Validate(stage):
        if error.GetName() in SAID_BY_US:
            continue
        sites = [site.GetPrim().GetPath() for site in error.GetSites() if site.IsPrim()]
        yield str(sites[0]) if sites else "", f"{error.GetName()}: {error.GetMessage()}"


def _stage_findings(stage: Usd.Stage) -> Iterator[tuple[str, str]]:
    """Our rules for the whole stage and for every prim."""
    splats = 0
    for prim in stage.Traverse():
        site = str(prim.GetPath())
        if prim.GetTypeName() == SPLAT_TYPE:
            splats += 1
            yield from ((site, sentence) for sentence in splat_findings(prim))
        if prim.IsA(UsdGeom.PointBased):
            yield from ((site, sentence) for sentence in _point_findings(prim))
            yield from ((site, sentence) for sentence in _skin_findings(prim))
    if splats and SPLAT_TYPE not in (stage.GetMetadata("fallbackPrimTypes") or {}):
        text = f"the root layer names no fallbackPrimTypes for {SPLAT_TYPE}: a USD before 26.03 shows nothing"
        yield "", Advice(text)
    if stage.GetDefaultPrim():
        box = UsdGeom.BBoxCache(stage.GetStartTimeCode(), PURPOSES).ComputeWorldBound(stage.GetDefaultPrim())
        if box.ComputeAlignedRange().IsEmpty():
            yield str(stage.GetDefaultPrim().GetPath()), "the world bound is empty: viewers cannot frame the hand"
    else:
        yield "", "there is no default prim: a reference to this file brings nothing"


def _point_findings(prim: Usd.Prim) -> Iterator[str]:
    attr = UsdGeom.PointBased(prim).GetPointsAttr()
    if attr.GetNumTimeSamples() and attr.Get() is None:
        yield "points have time samples but no Default value: several readers show nothing"
    for time in (Usd.TimeCode.Default(), *attr.GetTimeSamples()):
        points, extent = attr.Get(time), UsdGeom.Boundable(prim).GetExtentAttr().Get(time)
        if points is None or not len(points):
            continue
        if not np.isfinite(np.asarray(points)).all():
            yield f"points hold NaN or infinity at {time_name(time)}"
        if extent is None:
            yield f"there is no extent at {time_name(time)}"
        elif len(extent) != 2:
            yield extent_sentence(len(extent), time)


def _skin_findings(prim: Usd.Prim) -> Iterator[str]:
    if not prim.HasAPI(UsdSkel.BindingAPI):
        return
    binding = UsdSkel.BindingAPI(prim)
    if not binding.GetInheritedSkeleton():
        yield "skel:skeleton has no target: the skeleton got lost, the skin will not move"
        return
    weights = binding.GetJointWeightsPrimvar().Get()
    size = binding.GetJointWeightsPrimvar().GetElementSize()
    if weights is None:
        return
    if size < 1 or len(weights) % size:
        yield f"{len(weights)} joint weights are not {size} for every point: readers drop them all"
    elif not np.abs(np.asarray(weights).reshape(-1, size).sum(axis=1) - 1).max(initial=0) <= USD_WEIGHT_SUM_TOLERANCE:
        yield "joint weights of a point do not sum to 1: it will shrink towards the origin"
