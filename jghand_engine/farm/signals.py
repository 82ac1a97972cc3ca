"""What signals do while jobs are submitted and run."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator

# Ctrl-C, and a polite kill
STOPS = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Ctrl-C and a polite kill that come meanwhile take effect at the end."""
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
def unheard_by_programs() -> Iterator[None]:
    """Programs that are started meanwhile hear neither Ctrl-C nor a polite kill; for this process they wait."""
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
    # some programs, shells among them, begin with an empty mask; what is ignored stays so. Linux keeps a signal that is
    # blocked even where it is ignored
    before = {number: signal.signal(number, signal.SIG_IGN) for number in STOPS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextlib.contextmanager
def without_ctrl_c() -> Iterator[None]:
    """Programs that are started meanwhile never hear Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def stop_requests() -> Iterator[threading.Event]:
    """Set by a polite kill or Ctrl-C. Other signals keep their handlers."""
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
