"""The light of a capture in which every picture has another: a world and two lamps, some of them kept for the test.

plan/lights.json        {"format": 1, "primaries": "rec709", "up": "y", "groups": ["world", "lamp1", "lamp2"],
                         "held_out": {"worlds": […], "lamps": […]}, "pictures": {"<frame>/<camera>": {…}}}
plan/worlds/<name>.npy  (rows, columns, 3) float32 radiance, mean 1 over directions and colors; of the environments that
                        come with Blender the worker writes them, reduced, as it begins

A picture is {"is_held_out": false, "world": {"picture": "worlds/city.npy", "env_from_world": [[…]]}, "lamps": [{…}]};
keys of a lamp are the fields of avatar/scene_light.py's `Lamp`. A lamp gives 2 pi W/m2 to what faces it in the middle
of the hand, a world of radiance 1 gives pi from all sides: two lamps light a hand as much as the world does.

A picture with a held-out light has a held-out world, and each of its lamps is of a held-out kind. These are all that
show a new pose through a new camera, and one of `EVERY_PICTURE` of those that would be learned from otherwise.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jghand_engine.captures.making.skies import SKIES, sky_radiance
from jghand_engine.hand.rotations import quaternion_rotation
from jghand_engine.render.camera import Camera

FORMAT = 1
LIGHTS_FILE = "lights.json"
GROUPS = ("world", "lamp1", "lamp2")
# of pictures whose pose and camera are learned, one of so many has a held-out light
EVERY_PICTURE = 12
# part of the lamps that stand behind the hand as its camera sees it: back light is where wrong terms show
BEHIND = 0.25
# how far lamps stand, meters, and how far from the hand's middle they aim
AWAY_M = (0.35, 1.0)
AIM_M = 0.03
# across; of the real one, of one in haze, of one behind thin cloud
SUN_ANGLES_DEG = (0.53, 3.0, 12.0)
# of what faces a lamp in the middle of the hand, W/m2
IRRADIANCE = 2 * np.pi
KINDS = ("sun", "point", "spot", "area")
# never learned from: a small spot behind the hand, and an area whose light is narrowed as by a grid
HELD_OUT_KINDS = ("rim", "grid")
# digits of the numbers in the file: a millionth of a meter, a radian, a watt
DIGITS = 6


@dataclass(frozen=True)
class VariedLight:
    """Which worlds pictures are learned from, and which are kept for the test: environments of Blender, and SKIES."""

    worlds: tuple[str, ...] = (
        *("city", "courtyard", "forest", "interior", "night", "studio"),
        *("overcast", "partly_cloudy", "clear_noon", "clear_evening"),
    )
    held_out_worlds: tuple[str, ...] = ("sunrise", "sunset", "hazy_noon", "hazy_evening")

    @property
    def shipped(self) -> list[str]:
        """Those that come with Blender."""
        return [name for name in (*self.worlds, *self.held_out_worlds) if name not in SKIES]

    def sky_files(self) -> dict[str, bytes]:
        """name in the plan's folder -> content, of those that do not."""
        names = [name for name in (*self.worlds, *self.held_out_worlds) if name in SKIES]
        return {_world_file(name): _npy(sky_radiance(SKIES[name])) for name in names}


def plan_lights(
    light: VariedLight,
    vertices_m: np.ndarray,
    cameras: Sequence[Mapping[str, Camera]],
    tests: tuple[set[int], set[str]],
    seed: int,
) -> dict[str, Any]:
    """The content of lights.json. The light of a picture depends on its pose, its camera and the seed alone.

    vertices_m: (P, V, 3) of every pose · cameras: by name, of every pose · tests: poses, and cameras, that are kept for
    the test
    """
    pictures = {}
    for pose, vertices in enumerate(vertices_m):
        middle_m = vertices.astype(np.float64).mean(0)
        for number, (name, camera) in enumerate(cameras[pose].items()):
            rng = np.random.default_rng((seed, 2, pose, number))
            new = pose in tests[0], name in tests[1]
            held_out = all(new) or (not any(new) and bool(rng.random() * EVERY_PICTURE < 1))
            eye_m = np.linalg.inv(camera.camera_from_world)[:3, 3]
            behind = (middle_m - eye_m) / np.linalg.norm(middle_m - eye_m)
            kinds = rng.permutation(HELD_OUT_KINDS) if held_out else rng.choice(KINDS, 2)
            world = str(rng.choice(light.held_out_worlds if held_out else light.worlds))
            pictures[f"{pose}/{name}"] = {
                "is_held_out": held_out,
                "world": {
                    "picture": _world_file(world),
                    "env_from_world": np.round(quaternion_rotation(_unit(rng, 4)), DIGITS).tolist(),
                },
                "lamps": [random_lamp(str(kind), middle_m, behind, rng) for kind in kinds],
            }
    return {
        "format": FORMAT, "primaries": "rec709", "up": "y", "groups": list(GROUPS),
        "held_out": {"worlds": list(light.held_out_worlds), "lamps": list(HELD_OUT_KINDS)}, "pictures": pictures,
    }  # fmt: skip


def random_lamp(kind: str, middle_m: np.ndarray, behind: np.ndarray, rng: np.random.Generator) -> dict[str, Any]:
    """The record of a lamp of a kind of KINDS or HELD_OUT_KINDS around a hand. behind: (3,) unit, from the eye on."""
    towards = _unit(rng, 3)
    if rng.random() < BEHIND or kind == "rim":
        towards = behind + 0.5 * towards
        towards /= np.linalg.norm(towards)
    if kind == "sun":
        angle = float(np.radians(rng.choice(SUN_ANGLES_DEG)))
        return _record(kind="sun", rgb=[IRRADIANCE] * 3, place_m=towards, angle_rad=angle)
    away_m = float(rng.uniform(*AWAY_M))
    place_m = middle_m + away_m * towards
    axis = middle_m + rng.uniform(-AIM_M, AIM_M, 3) - place_m
    axis /= np.linalg.norm(axis)
    intensity = IRRADIANCE * away_m**2
    if kind in ("area", "grid"):
        side = np.cross(axis, _unit(rng, 3))
        size_m = rng.uniform(0.1, 0.5, 2)
        round_ = bool(rng.random() < 0.3)
        # narrowing gathers the light: the gain of RELIGHTING's table, tan h / (tan h - h) on the axis
        half = 0.5 if kind == "grid" else np.pi / 2
        gain = 1.0 if kind == "area" else np.tan(half) / (np.tan(half) - half)
        radiance = intensity / (size_m.prod() * (np.pi / 4 if round_ else 1.0)) / gain
        return _record(
            kind="area", rgb=[radiance] * 3, place_m=place_m, axis=axis, side=side / np.linalg.norm(side),
            size_m=size_m, is_ellipse=round_, spread_rad=2 * half,
        )  # fmt: skip
    small = kind == "rim"
    record = _record(
        kind="point" if kind == "point" else "spot", rgb=[intensity] * 3, place_m=place_m,
        radius_m=0.01 if small else rng.uniform(0.005, 0.06),
    )  # fmt: skip
    if kind == "point":
        return record
    cone, blend = (50.0, 0.2) if small else (rng.uniform(35, 80), rng.uniform(0.05, 0.6))
    return record | _record(axis=axis, cone_rad=np.radians(cone), blend=blend)


def _unit(rng: np.random.Generator, size: int) -> np.ndarray:
    """(size,) in any direction."""
    vector = rng.standard_normal(size)
    return vector / np.linalg.norm(vector)


def _record(**fields: Any) -> dict[str, Any]:
    return {
        name: value if isinstance(value, str | bool) else np.round(value, DIGITS).tolist()
        for name, value in fields.items()
    }


def _world_file(name: str) -> str:
    return f"worlds/{name}.npy"


def _npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def lights_bytes(content: dict[str, Any]) -> bytes:
    """As the file has it: a picture a line."""
    head = json.dumps({name: value for name, value in content.items() if name != "pictures"}, indent=1)
    pictures = ",\n".join(f"  {json.dumps(key)}: {json.dumps(one)}" for key, one in content["pictures"].items())
    return f'{head[:-2]},\n "pictures": {{\n{pictures}\n }}\n}}\n'.encode()
