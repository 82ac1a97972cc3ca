"""The few kinds of error that JGHand raises on purpose.

Every message names the thing, what was wanted, what came, and what to do. The command line turns the kind into
its exit code: 2 bad input, 3 try again, 4 out of memory.
"""

from __future__ import annotations

import importlib
import re
import shlex
import sys
from typing import Any

# the exit code of a command that the user stopped
STOPPED = 130


class JGHandError(Exception):
    """An error with a remedy.

    `thing` is what was wrong (a file, an argument), `wanted` what was expected, `came` what was found,
    `remedy` one sentence that tells what to do.
    """

    exit_code = 1

    def __init__(self, thing: str, *, wanted: str = "", came: str = "", remedy: str = "") -> None:
        self.thing, self.wanted, self.came, self.remedy = thing, wanted, came, remedy
        sentence = thing
        if wanted:
            sentence += f": wanted {wanted}"
        if came:
            sentence += f"{',' if wanted else ':'} got {came}"
        # words of other programs may end with a full stop already, or with two; the folder .. is none
        sentence = re.sub(r"(?<=[^\s./])\.+$", "", sentence)
        if not sentence.endswith(("…", "!", "?")):
            sentence += "."
        if remedy:
            sentence += f" {remedy}"
        super().__init__(sentence)


class InputError(JGHandError):
    """What the user gave cannot be used: a wrong shape, unit, file or argument."""

    exit_code = 2


class RetryError(JGHandError):
    """Nothing is wrong with the input; the world was not ready (disk full, engine busy, folder in use)."""

    exit_code = 3


class DiskFullError(RetryError):
    """There is no room left on the disk, or too little for what is to be written."""


class MemoryLimitError(JGHandError):
    """The request does not fit into memory."""

    exit_code = 4


def package(module: str, thing: str, extra: str) -> Any:
    """A module of an optional extra. InputError says how to get what `thing` needs."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        wanted = f"the package {module}"
        raise InputError(thing, wanted=wanted, came="none", remedy=install_extra(extra)) from error


def install_extra(name: str) -> str:
    """The remedy where the packages of an optional extra are missing: the command for this very Python."""
    return f"Install the extra: {shlex.quote(sys.executable)} -m pip install 'jghand[{name}]'."


def first_line(error: BaseException) -> str:
    """The first line of what a library says, at most 200 letters; the name of its error where it says nothing."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]


def is_out_of_memory(error: BaseException) -> bool:
    """Whether `error` says that memory ran out: Python's own, torch's, and torch's on the CPU, which is a plain
    RuntimeError that only its text tells apart."""
    if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError":
        return True
    texts = ("not enough memory", "can't allocate memory", "Cannot allocate memory")
    return isinstance(error, RuntimeError) and any(text in str(error) for text in texts)
