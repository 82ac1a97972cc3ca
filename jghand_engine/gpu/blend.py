"""The last step of a picture on a device: records and lists of the tiles to planes, by blend.wgsl."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import MemoryLimitError, RetryError
from jghand_engine.gpu.device import Device, forget
from jghand_engine.native import contract

_SHADER = Path(__file__).with_name("blend.wgsl")
_MIB = 2**20


class GpuBlend:
    """Memory on a device for one picture at a time, kept from picture to picture."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._buffers: dict[str, Any] = {}
        self._pipeline: Any = None

    def draw(
        self, inputs: dict[str, np.ndarray], planes: np.ndarray, cuts: tuple[float, float], *, fills: bool
    ) -> None:
        """Draws into planes (5, H, W) float32. inputs: records (Gaussians, 16) float32, tile_start (tiles + 1,) and
        tile_list (pairs,) int32 as native/raster.h has them, in this order; cuts: its log2_alpha_min and t_stop; fills:
        whether it has `front`.

        MemoryLimitError for arrays that the device does not hold, RetryError when it fails or was lost.
        """
        import wgpu

        device = self.device
        if device.process != os.getpid():
            raise RetryError(f"{device.name} belongs to another process")
        try:
            with device.turn:
                self._draw(inputs, planes, cuts, fills)
        except wgpu.GPUOutOfMemoryError as error:  # the next picture may be smaller
            self._buffers.clear()
            raise MemoryLimitError(f"picture on {device.name}: {_last_line(error)}") from error
        except (wgpu.GPUError, wgpu.GPUPipelineError, RuntimeError) as error:  # the last for maps that fail
            self._buffers.clear()
            forget(device)
            raise RetryError(f"{device.name} stopped drawing: {_last_line(error)}") from error

    def _draw(self, inputs: dict[str, np.ndarray], planes: np.ndarray, cuts: tuple[float, float], fills: bool) -> None:
        from wgpu import BufferUsage, MapMode

        handle, (height, width) = self.device.handle, planes.shape[1:]
        tiles_x, tiles_y = -(-width // contract.TILE_PX), -(-height // contract.TILE_PX)
        stored = BufferUsage.STORAGE | BufferUsage.COPY_DST
        picture = self._buffer("picture", 32, BufferUsage.UNIFORM | BufferUsage.COPY_DST)
        given = [self._buffer(name, array.nbytes, stored) for name, array in inputs.items()]
        drawn = self._buffer("planes", planes.nbytes, BufferUsage.STORAGE | BufferUsage.COPY_SRC)
        read = self._buffer("read", planes.nbytes, BufferUsage.MAP_READ | BufferUsage.COPY_DST)
        numbers = struct.pack("4I4f", width, height, tiles_x, fills, cuts[0], contract.ALPHA_MAX, cuts[1], 0)
        handle.queue.write_buffer(picture, 0, numbers)
        for buffer, array in zip(given, inputs.values(), strict=True):
            if array.size:
                handle.queue.write_buffer(buffer, 0, array)
        pipeline = self._pipeline = self._pipeline or _compiled(handle)
        bound = [{"binding": place, "resource": {"buffer": one}} for place, one in enumerate((picture, *given, drawn))]
        encoder = handle.create_command_encoder()
        step = encoder.begin_compute_pass()
        step.set_pipeline(pipeline)
        step.set_bind_group(0, handle.create_bind_group(layout=pipeline.get_bind_group_layout(0), entries=bound))
        step.dispatch_workgroups(tiles_x, tiles_y)
        step.end()
        encoder.copy_buffer_to_buffer(drawn, 0, read, 0, planes.nbytes)
        handle.queue.submit([encoder.finish()])
        read.map_sync(MapMode.READ, 0, planes.nbytes)
        try:
            # in one expression: nothing may hold that memory when it goes
            np.copyto(
                planes,
                np.frombuffer(read.read_mapped(0, planes.nbytes, copy=False), np.float32).reshape(planes.shape),
            )
        finally:
            read.unmap()

    def _buffer(self, name: str, size: int, usage: int) -> Any:
        """Memory of that name for `size` bytes; made anew where it is too small, with a quarter more for what grows."""
        buffer = self._buffers.get(name)
        if buffer is None or buffer.size < size:
            if size > self.device.largest:
                raise MemoryLimitError(
                    f"{name} of the picture on {self.device.name}",
                    wanted=f"at most {self.device.largest / _MIB:.0f} MiB",
                    came=f"{size / _MIB:.0f} MiB",
                )
            self._buffers.pop(name, None)  # the old one first: both together may not fit
            room = min(-(-max(size + size // 4, 16) // 16) * 16, self.device.largest)
            buffer = self._buffers[name] = self.device.handle.create_buffer(label=name, size=room, usage=usage)
        return buffer


def _compiled(handle: Any) -> Any:
    module = handle.create_shader_module(label=_SHADER.name, code=_SHADER.read_text(encoding="utf-8"))
    return handle.create_compute_pipeline(layout="auto", compute={"module": module, "entry_point": "main"})


def _last_line(error: Exception) -> str:
    return str(error).strip().splitlines()[-1].strip() if str(error).strip() else type(error).__name__
