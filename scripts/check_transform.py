"""Checks that the joint transform lands both ends of all bones on their joints, on very many hands, and prints a table.

    python scripts/check_transform.py [--hands 100000]

The limits are those of METHOD 2.11. The tests check the same on fewer hands, and the rest of that table; the study
`jghand study stability` has the hard hands. Exit code 1 when a figure misses its limit.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch

ROOT = Path(__file__).resolve().parents[1]
# the random hands of the tests share no code with the engine
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from hand import sampled_hands as hands  # pyright: ignore[reportMissingImports]

from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.skeleton import JointTransform

CANONICAL = hands.canonical()
MODES = [(swing, mode) for swing in ("minimal", "euler") for mode in ("axial", "uniform", 0.3)]
CHUNK = 5000
# millimeters
LIMITS_MM = {torch.float32: 5e-4, torch.float64: 2e-12}


def joint_errors_mm(count: int) -> dict[tuple[torch.dtype, str], float]:
    """The largest error of random hands, of the same root-relative, and of random point clouds, over all modes."""
    worst = {(dtype, kind): 0.0 for dtype in LIMITS_MM for kind in ("hands", "clouds", "hands, root-relative")}
    transforms = [
        JointTransform(CANONICAL, handedness=Handedness.RIGHT, swing=swing, scale_mode=mode) for swing, mode in MODES
    ]
    generator = torch.Generator().manual_seed(0)
    for seed, start in enumerate(range(0, count, CHUNK)):
        chunk = hands.sample(min(CHUNK, count - start), seed=seed)
        cloud = 0.05 * torch.randn(chunk.shape, dtype=torch.float64, generator=generator)
        for dtype in LIMITS_MM:
            for kind, joints in (("hands", chunk.to(dtype)), ("clouds", cloud.to(dtype))):
                for transform in transforms:
                    bones = transform.bones(joints)
                    error = hands.joint_error_mm(bones.matrices(), CANONICAL, joints)
                    worst[dtype, kind] = max(worst[dtype, kind], error)
                    if kind == "hands":
                        centered = torch.cat([bones.linear, bones.offset_m.unsqueeze(-1)], -1)
                        ends, _ = hands.ends_moved(centered, (CANONICAL - CANONICAL[0]).to(dtype))
                        error = ((ends + joints[:, :1] - joints).double().norm(dim=-1).max() * 1e3).item()
                        worst[dtype, "hands, root-relative"] = max(worst[dtype, "hands, root-relative"], error)
    return worst


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hands", type=int, default=100_000, help="random hands, and as many point clouds")
    options = parser.parse_args()
    print(f"{options.hands} random hands, bone lengths +-30 %, palm 6 mm, any rotation, within 1 m; six modes")
    errors_mm = joint_errors_mm(options.hands)
    for (dtype, kind), error_mm in errors_mm.items():
        verdict = "met" if error_mm <= LIMITS_MM[dtype] else "MISSED"
        print(f"  {f'{kind}, {str(dtype)[6:]}':<32} {error_mm:10.3g} mm   limit {LIMITS_MM[dtype]:g}   {verdict}")
    return 1 if any(error_mm > LIMITS_MM[dtype] for (dtype, _), error_mm in errors_mm.items()) else 0


if __name__ == "__main__":
    sys.exit(main())
