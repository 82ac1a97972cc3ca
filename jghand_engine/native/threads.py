"""Threads that run one compiled call together.

A ctypes call releases the GIL, so Python threads are enough: each makes the same call, and the call shares its items
between them (native/team.h). The threads stay alive between calls; handing a call to one of them takes some ten
microseconds, which is why a call should do all stages of a frame and not one.
"""

from __future__ import annotations

import itertools
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from jghand_engine import limits

Result = TypeVar("Result")


def physical_cores() -> int:
    """Cores that this process may use: hyper-threads of one core count once, a container's limit is respected."""
    allowed = sorted(os.sched_getaffinity(0)) if sys.platform == "linux" else range(os.cpu_count() or 1)
    cores = len({_core_of(cpu) for cpu in allowed})
    return max(1, min(cores, _container_limit() or cores))


def _core_of(cpu: int) -> str:
    """The physical core of a logical processor (its list of siblings); the processor itself where that is unknown."""
    try:
        return Path(f"/sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list").read_text().strip()
    except OSError:
        return str(cpu)


def _container_limit() -> int | None:
    """Whole cores granted by the control group of this process; None without a limit."""
    try:
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text().split()
        return None if quota == "max" else max(1, int(quota) // int(period))
    except (OSError, ValueError):
        return None


def thread_count(wanted: int) -> int:
    """`wanted`, or for 0 as many threads as is sensible: physical cores, at most limits.AUTOMATIC_THREADS."""
    return wanted if wanted > 0 else min(physical_cores(), limits.AUTOMATIC_THREADS)


class _Worker:
    """One waiting thread. Locks are its bells: the fastest way Python has to wake one thread."""

    def __init__(self, index: int) -> None:
        self.go, self.finished = threading.Lock(), threading.Lock()
        self.go.acquire()
        self.finished.acquire()
        self.function: Callable[[int], object] | None = None
        self.error: BaseException | None = None
        # a daemon: the interpreter does not wait for it at exit
        threading.Thread(target=self._loop, args=(index,), name=f"jghand-{index}", daemon=True).start()

    def _loop(self, index: int) -> None:
        while True:
            self.go.acquire()
            function, self.function = self.function, None
            if function is None:
                return
            try:
                function(index)
            except BaseException as error:  # handed to the calling thread, which raises it
                self.error = error
            self.finished.release()

    def start(self, function: Callable[[int], object] | None) -> None:
        """Runs `function`; None ends the thread."""
        self.function = function
        self.go.release()

    def wait(self) -> BaseException | None:
        self.finished.acquire()
        error, self.error = self.error, None
        return error


class WorkerPool:
    """`threads` threads, of which the calling one is the first. One call runs at a time; others wait for it."""

    def __init__(self, threads: int) -> None:
        self.threads = max(1, threads)
        self._busy = threading.Lock()
        self._workers = [_Worker(index) for index in range(1, self.threads)]

    def run(self, function: Callable[[int], object]) -> None:
        """Calls function(thread index) on every thread and waits for all. The first error is raised here.

        Must not be called from inside `function`: the pool is busy then.
        """
        with self._busy:
            for worker in self._workers:
                worker.start(function)
            error: BaseException | None = None
            try:
                function(0)
            except BaseException as own:
                error = own
            errors = [worker.wait() for worker in self._workers]
        for problem in (error, *errors):
            if problem is not None:
                raise problem

    def map(self, function: Callable[[int], Result], count: int) -> list[Result]:
        """[function(0), …, function(count - 1)]; items are taken from one counter by all threads."""
        results: list[Result | None] = [None] * count
        take = itertools.count()  # next() on a count is atomic under the GIL

        def loop(_thread: int) -> None:
            while (i := next(take)) < count:
                results[i] = function(i)

        if count > 1 and self._workers:
            self.run(loop)
        else:
            loop(0)
        return results  # type: ignore[return-value]

    def close(self) -> None:
        """Ends the threads. The pool cannot be used afterwards."""
        with self._busy:
            for worker in self._workers:
                worker.start(None)
            self._workers = []


_pools: dict[int, WorkerPool] = {}
_pools_lock = threading.Lock()


def shared_pool(threads: int = 0) -> WorkerPool:
    """The process's pool of that size (0: automatic). Made once; whoever asks for the same size shares it."""
    count = thread_count(threads)
    with _pools_lock:
        if count not in _pools:
            _pools[count] = WorkerPool(count)
        return _pools[count]


def _forget_pools() -> None:
    """Threads do not survive a fork: the child makes its own."""
    global _pools_lock
    _pools.clear()
    _pools_lock = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pools)
