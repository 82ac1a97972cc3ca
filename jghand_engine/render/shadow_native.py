"""The compiled self-shadow (native/shadow*.cpp): buffers for one picture size, and the differentiable form.

`splat/shadow.py` is the specification; the two differ by 5e-5 of visibility, except where the rounding of a sample
position or the choice between two depth differences falls the other way.
"""

from __future__ import annotations

import ctypes
import math

import numpy as np
import torch

from jghand_engine import limits
from jghand_engine.errors import RetryError
from jghand_engine.native.binding import Library, address, aligned_zeros, new_team
from jghand_engine.native.tasks import (
    LANES,
    PAD_COLUMNS,
    PAD_ROWS,
    ShadeGradient,
    ShadeTask,
    new_shade_task,
    padded_depth,
)
from jghand_engine.native.threads import shared_pool
from jghand_engine.render.camera import Camera
from jghand_engine.render.shadow import ShadowStyle, shade, vogel_disc


class NativeShade:
    """The shadow pass for pictures of one size. Buffers are allocated once; one picture at a time."""

    def __init__(self, library: Library, width: int, height: int) -> None:
        call = library.call
        for size, mirror in ((call.jg_shade_task_bytes(), ShadeTask), (call.jg_shade_gradient_bytes(), ShadeGradient)):
            if size != ctypes.sizeof(mirror):
                raise RetryError(
                    f"native library {library.path.name}", wanted=f"{mirror.__name__} as here", came="other"
                )
        self._call = call
        self.task = new_shade_task(width, height)
        self._depth = padded_depth(self.task)
        self._row_valid = aligned_zeros((height,), np.int32)
        self._stripes: np.ndarray | None = None
        self._keep: tuple[np.ndarray, ...] = ()
        self._disc_samples, self._disc = 0, aligned_zeros((2, LANES))
        self.team = new_team()
        self.task.row_valid = self._row_valid.ctypes.data

    def prepare(
        self,
        planes: np.ndarray,
        camera: Camera,
        style: ShadowStyle | None,
        *,
        near_m: float,
        visibility: np.ndarray | None = None,
        rgba: np.ndarray | None = None,
        depth_m: np.ndarray | None = None,
    ) -> None:
        """Sets the next picture: its planes (5, H, W), the shadow (None: none) and where results go (None: nowhere).

        near_m: some depth of the hand, meters; depths are kept relative to it, so that float32 does not tilt normals
        visibility: (H, W) · rgba: (H, W, 4) premultiplied · depth_m: (H, W), 0 where there is none; all float32.
        """
        task, size = self.task, (self.task.height, self.task.width)
        task.picture = address(planes, np.float32, "planes", (5, *size))
        task.visibility = _output(visibility, "visibility", size)
        task.rgba = _output(rgba, "rgba", (*size, 4))
        task.depth_out = _output(depth_m, "depth_m", size)
        self._keep = tuple(array for array in (planes, visibility, rgba, depth_m) if array is not None)
        task.origin = near_m
        task.fx, task.fy, task.cx, task.cy = camera.fx, camera.fy, camera.cx, camera.cy
        task.orthographic = camera.orthographic
        self._set_style(style)
        self.team.fill(0)

    def _set_style(self, style: ShadowStyle | None) -> None:
        task = self.task
        task.samples = 0 if style is None else style.samples
        if style is None:
            task.darkness = (0.0, 0.0, 0.0)
            return
        task.darkness = tuple(style.strength * k for k in style.tint)
        task.radius, task.bias, task.softness, task.gain = style.radius_m, style.bias, style.softness, style.gain
        padded = -(-style.samples // LANES) * LANES
        if style.samples != self._disc_samples:
            self._disc_samples, self._disc = style.samples, aligned_zeros((2, padded))
            self._disc[:, : style.samples] = vogel_disc(style.samples).numpy().T
            task.disc_x, task.disc_y = self._disc[0].ctypes.data, self._disc[1].ctypes.data

    def run(self, _thread: int = 0) -> None:
        """The forward pass of the prepared picture; every thread of a team calls it."""
        self._call.jg_shade(self.team.ctypes.data, ctypes.addressof(self.task))

    def prepare_backward(self, visibility: np.ndarray, darkened: np.ndarray, out: np.ndarray) -> ShadeGradient:
        """visibility (H, W) of the forward pass, gradient of the darkened color (3, H, W) -> `out` (5, H, W)."""
        size = (self.task.height, self.task.width)
        if self._stripes is None:
            self._stripes = aligned_zeros((size[0] + 2 * limits.SHADOW_STRIPES * PAD_ROWS, self.task.stride))
        self._keep += (visibility, darkened, out)
        self.team.fill(0)
        return ShadeGradient(
            visibility=address(visibility, np.float32, "visibility", size),
            darkened=address(darkened, np.float32, "gradient of the darkened color", (3, *size)),
            stripes=self._stripes.ctypes.data,
            out=address(out, np.float32, "gradient", (5, *size), writable=True),
            pad_columns=PAD_COLUMNS,
        )

    def run_backward(self, gradient: ShadeGradient) -> None:
        """The backward pass; every thread of a team calls it with the same prepared gradient."""
        self._call.jg_shade_backward(self.team.ctypes.data, ctypes.addressof(self.task), ctypes.addressof(gradient))


def _output(array: np.ndarray | None, name: str, shape: tuple[int, ...]) -> int | None:
    """Where a result goes; None: nowhere."""
    return None if array is None else address(array, np.float32, name, shape, writable=True)


def mean_depth_m(planes: torch.Tensor) -> float:
    """The mean depth of planes (5, H, W), meters; 0 for an empty picture."""
    alpha, depth_sum = (float(plane.sum(dtype=torch.float64)) for plane in planes[3:])
    mean = depth_sum / alpha if alpha > 0 else 0.0
    return mean if math.isfinite(mean) else 0.0


class _NativeShading(torch.autograd.Function):
    """Planes (5, H, W) float32 -> darkened color (3, H, W)."""

    @staticmethod
    def forward(ctx, planes, library, camera, style, threads):
        height, width = planes.shape[1:]
        native = NativeShade(library, width, height)
        visibility = np.empty((height, width), np.float32)
        native.prepare(planes.numpy(), camera, style, near_m=mean_depth_m(planes), visibility=visibility)
        shared_pool(threads).run(native.run)
        ctx.native, ctx.visibility, ctx.threads = native, visibility, threads
        ctx.save_for_backward(planes)
        darkness = torch.tensor([style.strength * k for k in style.tint], dtype=torch.float32)
        return planes[:3] * (1 - darkness[:, None, None] * (1 - torch.from_numpy(visibility)))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient):
        (planes,) = ctx.saved_tensors  # the kernel reads them again: torch checks that nobody changed them
        out = torch.empty_like(planes)
        task = ctx.native.prepare_backward(ctx.visibility, gradient.contiguous().numpy(), out.numpy())
        shared_pool(ctx.threads).run(lambda _thread: ctx.native.run_backward(task))
        return out, None, None, None, None


def darken(
    planes: torch.Tensor, camera: Camera, style: ShadowStyle, *, library: Library | None = None, threads: int = 0
) -> torch.Tensor:
    """The darkened premultiplied color (3, H, W) of planes (5, H, W): R G B, alpha, sum of weight * z. Differentiable.

    With a `library` and float32 planes by the compiled kernel, else by torch; so are gradients of parallel rays.
    """
    if library is None or planes.dtype != torch.float32 or camera.orthographic:
        return shade(planes[:3].permute(1, 2, 0), planes[3], planes[4], camera, style).permute(2, 0, 1)
    return _NativeShading.apply(planes.contiguous(), library, camera, style, threads)
