"""The light of a scene from a file: lamps and a world as JSON, as Blender writes them, or the picture of a world alone.

    {"format": "jghand-light", "version": 1, "lamps": [{"kind": "sun", ...}], "world": {"picture": "sky.hdr"}}

A lamp has the fields of `Lamp`. A world has a `picture` beside the file, or one color `rgb`, W/(m2 sr), and may be
turned by `env_from_world`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jghand_engine.avatar.light_records import NUMBER_MAX, lamps_of, light_of, refuse_others, turn_of
from jghand_engine.avatar.scene_light import SceneLight, World
from jghand_engine.export.world_picture import read_world_picture
from jghand_engine.json_files import JsonObject

FORMAT, VERSION = "jghand-light", 1
_REMEDY = "Let Blender write it, or see docs/LIGHT.md."
# the sky of a picture is up in Blender, +z, and up where hands are drawn, +y
ENV_FROM_WORLD = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def read_light(path: Path) -> SceneLight:
    """The light that a file describes. InputError names what is wrong."""
    if path.suffix.lower() != ".json":
        return light_of((), World(read_world_picture(path), ENV_FROM_WORLD))
    record = JsonObject.of_file(path, _REMEDY)
    if record.fields.get("format") != FORMAT or record.fields.get("version") != VERSION:
        raise record.wrong("format", f"{FORMAT} of version {VERSION}")
    refuse_others(record, ("format", "version", "lamps", "world"))
    return light_of(lamps_of(record), _world(record.object("world"), path.parent))


def files_of(path: Path) -> list[Path]:
    """Everything that a light is read from, the picture of its world too."""
    if path.suffix.lower() != ".json":
        return [path]
    world = JsonObject.of_file(path, _REMEDY).object("world")
    picture = None if world is None else world.fields.get("picture")
    return [path] if not isinstance(picture, str) else [path, path.parent / picture]


def _world(record: JsonObject | None, folder: Path) -> World | None:
    if record is None:
        return None
    refuse_others(record, ("picture", "rgb", "env_from_world"))
    if "picture" in record.fields and "rgb" in record.fields:
        raise record.wrong("rgb", "nothing beside a picture")
    turn = ENV_FROM_WORLD if record.fields.get("env_from_world") is None else turn_of(record)
    if "picture" in record.fields:
        name = record.value("picture", lambda value: isinstance(value, str) and value != "", "the name of a picture")
        return World(read_world_picture(folder / name), turn)
    rgb = record.numbers("rgb", 3, 0, NUMBER_MAX)
    return World(np.broadcast_to(np.array(rgb, np.float32), (2, 4, 3)), turn)
