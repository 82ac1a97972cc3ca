"""Which graphics card draws, and opening it: Vulkan, Metal or Direct3D 12 through the package wgpu.

Software adapters (llvmpipe, WARP) are slower than the native kernel, so they are taken only when asked for.
"""

from __future__ import annotations

import importlib.util
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from jghand_engine.errors import InputError, JGHandError, RetryError, install_extra

# names a part of an adapter's summary, or any adapter, software too
ADAPTER_VARIABLE, ANY = "JGHAND_GPU", "any"
# OpenGL is left out: it lists the same cards once more
_INTERFACES = ("Vulkan", "Metal", "D3D12")
# best first
_KINDS = ("DiscreteGPU", "IntegratedGPU", "VirtualGPU", "Unknown", "CPU")
_SOFTWARE = "CPU"
# a folder for the sockets of window systems, which nothing here needs
_WINDOWS = "XDG_RUNTIME_DIR"
# how large arrays may be is all that is asked for beyond what every WebGPU device has
_SIZE_LIMITS = ("max-buffer-size", "max-storage-buffer-binding-size")
# sizes of arrays are multiples of it, bytes: a vec4f of the shader
_BLOCK = 16


@dataclass(frozen=True, eq=False)
class Device:
    """An open device of this process.

    name:    of its adapter, as the driver tells it, with kind and interface
    largest: array that it holds, bytes
    turn:    held by who draws, for a device belongs to one thread at a time
    process: that opened it; a child made by fork cannot use it
    """

    handle: Any
    name: str
    largest: int
    turn: threading.Lock = field(default_factory=threading.Lock)
    process: int = field(default_factory=os.getpid)


_open: dict[str, Device] = {}
_opening = threading.Lock()
# where wgpu was loaded first: what a child made by fork has of it hangs
_home: list[int] = []


def is_installed() -> bool:
    """Whether the extra is there; nothing of it is loaded."""
    return importlib.util.find_spec("wgpu") is not None


def open_device(named: str = "") -> Device:
    """The device to draw on, opened once; only the one of that name, if given. InputError where there is none, with
    what was seen; RetryError where it cannot be opened, or this process was forked from one that looked for devices."""
    if _home and _home[0] != os.getpid():  # before the lock, which somebody may have held
        raise RetryError("backend gpu", wanted="the process that looked for graphics cards first", came="a fork of it")
    wanted = os.environ.get(ADAPTER_VARIABLE, "").strip().lower()
    with _opening:
        if wanted not in _open:
            try:
                _open[wanted] = _opened(_choose(wanted), named)
            except JGHandError:
                raise
            except Exception as error:  # whatever loading wgpu, its drivers and its answers raise
                raise RetryError("backend gpu", wanted="a device that opens", came=str(error) or repr(error)) from error
        elif named:
            _check_name(_open[wanted].name, named)
        return _open[wanted]


def forget(device: Device) -> None:
    """After an error: who asks next gets a device that was opened anew."""
    with _opening:
        for wanted in [key for key, value in _open.items() if value is device]:
            del _open[wanted]


def _choose(wanted: str) -> Any:
    try:
        import wgpu

        _home[:] = [os.getpid()]
    except ImportError as error:
        raise InputError("backend gpu: the package wgpu is missing", remedy=install_extra("gpu")) from error
    adapters = [one for one in _quietly(wgpu.gpu.enumerate_adapters_sync) if one.info["backend_type"] in _INTERFACES]
    adapters.sort(key=lambda one: _KINDS.index(one.info["adapter_type"]))
    if wanted == ANY:
        usable = adapters
    elif wanted:
        usable = [one for one in adapters if wanted in one.summary.lower()]
    else:
        usable = [one for one in adapters if one.info["adapter_type"] != _SOFTWARE]
    if usable:
        return usable[0]
    raise InputError(
        "backend gpu",
        wanted=f"a graphics card with {wanted!r} in its name" if wanted else "a graphics card",
        came=", ".join(one.summary for one in adapters) or "none that Vulkan, Metal or Direct3D 12 knows",
        remedy=f"Install the card's driver, or leave out --backend; {ADAPTER_VARIABLE} chooses among several.",
    )


def _quietly(look: Callable[[], list[Any]]) -> list[Any]:
    """Without what Mesa's drivers print where no window system can be."""
    if os.environ.get(_WINDOWS):
        return look()
    os.environ[_WINDOWS] = os.devnull
    try:
        return look()
    finally:
        del os.environ[_WINDOWS]


def _opened(adapter: Any, named: str = "") -> Device:
    if named:
        _check_name(adapter.summary, named)
    limits = {name: adapter.limits[name] for name in _SIZE_LIMITS}
    largest = min(limits.values()) // _BLOCK * _BLOCK
    return Device(adapter.request_device_sync(required_limits=limits), adapter.summary, largest)


def _check_name(name: str, named: str) -> None:
    if name != named:
        raise InputError("graphics card", wanted=f"{named}, which jghand bench measured", came=name)
