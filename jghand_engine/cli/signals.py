"""What signals mean to a command."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator

# Windows has no hang-up
_POLITE = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextlib.contextmanager
def polite_kill_is_ctrl_c() -> Iterator[None]:
    """SIGTERM, which schedulers, systemd and `timeout` send, and SIGHUP, which a terminal that is closed sends, end
    what is under way as Ctrl-C does: tidily. In the main thread alone."""
    before = {number: signal.getsignal(number) for number in _POLITE}
    # what is ignored stays so (nohup); None is a handler that is not Python's and could not be put back
    heard = {number: handler for number, handler in before.items() if handler not in (signal.SIG_IGN, None)}
    for number in heard:
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number, handler in heard.items():
            signal.signal(number, handler)
