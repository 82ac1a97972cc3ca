"""Films of a hand that the engine draws itself: joints, masks, light and skin are known exactly."""

from dataclasses import replace

import numpy as np
from shaped_films import FPS, poses_of

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.scene_light import SceneLight, World
from jghand_engine.color import linear_to_srgb, to_bytes
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.rotations import axis_rotation
from jghand_engine.hand.sequence import bone_directions
from jghand_engine.own.film import FilmPictures
from jghand_engine.own.hand_fit import FittedHand
from jghand_engine.own.make import Begun, Explained
from jghand_engine.own.report import FilmView
from jghand_engine.own.shape import SHAPE_COUNT
from jghand_engine.own.start import Start
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.settings import RenderSettings
from jghand_engine.track.track import MOTION_FROM_CAMERA

POSES = ("open", "relaxed", "open", "point", "open", "spread", "relaxed", "open")
WAY_M = 0.42
TONE = (0.52, 0.33, 0.27)
# a wall of another color than the skin, linear: about as bright as what lights the hand from behind
WALL_RGB = (0.19, 0.27, 0.24)


def plain_hand(count: int = 2500) -> HandAvatar:
    """Without the texture of its skin: most tests look at none, and it takes seconds to make it ready."""
    return replace(load_builtin(handedness=Handedness.RIGHT).prefix(count), detail=None)


def marked_hand(avatar: HandAvatar) -> HandAvatar:
    """Of another tone that changes slowly, with a blue mark of 12 mm in the palm and a red one on the back."""
    place_m = avatar.position_m
    rgb = np.array(TONE) * (1 + 0.15 * np.sin(place_m @ np.array([[20.0, 0, 30], [40, 30, 0], [0, 90, 60]])))
    for middle_m, color in (((0.0, 0.045, 0.012), (0.08, 0.15, 0.35)), ((0.0, 0.05, -0.015), (0.35, 0.05, 0.05))):
        near = np.linalg.norm(place_m[:, :2] - middle_m[:2], axis=1) < 0.006
        rgb[near & (np.sign(place_m[:, 2]) == np.sign(middle_m[2]))] = color
    return replace(avatar, rgb=np.clip(rgb, 0, 1).astype(np.float32))


def window_world() -> World:
    """Light from everywhere, with a wide bright part to the upper left of the camera, and a warm one to the right."""
    direction, _ = World(np.ones((16, 32, 3))).samples
    left, right = np.array([-0.5, 0.5, 0.7]), np.array([0.9, -0.1, 0.4])
    radiance = 0.45 * np.ones((16, 32, 3))
    for way, sharp, rgb in ((left, 6.0, (1.9, 2.0, 2.2)), (right, 4.0, (0.7, 0.5, 0.3))):
        radiance += np.exp(sharp * (direction @ way / np.linalg.norm(way) - 1))[..., None] * np.array(rgb)
    return World((0.55 * radiance).astype(np.float32))


def film_of(avatar: HandAvatar, world: World | None, size: tuple[int, int] = (96, 160), count: int = 8) -> FilmView:
    """The hand turns from its palm to its back. world: None: it shines with its own colors, which are display-referred
    then; size: width and height, pixels"""
    width, height = size
    focal = 3.3 * WAY_M * height
    camera = Camera(width, height, focal, focal, width / 2, height / 2, np.eye(4))
    view = replace(camera, camera_from_world=np.diag([*MOTION_FROM_CAMERA, 1.0]))
    renderer = SceneRenderer([avatar], RenderSettings(antialias=False), None if world is None else SceneLight(world))
    joints, pictures, masks = [], [], []
    for number in range(count):
        pose = named_pose(POSES[number % len(POSES)], avatar.canonical_joints_m, handedness=Handedness.RIGHT)
        turn = axis_rotation(np.array([0.0, 1.0, 0.0]), np.asarray(np.pi * number / max(count - 1, 1)))
        turn = axis_rotation(np.array([1.0, 0.0, 0.0]), np.asarray(0.3 * np.sin(2.1 * number))) @ turn
        placed = (pose - pose[3]) @ turn.T + [0.004 * np.sin(number) - 0.012, 0.0, -WAY_M]
        frame = renderer.render([placed], view)
        rgba = frame.rgba
        shown = rgba[..., :3] if world is None else linear_to_srgb(np.clip(rgba[..., :3], 0, 1))
        pictures.append(to_bytes(shown + (1 - rgba[..., 3:]) * linear_to_srgb(np.array(WALL_RGB))))
        masks.append(rgba[..., 3] > 0.5)
        joints.append(placed * MOTION_FROM_CAMERA)
    return FilmView(np.array(joints), camera, np.stack(pictures), np.stack(masks))


def explained_of(shown: FilmView, residual: np.ndarray) -> Explained:
    """A film that is fitted as it truly is, whose outlines are said to be off by so much, (F,)."""
    numbers, canonical_m, poses = np.arange(len(residual)), plain_hand().canonical_joints_m, poses_of(len(residual))
    landmarks, directions = shown.camera.project(shown.joints_m)[0], bone_directions(shown.joints_m)
    start = Start(shown.camera, Handedness.RIGHT, landmarks, directions, poses, canonical_m)
    pictures = FilmPictures(shown.pictures, numbers / FPS, numbers, "film.mp4", "ab", True)
    fitted = FittedHand(shown.camera, poses, shown.joints_m, canonical_m, np.zeros(SHAPE_COUNT), residual)
    return Explained(Begun(start, pictures, start, []), fitted, shown.masks)
