"""How long an export to USD takes and how large it gets, end to end: 60,000 Gaussians, 60 frames by default.

    python scripts/benchmark_usd.py [--frames 60] [--gaussians 60000] [--runs 5]

Prints median and worst of the runs after one warm-up: writing the Gaussians (splats and points in one layer), posing
them, everything; and the size in all and per further frame. Files go to a temporary folder on the disk of --folder.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from jghand_engine.avatar.builtin import load_painted
from jghand_engine.exporters.usd import UsdReport, export_usd
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import PoseSequence


def swaying_hand(canonical_joints_m: np.ndarray, frames: int) -> PoseSequence:
    """A hand that turns and walks: every position differs in every frame, so nothing is stored twice."""
    angle = np.linspace(0, 2 * np.pi, frames, endpoint=False)
    cosine, sine, zero, one = np.cos(angle), np.sin(angle), np.zeros(frames), np.ones(frames)
    turn = np.stack([cosine, zero, sine, zero, one, zero, -sine, zero, cosine], axis=-1).reshape(frames, 3, 3)
    shift_m = 0.1 * np.stack([sine, cosine, zero], axis=-1)
    joints_m = np.einsum("fab,jb->fja", turn, canonical_joints_m) + shift_m[:, None]
    return PoseSequence(joints_m, 30.0, Handedness.RIGHT)


def one_run(folder: Path, gaussians: int, frames: int) -> tuple[UsdReport, float]:
    avatar = load_painted(handedness=Handedness.RIGHT).prefix(gaussians)
    motion = swaying_hand(avatar.canonical_joints_m.numpy(), frames)
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        start = time.perf_counter()
        report = export_usd(temporary, avatar, motion)
        return report, time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--gaussians", type=int, default=60_000)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    options = parser.parse_args()
    one_run(options.folder, options.gaussians, options.frames)
    runs = [one_run(options.folder, options.gaussians, options.frames) for _ in range(options.runs)]
    doubled, _ = one_run(options.folder, options.gaussians, 2 * options.frames)
    report = runs[0][0]
    print(
        f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, torch threads {torch.get_num_threads()}"
    )
    print(f"{report.gaussians} Gaussians, {report.frames} frames, {len(runs)} runs after 1 warm-up; median (worst)")
    rows = {
        "write, ms/frame": [run.write_ms_per_frame for run, _ in runs],
        "pose, ms/frame": [1e3 * run.seconds["posing"] / run.frames for run, _ in runs],
        "all, ms/frame": [1e3 * seconds / run.frames for run, seconds in runs],
    }
    for name, values in rows.items():
        print(f"  {name:<22} {statistics.median(values):7.2f} ({max(values):.2f})")
    growth = (sum(doubled.bytes.values()) - sum(report.bytes.values())) / options.frames
    print(f"  {'size, MB':<22} {sum(report.bytes.values()) / 1e6:7.2f}, {report.megabytes_per_frame:.3f} per frame")
    print(f"  {'per further frame, MB':<22} {growth / 1e6:7.3f}")


if __name__ == "__main__":
    main()
