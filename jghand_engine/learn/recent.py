"""What was made recently, kept as long as there is room."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Value = TypeVar("Value")


class Recent(Generic[Value]):
    """Keeps what was used last, up to `room` bytes, and always the newest. size_of: bytes of a value."""

    def __init__(self, room: int, size_of: Callable[[Value], int]) -> None:
        self._room, self._size_of = room, size_of
        self._kept: OrderedDict[Hashable, Value] = OrderedDict()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._kept)

    def get(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """The value of `key`, made when it is not there; the longest unused go when there is no room for it."""
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        value = make()
        self._kept[key] = value
        self._bytes += self._size_of(value)
        while self._bytes > self._room and len(self._kept) > 1:
            _, oldest = self._kept.popitem(last=False)
            self._bytes -= self._size_of(oldest)
        return value
