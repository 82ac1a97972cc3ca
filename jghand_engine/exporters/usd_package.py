"""A stage as one file: with the chosen variant alone in a .usdc, or with everything in a .usdz (EXPORT 5)."""

from __future__ import annotations

from pathlib import Path

from pxr import Sdf, Usd, UsdUtils

from jghand_engine.errors import RetryError
from jghand_engine.exporters.usd_layers import TimeRange
from jghand_engine.exporters.usd_options import Variant
from jghand_engine.exporters.usd_splats import Places, SplatLayer, SplatPrims
from jghand_engine.exporters.usd_stage import HAND_PATH


def write_archive(interface: Path, target: Path) -> None:
    """Packs a stage and its layers into a .usdz. RetryError when USD cannot."""
    if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(interface)), str(target)):
        raise _cannot_write(target)


def write_flat(interface: Path, target: Path) -> None:
    """Puts a stage with its chosen variant into one layer, all of it in memory: without the frames of Gaussians, which
    `frames_of_flat` adds. RetryError when USD cannot."""
    if not Usd.Stage.Open(str(interface)).Flatten().Export(str(target)):
        raise _cannot_write(target)


def frames_of_flat(target: Path, variant: Variant, prims: SplatPrims, time: TimeRange) -> SplatLayer | None:
    """What adds the frames to a file that `write_flat` made; None for a variant that has none.

    prims: of the layer that was put there, which knows what does not move
    """
    places = {
        Variant.SPLATS: Places(f"{HAND_PATH}/Splats", None),
        Variant.POINTS: Places(None, f"{HAND_PATH}/Points"),
    }.get(variant)
    if places is None:
        return None
    stage = Usd.Stage.Open(str(target))
    return SplatLayer(stage, prims.elsewhere(stage, places), time)


def _cannot_write(target: Path) -> RetryError:
    return RetryError(f"cannot write {target.name}", remedy="Check the disk and try again.")
