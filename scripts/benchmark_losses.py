"""How long the terms of the training loss take, forward and backward, on one picture the size of a training's cut.

    python scripts/benchmark_losses.py [--size 250x300] [--threads 2] [--rounds 50]

SSIM three ways: the native kernel, our torch form, and the formula as it is written under torch's autograd. Cases take
turns; median and 95th percentile after a warm-up, samples on a disturbed machine dropped (studies.timing).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import torch
from torch.nn import functional

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from jghand_engine.learn import losses, perceptual, ssim
from jghand_engine.native.ssim import window
from jghand_engine.study.frame_time import COLUMNS, machine, rows
from jghand_engine.study.timing import Case, measure

Loss = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]


def plain_ssim(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """1 - SSIM with one two-dimensional convolution per map, as the formula reads."""
    weights = torch.from_numpy(window()).to(a.dtype)
    kernel = torch.outer(weights, weights)[None, None]

    def mean(maps: torch.Tensor) -> torch.Tensor:
        return functional.conv2d(maps.permute(2, 0, 1).unsqueeze(1), kernel)

    ma, mb = mean(a), mean(b)
    saa, sbb, sab = mean(a * a) - ma * ma, mean(b * b) - mb * mb, mean(a * b) - ma * mb
    luminance = (2 * ma * mb + ssim.C1) / (ma * ma + mb * mb + ssim.C1)
    return 1 - (luminance * (2 * sab + ssim.C2) / (saa + sbb + ssim.C2)).mean()


def torch_ssim(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return 1 - ssim._MeanSsim.apply(a, b)  # type: ignore[operator]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="250x300", help="width x height, pixels")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--rounds", type=int, default=50)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    width, height = (int(edge) for edge in options.size.split("x"))
    random = torch.Generator().manual_seed(0)
    rgb, truth = (torch.rand(height, width, 3, generator=random) for _ in range(2))
    terms: dict[str, Loss] = {
        "SSIM, native": losses.ssim_loss,
        "SSIM, torch": torch_ssim,
        "SSIM, plain autograd": plain_ssim,
        "L1": losses.l1_loss,
        "mask": lambda a, b: losses.mask_loss(a[..., 0], b[..., 0]),
    }
    metric = perceptual.st_lpips()
    if metric is None:
        print(perceptual.ST_LPIPS_MISSING)
    else:
        terms["ST-LPIPS"] = metric.distance

    def with_backward(loss: Loss) -> Callable[[], None]:
        return lambda: loss(rgb.clone().requires_grad_(), truth).backward()

    cases = [
        Case(f"{width} x {height}, forward and backward", name, with_backward(loss), threads=options.threads)
        for name, loss in terms.items()
    ]
    print(", ".join(f"{name} {value}" for name, value in machine(options.threads).items()))
    print("  ".join(f"{head:>14}" for head in COLUMNS))
    for row in rows(measure(cases, rounds=options.rounds, warm_up=5)):
        print(f"{row[0]:<44}" + "".join(f"{cell:>14}" for cell in row[1:]))


if __name__ == "__main__":
    main()
