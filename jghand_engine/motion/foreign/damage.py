"""What is wrong with a motion file, in one sentence: whether it is damaged, or a good file that holds no motion."""

from __future__ import annotations

import contextlib
import csv
import struct
import tokenize
from collections.abc import Iterator
from pathlib import Path

from jghand_engine.errors import InputError, MemoryLimitError


class NoMotionError(ValueError):
    """A file that may be a good one, but is none that JGHand can take a motion from; its text says why."""


# what numpy, json, csv and zip raise on a damaged or hostile file
_DAMAGE = (
    *(ValueError, TypeError, KeyError, IndexError, EOFError, OverflowError, SyntaxError, RecursionError),
    *(csv.Error, NotImplementedError, RuntimeError, AttributeError),
    # numpy reads a header as Python literals: a flipped bit makes it a broken program
    *(tokenize.TokenError, struct.error),
)


@contextlib.contextmanager
def told_damage(file: Path) -> Iterator[None]:
    """What readers raise on a damaged or hostile file, said in one sentence: InputError, MemoryLimitError."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot read motion file {file}", came=str(error.strerror or error)) from error
    except MemoryError as error:
        raise MemoryLimitError(
            f"motion file {file}", wanted="memory to read it", came="none left", remedy="Cut it into shorter motions."
        ) from error
    except NoMotionError as error:
        raise InputError(f"motion file {file}: {error}") from error
    except _DAMAGE as error:
        raise InputError(f"motion file {file}", wanted="an undamaged file", came=_one_line(error)) from error


def _one_line(error: BaseException) -> str:
    """The first line of an error; Python's name for it only where its text alone says nothing."""
    text = str(error).strip().splitlines()
    if not text:
        return type(error).__name__
    return text[0][:200] if isinstance(error, ValueError) else f"{type(error).__name__}: {text[0][:200]}"
