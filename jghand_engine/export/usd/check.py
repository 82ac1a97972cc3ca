"""Says in plain sentences what is wrong with a stage, ours or anybody's, in every variant.

USD's own validators look at structure; none of them looks at splats: logarithms as scales, opacity 2, no extent, a
skeleton that got lost all pass. So the rules for data are here (EXPORT 9, 10), beside USD's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel, UsdUtils

from jghand_engine.errors import InputError
from jghand_engine.export.usd.check_said import WHEN, Advice, Said, extent_finding, merged
from jghand_engine.export.usd.check_splats import splat_findings, splat_size
from jghand_engine.export.usd.layers import SPLAT_TYPE
from jghand_engine.limits import USD_CHECK_VARIANTS_MAX, USD_WEIGHT_SUM_TOLERANCE
from jghand_engine.motion.usd_files import reading

PURPOSES = [UsdGeom.Tokens.default_, UsdGeom.Tokens.render, UsdGeom.Tokens.proxy, UsdGeom.Tokens.guide]

# USD's names of what our own rules say in a sentence, also where USD has no validators
SAID_BY_US = ("MissingDefaultPrim",)
NO_SPLATS = Advice("there are no Gaussian splats in it: most of our rules are about those")


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


@dataclass(frozen=True)
class Examination:
    """What was looked at, and what is wrong with it. gaussians: the most that a variant shows · variants: how many were
    looked at, 0 without any · frames: how many times the splats have samples of · findings: errors first."""

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
        choices = _choices(path)
        looked_at = choices[:USD_CHECK_VARIANTS_MAX] or [_Choice()]
        looks = [_look(path, choice) for choice in looked_at]
    seen: dict[tuple[str, str], list[str]] = {}
    sets = {choice.variant_set for choice in choices}
    for choice, look in zip(looked_at, looks, strict=True):
        label = choice.name if len(sets) < 2 else f"{choice.variant_set}={choice.name}"
        for site, sentence in look.found:
            variants = seen.setdefault((site, sentence), [])
            if label not in variants:
                variants.append(label)
    of_all = [""] * len(looked_at)
    if len(choices) > len(looked_at):
        seen["", Advice(f"only {len(looked_at)} of {len(choices)} variants were looked at")] = of_all
    if not any(look.splats for look in looks):
        seen["", NO_SPLATS] = of_all
    findings = [
        # what shows in every variant has nothing to do with them
        Finding("" if len(variants) == len(looked_at) else ", ".join(variants), site, sentence,
                not isinstance(sentence, Advice))
        for (site, sentence), variants in seen.items()
    ]  # fmt: skip
    return Examination(
        max(look.gaussians for look in looks), len(choices[: len(looked_at)]), max(look.frames for look in looks),
        sorted(findings, key=lambda finding: not finding.is_error),
    )  # fmt: skip


class _Look:
    """What is found in one variant of a stage: `found`, (path of the prim, sentence)."""

    def __init__(self, stage: Usd.Stage) -> None:
        self.splats, self.gaussians, self.frames = 0, 0, 0
        self.found = [*_usd_findings(stage), *self._of_prims(stage), *self._of_stage(stage)]

    def _of_prims(self, stage: Usd.Stage) -> Iterator[tuple[str, str]]:
        for prim in _prims(stage):
            found: list[str | Said] = []
            if prim.GetTypeName() == SPLAT_TYPE:
                gaussians, frames = splat_size(prim)
                self.splats, self.gaussians = self.splats + 1, self.gaussians + gaussians
                self.frames = max(self.frames, frames)
                found += splat_findings(prim)
            if prim.IsA(UsdGeom.PointBased):
                found += [*_point_findings(prim), *_skin_findings(prim)]
            yield from ((str(prim.GetPath()), sentence) for sentence in merged(found))

    def _of_stage(self, stage: Usd.Stage) -> Iterator[tuple[str, str]]:
        if self.splats and SPLAT_TYPE not in (stage.GetMetadata("fallbackPrimTypes") or {}):
            text = f"the root layer names no fallbackPrimTypes for {SPLAT_TYPE}: a USD before 26.03 shows nothing"
            yield "", Advice(text)
        if stage.GetDefaultPrim():
            box = UsdGeom.BBoxCache(stage.GetStartTimeCode(), PURPOSES).ComputeWorldBound(stage.GetDefaultPrim())
            if box.ComputeAlignedRange().IsEmpty():
                yield str(stage.GetDefaultPrim().GetPath()), "the world bound is empty: viewers cannot frame the hand"
        else:
            yield "", "there is no default prim: a reference to this file brings nothing"


def _look(path: Path, choice: _Choice) -> _Look:
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    stage = _open(path)
    stage.SetEditTarget(stage.GetSessionLayer())
    for prim_path in choice.prims:
        stage.GetPrimAtPath(prim_path).GetVariantSet(choice.variant_set).SetVariantSelection(choice.name)
    look = _Look(stage)
    look.found += [("", f"USD warns: {item.commentary}") for item in delegate.TakeUncoalescedDiagnostics()]
    return look


def _open(path: Path) -> Usd.Stage:
    stage = Usd.Stage.Open(str(path))
    if stage is None:
        raise InputError(f"USD file {path}", wanted="a stage that opens", came="nothing")
    return stage


def _prims(stage: Usd.Stage) -> Iterator[Usd.Prim]:
    """Every prim; what is instanced once, in the first of its instances."""
    seen = set()
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if prim.IsInstanceProxy():
            shared = prim.GetPrimInPrototype().GetPath()
            if shared in seen:
                continue
            seen.add(shared)
        yield prim


def _choices(path: Path) -> list[_Choice]:
    """Every variant on the stage, those within instances aside, which only change with all that share them."""
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
        text = f"{error.GetName()}: {error.GetMessage()}"
        is_error = error.GetType() == UsdValidation.ValidationErrorType.Error
        yield str(sites[0]) if sites else "", text if is_error else Advice(text)


def _point_findings(prim: Usd.Prim) -> Iterator[str | Said]:
    attr = UsdGeom.PointBased(prim).GetPointsAttr()
    if attr.GetNumTimeSamples() and attr.Get() is None:
        yield "points have time samples but no Default value: several readers show nothing"
    for time in (Usd.TimeCode.Default(), *attr.GetTimeSamples()):
        points, extent = attr.Get(time), UsdGeom.Boundable(prim).GetExtentAttr().Get(time)
        if points is None or not len(points):
            continue
        if not np.isfinite(np.asarray(points)).all():
            yield Said(f"points hold NaN or infinity {WHEN}", time)
        if extent is None:
            yield Said(f"there is no extent {WHEN}", time)
        elif len(extent) != 2:
            yield extent_finding(len(extent), time)


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
