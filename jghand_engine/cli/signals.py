"""What signals mean to a command."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator


@contextlib.contextmanager
def polite_kill_is_ctrl_c() -> Iterator[None]:
    """SIGTERM, which schedulers, systemd and `timeout` send, ends what is under way as Ctrl-C does: tidily. In the main
    thread alone."""
    before = signal.getsignal(signal.SIGTERM)
    if before is signal.SIG_IGN:
        yield
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
