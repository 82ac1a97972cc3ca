"""How long the joint transform takes: batches in torch with and without gradients, and one hand natively.

    python scripts/benchmark_transform.py [--runs 100] [--reference FOLDER]

Median and 95th percentile of the runs after a warm-up. `--reference` names a folder with `skeleton.py`, another
implementation of the same transform, which is then timed in turn with ours. METHOD 2.11 asks, for 1000 hands in float32
on one thread, for 18 / 40 ms forward / with backward (euler) and 22 / 49 ms (minimal), and for 0.3 ms for one hand.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from hand import sampled_hands as hands  # pyright: ignore[reportMissingImports]

from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import Skeleton
from jghand_engine.learn.skeleton import BoneTransforms, JointTransform

CANONICAL = hands.canonical()


def everything(bones: BoneTransforms) -> torch.Tensor:
    """The matrices, after the angles were computed too, as other implementations always do."""
    _ = bones.frames.angles, bones.frames.palm_p, bones.frames.palm_n
    return bones.matrices()


def forward(transform: Callable[[torch.Tensor], torch.Tensor], joints: torch.Tensor) -> Callable[[], object]:
    def run() -> object:
        with torch.no_grad():
            return transform(joints)

    return run


def with_backward(transform: Callable[[torch.Tensor], torch.Tensor], joints: torch.Tensor) -> Callable[[], object]:
    def run() -> object:
        return transform(joints.clone().requires_grad_()).sum().backward()

    return run


def timed(calls: dict[str, Callable[[], object]], runs: int) -> None:
    """Runs the calls in turn, so that a busy machine is unfair to none, and prints a row for each."""
    spent: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        for _ in range(max(3, runs // 10)):
            call()
    for _ in range(runs):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            spent[name].append(1e3 * (time.perf_counter() - start))
    for name, times in spent.items():
        print(f"  {name:<58} {np.median(times):8.3f} {np.percentile(times, 95):8.3f}")


def our_transform(swing: str) -> Callable[[torch.Tensor], torch.Tensor]:
    transform = JointTransform(CANONICAL, handedness=Handedness.RIGHT, swing=swing)
    return lambda joints: everything(transform.bones(joints))


def reference_transform(folder: Path, swing: str) -> Callable[[torch.Tensor], torch.Tensor]:
    sys.path.insert(0, str(folder))
    import skeleton  # pyright: ignore[reportMissingImports]

    transform: Any = skeleton.JointTransform(CANONICAL, swing)
    return lambda joints: transform(joints)[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--reference", type=Path, help="folder with another implementation, skeleton.py")
    options = parser.parse_args()
    machine = platform.processor() or platform.machine()
    print(
        f"{machine}, {os.cpu_count()} cores, torch {torch.__version__}; ms: median, 95th percentile of {options.runs}"
    )
    for threads in (1, 2):
        torch.set_num_threads(threads)
        for count in (1, 1000):
            joints = hands.sample(count).float()
            print(f"{count} hands, float32, {threads} threads")
            for swing in ("euler", "minimal"):
                makers: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {"": our_transform(swing)}
                if options.reference:
                    makers[", reference"] = reference_transform(options.reference, swing)
                calls: dict[str, Callable[[], object]] = {}
                for whose, transform in makers.items():
                    calls[f"{swing}, forward{whose}"] = forward(transform, joints)
                    calls[f"{swing}, forward + backward{whose}"] = with_backward(transform, joints)
                timed(calls, options.runs)
    print("1 hand, float64 in, float32 out, the Python call included")
    one = hands.sample(1)[0].numpy()
    for swing in ("euler", "minimal"):
        fast = Skeleton(CANONICAL, handedness=Handedness.RIGHT, swing=swing)
        timed({f"{swing}, native": lambda t=fast: t.bones(one)}, 20 * options.runs)


if __name__ == "__main__":
    main()
