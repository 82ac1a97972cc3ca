"""Structural similarity of two pictures, with a backward pass written out by hand.

    SSIM = (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sxx + syy + C2))

per channel, with means and (co)variances under an 11 x 11 Gaussian window of sigma 1.5 (Wang et al. 2004; METHOD 4.3).
Only windows that lie wholly inside the picture count. It is a loss of every training step, so float32 RGB
pictures on the CPU go through one call of the native kernel, everything else through torch, where the blurred maps of
all channels share one pair of one-dimensional convolutions. The two agree to rounding.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from jghand_engine.errors import InputError
from jghand_engine.native.binding import Library
from jghand_engine.native.library import load
from jghand_engine.native.ssim import CHANNELS, SSIM_K1, SSIM_K2, NativeSsim, window
from jghand_engine.native.tasks import SSIM_WINDOW_PX
from jghand_engine.native.threads import thread_count

C1 = SSIM_K1**2
C2 = SSIM_K2**2


def ssim(rgb: Tensor, truth: Tensor) -> Tensor:
    """Mean SSIM, a scalar; its gradient goes to `rgb` only.

    rgb, truth: (H, W, 3) or any number of channels, floating, 0..1. InputError for unlike shapes or a picture smaller
    than the window.
    """
    check_pictures(rgb, truth)
    truth = truth.detach()
    library = _library_for(rgb, truth)
    if library is None:
        return _MeanSsim.apply(rgb, truth)  # type: ignore[no-any-return]
    return _NativeMeanSsim.apply(rgb, truth, library)  # type: ignore[no-any-return]


def ssim_parts(rgb: Tensor, truth: Tensor) -> tuple[Tensor, Tensor]:
    """Without gradient: SSIM of every window, and its contrast-structure factor alone, both (C, H - 10, W - 10)."""
    check_pictures(rgb, truth)
    with torch.no_grad():
        m = _Moments.of(rgb.permute(2, 0, 1), truth.permute(2, 0, 1))
        contrast = m.A2 / m.B2
        return contrast * m.A1 / m.B1, contrast


def check_pictures(rgb: Tensor, truth: Tensor) -> None:
    """InputError unless both are (H, W, C) of the same shape and not smaller than the window."""
    if rgb.dim() != 3 or rgb.shape != truth.shape:
        raise InputError("pictures to compare", wanted="two of one shape (height, width, channels)",
                         came=f"{tuple(rgb.shape)} and {tuple(truth.shape)}")  # fmt: skip
    if min(rgb.shape[:2]) < SSIM_WINDOW_PX:
        raise InputError("SSIM", wanted=f"pictures of at least {SSIM_WINDOW_PX} pixels along each side",
                         came=f"{rgb.shape[1]} x {rgb.shape[0]}")  # fmt: skip


# ---- native ---------------------------------------------------------------------------------------------------------

_kernels = threading.local()


def _library_for(rgb: Tensor, truth: Tensor) -> Library | None:
    native = all(t.dtype == torch.float32 and t.device.type == "cpu" and t.shape[2] == CHANNELS for t in (rgb, truth))
    return load() if native else None


def _kernel(library: Library) -> NativeSsim:
    """The kernel's memory, one for each Python thread; no more threads than torch may use."""
    threads = min(thread_count(0), torch.get_num_threads())
    key = (library.path, threads)
    if getattr(_kernels, "key", None) != key:
        _kernels.key, _kernels.kernel = key, NativeSsim(library, threads)
    return _kernels.kernel


class _NativeMeanSsim(torch.autograd.Function):
    """As `_MeanSsim`: the gradient comes with the value."""

    @staticmethod
    def forward(ctx: Any, rgb: Tensor, truth: Tensor, library: Library) -> Tensor:
        pictures = [tensor.detach().contiguous().numpy() for tensor in (rgb, truth)]
        if not ctx.needs_input_grad[0]:
            return torch.tensor(_kernel(library).mean(*pictures))
        value, gradient = _kernel(library).mean_and_gradient(*pictures)
        ctx.save_for_backward(torch.from_numpy(gradient))
        return torch.tensor(value)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, None, None]:
        return (upstream * ctx.saved_tensors[0] if ctx.needs_input_grad[0] else None), None, None


# ---- torch ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Moments:
    """Blurred maps (C, H - 10, W - 10): means of x and y, and the factors of the formula."""

    mx: Tensor
    my: Tensor
    A1: Tensor
    A2: Tensor
    B1: Tensor
    B2: Tensor

    @staticmethod
    def of(x: Tensor, y: Tensor) -> _Moments:
        """x, y: (C, H, W)."""
        maps = x.new_empty(5, *x.shape)
        maps[0], maps[1] = x, y
        x, y = maps[0], maps[1]
        torch.mul(x, x, out=maps[2])
        torch.mul(y, y, out=maps[3])
        torch.mul(x, y, out=maps[4])
        mx, my, exx, eyy, exy = _blur(maps.flatten(0, 1), inside=True).unflatten(0, (5, -1))
        mean_product, mean_squares = mx * my, mx * mx + my * my
        return _Moments(
            mx=mx,
            my=my,
            A1=2 * mean_product + C1,
            A2=2 * (exy - mean_product) + C2,
            B1=mean_squares + C1,
            B2=exx + eyy - mean_squares + C2,
        )


class _MeanSsim(torch.autograd.Function):
    """The gradient is found in the forward pass: it shares nearly everything with it, and no map has to be kept."""

    @staticmethod
    def forward(ctx: Any, rgb: Tensor, truth: Tensor) -> Tensor:
        x, y = rgb.permute(2, 0, 1), truth.permute(2, 0, 1)
        m = _Moments.of(x, y)
        inverse = 1 / (m.B1 * m.B2)
        value = m.A1 * m.A2 * inverse
        if ctx.needs_input_grad[0]:
            ctx.save_for_backward(_gradient(m, value, inverse, x, y))
        return value.mean()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, None]:
        return (upstream * ctx.saved_tensors[0] if ctx.needs_input_grad[0] else None), None


def _gradient(m: _Moments, value: Tensor, inverse: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """d mean SSIM / d x as (H, W, C). The maps are those of d/d mx, d/d E[xx] and d/d E[xy], spread back through the
    window, which is symmetric: d/dx = G*dm + 2 x G*dxx + y G*dxy."""
    maps = value.new_empty(3, *value.shape)
    torch.mul(m.A1, inverse, out=maps[2]).mul_(2)
    torch.div(value, m.B2, out=maps[1]).neg_()
    torch.mul(m.my, (m.A2 - m.A1) * inverse, out=maps[0])
    maps[0].sub_(m.mx * (value / m.B1 + maps[1])).mul_(2)
    by_mean, by_xx, by_xy = _blur(maps.flatten(0, 1), inside=False).unflatten(0, (3, -1))
    spread = by_mean.addcmul_(x, by_xx, value=2).addcmul_(y, by_xy)
    return spread.div_(value.numel()).permute(1, 2, 0)


@lru_cache(maxsize=8)
def _weights(dtype: torch.dtype, device: torch.device) -> Tensor:
    return torch.from_numpy(window()).to(device, dtype)


def _blur(maps: Tensor, *, inside: bool) -> Tensor:
    """(C, H, W) -> the window's mean over every place: wholly inside the picture (smaller by 10), or with zeros
    around it (larger by 10: the transpose of the former)."""
    size = SSIM_WINDOW_PX
    weights, channels = _weights(maps.dtype, maps.device), maps.shape[0]
    pad = 0 if inside else size - 1
    # channels last: only so are convolutions of single channels vectorized on CPUs (some 50 times as fast)
    image = maps.unsqueeze(0).contiguous(memory_format=torch.channels_last)
    down = weights.reshape(1, 1, size, 1).expand(channels, 1, size, 1)
    across = weights.reshape(1, 1, 1, size).expand(channels, 1, 1, size)
    image = functional.conv2d(image, down, padding=(pad, 0), groups=channels)
    return functional.conv2d(image, across, padding=(0, pad), groups=channels).squeeze(0).contiguous()
