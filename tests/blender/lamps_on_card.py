"""How the engine lights a card with lamps: JSON on standard input and output, in the engine's Python.

In: a list of lists of lamps, as Blender sends them. Out: for each list the irradiance (3,) of a card at the origin that
faces up, W/m2.
"""

import json
import sys

import numpy as np

from jghand_engine.avatar.lamp_rows import LIMITS, irradiance_at, lamp_rows, light_shares
from jghand_engine.avatar.light_records import lamps_of
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.errors import InputError
from jghand_engine.json_files import JsonObject

UP = (0.0, 1.0, 0.0)
ORIGIN = np.zeros(3)


def wrong(name: str, wanted: str, came: object) -> InputError:
    return InputError(name, wanted=wanted, came=repr(came))


def irradiance(lamps: list[dict]) -> np.ndarray:
    light = SceneLight(lamps=lamps_of(JsonObject({"lamps": lamps}, wrong)))
    points = ORIGIN[None]
    rows, *_ = lamp_rows(light, light_shares(light, ORIGIN, points), ORIGIN, points, LIMITS)
    cosines = [max(float(row[:3] @ UP) / np.linalg.norm(row[:3]), 0.0) for row in rows]
    return np.array(cosines) @ irradiance_at(rows, points)[:, 0]


print(json.dumps([irradiance(lamps).tolist() for lamps in json.load(sys.stdin)]))
