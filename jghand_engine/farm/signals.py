"""What signals do while jobs are submitted and run."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterable, Iterator
from typing import Any

# Ctrl-C, a polite kill, and the end of the terminal; Windows has no such end
STOPS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Those of STOPS that come meanwhile take effect at the end."""
    came: list[int] = []
    try:
        with _handled(STOPS, lambda number, _: came.append(number)):
            yield
    finally:
        for number in came:
            signal.raise_signal(number)


@contextlib.contextmanager
def unheard_by_programs(*numbers: int) -> Iterator[None]:
    """Programs that are started meanwhile do not hear these signals, if they leave blocked what they find blocked, as
    SLURM's do; a shell of Debian does not. This process does: where it has one thread at the end, else at once."""
    # not by ignoring them: another thread would take a signal that is blocked in this one, and drop it
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextlib.contextmanager
def stop_requests() -> Iterator[threading.Event]:
    """Set by those of STOPS that are not ignored."""
    asked = threading.Event()
    heard = [number for number in STOPS if signal.getsignal(number) is not signal.SIG_IGN]
    with _handled(heard, lambda *_: asked.set()):
        yield asked


@contextlib.contextmanager
def _handled(numbers: Iterable[int], handler: Any) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
