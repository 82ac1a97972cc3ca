"""The built-in hand in the light of a studio, and in that of five scenes; or in Blender's, as a window showed it.

python scripts/show_light.py [--out docs/light.webp] [--avatar builtin]

python scripts/test_in_blender.py light
python scripts/show_light.py --window build/in_blender/light --out docs/scene_light.webp
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from PIL import Image

from jghand_engine.avatar.builtin import load_avatar_called
from jghand_engine.avatar.light_records import light_of
from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.export.light_file import ENV_FROM_WORLD
from jghand_engine.export.pictures import flatten
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.render.framing import framing_camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset

POSES = ("open", "fist")
SIZE, BACKGROUND = (420, 460), (0.12, 0.12, 0.12)


def sky(strength: float) -> World:
    """Blue above, brown below, W/(m2 sr)."""
    rows = np.linspace(1, 0, 32)[:, None, None] ** 2
    colors = rows * np.array([0.45, 0.6, 1.0]) + (1 - rows) * np.array([0.2, 0.15, 0.1])
    return World(strength * np.broadcast_to(colors, (32, 64, 3)), ENV_FROM_WORLD)


def point(place_m: tuple[float, float, float], *rgb: float) -> Lamp:
    """A lamp of 2 cm, W/sr."""
    return Lamp(LampKind.POINT, (rgb[0], rgb[1], rgb[2]), place_m, radius_m=0.02)


SUN = Lamp(LampKind.SUN, (3.6, 3.2, 2.6), (0.8, 0.7, 0.6), angle_rad=0.01)
WINDOW = Lamp(LampKind.AREA, (6.0, 5.6, 5.0), (-0.5, 0.2, 0.4), (0.8, -0.2, -0.6), size_m=(0.4, 0.5))
BEHIND = Lamp(LampKind.SPOT, (1.2, 1.2, 1.2), (0.15, 0.35, -0.4), (-0.15, -0.25, 0.4), radius_m=0.03, cone_rad=1.2)
LIGHTS: dict[str, SceneLight | None] = {
    "studio": None,
    "sky": light_of((), sky(2.0)),
    "sun": light_of((SUN,), sky(0.25)),
    "window": light_of((WINDOW,), sky(0.08)),
    "two lamps": light_of((point((-0.3, 0.1, 0.2), 0.4, 0.06, 0.03), point((0.3, 0.2, 0.2), 0.05, 0.1, 0.4)), None),
    "from behind": light_of((BEHIND,), sky(0.1)),
}


# pictures of the story tests/in_blender/light.py, the part of each that shows the hand, and how large it becomes
SHEET = (
    (("*_lamp_before_it", (270, 150, 830, 710), (480, 480)), ("*_lamp_behind_it", (270, 150, 830, 710), (480, 480)),
     ("*_cube_before_lamp", (270, 150, 830, 710), (480, 480))),
    (("*_material_preview", (240, 160, 960, 640), (720, 480)), ("mesh_hand_beside_it", (0, 0, 480, 320), (720, 480))),
)  # fmt: skip


@dataclass(frozen=True)
class Options:
    """out: the picture · avatar: a .jghand file or builtin · window: a folder with the story's pictures"""

    out: Path = Path("docs/light.webp")
    avatar: str = "builtin"
    window: Path | None = None


def in_window(folder: Path) -> list[np.ndarray]:
    """The rows of a sheet."""

    def shown(name: str, box_px: tuple[int, int, int, int], size_px: tuple[int, int]) -> np.ndarray:
        (path,) = folder.glob(f"{name}.png")
        return np.asarray(Image.open(path).convert("RGB").crop(box_px).resize(size_px, Image.Resampling.LANCZOS))

    return [np.concatenate([shown(*each) for each in row], 1) for row in SHEET]


def main(options: Options) -> None:
    rows = in_window(options.window) if options.window is not None else lit(options.avatar)
    Image.fromarray(np.concatenate(rows)).save(options.out, quality=88)


def lit(name: str) -> list[np.ndarray]:
    """The same, of an avatar."""
    avatar = load_avatar_called(name).for_hand(Handedness.RIGHT)
    rows = []
    for pose in POSES:
        joints_m = named_pose(pose, avatar.rest_joints_m, handedness=Handedness.RIGHT, fist=avatar.fist)
        camera = framing_camera(joints_m[None], Handedness.RIGHT, "front", width=SIZE[0], height=SIZE[1])
        frames = [HandRenderer(avatar, preset("final"), light).render(joints_m, camera) for light in LIGHTS.values()]
        rows.append(np.concatenate([flatten(frame.displayed(), BACKGROUND) for frame in frames], 1))
    return rows


if __name__ == "__main__":
    main(tyro.cli(Options))
