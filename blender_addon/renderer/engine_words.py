# SPDX-License-Identifier: GPL-3.0-or-later
"""The words of the engine's command line for the jobs that Blender starts: one function per verb. Does not use bpy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..export.recording import Recording


@dataclass(frozen=True)
class UsdChoices:
    """What a stage holds, in the command line's own words. variant: what a program shows that cannot choose"""

    variant: str = "splats"
    sizes: str = "constant"
    radiance: str = "srgb"
    width_factor: float = 1.0


# what suits a program: the variant that is shown first, and the size of points; a test compares it with the engine's
USD_PRESETS: dict[str, tuple[str, float]] = {
    "generic": ("splats", 1.0),
    "omniverse": ("splats", 1.0),
    "usdview": ("points_skinned", 2.0),
    "blender": ("points", 2.0),
    "houdini": ("points", 1.0),
}


def export_usd(recording: Recording, motion: Path, out: Path, figures: Path, choices: UsdChoices) -> tuple[str, ...]:
    """`jghand export`: NAME.usda and its layers in `out`, and what it did as JSON in `figures`."""
    return (
        *("export", "usd", *_of(recording, motion, out, figures)),
        *("--default-variant", choices.variant, "--sizes", choices.sizes),
        *("--radiance", choices.radiance, "--width-factor", f"{choices.width_factor:g}"),
        # whose files are replaced was looked at (export_stamp)
        "--overwrite",
    )


def export_ply(recording: Recording, motion: Path, out: Path, figures: Path, axes: str) -> tuple[str, ...]:
    """`jghand export ply`: NAME.0001.ply and so on in `out`."""
    return ("export", "ply", *_of(recording, motion, out, figures), "--axes", axes, "--overwrite")


def _of(recording: Recording, motion: Path, out: Path, figures: Path) -> tuple[str, ...]:
    return (
        *("--motion", str(motion), "--avatar", recording.avatar, "--out", str(out), "--name", recording.name),
        *("--first-frame", str(recording.first_frame), "--up", "z"),
        # the hand that is seen: nothing is repaired on the way
        *("--keep-bone-lengths", "--on-missing", "stop", "--any-proportions", "--json", str(figures)),
    )


@dataclass(frozen=True)
class CaptureChoices:
    """A training set. identity: number or name of the rigged hand · size: pixels · samples: rays per pixel."""

    identity: str
    cameras: int
    poses: int
    size: tuple[int, int]
    samples: int
    seed: int
    threads: int


def capture(out: Path, choices: CaptureChoices, motion: Path | None = None) -> tuple[str, ...]:
    """`jghand capture`; the same words again go on where it was stopped. motion: its poses instead of made-up ones."""
    return (
        *("capture", "--out", str(out), "--identity", choices.identity),
        *("--cameras", str(choices.cameras), "--poses", str(choices.poses)),
        *("--size", f"{choices.size[0]}x{choices.size[1]}", "--samples", str(choices.samples)),
        *("--seed", str(choices.seed), "--threads", str(choices.threads)),
        *(("--motion", str(motion)) if motion is not None else ()),
    )


@dataclass(frozen=True)
class TrainChoices:
    """A training. minutes: all sessions together · all_pictures: also those that are held out."""

    preset: str
    minutes: float
    seed: int
    all_pictures: bool
    overwrite: bool


def train(capture_folder: Path, out: Path, choices: TrainChoices, start: str = "") -> tuple[str, ...]:
    """`jghand train`. start: "resume" goes on, "fresh" forgets what there is."""
    return (
        *("train", str(capture_folder), "--out", str(out), "--preset", choices.preset),
        *("--minutes", f"{choices.minutes:g}", "--seed", str(choices.seed)),
        *(("--all-pictures",) if choices.all_pictures else ()),
        *(("--overwrite",) if choices.overwrite else ()),
        *((f"--{start}",) if start else ()),
    )
