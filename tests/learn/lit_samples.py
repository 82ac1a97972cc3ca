"""Pictures of a hand in known light, drawn by our own renderer: a world, a sun and a lamp, each apart."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.captures.interhand_writer import RecordedHand, write_interhand
from jghand_engine.captures.known_light import KnownLight, groups_file, read_lights
from jghand_engine.captures.sample import Sample
from jghand_engine.color import linear_to_srgb, to_bytes
from jghand_engine.export.pictures import write_png
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


def write_lit_capture(folder: Path, avatar: HandAvatar) -> Path:
    """Twelve pictures of 56 x 64, of four poses by three cameras, each in another light: one pose, one camera and one
    light are for the test, and a light with them that has a spot."""
    joints_m = {number: named_pose(pose, avatar.canonical_joints_m, handedness=Handedness.RIGHT)
                for number, pose in enumerate(("open", "relaxed", "point", "fist"))}  # fmt: skip
    width, height = SIZE_PX
    middle_m = np.mean(list(joints_m.values()), axis=(0, 1))
    cameras = {}
    for number in range(3):
        eye_m = middle_m + np.array([0.45 * np.sin(2.4 * number), 0.1, 0.45 * np.cos(2.4 * number)])
        cameras[f"40000{number}"] = Camera.looking_at(
            eye_m, middle_m, [0, 1, 0], width=width, height=height, focal_px=115.0
        )
    boxes = {(frame, name): (0, 0, width, height) for frame in joints_m for name in cameras}
    hand = RecordedHand(cameras, joints_m, boxes)
    write_interhand(folder, hand)
    pictures, spot = {}, {"kind": "spot", "rgb": [0.4] * 3, "place_m": [0.1, 0.1, -0.4], "axis": [-0.2, 0.0, 1.0],
                          "radius_m": 0.01, "cone_rad": 1.0, "blend": 0.2}  # fmt: skip
    (folder / "plan" / "worlds").mkdir(parents=True)
    for place, (frame, name) in enumerate(boxes):
        light = known_light(place)
        assert light.world is not None
        np.save(folder / "plan" / "worlds" / f"{place}.npy", light.world.radiance)
        sun, point = light.lamps
        lamps = [
            {"kind": "sun", "rgb": list(sun.rgb), "place_m": list(sun.place_m), "angle_rad": sun.angle_rad},
            spot if place == 4 else {"kind": "point", "rgb": list(point.rgb), "place_m": list(point.place_m)},
        ]
        world = {"picture": f"worlds/{place}.npy", "env_from_world": np.eye(3).tolist()}
        pictures[f"{frame}/{name}"] = {"is_held_out": place == 4, "world": world, "lamps": lamps}
    (folder / "plan" / "lights.json").write_text(json.dumps({"format": 1, "pictures": pictures}))
    split = {"format": 1, "test_frames": {hand.sequence: [3]}, "test_cameras": ["400002"],
             "test_lights": {hand.sequence: ["1/400001"]}}  # fmt: skip
    (folder / "splits.json").write_text(json.dumps(split))
    renderer = SceneRenderer([avatar], RenderSettings(antialias=False), SceneLight())
    for (frame, name), known in read_lights(folder).items():
        image = hand.image(folder, frame, name)
        drawn = []
        for weight in np.eye(known.groups):
            renderer.light = known.weighted(weight[:, None] * np.ones(3))
            drawn.append(renderer.render([joints_m[frame]], cameras[name]).rgba)
        alpha = np.rint(255 * drawn[0][..., 3]).astype(np.uint8)
        groups = np.stack([rgba[..., :3] for rgba in drawn]).astype(np.float16)
        box_px = np.array([0, 0, width, height])
        image.parent.mkdir(parents=True, exist_ok=True)
        np.savez(groups_file(image), groups=groups, alpha=alpha, box_px=box_px, stamp=np.array("test"))
        rgb = to_bytes(linear_to_srgb(np.clip(groups.astype(np.float32).sum(0), 0, 1)))
        write_png(image, np.dstack([rgb, alpha]))
    return folder
