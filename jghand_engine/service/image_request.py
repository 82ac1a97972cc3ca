"""What a `render_picture` request may ask for, an image, read from its message and checked before anything is drawn.

The world of a request is the one in which trained hands learned their light: meters, +y up, +z towards whoever looks at
the palm of a hand that points up (as captures have it). A hand's own space lies in it by
`world_from_hand`, a camera by `camera_from_world`; everything is float64 or float32 on the wire and float64 here, so
that a hand far from the origin loses nothing. Joints are in the standard order. Source: BLENDER 3.2.

An image of more than one moment (motion blur) carries each, in the order of time.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jghand_engine.errors import InputError, MemoryLimitError
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.hand.sequence import HandPose
from jghand_engine.hand.wrist import unit_turns
from jghand_engine.native import contract
from jghand_engine.render.blur import Moment
from jghand_engine.render.camera import Camera, Lens
from jghand_engine.service.protocol import PAYLOAD_MAX_BYTES, WORLD, Message

# hands in one image; each costs as much as the first
IMAGE_HANDS_MAX = 16
# moments of one image with motion blur: as many as the extension may ask for
EXPOSURES_MAX = 64
# renderers of other settings are asked for one frame in so many milliseconds; a minute is no frame any more
BUDGET_MAX_MS = 60_000.0
# letters of a text among the settings of an image
SETTING_TEXT_MAX = 200
# meters of places in a request: beyond any scene, and far from where float64 overflows
REQUEST_NUMBER_MAX = 1e9
# pixels of a world's picture: suns are found in it, and more of it lights no skin
WORLD_ROWS_MAX, WORLD_COLUMNS_MAX = 256, 512
# focal length and principal point, px: a view a million times narrower than any lens is a mistake
PINHOLE_MAX_PX = 1e9
# by how much a rotation on the wire may fail to be one: twice the rounding of Blender's float32 matrices, and no scale
RIGID_MAX = 1e-4

# outputs that an image may be asked for -> bytes per pixel
OUTPUT_BYTES = {"rgba_f32": 16, "rgba_u8": 4, "depth": 4, "depth_covered": 4, "ids": 1}
JOINTS = 21


@dataclass(frozen=True)
class ImageSettings:
    """How an image is made.

    preset:    name of a preset of RenderSettings
    budget_ms: instead of the preset's, the most accurate settings that draw a frame in so many milliseconds
    """

    preset: str = "viewport"
    budget_ms: float | None = None

    @classmethod
    def parse(cls, value: Any) -> ImageSettings:
        """From the JSON object of a request; InputError names what is unknown or cannot be."""
        if not isinstance(value, dict):
            raise InputError("settings", wanted="an object", came=repr(value)[:80])
        unknown = [name for name in value if name not in _CHECKS]
        if unknown:
            raise InputError("settings", wanted=" | ".join(_CHECKS), came=", ".join(map(str, unknown))[:80])
        for name, given in value.items():
            check, wanted = _CHECKS[name]
            if not check(given):
                raise InputError(f"settings: {name}", wanted=wanted, came=repr(given)[:80])
        return cls(**value)


_CHECKS = {
    "preset": (lambda v: isinstance(v, str) and 0 < len(v) <= SETTING_TEXT_MAX, "the name of a preset"),
    "budget_ms": (
        lambda v: v is None or (type(v) in (int, float) and 0 < v <= BUDGET_MAX_MS),
        f"null, or milliseconds above 0, at most {BUDGET_MAX_MS:g}",
    ),
}


@dataclass(frozen=True)
class RequestedHand:
    """avatar: as it was loaded; handedness: "right" or "left"; forearm: whether it is shown, where there is one."""

    avatar: str
    handedness: str
    forearm: bool = True


@dataclass(frozen=True)
class RequestedLight:
    """The light of a scene, in the request's world.

    record:   lamps, how the world lies, and a key of its picture, see `avatar.light_records`: what is the same in all
              of them is the same light
    radiance: (rows, columns, 3) float32, the world's picture; None for a black world
    left:     (hands, lamps, P) uint8, what the scene's things leave of each lamp at points of each hand, 255 all; None
              where nothing stands in the light
    left_at:  (P, 3) these points on the right hand of the built-in template at rest, meters
    baked:    (hands, Q, 4, 3) all light that was found at other points, see `avatar.scene_light.Baked`; None: lamps and
              world light skin
    baked_at: (Q, 3) these points
    """

    record: dict[str, Any]
    radiance: np.ndarray | None
    left: np.ndarray | None = None
    left_at: np.ndarray | None = None
    baked: np.ndarray | None = None
    baked_at: np.ndarray | None = None


@dataclass(frozen=True)
class ImageRequest:
    """One image.

    width, height: pixels
    hands:         none for an empty image
    moments:       at least one, in the order of time; the middle one, or the one before, is the image's moment. Joints
                   in the world, cameras of that size
    weights:       of each moment in the mean of all
    depth, ids:    whether these maps are wanted
    light:         of the scene, in which colors are scene-linear; None for the light of the captures
    """

    width: int
    height: int
    hands: tuple[RequestedHand, ...]
    moments: tuple[Moment, ...]
    weights: tuple[float, ...]
    settings: ImageSettings = field(default_factory=ImageSettings)
    depth: bool = False
    ids: bool = False
    light: RequestedLight | None = None


def read_request(message: Message) -> tuple[ImageRequest, list[str]]:
    """The image that a message asks for, and the outputs it is wanted in.

    Raises InputError, or MemoryLimitError for an image that one message cannot carry.
    """
    header = message.header
    width, height = (_whole(header, name, contract.IMAGE_MAX_PX) for name in ("width", "height"))
    outputs = _outputs(header)
    _check_size(width, height, outputs)
    orthographic = header.get("orthographic", False)
    if type(orthographic) is not bool:
        raise InputError("orthographic", wanted="true or false", came=repr(orthographic)[:80])
    hands = _hands(header)
    moments, weights = _moments(message, len(hands), (width, height), orthographic=orthographic)
    return ImageRequest(
        width,
        height,
        hands,
        moments,
        weights,
        ImageSettings.parse(header.get("settings", {})),
        depth="depth" in outputs or "depth_covered" in outputs,
        ids="ids" in outputs,
        light=_light(message, len(hands)),
    ), outputs


def text_of(header: dict[str, Any], name: str) -> str:
    """A text of a header that is not empty; InputError."""
    value = header.get(name)
    if not isinstance(value, str) or not value:
        raise InputError(name, wanted="a text", came=repr(value)[:80])
    return value


def _outputs(header: dict[str, Any]) -> list[str]:
    outputs = header.get("outputs")
    if not (isinstance(outputs, list) and outputs and all(isinstance(o, str) and o in OUTPUT_BYTES for o in outputs)):
        raise InputError("outputs", wanted="a list of " + " | ".join(OUTPUT_BYTES), came=repr(outputs)[:80])
    return list(dict.fromkeys(outputs))


def _check_size(width: int, height: int, outputs: list[str]) -> None:
    """Refuses an image that one message cannot carry, before it is drawn."""
    size = width * height * sum(OUTPUT_BYTES[name] for name in outputs)
    if size > PAYLOAD_MAX_BYTES:
        raise MemoryLimitError(
            f"an image of {width} x {height} pixels",
            wanted=f"at most {PAYLOAD_MAX_BYTES} bytes in one message",
            came=f"{size}",
            remedy="Ask for a smaller image or fewer outputs.",
        )


def _hands(header: dict[str, Any]) -> tuple[RequestedHand, ...]:
    entries = header.get("hands")
    if not (isinstance(entries, list) and len(entries) <= IMAGE_HANDS_MAX):
        raise InputError("hands", wanted=f"a list of at most {IMAGE_HANDS_MAX}", came=repr(entries)[:80])
    for entry in entries:
        if not isinstance(entry, dict):
            raise InputError("hand", wanted="an object with avatar and handedness", came=repr(entry)[:80])
        if type(entry.get("forearm", True)) is not bool:
            raise InputError("hand: forearm", wanted="true or false", came=repr(entry["forearm"])[:80])
    return tuple(
        RequestedHand(text_of(entry, "avatar"), text_of(entry, "handedness"), entry.get("forearm", True))
        for entry in entries
    )


def _moments(
    message: Message, hands: int, size_px: tuple[int, int], *, orthographic: bool
) -> tuple[tuple[Moment, ...], tuple[float, ...]]:
    """Every moment and its weight: arrays pinholes (m, 4), lenses (m, 2; left out: pinholes), weights (m; left out:
    all alike), camera_from_world (m, 4, 4), and where there are hands joints (m, n, 21, 3), world_from_hand
    (m, n, 4, 4) and forearms (m, n, 4; left out: as palms carry them)."""
    came = message.arrays.get("pinholes")
    count = came.shape[0] if came is not None else 0
    if not 1 <= count <= EXPOSURES_MAX:
        wanted = f"fx, fy, cx, cy of 1 to {EXPOSURES_MAX} exposures"
        raise InputError("array pinholes", wanted=wanted, came="nothing" if came is None else str(came.shape))
    pinholes = _numbers(message, "pinholes", (count, 4))
    if not (np.abs(pinholes) < PINHOLE_MAX_PX).all() or not (pinholes[:, :2] > 0).all():
        raise InputError("array pinholes", wanted="pixels, fx and fy above 0", came=str(pinholes.tolist())[:80])
    lenses = np.tile((0.0, 1.0), (count, 1))
    if "lenses" in message.arrays:
        lenses = _numbers(message, "lenses", (count, 2))
        if not (lenses[:, 0] >= 0).all() or not (lenses[:, 1] > contract.Z_NEAR_M).all():
            wanted = f"an aperture of 0 or more and a focus beyond {contract.Z_NEAR_M:g}, meters"
            raise InputError("array lenses", wanted=wanted, came=str(lenses.tolist())[:80])
        if orthographic and lenses[:, 0].any():
            raise InputError("lenses", wanted="an aperture of 0 for an orthographic camera", came="an open lens")
    weights = np.ones(count)
    if "weights" in message.arrays:
        weights = _numbers(message, "weights", (count,))
        if not (weights >= 0).all() or not weights.sum() > 0:
            raise InputError("array weights", wanted="0 or more, not all 0", came=str(weights.tolist())[:80])
    cameras_from_world = _rigid(message, "camera_from_world", (count, 4, 4))
    joints, places = np.zeros((count, 0, JOINTS, 3)), np.zeros((count, 0, 4, 4))
    if hands:
        joints = _numbers(message, "joints", (count, hands, JOINTS, 3))
        places = _rigid(message, "world_from_hand", (count, hands, 4, 4))
    turns, offsets_m = places[..., :3, :3], places[..., None, :3, 3]
    joints_m = to_level(np.einsum("mnab,mnjb->mnja", turns, joints) + offsets_m, JointOrder.STANDARD)
    forearms = [[None] * hands] * count
    if "forearms" in message.arrays:
        forearms = unit_turns(_numbers(message, "forearms", (count, hands, 4)))
    moments = []
    for k in range(count):
        lens = Lens(*lenses[k].tolist()) if lenses[k, 0] > 0 else None
        fx, fy, cx, cy = pinholes[k].tolist()
        camera = Camera(*size_px, fx, fy, cx, cy, cameras_from_world[k], lens, orthographic)
        moments.append(Moment(list(map(HandPose, joints_m[k], forearms[k])), camera))
    return tuple(moments), tuple(weights.tolist())


def _rigid(message: Message, name: str, shape: tuple[int, ...]) -> np.ndarray:
    maps = _numbers(message, name, shape)
    turns = maps[..., :3, :3]
    errors = np.abs(np.swapaxes(turns, -1, -2) @ turns - np.eye(3))
    if not (
        (errors < RIGID_MAX).all() and (np.linalg.det(turns) > 0).all() and (maps[..., 3, :] == (0, 0, 0, 1)).all()
    ):
        raise InputError(f"array {name}", wanted="a rotation and a translation", came="a scaled or mirrored map")
    return maps


def _numbers(message: Message, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """An array of the message as float64, of exactly this shape, its numbers finite and no farther than any scene."""
    array = message.arrays.get(name)
    if array is None or array.dtype not in ("<f4", "<f8") or array.shape != shape:
        came = "nothing" if array is None else f"{array.dtype} {array.shape}"
        raise InputError(f"array {name}", wanted=f"floats of shape {shape}", came=came)
    values = np.asarray(array.view()).astype(np.float64)
    if not (np.abs(values) <= REQUEST_NUMBER_MAX).all():  # false for NaN too
        wanted = f"finite numbers up to {REQUEST_NUMBER_MAX:g}"
        raise InputError(f"array {name}", wanted=wanted, came="NaN, infinity or a larger one")
    return values


def _light(message: Message, hands: int) -> RequestedLight | None:
    """The object `light`: a list of lamps, and a world with the key of its picture, which is the array `world`; the
    arrays `left` and `left_at` where things of the scene stand in the light, `baked` and `baked_at` where it was
    baked."""
    record = message.header.get("light")
    if record is None:
        return None
    world = record.get("world") if isinstance(record, dict) else record
    if world is not None and not isinstance(world, dict):
        raise InputError("light", wanted="an object with lamps and world", came=repr(record)[:80])
    at_points = _at_points(message, record, hands)
    if world is None:
        return RequestedLight(record, None, **at_points)
    text_of(world, "key")
    came = message.arrays.get(WORLD)
    if came is None or came.dtype != "<f4" or not _is_world(came.shape):
        wanted = f"float32 of rows, columns and 3, at most {WORLD_ROWS_MAX} x {WORLD_COLUMNS_MAX} pixels"
        raise InputError("array world", wanted=wanted, came="nothing" if came is None else f"{came.dtype} {came.shape}")
    # its numbers are checked where its key is new
    return RequestedLight(record, np.asarray(came.view()), **at_points)


def _is_world(shape: tuple[int, ...]) -> bool:
    return len(shape) == 3 and shape[0] <= WORLD_ROWS_MAX and shape[1] <= WORLD_COLUMNS_MAX and shape[2] == 3


def _at_points(message: Message, record: dict[str, Any], hands: int) -> dict[str, np.ndarray]:
    """The arrays left, left_at, baked and baked_at, where they came."""
    found, lamps = {}, record.get("lamps")
    array = message.arrays.get("left")
    if array is not None:
        shape = (hands, len(lamps) if isinstance(lamps, list) else 0, array.shape[-1] if array.shape else 0)
        if array.dtype != "|u1" or array.shape != shape:
            raise InputError("array left", wanted=f"bytes of shape {shape}", came=f"{array.dtype} {array.shape}")
        found |= {"left": np.array(array.view()), "left_at": _numbers(message, "left_at", (shape[2], 3))}
    array = message.arrays.get("baked")
    if array is not None:
        points = array.shape[1] if len(array.shape) > 1 else 0
        found["baked"] = _numbers(message, "baked", (hands, points, 4, 3))
        found["baked_at"] = _numbers(message, "baked_at", (points, 3))
    return found


def _whole(header: dict[str, Any], name: str, largest: int) -> int:
    value = header.get(name)
    if type(value) is not int or not 1 <= value <= largest:
        raise InputError(name, wanted=f"a whole number from 1 to {largest}", came=repr(value)[:80])
    return value
