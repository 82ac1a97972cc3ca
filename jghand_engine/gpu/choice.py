"""Whether pictures are drawn on a graphics card: where it is named, or where `jghand bench` found it the faster one."""

from __future__ import annotations

import functools
import json
import os
import sys
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np

from jghand_engine.errors import JGHandError, RetryError
from jghand_engine.files import cache_folder, writing
from jghand_engine.gpu.device import Device, open_device
from jghand_engine.gpu.rasterizer import GpuRasterizer
from jghand_engine.native import selftest
from jghand_engine.native.binding import Library
from jghand_engine.native.library import GPU
from jghand_engine.native.machine import processor
from jghand_engine.native.rasterizer import NativeRasterizer

# of a pixel, between the device's picture of the self-test and the kernel's
_TOLERANCE = 1e-4
_checked: weakref.WeakSet[Device] = weakref.WeakSet()


def device_for(backend: str, library: Library) -> Device | None:
    """The device that draws for a backend's name, or None for the processor.

    "gpu" wants one: InputError where there is none, RetryError where it draws something else than the kernel. "auto",
    without another name in JGHAND_BACKEND, takes the one that `remember` was told to be faster, and says on stderr why
    it cannot be had, once.
    """
    named = os.environ.get("JGHAND_BACKEND", "").strip() if backend == "auto" else backend
    if named == GPU:
        return working_device(library)
    if named not in ("", "auto") or not (faster := remembered()):
        return None
    try:
        return working_device(library, faster)
    except JGHandError as error:
        _say_once(f"jghand: drawing with the processor: {error}")
        return None


@functools.cache
def _say_once(sentence: str) -> None:
    print(sentence, file=sys.stderr)


def new_rasterizer(library: Library, threads: int, device: Device | None) -> NativeRasterizer:
    """What draws on the device, or on the processor where it is None."""
    return NativeRasterizer(library, threads) if device is None else GpuRasterizer(library, threads, device)


def remember(device: Device, *, gpu_ms: float, processor_ms: float) -> bool:
    """Keeps which of the two was faster on this machine, for `auto`; returns whether it is the device. DiskFullError,
    RetryError where nothing can be written."""
    facts = {"processor": processor(), "device": device.name, "gpu_ms": gpu_ms, "processor_ms": processor_ms}
    with writing(_memory()) as temporary:
        temporary.write_text(json.dumps(facts), encoding="utf-8")
    return gpu_ms < processor_ms


def remembered() -> str:
    """Name of the device that was faster than this machine's processor; empty where none was, or none was measured."""
    try:
        facts = json.loads(_memory().read_text(encoding="utf-8"))
        faster = facts["gpu_ms"] < facts["processor_ms"] and facts["processor"] == processor()
        return str(facts["device"]) if faster else ""
    except (OSError, ValueError, KeyError, TypeError):  # none, or none of ours
        return ""


def _memory() -> Path:
    return cache_folder() / "gpu.json"


def working_device(library: Library, named: str = "") -> Device:
    """The device to draw on, once it has drawn the self-test's picture; only the one of that name, if given.
    InputError, RetryError as of `device_for`."""
    device = open_device(named)
    if device not in _checked:
        _check(library, device)
        _checked.add(device)
    return device


def _check(library: Library, device: Device) -> None:
    """RetryError where the device does not draw the self-test's picture."""
    on_device, sample = GpuRasterizer(library, 1, device), selftest.sample_gaussians()
    front = (np.arange(len(sample)) % 3 / 2).astype(np.float32)
    drawn, wanted = (
        one.forward(replace(sample, rgb=sample.rgb * front[:, None], front=front), selftest.sample_view())
        for one in (on_device, NativeRasterizer(library, 1))
    )
    if on_device.fell_back:
        raise RetryError("backend gpu", wanted="a graphics card that draws", came=on_device.fell_back)
    worst = float(abs(drawn - wanted).max())
    if not worst <= _TOLERANCE:
        raise RetryError(f"self-test of {device.name}", wanted="the kernel's picture", came=f"{worst:.2g} beside it")
