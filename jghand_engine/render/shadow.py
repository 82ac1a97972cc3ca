"""The self-shadow of hands from their own depth, by the compiled kernel (native/shadow*.cpp): its look, and the buffers
for images of one size. METHOD 5.2; `learn/shadow.py` is the specification, in torch.

For every pixel with a depth, N samples on a disc of world radius R are compared with the tangent plane; what stands out
of the plane within R occludes. Only the premultiplied color is darkened, alpha stays.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass

import numpy as np

from jghand_engine.errors import InputError, RetryError
from jghand_engine.native import contract
from jghand_engine.native.binding import Library, address, aligned_zeros, new_team
from jghand_engine.native.rasterizer import SeenSurface
from jghand_engine.native.tasks import (
    LANES,
    PAD_COLUMNS,
    PAD_ROWS,
    ShadeGradient,
    ShadeTask,
    new_shade_task,
    padded_depth,
)
from jghand_engine.render.camera import Camera


@dataclass(frozen=True)
class ShadowStyle:
    """How the shadow looks.

    samples:        taps per pixel
    strength:       0..1 on top of everything: the gate's fade
    radius_m:       reach R, meters
    bias, softness: beta and tau of the occlusion curve
    gain:           darkness g
    tint:           strength k per color channel, 0..1
    """

    samples: int = 16
    strength: float = 1.0
    radius_m: float = contract.SHADOW_RADIUS_M
    bias: float = contract.SHADOW_BIAS
    softness: float = contract.SHADOW_SOFTNESS
    gain: float = contract.SHADOW_GAIN
    tint: tuple[float, float, float] = contract.SHADOW_TINT

    def __post_init__(self) -> None:
        checks = (
            ("samples", 1 <= self.samples <= contract.SHADOW_SAMPLES_MAX, f"1 to {contract.SHADOW_SAMPLES_MAX}"),
            ("strength", 0 <= self.strength <= 1, "0 to 1"),
            ("radius_m", math.isfinite(self.radius_m) and self.radius_m > 0, "a positive length in meters"),
            ("bias", math.isfinite(self.bias), "a finite number"),
            ("softness", math.isfinite(self.softness) and self.softness > 0, "a positive number"),
            ("gain", math.isfinite(self.gain) and self.gain >= 0, "0 or more"),
            ("tint", len(self.tint) == 3 and all(0 <= k <= 1 for k in self.tint), "three values from 0 to 1"),
        )
        for name, good, wanted in checks:
            if not good:
                raise InputError(f"shadow {name}", wanted=wanted, came=str(getattr(self, name)))
        if (1 + abs(self.bias)) / self.softness > contract.SHADOW_STEEPNESS_MAX:
            wanted = f"(1 + |bias|) / softness up to {contract.SHADOW_STEEPNESS_MAX:g}"
            raise InputError("shadow softness", wanted=wanted, came=f"{self.softness} with bias {self.bias}")


def vogel_disc(count: int) -> np.ndarray:
    """`count` points of the unit disc at equal area, (count, 2) float64: a sunflower, the same for every pixel."""
    index = np.arange(count) + 0.5
    radius, angle = np.sqrt(index / count), index * contract.GOLDEN_ANGLE_RAD
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)


class NativeShade:
    """The shadow pass for images of one size. Buffers are allocated once; one image at a time."""

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
        """Sets the next image: its planes (5, H, W), the shadow (None: none) and where results go (None: nowhere).

        near_m: some depth of the hand, meters; depths are kept relative to it, so that float32 does not tilt normals
        visibility: (H, W) · rgba: (H, W, 4) premultiplied · depth_m: (H, W), 0 where there is none; all float32.
        """
        task, size = self.task, (self.task.height, self.task.width)
        task.picture = address(planes, np.float32, "planes", (5, *size))
        task.visibility = _output(visibility, "visibility", size)
        task.rgba = _output(rgba, "rgba", (*size, 4))
        task.depth_out = _output(depth_m, "depth_m", size)
        # results are their owner's
        self._keep, task.surface = (planes,), None
        task.origin = near_m
        task.fx, task.fy, task.cx, task.cy = camera.fx, camera.fy, camera.cx, camera.cy
        task.orthographic = camera.orthographic
        self._set_style(style)
        self.team.fill(0)

    def set_surface(self, surface: SeenSurface) -> None:
        """Of the image that was prepared: edges of its skin before other skin are smoothed."""
        task = self.task
        self._keep = (*self._keep, surface.near)
        task.surface, task.surface_stride = surface.first_pixel(task.width, task.height)
        task.edge_step, task.edge_steepness = surface.scale * contract.EDGE_STEP_M, contract.EDGE_STEEPNESS
        task.edge_part = surface.part

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
            # around the disc: samples that go beside the hand lie next to each other, and are left out together
            disc = sorted(vogel_disc(style.samples), key=lambda place: math.atan2(place[1], place[0]))
            self._disc[:, : style.samples] = np.transpose(disc)
            task.disc_x, task.disc_y = self._disc[0].ctypes.data, self._disc[1].ctypes.data

    def run(self, _thread: int = 0) -> None:
        """The forward pass of the prepared image; every thread of a team calls it."""
        self._call.jg_shade(self.team.ctypes.data, ctypes.addressof(self.task))

    def prepare_backward(self, visibility: np.ndarray, darkened: np.ndarray, out: np.ndarray) -> ShadeGradient:
        """visibility (H, W) of the forward pass, gradient of the darkened color (3, H, W) -> `out` (5, H, W)."""
        size = (self.task.height, self.task.width)
        if self._stripes is None:
            self._stripes = aligned_zeros((size[0] + 2 * contract.SHADOW_STRIPES * PAD_ROWS, self.task.stride))
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
