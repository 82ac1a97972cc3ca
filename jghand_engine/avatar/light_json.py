"""Lamps as JSON has them: of a wire, of a light file, of a capture. The keys of one are the fields of `Lamp`."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from jghand_engine.avatar.scene_light import Lamp
from jghand_engine.json_files import JsonObject
from jghand_engine.native.scene_light_task import LampKind

_KINDS = {kind.name.lower(): kind for kind in LampKind}
# how many numbers a field has, and whether they may be negative
_VECTORS = {"rgb": (3, False), "place_m": (3, True), "axis": (3, True), "side": (3, True), "size_m": (2, False)}


def lamp_of_json(entry: JsonObject) -> Lamp:
    """The lamp of an entry; what it leaves out has the default of `Lamp`. InputError names what is wrong."""
    fields = {field.name: field for field in dataclasses.fields(Lamp)}
    for name in entry.fields:
        if name not in fields:
            raise entry.wrong(name, f"entries of these names only: {', '.join(fields)}")
    values: dict[str, Any] = {"kind": _KINDS[entry.one_of("kind", tuple(_KINDS))]}
    for name, field in fields.items():
        if name == "kind" or (name not in entry.fields and field.default is not dataclasses.MISSING):
            continue
        if isinstance(field.default, bool):
            values[name] = entry.flag(name)
        elif name in _VECTORS:
            count, signed = _VECTORS[name]
            values[name] = entry.numbers(name, count, -math.inf if signed else 0, math.inf)
        else:
            values[name] = entry.number(name, 0, math.inf)
    return Lamp(**values)
