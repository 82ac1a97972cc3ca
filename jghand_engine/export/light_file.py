"""The light of a scene from a file: lamps and a world as JSON, as Blender writes them, or the picture of a world alone.

    {"format": "jghand-light", "version": 1, "lamps": [{"kind": "sun", ...}], "world": {"picture": "sky.hdr"}}

A lamp has the fields of `Lamp`. A world has a `picture` beside the file, or one color `rgb`, W/(m2 sr), and may be
turned by `env_from_world`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np

from jghand_engine.avatar.light_records import NUMBER_MAX, lamp_of, lamps_of, light_of, refuse_others, turn_of
from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.avatar.world_suns import averaged
from jghand_engine.errors import InputError
from jghand_engine.export.exr import exr_package
from jghand_engine.json_files import JsonObject

FORMAT, VERSION = "jghand-light", 1
_REMEDY = "Let Blender write it, or see docs/LIGHT.md."
# the sky of a picture is up in Blender, +z, and up where hands are drawn, +y
ENV_FROM_WORLD = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def read_light(path: Path, lamps: Sequence[Lamp] = ()) -> SceneLight:
    """The light that a file describes, with `lamps` after its own. InputError names what is wrong."""
    if path.suffix.lower() != ".json":
        return light_of(tuple(lamps), World(read_world_picture(path), ENV_FROM_WORLD))
    record = JsonObject.of_file(path, _REMEDY)
    if record.fields.get("format") != FORMAT or record.fields.get("version") != VERSION:
        raise record.wrong("format", f"{FORMAT} of version {VERSION}")
    refuse_others(record, ("format", "version", "lamps", "world"))
    return light_of((*lamps_of(record), *lamps), _world(record.object("world"), path.parent))


def lamp_of_words(text: str) -> Lamp:
    """`sun:rgb=3/2.7/2.2,angle=0.01`, a lamp as in a file, names with or without their unit. InputError as there."""

    def wrong(name: str, wanted: str, came: object) -> InputError:
        shown = "none" if came is None else str(came)[:200]
        return InputError(f"{name} in --lamp {text}", wanted=wanted, came=shown, remedy="See docs/LIGHT.md.")

    names = {re.sub("_(m|rad)$", "", field.name): field.name for field in fields(Lamp)}
    kind, _, words = text.partition(":")
    values = {}
    for word in filter(None, words.split(",")):
        name, _, value = word.partition("=")
        found, field = [_number_or_flag(each) for each in value.split("/")], names.get(name, name)
        if field in values or field == "kind":
            raise wrong(field, "given once", word)
        values[field] = found if len(found) > 1 else found[0]
    return lamp_of(JsonObject({**values, "kind": kind}, wrong))


def _number_or_flag(text: str) -> float | bool | str:
    try:
        return float(text)
    except ValueError:
        return {"true": True, "false": False}.get(text, text)


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


# ---- pictures of worlds ---------------------------------------------------------------------------------------------

# rows and columns that are enough to find suns in
ROWS_MAX, COLUMNS_MAX = 256, 512
# the longest run of one channel in a packed row
RUN_MAX = 127


def read_world_picture(path: Path) -> np.ndarray:
    """(rows, columns, 3) float32, 0 and up, at most 256 x 512: the means of the file's pixels over solid angle.

    InputError where the file is no such picture, is damaged, or its package is missing.
    """
    readers = {".hdr": _read_hdr, ".npy": partial(np.load, allow_pickle=False), ".exr": _read_exr}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path}", wanted="a picture in .hdr, .exr or .npy", came=path.suffix or "no ending")
    try:
        picture = reader(path)
    except (OSError, ValueError, IndexError, KeyError, RuntimeError, TypeError, EOFError) as error:
        raise InputError(f"cannot read {path}", came=str(error)[:200] or type(error).__name__) from error
    if picture.ndim != 3 or picture.shape[2] < 3 or 0 in picture.shape:
        raise InputError(f"{path}", wanted="a picture of three channels", came=f"shape {picture.shape}")
    # resampled pictures swing below zero beside their suns
    finite = np.nan_to_num(picture[..., :3].astype(np.float32), copy=False, nan=0, posinf=0, neginf=0)
    return averaged(np.maximum(finite, 0), ROWS_MAX, COLUMNS_MAX)


def _read_exr(path: Path) -> np.ndarray:
    with exr_package().File(str(path)) as content:
        channels = content.channels()
        return channels["RGBA" if "RGBA" in channels else "RGB"].pixels


def _read_hdr(path: Path) -> np.ndarray:
    """Radiance's RGBE. Source: Ward, "Real Pixels", Graphics Gems II, 1991, and Radiance's color.c."""
    data = path.read_bytes()
    header, _, rest = data.partition(b"\n\n")
    if not header.startswith(b"#?") or b"FORMAT=32-bit_rle_rgbe" not in header:
        raise ValueError("no picture of Radiance in RGBE")
    size = re.match(rb"-Y (\d+) \+X (\d+)\n", rest)
    if size is None:
        raise ValueError("rows do not go from the top and columns from the left")
    rows, columns = (int(number) for number in size.groups())
    packed = np.frombuffer(rest, np.uint8, offset=size.end())
    if rows * columns > len(packed) * RUN_MAX:  # before there is memory for it
        raise ValueError(f"too short for {columns} x {rows} pixels")
    # runs are packed by rows, where a row begins with 2, 2 and its length
    if packed[:4].tolist() == [2, 2, *divmod(columns, 256)]:
        rgbe = np.empty((rows, columns, 4), np.uint8)
        at = 0
        for row in rgbe:
            at += 4
            for channel in range(4):
                at = _unpack(packed, at, row[:, channel])
    else:
        rgbe = packed[: rows * columns * 4].reshape(rows, columns, 4)
    mantissa, exponent = rgbe[..., :3].astype(np.float32), rgbe[..., 3:].astype(np.int32)
    # without Ward's half a step: as Blender and OpenImageIO read it
    return np.where(exponent > 0, np.ldexp(mantissa, exponent - 136), np.float32(0))


def _unpack(packed: np.ndarray, at: int, row: np.ndarray) -> int:
    """Fills one channel of one row from runs that begin at `at`; returns where they end."""
    filled = 0
    while filled < len(row):
        count = int(packed[at])
        # above 128: as many of one value; else so many values
        run, used = (count - 128, 1) if count > 128 else (count, count)
        if run == 0 or filled + run > len(row) or at + 1 + used > len(packed):
            raise ValueError("damaged runs")
        row[filled : filled + run] = packed[at + 1 : at + 1 + used]
        filled, at = filled + run, at + 1 + used
    return at
