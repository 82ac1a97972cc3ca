"""The native rasterizer with its last step, the blend of the tiles, on a graphics card.

Projection, order and lists of the tiles stay with the kernel, in float64 where the contract wants it, so that a picture
differs in rounding alone. They are a small part of the work: see docs/GPU.md.
"""

from __future__ import annotations

import ctypes

import numpy as np

from jghand_engine.errors import InputError, MemoryLimitError, RetryError
from jghand_engine.gpu.blend import GpuBlend
from jghand_engine.gpu.device import Device
from jghand_engine.native.binding import Library
from jghand_engine.native.rasterizer import DRAWN_HERE, Gradients, NativeRasterizer
from jghand_engine.native.threads import shared_pool


class GpuRasterizer(NativeRasterizer):
    """As NativeRasterizer, without a backward pass. A picture that the device cannot hold is drawn by the kernel, and
    so is every picture after the device failed; `fell_back` says why."""

    finishes_elsewhere = True

    def __init__(self, library: Library, threads: int, device: Device) -> None:
        super().__init__(library, threads)
        self._blend: GpuBlend | None = GpuBlend(device)

    def run(self, _thread: int = 0) -> None:
        """Lists of what was prepared, together with the other threads of a pool; the picture, too, without a device."""
        if self._blend is None:
            super().run(_thread)
            return
        self.library.call.jg_raster_lists(ctypes.addressof(self._job))

    def finished(self) -> bool:
        """As NativeRasterizer's; draws, too."""
        if not super().finished():
            return False
        assert self._planes is not None
        self.fell_back = ""
        if self._blend is None:
            self.fell_back = f"{DRAWN_HERE}: the graphics card failed before"
            return True
        job, arrays = self._job, self._arrays
        try:
            inputs = {name: arrays[name] for name in ("records", "tile_start")}
            inputs["tile_list"] = arrays["tile_list"][: job.pairs]
            cuts = job.log2_alpha_min, job.t_stop
            self._blend.draw(inputs, self._planes, cuts, fills=bool(job.front))
        except MemoryLimitError as error:
            self._draw_here(str(error))
        except RetryError as error:
            self._blend = None
            self._draw_here(str(error))
        return True

    def backward(self, plane_gradients: np.ndarray) -> Gradients:
        """InputError: a graphics card only draws."""
        raise InputError("backward pass", wanted="a backend of the processor", came="gpu")

    def _draw_here(self, why: str) -> None:
        self.fell_back = f"{DRAWN_HERE}: {why}"
        self._job.keeps_empty = 0  # the device did not write down which tiles it left empty
        shared_pool(self.threads).run(super().run)
        self._team.fill(0)
