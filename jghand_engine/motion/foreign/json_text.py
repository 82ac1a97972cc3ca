"""JSON whose content is not trusted, an element at a time: a file of frames never stands in memory as objects.

Python's objects take ten times their text. So only one element of a list is built at a time, none of more than
JSON_ELEMENT_MAX_BYTES, and what nobody asks for is skipped without building it.
"""

from __future__ import annotations

import codecs
import itertools
import json
import re
from codecs import BOM_UTF8
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine import limits

_SPACE = re.compile(r"[ \t\n\r]*")
_STRING = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"', re.DOTALL)
_QUOTE, _BRACKETS = ord('"'), ((ord("["), ord("{")), (ord("]"), ord("}")))
_SCALAR_END = re.compile(r"[,\]} \t\n\r]")
_DECODER = json.JSONDecoder()


class JsonText:
    """The text of a JSON file; places are indices into it. Everything raises ValueError, or RecursionError, for what is
    no JSON.

    `text` has a character for each byte, whatever is written in it, so that one emoji does not make all of it four
    times as large; only values are decoded.
    """

    def __init__(self, content: bytes) -> None:
        _check_utf8(content)
        self.text = content.decode("latin-1")
        self._look = limits.JSON_LOOK_BYTES
        self.start = self.after_space(len(BOM_UTF8) if content.startswith(BOM_UTF8) else 0)
        end = len(self.text.rstrip(" \t\n\r"))
        # a file that was cut is most quickly known by its end
        if self.start >= end:
            raise ValueError("nothing in it")
        if self.text[self.start] + self.text[end - 1] not in ("{}", "[]"):
            raise ValueError("neither an object nor a list, or cut off before its end")

    @classmethod
    def of_file(cls, file: Path) -> JsonText:
        """The text of a file. OSError, UnicodeDecodeError."""
        return cls(file.read_bytes())

    def after_space(self, place: int) -> int:
        """The next place that is no white space."""
        match = _SPACE.match(self.text, place)
        return match.end() if match else place

    @cached_property
    def names(self) -> dict[str, int]:
        """Names of the file's object, and where their values begin; {} for a list."""
        if self.text[self.start] == "[":
            return {}
        names = dict(itertools.islice(self.members(self.start), limits.JSON_NAMES_MAX + 1))
        if len(names) > limits.JSON_NAMES_MAX:
            raise ValueError(f"an object of more than {limits.JSON_NAMES_MAX} names")
        return names

    def value(self, place: int) -> Any:
        """The value that begins there."""
        return self._decoded(place)[0]

    def elements(self, place: int, most: int = limits.JSON_ELEMENT_MAX_BYTES) -> Iterator[Any]:
        """The values of the list that begins at `place`, one after the other, none of more than `most` bytes."""
        place = self.after_space(place + 1)
        if self._mark(place) == "]":
            return
        while True:
            value, place = self._decoded(place, most)
            yield value
            place = self.after_space(place)
            if self._mark(place) == "]":
                return
            if self._mark(place) != ",":
                raise ValueError(f"no comma at character {place}")
            place = self.after_space(place + 1)

    def members(self, place: int) -> Iterator[tuple[str, int]]:
        """Names of the object that begins at `place`, and where their values begin. None of them is built."""
        place = self.after_space(place + 1)
        if self._mark(place) == "}":
            return
        while True:
            if self._mark(place) != '"':
                raise ValueError(f"no name at character {place}")
            name, place = self._decoded(place)
            place = self.after_space(place)
            if self._mark(place) != ":":
                raise ValueError(f"no colon at character {place}")
            place = self.after_space(place + 1)
            yield name, place
            place = self.after_space(self.after_value(place))
            if self._mark(place) == "}":
                return
            if self._mark(place) != ",":
                raise ValueError(f"no comma at character {place}")
            place = self.after_space(place + 1)

    def after_value(self, place: int) -> int:
        """Where the value that begins at `place` ends."""
        if self._mark(place) not in '[{"':
            match = _SCALAR_END.search(self.text, place)
            return match.start() if match else len(self.text)
        if self._mark(place) == '"':
            match = _STRING.match(self.text, place)
            if match is None:
                raise ValueError(f"a string without an end at character {place}")
            return match.end()
        return self._after_container(place)

    def _after_container(self, place: int) -> int:
        """Where the list or object that begins at `place` ends: brackets outside of strings are counted, a block of the
        text at a time."""
        depth, inside, look = 0, 0, limits.JSON_LOOK_BYTES
        while place < len(self.text):
            block = self.text[place : place + look]
            if (len(block) - len(block.rstrip("\\"))) % 2:
                # the character behind the last backslash belongs to it
                block = self.text[place : place + len(block) + 1]
            depths, in_string, closes = _depths(block, depth, inside)
            ends = np.flatnonzero((depths == 0) & closes & (in_string == 0))
            if len(ends):
                return place + int(ends[0]) + 1
            depth, inside = int(depths[-1]), int(in_string[-1])
            place += len(block)
            # most values are short
            look = min(look * limits.JSON_LOOK_GROWTH, limits.JSON_BLOCK_BYTES)
        raise ValueError("cut off before its end")

    def _mark(self, place: int) -> str:
        if place >= len(self.text):
            raise ValueError("cut off before its end")
        return self.text[place]

    def _decoded(self, place: int, most: int = limits.JSON_ELEMENT_MAX_BYTES) -> tuple[Any, int]:
        """A value and where it ends. Only a part of the text is shown to the decoder, so that a value that never ends
        is not built either."""
        # elements of a list are mostly of about the same length
        look = min(self._look, most)
        while True:
            part = self.text[place : place + look]
            is_rest, is_ascii = len(part) < look, part.isascii()
            if not is_ascii:
                # a character that the look cuts in two stands behind the value, or the look is too short
                part = part.encode("latin-1").decode("utf-8", "ignore")
            try:
                value, end = _DECODER.raw_decode(part)
                # a number at the end of the part may go on behind it
                if end < len(part) or is_rest:
                    taken = end if is_ascii else len(part[:end].encode())
                    self._look = max(2 * taken, limits.JSON_LOOK_BYTES)
                    return value, place + taken
            except ValueError as error:
                if is_rest:
                    raise ValueError(f"{error} (character {place} of the file)") from error
            if look >= most:
                raise ValueError(f"no whole value of at most {most / 2**20:g} MiB at character {place}")
            look = min(look * limits.JSON_LOOK_GROWTH, most)


def _depths(block: str, depth: int, inside: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each character of a block how deep in brackets it leaves us, whether it is in a string, and whether it is a
    closing bracket. depth, inside: those before the block."""
    # what is escaped is no mark; the lengths stay
    plain = block.replace("\\\\", "xx").replace('\\"', "xx") if "\\" in block else block
    marks = np.frombuffer(plain.encode("latin-1"), np.uint8)
    in_string = (np.cumsum(marks == _QUOTE, dtype=np.int64) + inside) % 2
    opens, closes = ((marks == first) | (marks == second) for first, second in _BRACKETS)
    return depth + np.cumsum(np.where(in_string, 0, opens.astype(np.int64) - closes)), in_string, closes


def _check_utf8(content: bytes) -> None:
    """UnicodeDecodeError for what is no UTF-8; without a copy of the whole."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    for place in range(0, len(content), limits.JSON_BLOCK_BYTES):
        decoder.decode(content[place : place + limits.JSON_BLOCK_BYTES])
    decoder.decode(b"", final=True)
