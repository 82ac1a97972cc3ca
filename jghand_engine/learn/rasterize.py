"""Gaussians to a picture: the kernel under torch's autograd, else the reference.

    picture = rasterize(gaussians, camera, settings)

Gradients go to position, sigma or covariance, opacity and color. float32 tensors on the CPU are drawn by the kernel;
all others, such as float64 ones, which ask for the exact picture, by the reference. A graphics card draws only where
its backend is named, and has no gradients.
"""

from __future__ import annotations

import threading
import weakref
from typing import Any

import numpy as np
import torch

from jghand_engine.gpu.choice import new_rasterizer, working_device
from jghand_engine.gpu.device import Device
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.reference import Picture, check_gaussians, rasterize_reference
from jghand_engine.native.binding import Library
from jghand_engine.native.library import GPU, load
from jghand_engine.native.rasterizer import PLANES, GaussianArrays, NativeRasterizer
from jghand_engine.native.threads import thread_count
from jghand_engine.render.backend import view_of
from jghand_engine.render.camera import Camera
from jghand_engine.render.settings import RenderSettings


def rasterize(gaussians: Gaussians, camera: Camera, settings: RenderSettings | None = None) -> Picture:
    """Draws all `gaussians` (world frame) as `camera` sees them, on nothing: premultiplied color, alpha and depth.

    settings: alpha_min, t_stop, threads and backend are used here (`settings.gaussians` is for whoever poses them).
    InputError names a tensor of a wrong shape or dtype. Values that cannot be drawn are left out and counted in the
    picture; their gradient is zero.
    """
    settings = settings or RenderSettings()
    check_gaussians(gaussians)
    position = gaussians.position_m
    if position.dtype != torch.float32 or position.device.type != "cpu":
        return rasterize_reference(gaussians, camera, alpha_min=settings.alpha_min)
    library = load(settings.backend)
    device = working_device(library) if settings.backend == GPU else None
    lease = _Lease(library, thread_count(settings.threads), device)
    tensors = (getattr(gaussians, name) for name in _NAMES)
    planes = _NativeRaster.apply(*tensors, gaussians.pixel_m, lease, camera, settings)
    visible, invalid = lease.rasterizer.visible, lease.rasterizer.invalid
    return Picture.from_planes(planes, visible_gaussians=visible, invalid_gaussians=invalid)  # type: ignore[arg-type]


# ---- memory of the kernel -------------------------------------------------------------------------------------------

_idle: dict[tuple[str, int, Device | None], list[NativeRasterizer]] = {}
_idle_lock = threading.Lock()


class _Lease:
    """A NativeRasterizer on loan. It goes back when the last holder lets go: the call that draws, or, when gradients
    are wanted, the node of the graph, whose backward pass needs what the forward pass left in it."""

    def __init__(self, library: Library, threads: int, device: Device | None) -> None:
        key = (str(library.path), threads, device)
        with _idle_lock:
            idle = _idle.setdefault(key, [])
            rasterizer = idle.pop() if idle else None
        self.rasterizer = rasterizer or new_rasterizer(library, threads, device)
        weakref.finalize(self, idle.append, self.rasterizer).atexit = False


# the tensors of Gaussians, as GaussianArrays and Gradients call them too
_NAMES = ("position_m", "sigma_m", "opacity", "rgb", "covariance_m2")


class _NativeRaster(torch.autograd.Function):
    """Planes (5, H, W) from the tensors of Gaussians, in the order of _NAMES."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any):
        tensors, (pixel_m, lease, camera, settings) = inputs[: len(_NAMES)], inputs[len(_NAMES) :]
        arrays: list[Any] = [None if tensor is None else tensor.detach().contiguous().numpy() for tensor in tensors]
        planes = torch.empty(PLANES, camera.height, camera.width)
        lease.rasterizer.forward(
            GaussianArrays(**dict(zip(_NAMES, arrays, strict=True)), pixel_m=pixel_m),
            view_of(camera),
            alpha_min=settings.alpha_min,
            t_stop=settings.t_stop,
            planes=planes.numpy(),
        )
        if any(ctx.needs_input_grad):
            ctx.lease = lease
            # saved, so that torch notices when someone overwrites them before the backward pass
            ctx.save_for_backward(*tensors, planes)
        return planes

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, plane_gradients: torch.Tensor):
        _ = ctx.saved_tensors  # raises when an input was modified in place
        incoming = np.ascontiguousarray(plane_gradients.detach().to(torch.float32).numpy())
        gradients = ctx.lease.rasterizer.backward(incoming)
        wanted = zip(_NAMES, ctx.needs_input_grad[: len(_NAMES)], strict=True)
        tensors = [_tensor(getattr(gradients, name)) if want else None for name, want in wanted]
        return (*tensors, None, None, None, None)


def _tensor(array: np.ndarray | None) -> torch.Tensor | None:
    return None if array is None else torch.from_numpy(array)
