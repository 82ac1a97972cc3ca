"""The golden cases: what is drawn and what is exported. The only file here that calls the engine."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from golden_store import read

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.learned import Ellipsoid
from jghand_engine.export.usd.package import UsdOptions, export_usd
from jghand_engine.export.usd.stage import Variant
from jghand_engine.export.web.page import WebView, export_web
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.render.blur import Moment, shutter_at
from jghand_engine.render.camera import Camera, Lens
from jghand_engine.render.renderer import Frame, HandRenderer, SceneRenderer
from jghand_engine.render.settings import ShadowMode, preset

RIGHT, LEFT = Handedness.RIGHT, Handedness.LEFT
MIDDLE_M = (0.0, 0.09, 0.0)

# ---- hands ----------------------------------------------------------------------------------------------------------


@functools.cache
def avatar_of(name: str, hand: Handedness) -> HandAvatar:
    """A shipped avatar, or the built-in one with ellipsoids in place of its balls."""
    if name != "stretched":
        return (load_builtin if name == "builtin" else load_painted)(handedness=hand)
    avatar, rng = load_builtin(handedness=hand), np.random.default_rng(7)
    assert avatar.learned is not None
    log_stretch, turns = (rng.normal(size=(len(avatar), width)).astype(np.float32) for width in (3, 4))
    shape = Ellipsoid(0.4 * log_stretch, turns)
    return replace(avatar, learned=replace(avatar.learned, ellipsoid=shape))


def joints_of(pose: str, hand: Handedness) -> np.ndarray:
    """Of the shipped avatars in a pose as joints.npz has it, right hands: the named poses of one day, for a case says
    what is drawn of joints, not what a pose is. "to_fist" are three frames on the way from an open hand."""
    joints_m = read("joints")[pose]
    return joints_m * (-1.0, 1.0, 1.0) if hand is LEFT else joints_m


# ---- cameras --------------------------------------------------------------------------------------------------------


def camera(
    eye_m: tuple[float, float, float],
    focal_px: float,
    target_m: tuple[float, float, float] = MIDDLE_M,
    size: tuple[int, int] = (176, 176),
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    **changes: Any,
) -> Camera:
    width, height = size
    eye, target, upwards = (np.array(vector, np.float64) for vector in (eye_m, target_m, up))
    return replace(Camera.looking_at(eye, target, upwards, width=width, height=height, focal_px=focal_px), **changes)


VIEWS = {
    "front": camera((0.1, 0.1, 0.5), 390),
    "back": camera((-0.1, 0.2, -0.5), 390),
    "side": camera((0.45, 0.15, 0.2), 390),
    "top": camera((0.05, 0.6, 0.2), 390, up=(0, 0, -1)),
    "far": camera((0.4, 0.5, 2.9), 2300),
    "fingertips": camera((0.05, 0.2, 0.15), 190, target_m=(0, 0.15, 0)),
    "palm": camera((0.02, 0.05, 0.09), 110, target_m=(0, 0.08, 0)),
    "parallel": camera((0.1, 0.1, 0.5), 780, orthographic=True),
    "parallel-back": camera((-0.3, 0.2, -0.5), 780, orthographic=True),
    "cut": camera((0.1, 0.1, 0.5), 420, cx=145, cy=110),
    "corner": camera((-0.1, 0.2, -0.5), 500, cx=40, cy=160),
    "odd": camera((0.3, -0.2, 0.4), 400, size=(224, 160), up=(0.5, 1, 0.1), fx=430, cx=100, cy=85),
    "small": camera((0.1, 0.1, 0.5), 110, size=(224, 224), cx=70),
    "tiny": camera((0.2, 0.2, 2.0), 190, size=(224, 224)),
}

# ---- pictures -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Picture:
    """settings: changes to the preset · scale, offset_m: of the hand; the camera goes along with the offset · lens: of
    the camera · pair: with the other hand beside · moving: part of the time between frames that the shutter is open"""

    pose: str
    avatar: str
    hand: Handedness
    preset: str
    view: str
    settings: dict[str, Any] = field(default_factory=dict)
    scale: float = 1.0
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lens: Lens | None = None
    pair: bool = False
    moving: float = 0.0

    @property
    def name(self) -> str:
        special = {
            "large": self.scale != 1, "away": any(self.offset_m), "lens": self.lens, "pair": self.pair,
            "moving": self.moving, **self.settings,
        }  # fmt: skip
        return "-".join((self.pose, self.avatar, self.hand, self.preset, self.view, *filter(special.get, special)))


# where a draft's pixel stops depends on which pixels a kernel draws together
DRAFT = {"t_stop": 1e-4}
# lenses and shutters average in linear light: groups of their own
PICTURES: dict[str, list[Picture]] = {
    "plain": [
        Picture("open", "builtin", RIGHT, "viewport", "front"),
        Picture("fist", "builtin", RIGHT, "viewport", "front"),
        Picture("relaxed", "builtin", RIGHT, "viewport", "side"),
        Picture("point", "builtin", LEFT, "viewport", "back"),
        Picture("ok", "builtin", LEFT, "viewport", "far"),
        Picture("spread", "builtin", RIGHT, "viewport", "fingertips"),
        Picture("claw", "builtin", LEFT, "viewport", "palm"),
        Picture("victory", "builtin", RIGHT, "viewport", "parallel"),
        Picture("thumb_up", "builtin", RIGHT, "viewport", "cut"),
        Picture("pinch", "builtin", LEFT, "viewport", "odd"),
        Picture("grasp", "builtin", RIGHT, "viewport", "small"),
        Picture("flat", "painted", RIGHT, "viewport", "back"),
        Picture("fist", "painted", LEFT, "viewport", "side"),
        Picture("three", "painted", LEFT, "viewport", "parallel-back"),
        Picture("call", "painted", RIGHT, "viewport", "corner"),
        Picture("rock", "painted", RIGHT, "viewport", "odd"),
        Picture("open", "builtin", LEFT, "draft", "front", DRAFT),
        Picture("fist", "painted", RIGHT, "draft", "far", DRAFT),
        Picture("fist", "builtin", LEFT, "final", "front"),
        Picture("pinch", "builtin", RIGHT, "final", "fingertips"),
        Picture("table", "builtin", RIGHT, "final", "top"),
        Picture("four", "painted", RIGHT, "final", "front"),
        Picture("ok", "painted", LEFT, "final", "cut"),
        Picture("grasp", "builtin", RIGHT, "reference", "side"),
        Picture("claw", "painted", LEFT, "reference", "parallel"),
        Picture("fist", "builtin", RIGHT, "viewport", "top", {"shadow": ShadowMode.ALWAYS, "shadow_samples": 32}),
        Picture("spread", "stretched", RIGHT, "viewport", "front"),
        Picture("fist", "stretched", LEFT, "final", "odd"),
        Picture("relaxed", "builtin", RIGHT, "viewport", "front", scale=1.2),
        Picture("relaxed", "builtin", LEFT, "viewport", "side", offset_m=(40.0, -3.0, 70.0)),
        Picture("open", "builtin", RIGHT, "viewport", "far", pair=True),
        Picture("open", "painted", RIGHT, "viewport", "tiny", {"antialias": True}),
        Picture("point", "builtin", RIGHT, "viewport", "small", {"antialias": True}),
    ],
    "lens": [
        Picture("point", "builtin", RIGHT, "viewport", "fingertips", lens=Lens(0.01, 0.15)),
        Picture("open", "builtin", LEFT, "viewport", "side", lens=Lens(0.02, 0.45)),
        Picture("fist", "painted", RIGHT, "final", "front", lens=Lens(0.03, 0.5)),
    ],
    "moving": [
        Picture("fist", "builtin", RIGHT, "viewport", "front", moving=0.5),
        Picture("spread", "builtin", LEFT, "final", "side", moving=1.0),
        Picture("fist", "painted", RIGHT, "viewport", "back", lens=Lens(0.02, 0.5), moving=0.5),
    ],
}


def drawn(picture: Picture, jitter_m: np.ndarray | float = 0.0) -> Frame:
    """jitter_m: (21, 3), added to the joints."""
    avatar, view = avatar_of(picture.avatar, picture.hand), VIEWS[picture.view]
    # repeatable: nothing of one case is kept for the next; most cases show what a kernel draws, without the filter
    fixed = {"threads": 1, "repeatable": True, "antialias": False}
    settings = replace(preset(picture.preset), **fixed | picture.settings)
    world = view.camera_from_world.copy()
    world[:3, 3] -= world[:3, :3] @ np.array(picture.offset_m)
    view = replace(view, camera_from_world=world, lens=picture.lens)

    def placed(joints_m: np.ndarray) -> np.ndarray:
        return picture.scale * joints_m + np.array(picture.offset_m) + jitter_m

    joints_m = placed(joints_of(picture.pose, picture.hand))
    if picture.pair:
        other = LEFT if picture.hand is RIGHT else RIGHT
        beside_m = placed(joints_of("fist", other)) + np.array([0.02, -0.01, 0.06])
        scene = SceneRenderer([avatar, avatar_of(picture.avatar, other)], settings)
        return scene.render([joints_m, beside_m], view)
    moments = [Moment([joints_m], view)]
    if picture.moving:
        motion = joints_of(f"to_{picture.pose}", picture.hand)
        moments = shutter_at(placed(motion), 1, picture.moving, view)
    frame = HandRenderer(avatar, settings).render_moments(moments, [1.0] * len(moments))
    return replace(frame, depth_m=frame.covered_depth_m)


# ---- exports --------------------------------------------------------------------------------------------------------


def motion_of(hand: Handedness) -> PoseSequence:
    """Three poses of a hand that turns and wanders."""
    frames = []
    for index, pose in enumerate(("open", "pinch", "fist")):
        sine, cosine = np.sin(0.4 * index), np.cos(0.4 * index)
        turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
        frames.append(joints_of(pose, hand) @ turn.T + index * np.array([0.01, -0.02, 0.03]))
    return PoseSequence(np.stack(frames), 24, hand)


@dataclass(frozen=True)
class Export:
    """write: what an avatar with its motion leaves in a folder"""

    avatar: str
    hand: Handedness
    write: Callable[[Path, HandAvatar, PoseSequence], object]

    def __call__(self, folder: Path) -> None:
        # the first Gaussians cover the whole hand evenly, and more of them would tell nothing new
        avatar = avatar_of(self.avatar, self.hand).prefix(4000)
        self.write(folder, avatar, motion_of(self.hand))


def usd(**options: Any) -> Callable[[Path, HandAvatar, PoseSequence], object]:
    cameras = {"front": VIEWS["front"], "odd": VIEWS["odd"]}
    return lambda folder, avatar, motion: export_usd(folder, avatar, motion, cameras, UsdOptions(**options))


def web(folder: Path, avatar: HandAvatar, motion: PoseSequence) -> None:
    export_web(folder, avatar, motion, WebView((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 2.2, (0.012,) * 21))


EXPORTS: dict[str, dict[str, Export]] = {
    "usd": {
        "usd-layers": Export("builtin", RIGHT, usd()),
        "usd-one-file": Export("builtin", LEFT, usd(package="usdc", radiance="linear")),
        "usd-zip": Export("painted", RIGHT, usd(package="usdz", default_variant=Variant.POINTS_SKINNED)),
    },
    "web": {"web": Export("builtin", LEFT, web)},
}
