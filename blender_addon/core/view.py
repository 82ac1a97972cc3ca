# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras, hands in their own space, the request for a picture of them, and that picture as Blender's passes.
Source: BLENDER 3.2, 6, 7.3 (what must be written where) and 8.1."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from . import protocol
from .joints import MIDDLE, WRIST
from .posing import forearm_rotations
from .stand_in import FINE_POINTS, points_m

# a hand is looked at from near: where new cameras, and the part of a view that can show hands, begin, meters
CLIP_START_M = 0.01
# the part of a view that can show a hand ends so far from its joints and the end of its forearm, meters: skin, and the
# blur of splats; it is rounded outwards to so many pixels, so that a small move keeps the picture's size
REACH_M = 0.06
# a forearm ends so far behind the wrist, in lengths from there to the middle knuckle: 14 cm behind 8.8 cm
FOREARM_LENGTH = 1.6
CROP_STEP_PX = 32
_CORNERS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), -1).reshape(-1, 3) * REACH_M

# OpenCV looks along +z with y down, Blender along -z with y up
OPENCV_FROM_BLENDER = np.diag([1.0, -1.0, -1.0, 1.0])
# the avatar that comes with the engine
BUILTIN_AVATAR = "builtin"
# avatars that the engine brings along, by name instead of file
SHIPPED_AVATARS = (BUILTIN_AVATAR, "painted")

# Trained hands learned their light in captures, where +y is up and +z looks at the viewer; in Blender +z is up and the
# viewer of the front view stands at -y. The engine's world is the captures', so that light comes from above here too.
LIGHT_FROM_WORLD = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True)
class Pinhole:
    """width, height, fx, fy, cx, cy: pixels, (0, 0) is the top-left corner; camera_from_world: (4, 4) rigid, meters,
    OpenCV axes (x right, y down, z forward). aperture_m, focus_m: diameter of a lens, 0 for none, and the depth that it
    shows sharp, meters. orthographic: parallel rays; fx and fy are pixels per meter then."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_from_world: np.ndarray
    aperture_m: float = 0.0
    focus_m: float = 1.0
    orthographic: bool = False

    def project(self, points_m: np.ndarray) -> np.ndarray:
        """World points (..., 3), meters -> (..., 3): u and v in pixels, depth along the view axis in meters."""
        p = points_m @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3]
        z = p[..., 2]
        scale = np.ones_like(z) if self.orthographic else z
        return np.stack([self.fx * p[..., 0] / scale + self.cx, self.fy * p[..., 1] / scale + self.cy, z], -1)


def pinhole_from(
    projection: np.ndarray, camera_from_world: np.ndarray, size: tuple[int, int], unit_m: float, *, orthographic: bool
) -> Pinhole:
    """The pinhole of a projection of Blender's, which maps its camera's axes to clip space.

    projection: (4, 4), scene units; camera_from_world: (4, 4) rigid, Blender's axes, meters; size: width and height in
    pixels; unit_m: meters per unit of the scene.
    """
    width, height = size
    per_m = 1.0 / unit_m if orthographic else 1.0
    # where the axis goes through the picture: a shift is in the third column, and in the fourth without perspective
    aside = projection[:2, 3] if orthographic else -projection[:2, 2]
    return Pinhole(
        width,
        height,
        fx=float(width * projection[0, 0] / 2 * per_m),
        fy=float(height * projection[1, 1] / 2 * per_m),
        cx=float(width * (1 + aside[0]) / 2),
        cy=float(height * (1 - aside[1]) / 2),
        camera_from_world=OPENCV_FROM_BLENDER @ camera_from_world,
        orthographic=orthographic,
    )


def avatar_stamp(avatar: str) -> str:
    """Changes whenever the file of an avatar does, and when it comes or goes; "" for those that the engine brings."""
    if avatar in SHIPPED_AVATARS:
        return ""
    try:
        found = Path(avatar).stat()
    except (OSError, ValueError):
        return "none"
    return f"{found.st_mtime_ns}.{found.st_size}"


@dataclass(frozen=True)
class HandInSpace:
    """joints_m: (21, 3) in hand space, standard order, meters; world_from_hand: (4, 4) rigid, meters; name: for people
    alone; forearm: whether one is shown; forearm_turn: (4,) how, see `posing.forearm_rotations`, None: as the palm
    carries it; called: what light linking may call it, see `armature.called`."""

    handedness: str
    joints_m: np.ndarray
    world_from_hand: np.ndarray
    avatar: str = BUILTIN_AVATAR
    name: str = ""
    forearm: bool = True
    forearm_turn: np.ndarray | None = None
    called: frozenset[tuple[str, ...]] = frozenset()

    @property
    def pose_bytes(self) -> bytes:
        """The same for the same pose at the same place."""
        turn = b"" if self.forearm_turn is None else self.forearm_turn.tobytes()
        return self.joints_m.tobytes() + self.world_from_hand.tobytes() + turn

    @property
    def joints_world_m(self) -> np.ndarray:
        """(21, 3) in the world, meters."""
        return self.joints_m @ self.world_from_hand[:3, :3].T + self.world_from_hand[:3, 3]


@dataclass(frozen=True)
class Moment:
    """What is seen at one moment of a picture: the same hands, in the same order, at each. weight: its part of the mean
    of all, in any unit."""

    view: Pinhole
    hands: Sequence[HandInSpace]
    weight: float = 1.0


# which things, or hands, a lamp picks by light linking: names, and whether these or all others
Picked = tuple[tuple[tuple[str, ...], ...], bool]
EVERYTHING: Picked = ((), False)
# fields of a lamp that the engine has not: see `lamps.BlenderLight`
BLOCKERS, RECEIVERS = "blockers", "receivers"


def is_picked(called: Collection[tuple[str, ...]], picked: Picked) -> bool:
    """Whether something of any of these names is among what a lamp picks."""
    names, are_these = picked
    return any(name in names for name in called) == are_these


@dataclass(frozen=True)
class SceneLight:
    """The light that a scene throws on its hands. lamps: records, see the engine's `Lamp`, in the axes of
    LIGHT_FROM_WORLD, and their BLOCKERS and RECEIVERS; world: {key, env_from_world}, None for a black one; picture:
    (rows, columns, 3) float32 of it;
    left: (hands, lamps, POINTS) uint8 what things leave of the lamps at `stand_in.points_on` hands, None for all.
    baked: (hands, FINE_POINTS, 4, 3) float32 all light at others, see the engine's `Baked`, None where it is not."""

    lamps: Sequence[Mapping[str, Any]] = ()
    world: Mapping[str, Any] | None = None
    picture: np.ndarray | None = None
    left: np.ndarray | None = None
    baked: np.ndarray | None = None

    def record(self, hands: Sequence[HandInSpace] = ()) -> dict[str, Any]:
        """As the engine takes it, beside the picture; equal for equal lights. A lamp has the numbers of those of these
        hands that it lights, where that is not all."""
        lamps = []
        for lamp in self.lamps:
            sent = {name: value for name, value in lamp.items() if name not in (BLOCKERS, RECEIVERS)}
            picked = lamp.get(RECEIVERS, EVERYTHING)
            lit = [place for place, hand in enumerate(hands) if is_picked(hand.called, picked)]
            lamps.append(sent if len(lit) == len(hands) else {**sent, "hands": lit})
        return {"lamps": lamps, "world": self.world}

    @cached_property
    def key(self) -> str:
        """Of the record and what lamps pick, and of what is left of it."""
        return repr((self.lamps, self.world)) + (
            "" if self.left is None else hashlib.blake2b(self.left.tobytes()).hexdigest()
        )


def picture_request(
    moments: Sequence[Moment],
    *,
    outputs: Sequence[str],
    preset: str,
    budget_ms: float | None = None,
    light: SceneLight | None = None,
) -> tuple[dict[str, Any], dict[str, protocol.Array]]:
    """Header and arrays of a `render_picture` request: all hands of one view in one request, at one moment or at
    several in the order of time (motion blur): the engine averages them in linear light; depth and ids are those of the
    middle one.

    outputs: of rgba_f32, rgba_u8, depth, depth_covered, ids. budget_ms: instead of the preset, what draws in that time.
    light: of the scene, in which rgba_f32 is scene-linear; None for that of the captures.
    """
    first = moments[0]
    views = [moment.view for moment in moments]
    header = {
        "kind": "render_picture",
        "width": first.view.width,
        "height": first.view.height,
        "orthographic": first.view.orthographic,
        "settings": {"preset": preset, "budget_ms": budget_ms},
        "outputs": list(outputs),
        "hands": [
            {"avatar": hand.avatar, "handedness": hand.handedness, "forearm": hand.forearm} for hand in first.hands
        ],
    }
    world_from_light = LIGHT_FROM_WORLD.T
    numbers = {
        "pinholes": [(view.fx, view.fy, view.cx, view.cy) for view in views],
        "lenses": [(view.aperture_m, view.focus_m) for view in views],
        "weights": [moment.weight for moment in moments],
        "camera_from_world": [view.camera_from_world @ world_from_light for view in views],
    }
    if first.hands:
        numbers["joints"] = [[hand.joints_m for hand in moment.hands] for moment in moments]
        numbers["world_from_hand"] = [
            [LIGHT_FROM_WORLD @ hand.world_from_hand for hand in moment.hands] for moment in moments
        ]
        turns = [[hand.forearm_turn for hand in moment.hands] for moment in moments]
        if any(turn is not None for of in turns for turn in of):
            numbers["forearms"] = [[(1, 0, 0, 0) if turn is None else turn for turn in of] for of in turns]
    arrays = {name: protocol.Array.of(np.array(values, "<f8")) for name, values in numbers.items()}
    if light is not None:
        header["light"] = light.record(first.hands)
        if light.world is not None and light.picture is not None:
            header["kept"] = light.world["key"]
            arrays[protocol.WORLD] = protocol.Array.of(np.ascontiguousarray(light.picture, "<f4"))
        if light.left is not None:
            arrays["left"], arrays["left_at"] = map(protocol.Array.of, (light.left, points_m()))
        if light.baked is not None:
            arrays["baked"], arrays["baked_at"] = map(protocol.Array.of, (light.baked, points_m(FINE_POINTS)))
    return header, arrays


# ---- the part of a view that can show hands: what is empty is neither drawn nor sent ---------------------------------


@dataclass(frozen=True)
class Part:
    """A rectangle of a view in whole pixels; (left, top) is inside, (right, bottom) just outside; y goes down."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def width(self) -> int:
        return self.right - self.left

    @property
    def height(self) -> int:
        return self.bottom - self.top

    @property
    def pixels(self) -> int:
        return self.width * self.height


def part_with(view: Pinhole, hands: Sequence[HandInSpace]) -> Part | None:
    """The part of a view outside which no hand can be; None when none can be seen."""
    if not hands:
        return None
    places_m = np.concatenate([_places_m(hand) for hand in hands])
    points = view.project((places_m[:, None] + _CORNERS).reshape(-1, 3))
    near_m = -math.inf if view.orthographic else CLIP_START_M
    if (points[:, 2] <= near_m).all():
        return None
    if (points[:, 2] <= near_m).any():  # what is beside the camera can be anywhere in the view
        return Part(0, 0, view.width, view.height)
    step = CROP_STEP_PX
    size = np.array([view.width, view.height])
    # far outside the view the numbers may be beyond what an integer holds
    first = np.clip(np.floor(points[:, :2].min(0) / step) * step, 0, size).astype(int)
    last = np.clip(np.ceil(points[:, :2].max(0) / step) * step, 0, size).astype(int)
    if (last <= first).any():
        return None
    return Part(int(first[0]), int(first[1]), int(last[0]), int(last[1]))


def _places_m(hand: HandInSpace) -> np.ndarray:
    """(N, 3) the joints in the world, meters, and where the forearm ends."""
    joints_m = hand.joints_world_m
    if not hand.forearm:
        return joints_m
    wrist_m = joints_m[WRIST]
    behind_m = wrist_m - joints_m[MIDDLE]
    if hand.forearm_turn is not None:
        behind_m = forearm_rotations(joints_m[None], hand.handedness, hand.forearm_turn[None])[0] @ behind_m
    return np.vstack([joints_m, wrist_m + FOREARM_LENGTH * behind_m])


def picture_of(view: Pinhole, part: Part, pixels_max: int) -> Pinhole:
    """The camera of the picture of a part of a view, made smaller where it has more pixels than that."""
    scale = min(1.0, math.sqrt(pixels_max / part.pixels))
    width, height = max(1, round(part.width * scale)), max(1, round(part.height * scale))
    across, down = width / part.width, height / part.height
    return replace(
        view,
        width=width,
        height=height,
        fx=view.fx * across,
        fy=view.fy * down,
        cx=(view.cx - part.left) * across,
        cy=(view.cy - part.top) * down,
    )


# ---- Blender's passes: display colors to scene-linear, depth in Blender's unit, rows from the bottom -----------------

# depth of nothing, Blender units: what Blender's own engines write, and Z combine expects
NOTHING_DEPTH = 1e10


def scene_linear(rgba: np.ndarray) -> np.ndarray:
    """(H, W, 4) premultiplied, display-referred sRGB -> the same premultiplied in linear light, float32.

    The curve is that of straight color, so alpha is divided out and multiplied in again.
    """
    out = np.zeros(rgba.shape, np.float32)
    box = covered(rgba[..., 3])
    values, alpha = rgba[box], rgba[box][..., 3]
    divisor = np.where(alpha > 0, alpha, np.float32(1))
    for channel in range(3):  # one after the other: small arrays stay in the cache
        out[box][..., channel] = linear_of(values[..., channel] / divisor) * alpha
    out[box][..., 3] = alpha
    return out


def over(rgba: np.ndarray, background: Sequence[float]) -> np.ndarray:
    """A premultiplied linear picture on an opaque color, linear too."""
    out = np.empty_like(rgba)
    out[...] = (*background, 1)
    box = covered(rgba[..., 3])
    values, behind = rgba[box], 1 - rgba[box][..., 3]
    for channel, color in enumerate(background):
        out[box][..., channel] = values[..., channel] + behind * np.float32(color)
    return out


def depth_units(depth_m: np.ndarray, unit_m: float) -> np.ndarray:
    """(H, W) meters along the view axis, 0 = nothing -> Blender units, with what a Z combine takes for nothing."""
    return np.where(depth_m > 0, depth_m / np.float32(unit_m), np.float32(NOTHING_DEPTH)).astype(np.float32)


def from_bottom(values: np.ndarray) -> np.ndarray:
    """(H, W, …) with row 0 at the top -> flat float32 as a pass of Blender takes it."""
    return np.ascontiguousarray(values[::-1], np.float32).ravel()


def covered(alpha: np.ndarray) -> tuple[slice, slice]:
    """The rows and columns outside of which a picture (H, W) is empty."""
    sides = []
    for axis in (1, 0):
        places = np.flatnonzero(alpha.any(axis))
        sides.append(slice(places[0], places[-1] + 1) if len(places) else slice(0, 0))
    return sides[0], sides[1]


def linear_of(srgb: np.ndarray) -> np.ndarray:
    """Display-referred sRGB -> linear light, float32 of any shape (IEC 61966-2-1)."""
    curve = ((np.maximum(srgb, 0) + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.where(srgb <= np.float32(0.04045), srgb / np.float32(12.92), curve)
