"""JSON files, read and checked so that whatever is wrong with one names the file and the entry."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from jghand_engine.errors import InputError, MemoryLimitError
from jghand_engine.files import write_file

# name, what was wanted, what came -> the error that names the file
Wrong = Callable[[str, str, object], InputError]
# bytes of a small file: a camera has 1 kB, a map of bones 10 kB. JSON takes up to thirty times its size in memory
JSON_BYTES_MAX = 100_000


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


def read_small_json(path: Path) -> Any:
    """The content of a small JSON file, without NaN and Infinity, which JSON does not know; 1e400 is infinite still.
    InputError names what is wrong."""
    try:
        with path.open("rb") as stream:
            content = stream.read(JSON_BYTES_MAX + 1)
            size = max(os.fstat(stream.fileno()).st_size, len(content))  # of a pipe nobody knows
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}", remedy="Check the name.") from error
    if size > JSON_BYTES_MAX:
        wanted = f"a small file, at most {JSON_BYTES_MAX} bytes"
        raise InputError(f"{path}", wanted=wanted, came=f"{size}", remedy="Check the name.")
    try:
        return json.loads(content, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}", wanted="JSON", came=str(error)) from error


def write_json(path: Path | str, content: dict[str, Any]) -> None:
    """Writes it whole or not at all. ValueError for NaN: JSON has none."""
    write_file(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def _no_number(word: str) -> None:
    """NaN and Infinity, which are Python's and not JSON's."""
    raise ValueError(f"{word}, which is no number")


def numbers(values: Any, shape: tuple[int, ...], what: str, remedy: str = "") -> np.ndarray:
    """Nested lists of a file -> float64 of `shape`; a flat list, or one with axes of length 1, is as good.

    `what` names it in the InputError for anything else. NaN and infinity pass.
    """
    came = "no rows of numbers"
    try:
        if np.array(values).dtype.kind == "U":
            raise TypeError
        array = np.array(values, dtype=np.float64)
        came = f"numbers of shape {array.shape}"
        if array.ndim > 1 and array.squeeze().shape != tuple(length for length in shape if length > 1):
            raise ValueError
        return array.reshape(shape)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(what, wanted=f"numbers of shape {shape}", came=came, remedy=remedy) from error


class JsonObject:
    """An object of a JSON file whose entries are asked for by what they must be.

    fields: the object · wrong: makes the InputError of an entry from its name, what was wanted and what came · within:
    what stands before the names of its entries in errors
    """

    def __init__(self, fields: Any, wrong: Wrong, within: str = "") -> None:
        self._wrong, self._within = wrong, within
        if not isinstance(fields, dict):
            raise wrong(within.strip() or "its description", "an object", fields)
        self.fields: dict[str, Any] = fields

    @classmethod
    def of_file(cls, path: Path, remedy: str) -> JsonObject:
        """The object in a file; errors name the file and end with `remedy`. Otherwise as `read_json_file`."""

        def wrong(name: str, wanted: str, came: object) -> InputError:
            shown = {type(None): "none", list: "a list", dict: "an object"}.get(type(came), str(came)[:200])
            return InputError(f"{name} in {path}", wanted=wanted, came=shown, remedy=remedy)

        content = read_json_file(path, remedy)
        if not isinstance(content, dict):
            raise InputError(f"{path}", wanted="a JSON object", came=type(content).__name__, remedy=remedy)
        return cls(content, wrong)

    def wrong(self, name: str, wanted: str) -> InputError:
        """That the entry of that name is something else."""
        return self._wrong(f"{self._within}{name}", wanted, self.fields.get(name))

    def object(self, name: str) -> JsonObject | None:
        """The object of that name, None where there is none."""
        value = self.fields.get(name)
        return None if value is None else self.inner(value, name)

    def needed(self, name: str) -> JsonObject:
        """The object of that name."""
        return self.inner(self.fields.get(name), name)

    def inner(self, value: Any, name: str) -> JsonObject:
        """An object that stands within this one, which errors call `name`."""
        return JsonObject(value, self._wrong, f"{self._within}{name} ")

    def array(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """As `numbers`."""
        try:
            return numbers(self.fields.get(name), shape, name)
        except InputError as error:
            raise self._wrong(f"{self._within}{name}", error.wanted, error.came) from error

    def entries(self, name: str) -> list[Any]:
        value = self.fields.get(name)
        if not isinstance(value, list) or not value:
            raise self.wrong(name, "a list with entries")
        return value

    def flag(self, name: str, left_out: bool | None = None) -> bool:
        value = self.fields.get(name, left_out)
        if not isinstance(value, bool):
            raise self.wrong(name, "true or false")
        return value

    def count(self, name: str, least: int, most: int) -> int:
        value = self.fields.get(name)
        if not is_number(value, least, most) or not isinstance(value, int):
            raise self.wrong(name, f"a count of {least} to {most}")
        return value

    def number(self, name: str, least: float, most: float) -> float:
        value = self.fields.get(name)
        if not is_number(value, least, most):
            raise self.wrong(name, f"a number of {least:g} to {most:g}")
        return float(value)

    def numbers(self, name: str, how_many: int, least: float, most: float) -> tuple[float, ...]:
        value = self.fields.get(name)
        if not isinstance(value, list) or len(value) != how_many or not all(is_number(x, least, most) for x in value):
            raise self.wrong(name, f"{how_many} numbers of {least:g} to {most:g}")
        return tuple(map(float, value))

    def value(self, name: str, is_good: Callable[[Any], bool], wanted: str) -> Any:
        value = self.fields.get(name)
        if not is_good(value):
            raise self.wrong(name, wanted)
        return value

    def one_of(self, name: str, choices: tuple[str, ...], left_out: str | None = None) -> str:
        value = self.fields.get(name, left_out)
        if value not in choices:
            raise self.wrong(name, " or ".join(choices))
        return value


def is_number(value: Any, least: float, most: float) -> TypeGuard[float]:
    """Whether it is a JSON number within these; NaN is not within anything, and true is no number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and least <= value <= most
