"""Makes the golden files anew, all or some groups; only for a change of pictures or exports that is meant.

python tests/golden/make_golden.py [GROUP ...]
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from cases import EXPORTS, PICTURES, Frame, Picture, drawn
from golden_decode import decoded
from golden_store import packed, path_of, write

# how joints are moved, meters, and how far depths may follow, meters; colors follow by much less than half a step,
# unless a threshold is passed
JITTERS = 12 * ((2e-7, 4e-6),) + 4 * ((1e-6, 2e-5),)
HALF_STEP = 0.5 / 255


def settled(picture: Picture, frame: Frame) -> np.ndarray:
    """(H, W) pixels that another order of rounding leaves alone. Elsewhere a Gaussian stands at the blend's cut-off, a
    sample of the self-shadow at an edge, or the coverage at that which a depth needs."""
    rng, same = np.random.default_rng(0), np.ones(frame.depth_m.shape, bool)
    for jitter_m, follows_m in JITTERS:
        moved = drawn(picture, rng.uniform(-jitter_m, jitter_m, (21, 3)))
        same &= np.abs(moved.rgba - frame.rgba).max(-1) < HALF_STEP
        same &= np.abs(moved.depth_m - frame.depth_m) < follows_m
    return same


def frames(group: str) -> Iterator[tuple[str, np.ndarray]]:
    for picture in PICTURES[group]:
        frame = drawn(picture)
        compared = settled(picture, frame)
        hand = frame.depth_m > 0
        print(f"{picture.name}: {hand.sum()} pixels of a hand, {(~compared).sum()} not compared")
        yield from ((f"{picture.name}|{name}", a) for name, a in packed(frame.rgba, frame.depth_m, compared).items())


def exports(group: str) -> Iterator[tuple[str, np.ndarray]]:
    for case, export in EXPORTS[group].items():
        with tempfile.TemporaryDirectory() as folder:
            export(Path(folder))
            yield from ((f"{case}|{name}", array) for name, array in decoded(case, Path(folder)).items())


if __name__ == "__main__":
    for group in sys.argv[1:] or [*PICTURES, *EXPORTS]:
        write(group, dict(frames(group) if group in PICTURES else exports(group)))
        print(f"{path_of(group).name}: {path_of(group).stat().st_size / 1e6:.2f} MB")
