"""Pictures of a hand in known light, drawn by our own renderer: a world, a sun and a lamp, each apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.captures.known_light import KnownLight
from jghand_engine.captures.sample import Sample
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.settings import RenderSettings

SIZE_PX = (56, 64)


def known_light(seed: int) -> KnownLight:
    g = np.random.default_rng(seed)
    sky = (0.3 + 0.5 * g.random((8, 16, 3))).astype(np.float32)
    sun = Lamp(LampKind.SUN, (1.5, 1.4, 1.2), tuple(g.standard_normal(3)), angle_rad=0.02)
    lamp = Lamp(LampKind.POINT, (0.3, 0.3, 0.35), (0.2, 0.3, 0.4), radius_m=0.02)
    return KnownLight(World(sky), (), (sun, lamp))


def lit_sample(folder: Path, avatar: HandAvatar, pose: str, number: int) -> Sample:
    """One picture; its groups lie in `folder`."""
    joints_m = named_pose(pose, avatar.canonical_joints_m, handedness=Handedness.RIGHT)
    turn = 2.4 * number
    eye_m = joints_m[3] + [0.45 * np.sin(turn), 0.1, 0.45 * np.cos(turn)]
    width, height = SIZE_PX
    camera = Camera.looking_at(eye_m, joints_m[3], [0, 1, 0], width=width, height=height, focal_px=115.0)
    light = replace(known_light(number), file=folder / f"image{number}.npz")
    lights = [SceneLight(light.world), *(SceneLight(None, (lamp,)) for lamp in light.lamps)]
    drawn = [SceneRenderer([avatar], RenderSettings(antialias=False), one).render([joints_m], camera) for one in lights]
    groups = np.stack([one.rgba[..., :3] for one in drawn]).astype(np.float16)
    alpha = np.rint(255 * drawn[0].rgba[..., 3]).astype(np.uint8)
    box = np.array([0, 0, width, height])
    np.savez(light.file, groups=groups, alpha=alpha, box_px=box, stamp=np.array("test"))
    return Sample(
        folder / f"image{number}.png", camera, joints_m, Handedness.RIGHT, "c", "s", number, "cam",
        light=light,
    )  # fmt: skip
