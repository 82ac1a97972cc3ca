"""Threads that run one compiled call together.

A ctypes call releases the GIL, so Python threads are enough: each makes the same call, and the call shares its items
between them (native/team.h). The threads stay alive between calls; handing a call to one of them takes some ten
microseconds, which is why a call should do all stages of a frame and not one.

Other programs may have the processors. So nobody waits for a thread that has not begun when the call's work is done:
it is told that the call is over.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TypeVar

Result = TypeVar("Result")
# threads taken without being asked, at most; beyond this many nothing was measured
AUTOMATIC_THREADS = 8


def physical_cores() -> int:
    """Cores that this process may use: hyper-threads of one core count once, a container's limit is respected."""
    return _limited(len({_core_of(cpu) for cpu in _allowed()}))


def processors() -> int:
    """Logical processors that this process may use: hyper-threads count, a container's limit is respected."""
    return _limited(len(_allowed()))


def _allowed() -> list[int]:
    """Numbers of the logical processors that this process may run on."""
    return sorted(os.sched_getaffinity(0)) if sys.platform == "linux" else list(range(os.cpu_count() or 1))


def _limited(count: int) -> int:
    return max(1, min(count, _container_limit() or count))


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
    """`wanted`, or for 0 as many threads as is sensible: physical cores, at most AUTOMATIC_THREADS."""
    return wanted if wanted > 0 else min(physical_cores(), AUTOMATIC_THREADS)


class _Call:
    """One call of `function` on all threads that come in time.

    outcome: by thread index, once the thread is done: its error, or None
    """

    def __init__(self, function: Callable[[int], object]) -> None:
        self.function = function
        self.outcome: dict[int, BaseException | None] = {}
        self._takers: dict[int, str] = {}

    def taken(self, index: int, by: str) -> bool:
        """Whether the share of thread `index` is `by`'s: of the worker that makes it, or of the caller that calls it
        off. The first to ask has it, however often they ask."""
        return self._takers.setdefault(index, by) == by


class _Worker:
    """One waiting thread. Queues are its bells: written in C, as fast as locks, and rung twice they do no harm."""

    def __init__(self, index: int) -> None:
        self._index = index
        self._calls: SimpleQueue[_Call | None] = SimpleQueue()
        self._bell: SimpleQueue[None] = SimpleQueue()  # rung after every call
        # a daemon: the interpreter does not wait for it at exit
        threading.Thread(target=self._loop, name=f"jghand-{index}", daemon=True).start()

    def _loop(self) -> None:
        while (call := self._calls.get()) is not None:
            if call.taken(self._index, "worker") and self._index not in call.outcome:
                error: BaseException | None = None
                try:
                    call.function(self._index)
                except BaseException as problem:  # handed to the calling thread, which raises it
                    error = problem
                call.outcome[self._index] = error
                del error
                self._bell.put(None)
            del call  # it holds the caller's arrays, and the next one may be long in coming

    def start(self, call: _Call | None) -> None:
        """Makes the call, if it was not made before; None ends the thread."""
        self._calls.put(call)

    def finish(self, call: _Call) -> None:
        """Waits until the call is over here, or calls it off where it has not begun."""
        if call.taken(self._index, "caller"):
            with contextlib.suppress(Empty):  # it holds the caller's arrays, too
                self._calls.get_nowait()
            return
        while self._index not in call.outcome:
            self._bell.get()


class WorkerPool:
    """`threads` threads, of which the calling one is the first. One call runs at a time; others wait for it."""

    def __init__(self, threads: int) -> None:
        self.threads = max(1, threads)
        self._busy = threading.Lock()
        self._workers = [_Worker(index) for index in range(1, self.threads)]

    def run(self, function: Callable[[int], object]) -> None:
        """Calls function(0) here and function(thread index) on the other threads, until all are done. The first error
        is raised here.

        function(0) must return no sooner than all work is done, its own and what the others took: a thread that has
        not begun by then, because other programs have the processors, does not begin any more.
        Ctrl-C is raised here too, but not before all threads are done: they work on the caller's memory.
        Must not be called from inside `function`: the pool is busy then.
        """
        call, begun = _Call(function), False
        problems: list[BaseException] = []
        with self._busy:
            while True:
                try:
                    if not begun:
                        # after an interruption once more: nobody knows which of them were told
                        for worker in self._workers:
                            worker.start(call)
                        begun = True
                        function(0)
                    for worker in self._workers:
                        worker.finish(call)
                    break
                except BaseException as problem:
                    problems.append(problem)
        problems += [error for error in call.outcome.values() if error is not None]
        if problems:
            # an interruption before any error that it may have caused
            raise min(problems, key=lambda problem: isinstance(problem, Exception))

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
