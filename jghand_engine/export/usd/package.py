"""A stage as one file: with the chosen variant alone in a .usdc, or with everything in a .usdz (EXPORT 5)."""

from __future__ import annotations

from pathlib import Path

from pxr import Sdf, Usd

from jghand_engine.errors import RetryError
from jghand_engine.export.usd.layers import TimeRange
from jghand_engine.export.usd.options import LayerNames, Variant
from jghand_engine.export.usd.splats import Places, SplatLayer, SplatPrims
from jghand_engine.export.usd.stage import HAND_PATH
from jghand_engine.export.usd.zip import write_zip


def write_archive(folder: Path, names: LayerNames, target: Path) -> None:
    """Packs a stage and its layers into a .usdz. InputError when they are too large for one."""
    write_zip(target, [folder / name for name in (names.interface, names.rig, names.splats, names.skinned)])


def write_flat(interface: Path, target: Path) -> None:
    """Puts a stage with its chosen variant into one layer, all of it in memory: without the frames of Gaussians, which
    `frames_of_flat` adds. RetryError when USD cannot."""
    # the comment would tell a place on our disk, as the identifier does that flattening makes of a relative one
    layer = Usd.Stage.Open(str(interface)).Flatten(addSourceFileComment=False)
    layer.GetPrimAtPath(HAND_PATH).assetInfo["identifier"] = Sdf.AssetPath(f"./{target.name}")
    if not layer.Export(str(target)):
        raise RetryError(f"cannot write {target.name}", remedy="Check the disk and try again.")


def frames_of_flat(target: Path, variant: Variant, prims: SplatPrims, time: TimeRange) -> SplatLayer | None:
    """What adds the frames to a file that `write_flat` made; None for a variant that has none.

    prims: of the layer that was put there, which knows what does not move
    """
    if not variant.has_frames:
        return None
    is_splats = variant is Variant.SPLATS
    places = Places(f"{HAND_PATH}/Splats", None) if is_splats else Places(None, f"{HAND_PATH}/Points")
    stage = Usd.Stage.Open(str(target))
    return SplatLayer(stage, prims.elsewhere(stage, places), time)
