"""How long an export to USD takes and how large it gets, end to end: 60,000 Gaussians at most, 60 frames by default.

    python scripts/benchmark_usd.py [--avatar builtin|painted] [--frames 60] [--gaussians 60000] [--runs 5]
                                    [--package layers|usdc|usdz]

The built-in hand, which users get, has 40,000 Gaussians at most, and colors of its own in every frame; the painted one
has 60,000 and none. Prints median and worst of the runs after one warm-up: writing the Gaussians (splats and points in
one layer), posing them, everything, opening the stage without its payloads; the size in all and per further frame; and
how much more memory 600 frames take than 48. Files go to a temporary folder on the disk of --folder.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from pxr import Usd

from jghand_engine.avatar.builtin import load_avatar_called
from jghand_engine.export.usd.package import PACKAGES, UsdOptions, UsdReport, export_usd
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import PoseSequence

# frames of a long take, and of one that warms everything up
LONG, SHORT = 600, 48


def swaying_hand(canonical_joints_m: np.ndarray, frames: int) -> PoseSequence:
    """A hand that turns and walks: every position differs in every frame, so nothing is stored twice."""
    angle = np.linspace(0, 2 * np.pi, frames, endpoint=False)
    cosine, sine, zero, one = np.cos(angle), np.sin(angle), np.zeros(frames), np.ones(frames)
    turn = np.stack([cosine, zero, sine, zero, one, zero, -sine, zero, cosine], axis=-1).reshape(frames, 3, 3)
    shift_m = 0.1 * np.stack([sine, cosine, zero], axis=-1)
    joints_m = np.einsum("fab,jb->fja", turn, canonical_joints_m) + shift_m[:, None]
    return PoseSequence(joints_m, 30.0, Handedness.RIGHT)


class Subject:
    """What is exported, and where."""

    def __init__(self, options: argparse.Namespace) -> None:
        whole = load_avatar_called(options.avatar).for_hand(Handedness.RIGHT)
        self.avatar = whole.prefix(min(options.gaussians, len(whole)))
        self._folder, self._package = options.folder, options.package

    def export(self, frames: int, options: UsdOptions | None = None) -> tuple[UsdReport, dict[str, float]]:
        """What the export says, and seconds in all and for opening the stage."""
        motion = swaying_hand(self.avatar.canonical_joints_m, frames)
        options = replace(options or UsdOptions(), package=self._package)
        with tempfile.TemporaryDirectory(dir=self._folder) as temporary:
            start = time.perf_counter()
            report = export_usd(temporary, self.avatar, motion, options=options)
            wrote = time.perf_counter()
            # nothing of it is open, so every layer is read
            stage = Usd.Stage.Open(str(report.stage), Usd.Stage.LoadNone)
            opened = time.perf_counter()
            if not stage.GetDefaultPrim():
                raise SystemExit("the stage has no hand in it")
            return report, {"all": wrote - start, "open": opened - wrote}


def size(report: UsdReport) -> int:
    return sum(report.bytes.values())


def memory_growth_mb(options: argparse.Namespace) -> float | None:
    """How far the peak of a process's memory rises from SHORT to LONG frames; None where it is not told."""
    if sys.platform != "linux":
        return None
    words = [sys.executable, __file__, "--memory", "--avatar", options.avatar, "--gaussians", str(options.gaussians)]
    words += ["--package", options.package]
    done = subprocess.run([*words, "--folder", options.folder], capture_output=True, text=True, check=True)
    return float(done.stdout)


def peak_mb() -> float:
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--avatar", default="builtin", help="a file, or builtin or painted")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--gaussians", type=int, default=60_000)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--package", default="layers", choices=PACKAGES)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    parser.add_argument("--memory", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    subject = Subject(options)
    if options.memory:
        subject.export(SHORT)
        before = peak_mb()
        subject.export(LONG)
        print(peak_mb() - before)
        return
    measure(subject, options)


def measure(subject: Subject, options: argparse.Namespace) -> None:
    """Runs everything and prints it."""
    subject.export(options.frames)
    runs = [subject.export(options.frames) for _ in range(options.runs)]
    doubled, _ = subject.export(2 * options.frames)
    report = runs[0][0]
    print(
        f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, torch threads {torch.get_num_threads()}"
    )
    print(
        f"{options.avatar}, {report.gaussians} Gaussians, {report.frames} frames, {options.package}, {len(runs)} runs "
        "after 1 warm-up; median (worst)"
    )
    rows = {
        "write, ms/frame": [1e3 * run.seconds["splats"] / run.frames for run, _ in runs],
        "pose, ms/frame": [1e3 * run.seconds["posing"] / run.frames for run, _ in runs],
        "all, ms/frame": [1e3 * seconds["all"] / run.frames for run, seconds in runs],
        "open, ms": [1e3 * seconds["open"] for _, seconds in runs],
    }
    for name, values in rows.items():
        print(f"  {name:<22} {statistics.median(values):7.2f} ({max(values):.2f})")
    growth = (size(doubled) - size(report)) / options.frames
    print(f"  {'size, MB':<22} {size(report) / 1e6:7.2f}, {size(report) / 1e6 / report.frames:.3f} per frame")
    for name, bytes_ in report.bytes.items():
        print(f"    {name:<20} {bytes_ / 1e6:7.2f}")
    print(f"  {'per further frame, MB':<22} {growth / 1e6:7.3f}")
    grown = memory_growth_mb(options)
    if grown is not None:
        print(f"  {f'{LONG} frames, MB more':<22} {grown:7.1f}")


if __name__ == "__main__":
    main()
