"""JSON files of data sets, read so that whatever is wrong with one names the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError, MemoryLimitError


def read_json_file(path: Path, remedy: str) -> Any:
    """What a JSON file holds. InputError, with `remedy`, when it is missing or damaged; MemoryLimitError."""
    try:
        return json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(f"cannot read {path}", came=error.strerror or str(error), remedy=remedy) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}", wanted="undamaged JSON", came=str(error)[:200], remedy=remedy) from error
    except MemoryError as error:
        raise MemoryLimitError(
            f"{path}",
            wanted="memory to read it (about ten times its size)",
            came="too little",
            remedy="Close other programs, or use a machine with more memory.",
        ) from error


def read_object(path: Path, remedy: str) -> dict[str, Any]:
    """The JSON object in a file; errors as in `read_json_file`, and InputError when it holds something else."""
    content = read_json_file(path, remedy)
    if not isinstance(content, dict):
        raise InputError(f"{path}", wanted="a JSON object", came=type(content).__name__, remedy=remedy)
    return content


def numbers(values: Any, shape: tuple[int, ...], what: str, remedy: str = "") -> np.ndarray:
    """Nested lists of a file -> float64 of `shape`; a flat list, or one with axes of length 1, is as good.

    `what` names it in the InputError for anything else. NaN and infinity pass.
    """
    try:
        return np.array(values, dtype=np.float64).reshape(shape)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(what, wanted=f"numbers of shape {shape}", came=str(error)[:200], remedy=remedy) from error
