"""What the engine lets of lamps past the flesh of a finger: JSON on standard input and output, in the engine's Python.

In: start_m, end_m (3,) and radius_m of a capsule, points_m (N, 3) of skin that faces up, lamps as Blender sends them.
Out: (lamps, N) the part of each lamp that reaches each point.
"""

import json
import sys

import numpy as np
import torch

from jghand_engine.avatar.lamp_rows import LIMITS, lamp_rows, light_shares
from jghand_engine.avatar.light_records import lamps_of
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.avatar.scene_light_step import FLESH_SOFTNESS
from jghand_engine.errors import InputError
from jghand_engine.json_files import JsonObject
from jghand_engine.learn.scene_light import Flesh, Skin, lamp_at, past_flesh

ORIGIN = np.zeros(3)


def wrong(name: str, wanted: str, came: object) -> InputError:
    return InputError(name, wanted=wanted, came=repr(came))


def left(lamp: dict, skin: Skin, flesh: Flesh) -> list[float]:
    light = SceneLight(lamps=lamps_of(JsonObject({"lamps": [lamp]}, wrong)))
    row, *_ = lamp_rows(light, light_shares(light, ORIGIN, ORIGIN[None]), ORIGIN, ORIGIN[None], LIMITS)[0]
    direction, _, sine = lamp_at(row, skin.position_m)
    return past_flesh(skin, flesh, direction[:, None], FLESH_SOFTNESS, sine[:, None])[:, 0].tolist()


given = json.load(sys.stdin)
points_m = torch.tensor(given["points_m"], dtype=torch.float64)
skin = Skin(points_m, torch.tensor([0.0, 1.0, 0.0]).expand_as(points_m))
capsule = (torch.tensor([given[name]], dtype=torch.float64) for name in ("start_m", "end_m", "radius_m"))
flesh = Flesh(*capsule, hides=torch.ones(len(points_m), 1), far=torch.tensor([False]))
print(json.dumps([left(lamp, skin, flesh) for lamp in given["lamps"]]))
