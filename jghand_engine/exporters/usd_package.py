"""A stage as one file: flattened into a .usdc with the chosen variant, or with everything in a .usdz (EXPORT 5)."""

from __future__ import annotations

from pathlib import Path

from pxr import Sdf, Usd, UsdUtils

from jghand_engine.errors import RetryError
from jghand_engine.exporters.usd_options import Package


def write_package(interface: Path, target: Path, package: Package) -> None:
    """One file of a stage that lies in layers. RetryError when USD cannot make it."""
    if package is Package.USDZ:
        made = UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(interface)), str(target))
    else:
        made = Usd.Stage.Open(str(interface)).Flatten().Export(str(target))
    if not made:
        raise RetryError(f"cannot write {target.name}", remedy="Check the disk and try again.")
