"""The USD export with a progress bar, for `jghand export` and `jghand demo`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.cli.console import progress
from jghand_engine.export.usd.export import export_usd
from jghand_engine.export.usd.half import HalfPrice
from jghand_engine.export.usd.options import UsdOptions, UsdReport
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.render.camera import Camera


def export_stage(
    folder: Path, avatar: HandAvatar, sequence: PoseSequence, cameras: Mapping[str, Camera], options: UsdOptions
) -> UsdReport:
    """Writes the stage and shows how far it is."""
    with progress("Writing USD", len(sequence)) as bar:
        task = bar.task_ids[0]
        return export_usd(
            folder, avatar, sequence, cameras, options, progress=lambda done, _: bar.update(task, completed=done)
        )


def usd_figures(report: UsdReport) -> dict[str, Any]:
    """What an export did, as plain data."""
    return {
        "stage": str(report.stage),
        "shot": None if report.shot is None else str(report.shot),
        "frames": report.frames,
        "gaussians": report.gaussians,
        "bytes": dict(report.bytes),
        "seconds": dict(report.seconds),
        "sigma_error": report.sigma_error,
        "made_from": dict(report.made_from),
        "half_precision": None if report.half is None else _half_figures(report.half),
    }


def _half_figures(price: HalfPrice) -> dict[str, float]:
    return {
        "position_error_m": price.position_m,
        "position_rms_m": price.rms_m,
        "sigma_error": price.sigma,
        "color_error": price.rgb,
        "opacity_error": price.opacity,
        "turn_error_deg": price.turn_deg,
    }
