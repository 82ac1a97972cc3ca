"""What signals do while jobs are submitted and run."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator

# Ctrl-C, a polite kill, and the end of the terminal; Windows has no such end
STOPS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Those of STOPS that come meanwhile take effect at the end."""
    came: list[int] = []
    before = {number: signal.signal(number, lambda got, _: came.append(got)) for number in STOPS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in came:
            signal.raise_signal(number)


@contextlib.contextmanager
def unheard_by_programs(*numbers: int) -> Iterator[None]:
    """Programs that are started meanwhile do not hear these signals; for this process they wait."""
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    # some programs, shells among them, begin with an empty mask; what is ignored stays so. Linux keeps a signal that is
    # blocked even where it is ignored
    before = {number: signal.signal(number, signal.SIG_IGN) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextlib.contextmanager
def stop_requests() -> Iterator[threading.Event]:
    """Set by those of STOPS that are not ignored. Other signals keep their handlers."""
    asked = threading.Event()
    before = {number: signal.getsignal(number) for number in STOPS}
    for number in STOPS:
        if before[number] is not signal.SIG_IGN:
            signal.signal(number, lambda *_: asked.set())
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
