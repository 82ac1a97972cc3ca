"""What machine this is, and how much of it is ours now."""

from __future__ import annotations

import ctypes
import hashlib
import platform
import sys
import time
from pathlib import Path

from jghand_engine.native.threads import WorkerPool

# how many bytes a control of free cores hashes per core: about 1 ms
CONTROL_BYTES = 1 << 21
# share of the wanted cores that a control must have seen for the machine to be called free
FREE_PART = 0.9


def processor() -> str:
    """Its name, as far as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    facts = dict(line.split(":", 1) for line in lines if ":" in line)
    stripped = {key.strip(): value.strip() for key, value in facts.items()}
    family = f" (family {stripped['cpu family']})" if "cpu family" in stripped else ""
    return stripped.get("model name", platform.machine()) + family


def return_free_memory() -> None:
    """Gives memory that was freed back to the system. glibc keeps it for later, up to 32 MB an array; other C libraries
    give back by themselves, or cannot be asked."""
    if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
        libc.malloc_trim(0)


class FreeCores:
    """How many of `threads` cores the machine really gives us now."""

    def __init__(self, threads: int) -> None:
        self._pool = WorkerPool(threads)
        self._bytes = bytes(CONTROL_BYTES)

    def __call__(self) -> float:
        wall, cpu = time.perf_counter(), time.process_time()
        self._pool.run(lambda _thread: hashlib.sha1(self._bytes, usedforsecurity=False).digest())
        return (time.process_time() - cpu) / (time.perf_counter() - wall)

    def close(self) -> None:
        self._pool.close()
