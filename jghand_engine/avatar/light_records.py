"""The light of a scene as JSON: what Blender sends with every image, and what a light file holds.

    light = light_of(lamps_of(JsonObject(record, wrong)), world)

A lamp is an object with the fields of `Lamp`, `kind` by its name; one that is left out has its default. A world is its
picture with `env_from_world`; suns are taken out of it here.
"""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import Any

import numpy as np

from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.avatar.world_suns import averaged, take_suns
from jghand_engine.json_files import JsonObject
from jghand_engine.native.scene_light_task import LampKind

# lamps of a record; the brightest 32 light the hand
RECORDS_MAX = 256
# rows and columns that are enough to light skin, and to mirror in it, once suns are out
ROWS_MAX, COLUMNS_MAX = 32, 64
# meters, watts and radiance: beyond any scene, and far from where float32 overflows
NUMBER_MAX = 1e9
_KINDS = {kind.name.lower(): kind for kind in LampKind}
# how many numbers a field has, and the least that they may be
_VECTORS = {
    "rgb": (3, 0), "place_m": (3, -NUMBER_MAX), "axis": (3, -NUMBER_MAX), "side": (3, -NUMBER_MAX), "size_m": (2, 0),
}  # fmt: skip


def light_of(lamps: tuple[Lamp, ...], world: World | None) -> SceneLight:
    """Lamps, and the suns of a world with what is left of it, small."""
    if world is None:
        return SceneLight(None, lamps)
    left, suns = take_suns(world)
    radiance = averaged(left.radiance, ROWS_MAX, COLUMNS_MAX)
    # a pixel is as bright all over, but counts as a point: those of a small picture are parted
    parts = -(-ROWS_MAX // len(radiance))
    small = World(radiance.repeat(parts, 0).repeat(parts, 1), left.env_from_world)
    return SceneLight(small, (*lamps, *suns))


def lamps_of(record: JsonObject) -> tuple[Lamp, ...]:
    """The lamps of a light. InputError names what is wrong."""
    lamps = record.fields.get("lamps", [])
    if not isinstance(lamps, list) or len(lamps) > RECORDS_MAX:
        raise record.wrong("lamps", f"a list of at most {RECORDS_MAX}")
    return tuple(lamp_of(record.inner(lamp, f"lamp {number}")) for number, lamp in enumerate(lamps, 1))


def lamp_of(record: JsonObject) -> Lamp:
    known = {field.name: field for field in fields(Lamp)}
    refuse_others(record, tuple(known))
    values: dict[str, Any] = {"kind": _KINDS[record.one_of("kind", tuple(_KINDS))]}
    for name, field in known.items():
        if name == "kind" or (name not in record.fields and field.default is not MISSING):
            continue
        if name == "hands":
            values[name] = tuple(record.value(name, _are_places, "a list of whole numbers, 0 and up"))
        elif name in _VECTORS:
            count, least = _VECTORS[name]
            values[name] = record.numbers(name, count, least, NUMBER_MAX)
        elif isinstance(field.default, bool):
            values[name] = record.flag(name)
        else:
            values[name] = record.number(name, 0, NUMBER_MAX)
    return Lamp(**values)


def _are_places(value: Any) -> bool:
    return isinstance(value, list) and all(type(place) is int and place >= 0 for place in value)


def turn_of(record: JsonObject) -> np.ndarray:
    """env_from_world (3, 3) of a world's record; no turn where it is left out."""
    return np.eye(3) if record.fields.get("env_from_world") is None else record.array("env_from_world", (3, 3))


def refuse_others(record: JsonObject, known: tuple[str, ...]) -> None:
    """InputError for an entry of another name: what is misspelled would be left out without a word."""
    for name in record.fields:
        if name not in known:
            raise record.wrong(name, f"nothing of that name, only {', '.join(known)}")
