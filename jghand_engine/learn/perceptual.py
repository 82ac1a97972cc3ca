"""Perceptual distance of two pictures: ST-LPIPS, and exact LPIPS for who has its trunk (DATA 6).

ST-LPIPS (shift-tolerant LPIPS, Ghildyal and Liu, ECCV 2022) is a metric of its own: it forgives shifts by design, so
its figures stand under its own name and beside no paper's LPIPS. LPIPS (Zhang et al. 2018, version 0.1) needs a trunk
that was trained on ImageNet and that no package ships: the user brings torchvision's checkpoint, the heads come from
the package lpips 0.1.4. Neither package is imported (both would import torchvision): only their files of tensors are
read. Both can be a loss: the gradient goes to the first picture.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from jghand_engine.errors import InputError, first_line, install_extra
from jghand_engine.learn.metrics import METRIC_BOX_MIN_PX

# floor of the length of a feature vector, as both networks were trained with it
PERCEPTUAL_NORM_EPS = 1e-10

ST_LPIPS, LPIPS = "ST-LPIPS", "LPIPS"
ST_LPIPS_MISSING = f"ST-LPIPS: not available (no package stlpips-pytorch). {install_extra('perceptual')}"
LPIPS_MISSING = "LPIPS: not available (needs the ImageNet trunk: torchvision's checkpoint of vgg16 or alexnet)"

Tensors = Mapping[str, Tensor]


@dataclass(frozen=True)
class PerceptualMetric:
    """A distance of pictures by the features of a network.

    name:     what its figures are called, ST-LPIPS or LPIPS
    note:     what a reader of the figures has to know
    features: five maps of a (1, 3, H, W) picture in -1..1
    heads:    per map, weights (1, C, 1, 1) of its channels
    """

    name: str
    note: str
    features: Callable[[Tensor], list[Tensor]]
    heads: tuple[Tensor, ...]

    def distance(self, rgb: Tensor, truth: Tensor) -> Tensor:
        """Scalar, 0 for equal pictures; (H, W, 3) float32 display-referred sRGB 0..1.

        InputError for a side below METRIC_BOX_MIN_PX, which captures of small pictures have.
        """
        if min(rgb.shape[:2]) < METRIC_BOX_MIN_PX:
            raise InputError(f"pictures for {self.name}", came=f"{rgb.shape[1]} x {rgb.shape[0]} pixels",
                             wanted=f"at least {METRIC_BOX_MIN_PX} along each side")  # fmt: skip
        ours = self.features(_network_input(rgb))
        with torch.no_grad():
            theirs = self.features(_network_input(truth))
        # weighted squared differences of feature maps, each of unit length over the channels
        squares = [(_unit(a) - _unit(b)).square() for a, b in zip(ours, theirs, strict=True)]
        parts = [functional.conv2d(one, head).mean() for one, head in zip(squares, self.heads, strict=True)]
        return torch.stack(parts).sum()


def _network_input(rgb: Tensor) -> Tensor:
    return (2 * rgb - 1).permute(2, 0, 1).unsqueeze(0)


def _unit(features: Tensor) -> Tensor:
    # the published norm has a plain root, whose gradient is NaN where all channels are 0 (black regions): the inner
    # selection keeps 0 away from the root and changes no value
    square = features.square().sum(1, keepdim=True)
    length = torch.where(square > 0, torch.where(square > 0, square, 1.0).sqrt(), 0.0)
    return features / (length + PERCEPTUAL_NORM_EPS)


def distances(metrics: Sequence[PerceptualMetric], rgb: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Of two pictures (H, W, 3), clipped to 0..1: each metric's distance, under its name in lower case."""
    a, b = (torch.from_numpy(np.clip(picture, 0, 1).astype(np.float32)) for picture in (rgb, truth))
    with torch.no_grad():
        return {metric.name.lower().replace("-", "_"): float(metric.distance(a, b)) for metric in metrics}


# ---- ST-LPIPS -------------------------------------------------------------------------------------------------------

# per slice: its convolutions, and the filter before it, as they are numbered in the file of weights
_ST_SLICES = (
    (1, (0, 2), None),
    (2, (6, 8), 5),
    (3, (12, 14, 16), 11),
    (4, (20, 22, 24), 19),
    (5, (28, 30, 32), 27),
)


def st_lpips(device: torch.device | None = None) -> PerceptualMetric | None:
    """ST-LPIPS with VGG, or None where its package is missing: the caller then prints ST_LPIPS_MISSING.

    device: where its pictures are compared; left out: the CPU
    """
    path = _installed_file("stlpips-pytorch", "weights/vST0.0/vgg_shift_tolerant.pth")
    if path is None:
        return None
    tensors = {name: tensor.to(device or "cpu") for name, tensor in _load_tensors(path).items()}
    shift, scale = tensors["scaling_layer.shift"], tensors["scaling_layer.scale"]

    def features(x: Tensor) -> list[Tensor]:
        x, maps = (x - shift) / scale, []
        for number, convolutions, filter_ in _ST_SLICES:
            if filter_ is not None:
                # pooled with stride 1, then low-passed with stride 2: what makes the features tolerate shifts
                kernel = tensors[f"net.slice{number}.{filter_}.filt"]
                x = functional.pad(functional.max_pool2d(x, 2, 1), (2, 2, 2, 2), mode="reflect")
                x = functional.conv2d(x, kernel, stride=2, groups=x.shape[1])
            for name in convolutions:
                layer = f"net.slice{number}.{name}"
                x = functional.conv2d(x, tensors[f"{layer}.weight"], tensors[f"{layer}.bias"], padding=1).relu()
            maps.append(x)
        return maps

    note = "shift-tolerant, VGG; forgives shifts by design, not comparable with LPIPS"
    return PerceptualMetric(ST_LPIPS, note, features, tuple(tensors[f"lin{i}.model.1.weight"] for i in range(5)))


# ---- LPIPS ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Trunk:
    """convolutions: per slice, numbers in torchvision's `features` · pool: kernel and stride of the pooling before the
    slices `pooled` · strides: stride and padding of the convolutions that differ from 1, 1."""

    convolutions: tuple[tuple[int, ...], ...]
    pool: tuple[int, int]
    pooled: tuple[int, ...]
    strides: Mapping[int, tuple[int, int]]


_TRUNKS = {
    "vgg": _Trunk(((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28)), (2, 2), (1, 2, 3, 4), {}),
    "alex": _Trunk(((0,), (3,), (6,), (8,), (10,)), (3, 2), (1, 2), {0: (4, 2), 3: (1, 2)}),
}
_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)


def lpips(trunk: Path, device: torch.device | None = None) -> PerceptualMetric:
    """Exact LPIPS 0.1. trunk: torchvision's checkpoint of vgg16, or of alexnet where its name says so · device: where
    its pictures are compared; left out: the CPU. InputError for a file that is no such trunk, and without the heads."""
    kind = "alex" if "alex" in trunk.name.lower() else "vgg"
    if not trunk.is_file():
        raise InputError(f"trunk of LPIPS {trunk}", wanted="torchvision's checkpoint", came="no such file")
    heads = _installed_file("lpips", f"weights/v0.1/{kind}.pth")
    if heads is None:
        raise InputError("heads of LPIPS", wanted="the package lpips 0.1.4", came="none",
                         remedy="pip install --no-deps lpips==0.1.4 (without it torchvision comes along).")  # fmt: skip
    ours, theirs = (
        {name: tensor.to(device or "cpu") for name, tensor in _load_tensors(path).items()} for path in (trunk, heads)
    )
    return lpips_of(ours, theirs, kind, str(trunk))


def lpips_of(trunk: Tensors, heads: Tensors, kind: str, thing: str = "trunk of LPIPS") -> PerceptualMetric:
    """LPIPS from the tensors of a trunk and of the heads. InputError names `thing` when one is missing."""
    spec = _TRUNKS[kind]
    numbers = [number for group in spec.convolutions for number in group]
    _check_present(trunk, [f"features.{n}.{part}" for n in numbers for part in ("weight", "bias")], thing)
    _check_present(heads, [f"lin{i}.model.1.weight" for i in range(5)], "heads of LPIPS")

    def features(x: Tensor) -> list[Tensor]:
        shift, scale = (x.new_tensor(values).reshape(1, 3, 1, 1) for values in (_SHIFT, _SCALE))
        x, maps = (x - shift) / scale, []
        for place, group in enumerate(spec.convolutions):
            if place in spec.pooled:
                x = functional.max_pool2d(x, *spec.pool)
            for number in group:
                stride, padding = spec.strides.get(number, (1, 1))
                weight, bias = trunk[f"features.{number}.weight"], trunk[f"features.{number}.bias"]
                x = functional.conv2d(x, weight.float(), bias.float(), stride=stride, padding=padding).relu()
            maps.append(x)
        return maps

    note = f"version 0.1, {kind}"
    return PerceptualMetric(LPIPS, note, features, tuple(heads[f"lin{i}.model.1.weight"].float() for i in range(5)))


# ---- files ----------------------------------------------------------------------------------------------------------


def _installed_file(package: str, ending: str) -> Path | None:
    """The file of an installed package whose path ends so, without importing the package; None where it is missing."""
    try:
        files = metadata.files(package) or []
    except metadata.PackageNotFoundError:
        return None
    found = (Path(str(file.locate())) for file in files if file.as_posix().endswith(ending))
    return next((path for path in found if path.is_file()), None)


def _load_tensors(path: Path) -> Tensors:
    """The tensors of a .pth file, on the CPU, without gradient. InputError when it holds anything else.

    The house forbids pickle, which these files are. This is the one exception: weights_only builds tensors and nothing
    else, and the file is one that the user installed or chose. A test holds torch.load to this line.
    """
    try:
        with warnings.catch_warnings():
            # torch warns of the old form in which the heads of LPIPS were stored
            warnings.simplefilter("ignore")
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        # a damaged file ends in whatever its bytes lead to: zip, pickle, key and decoding errors
        raise InputError(f"weights {path}", wanted="a file of tensors", came=first_line(error)) from error
    if not isinstance(content, dict) or not all(isinstance(value, Tensor) for value in content.values()):
        raise InputError(f"weights {path}", wanted="named tensors and nothing else", came=type(content).__name__)
    return {str(name): value.detach() for name, value in content.items()}


def _check_present(tensors: Tensors, names: list[str], thing: str) -> None:
    if missing := [name for name in names if name not in tensors]:
        raise InputError(thing, wanted=f"the tensor {missing[0]}", came=f"none ({len(missing)} are missing)")
