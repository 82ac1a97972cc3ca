"""Arrays as a web page takes them: in one block of bytes, described by kind, shape and place; and the task of the
kernels in the words of WebAssembly, where a pointer is as long as a number."""

from __future__ import annotations

import base64
import ctypes
import gzip
from typing import Any

import numpy as np

from jghand_engine.errors import InputError

# 0..9: 9 takes twice as long and saves 0.2 %
GZIP_LEVEL = 6
_EXACT = {"f8": "<f8", "f4": "<f4", "i4": "<i4", "i1": "<i1", "b1": "u1"}
_NARROW = {1: ("u1", np.uint8), 2: ("u2", np.uint16)}
_STEPS = 2**16 - 1
_NUMBERS = {ctypes.c_int32: np.int32, ctypes.c_float: np.float32, ctypes.c_double: np.float64}
# bytes of a pointer, and of most numbers
_WORD = 4
# places of arrays are multiples of the longest number
_ALIGNMENT = 8


class Pack:
    """Arrays that are collected. about: what JSON says of each."""

    def __init__(self) -> None:
        self.about: dict[str, dict[str, Any]] = {}
        self._parts: list[bytes] = []
        self._end = 0

    def exact(self, name: str, array: np.ndarray, kind: str) -> None:
        self._add(name, kind, array.shape, np.ascontiguousarray(array, _EXACT[kind]))

    def rounded(self, name: str, array: np.ndarray) -> None:
        """Real numbers (outer, channels, inner) in 16 bits, with steps of their own for each channel: 0 stays 0 where
        no number is below it."""
        values = array.astype(np.float64)
        low, high = values.min((0, 2), initial=0.0), values.max((0, 2), initial=0.0)
        step = (high - low) / _STEPS
        levels = (values - low[:, None]) / np.where(step > 0, step, 1.0)[:, None]
        self._add(name, "rounded", array.shape, np.rint(levels).astype("<u2"), low=low.tolist(), step=step.tolist())

    def counts(self, name: str, array: np.ndarray) -> None:
        """Whole numbers from 0 on, in as few bytes as they need; 32 bits in memory. InputError for 2^16 and more."""
        width = 1 if array.max(initial=0) < 2**8 else 2
        if array.max(initial=0) >= 2**16:
            raise InputError(name, wanted="numbers below 65536", came=str(array.max()))
        kind, dtype = _NARROW[width]
        self._add(name, kind, array.shape, array.astype(dtype))

    def empty(self, name: str, shape: tuple[int, ...]) -> None:
        self.about[name] = {"kind": "empty", "shape": list(shape)}

    def packed(self) -> str:
        """All bytes, gzipped, as base64. The same arrays always give the same text."""
        return base64.b64encode(gzip.compress(b"".join(self._parts), GZIP_LEVEL, mtime=0)).decode()

    def _add(self, name: str, kind: str, shape: tuple[int, ...], array: np.ndarray, **more: Any) -> None:
        content = array.tobytes()
        self.about[name] = {"kind": kind, "shape": list(shape), "at": self._end, **more}
        self._parts.append(content + bytes(-len(content) % _ALIGNMENT))
        self._end += len(self._parts[-1])


def task_in_words(task: ctypes.Structure) -> dict[str, Any]:
    """words: the numbers of a structure of pointers, int32, float32 and float64, pointers as 0 · pointers, fields: by
    name (`skin.rest`) the place of each pointer, and of each other field."""
    words: list[int] = []
    pointers: dict[str, int] = {}
    fields: dict[str, int] = {}

    def walk(structure: ctypes.Structure, prefix: str) -> int:
        """Gives the words at a multiple of which it begins."""
        aligned = 1
        for name, kind in ((entry[0], entry[1]) for entry in structure._fields_):
            value, full = getattr(structure, name), prefix + name
            if isinstance(value, ctypes.Structure):
                aligned = max(aligned, walk(value, full + "."))
            elif kind is ctypes.c_void_p:
                pointers[full] = len(words)
                words.append(0)
            else:
                element, values = (kind._type_, list(value)) if issubclass(kind, ctypes.Array) else (kind, [value])
                numbers = np.array(values, _NUMBERS[element])
                of_number = numbers.itemsize // _WORD
                words.extend([0] * (-len(words) % of_number))
                fields[full], aligned = len(words), max(aligned, of_number)
                words.extend(numbers.view(np.uint32).tolist())
        words.extend([0] * (-len(words) % aligned))
        return aligned

    walk(task, "")
    return {"words": words, "pointers": pointers, "fields": fields}
