"""Exported stages as tests open them."""

from pathlib import Path

from pxr import Usd


def opened(path: Path, variant: str = "splats") -> Usd.Stage:
    """A stage with a variant of the hand chosen, where it offers one; nothing of the file changes. Prims do not outlive
    it."""
    stage = Usd.Stage.Open(str(path))
    stage.SetEditTarget(stage.GetSessionLayer())
    variants = stage.GetDefaultPrim().GetVariantSet("representation")
    if variant in variants.GetVariantNames():
        variants.SetVariantSelection(variant)
    return stage
