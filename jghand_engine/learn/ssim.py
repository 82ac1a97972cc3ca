"""Structural similarity of two pictures.

    SSIM = (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sxx + syy + C2))

per channel, with means and (co)variances under an 11 x 11 Gaussian window of sigma 1.5 (Wang et al. 2004; METHOD 4.3).
Only windows that lie wholly inside the picture count. It is a loss of every training step, so float32 RGB
pictures on the CPU go through one call of the native kernel, everything else through torch. The two agree to rounding.
"""

from __future__ import annotations

import threading
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
    truth = truth.detach()
    _check_pictures(rgb, truth)
    if all(t.dtype == torch.float32 and t.device.type == "cpu" and t.shape[2] == CHANNELS for t in (rgb, truth)):
        return _NativeMeanSsim.apply(rgb, truth, load())  # type: ignore[no-any-return]
    return ssim_parts(rgb, truth)[0].mean()


def ssim_parts(rgb: Tensor, truth: Tensor) -> tuple[Tensor, Tensor]:
    """By torch: SSIM of every window, and its contrast-structure factor alone, both (C, H - 10, W - 10); InputError as
    `ssim`."""
    _check_pictures(rgb, truth)
    x, y = rgb.permute(2, 0, 1), truth.permute(2, 0, 1)
    mx, my, exx, eyy, exy = _blurred(torch.cat([x, y, x * x, y * y, x * y])).unflatten(0, (5, -1))
    contrast = (2 * (exy - mx * my) + C2) / (exx + eyy - mx * mx - my * my + C2)
    return contrast * (2 * mx * my + C1) / (mx * mx + my * my + C1), contrast


def _blurred(maps: Tensor) -> Tensor:
    """(C, H, W) -> (C, H - 10, W - 10): the window's mean over every place that lies wholly inside."""
    weights, channels = _weights(maps.dtype, maps.device), maps.shape[0]
    # channels last: only so are convolutions of single channels vectorized on CPUs (some 50 times as fast)
    image = maps.unsqueeze(0).contiguous(memory_format=torch.channels_last)
    down = weights.reshape(1, 1, -1, 1).expand(channels, 1, -1, 1)
    across = weights.reshape(1, 1, 1, -1).expand(channels, 1, 1, -1)
    image = functional.conv2d(image, down, groups=channels)
    return functional.conv2d(image, across, groups=channels).squeeze(0).contiguous()


@lru_cache(maxsize=8)
def _weights(dtype: torch.dtype, device: torch.device) -> Tensor:
    return torch.from_numpy(window()).to(device, dtype)


def _check_pictures(rgb: Tensor, truth: Tensor) -> None:
    """InputError unless both are (H, W, C) of the same shape and not smaller than the window."""
    if rgb.dim() != 3 or rgb.shape != truth.shape:
        raise InputError("pictures to compare", wanted="two of one shape (height, width, channels)",
                         came=f"{tuple(rgb.shape)} and {tuple(truth.shape)}")  # fmt: skip
    if min(rgb.shape[:2]) < SSIM_WINDOW_PX:
        raise InputError("SSIM", wanted=f"pictures of at least {SSIM_WINDOW_PX} pixels along each side",
                         came=f"{rgb.shape[1]} x {rgb.shape[0]}")  # fmt: skip


# ---- native ---------------------------------------------------------------------------------------------------------

_kernels = threading.local()


def _kernel(library: Library) -> NativeSsim:
    """The kernel's memory, one for each Python thread; no more threads than torch may use."""
    threads = min(thread_count(0), torch.get_num_threads())
    key = (library.path, threads)
    if getattr(_kernels, "key", None) != key:
        _kernels.key, _kernels.kernel = key, NativeSsim(library, threads)
    return _kernels.kernel


class _NativeMeanSsim(torch.autograd.Function):
    """The gradient comes with the value."""

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
