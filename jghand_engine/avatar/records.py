"""Frozen dataclasses of tensors, such as an avatar, as a whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

from torch import Tensor

Record = TypeVar("Record")


def mapped(record: Record, change: Callable[[Tensor], Tensor]) -> Record:
    """A frozen dataclass with `change` applied to its tensors, in nested records too; all else stays as it is."""
    values: dict[str, Any] = {}
    for f in fields(record):  # type: ignore[arg-type]
        value = getattr(record, f.name)
        if isinstance(value, Tensor):
            values[f.name] = change(value)
        elif is_dataclass(value) and not isinstance(value, type):
            values[f.name] = mapped(value, change)
    return replace(record, **values)  # type: ignore[type-var]
