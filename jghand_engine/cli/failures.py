"""How a command ends: errors as one sentence and one exit code, and what signals mean to it.

0 done · 1 a fault of JGHand · 2 bad input · 3 try again · 4 out of memory · 130 stopped by the user
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from jghand_engine.errors import (
    STOPPED,
    InputError,
    JGHandError,
    MemoryLimitError,
    RetryError,
    install_extra,
    is_out_of_memory,
)
from jghand_engine.files import file_error

FAULT = 1
# packages of the half that learns, which whoever only draws does without, and their extra
_EXTRA_OF = {"torch": "learn", "scipy": "learn", "trimesh": "learn"}
# Windows has no hang-up
_POLITE = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


@dataclass(frozen=True)
class Failure:
    """What to say and how to end."""

    sentence: str
    exit_code: int


def explain(error: BaseException) -> Failure:
    """The sentence and the exit code of whatever ended a command."""
    if isinstance(error, KeyboardInterrupt):
        return Failure("Stopped.", STOPPED)
    if isinstance(error, JGHandError):
        return Failure(str(error), error.exit_code)
    if is_out_of_memory(error):
        return explain(
            MemoryLimitError(
                "there is not enough memory for this", remedy="Choose a smaller --size or the preset draft."
            )
        )
    if isinstance(error, OSError):
        return explain(_of_the_system(error))
    if isinstance(error, ModuleNotFoundError) and error.name in _EXTRA_OF:
        came, remedy = f"no package {error.name}", install_extra(_EXTRA_OF[error.name])
        return explain(InputError("this command", wanted="what learning needs", came=came, remedy=remedy))
    return Failure(
        f"JGHand failed: {type(error).__name__}: {error}. This should not happen: run it again with JGHAND_DEBUG=1 "
        "and report what it prints.",
        FAULT,
    )


def _of_the_system(error: OSError) -> JGHandError:
    """An OSError that no one closer to it explained."""
    if isinstance(error, FileNotFoundError) and error.filename:
        return InputError(f"cannot find {error.filename}", remedy="Check the name.")
    if error.filename:
        return file_error(Path(str(error.filename)), error)
    return RetryError(f"the system refused: {error.strerror or error}", remedy="Try again.")


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
