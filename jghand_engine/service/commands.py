"""What each request to the engine does. No socket here, and no torch: pictures come from a `PictureSource`.

Joints on the wire are in the standard order, metres, in the space of their own hand; the camera of each hand maps
that space to OpenCV camera axes. Source: BLENDER 3.2.
"""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from jghand_engine import __version__, limits
from jghand_engine.errors import InputError, JGHandError, MemoryLimitError, RetryError, is_out_of_memory
from jghand_engine.service.protocol import PAYLOAD_MAX_BYTES, PROTOCOL_VERSION, Array, Message

# outputs that a picture may be asked for -> bytes per pixel (png: at most, with some room for its own bytes)
OUTPUT_BYTES = {"rgba_f32": 16, "rgba_u8": 4, "depth": 4, "png": 5}
JOINTS = 21


@dataclass(frozen=True)
class View:
    """A picture's size and pinhole in pixels, the name of a preset of RenderSettings, and whether depth is wanted."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    preset: str
    depth: bool


@dataclass(frozen=True)
class Hand:
    """avatar: as it was loaded; handedness: "right" or "left"; joints_m: (21, 3) float64, standard order, metres, hand
    space; camera_from_hand: (4, 4) float64, metres, OpenCV axes."""

    avatar: str
    handedness: str
    joints_m: np.ndarray
    camera_from_hand: np.ndarray


@dataclass(frozen=True)
class Painting:
    """rgba: (H, W, 4) float32 premultiplied, display-referred sRGB; depth_m: (H, W) float32, 0 = nothing;
    report: FrameReport as plain data."""

    rgba: np.ndarray
    depth_m: np.ndarray
    report: dict[str, Any]


@dataclass(frozen=True)
class LoadedAvatar:
    """facts: plain data for the reply; canonical_joints_m: (21, 3) float64, standard order, right hand."""

    facts: dict[str, Any]
    canonical_joints_m: np.ndarray


class PictureSource(Protocol):
    """Whoever makes the pictures: the engine, or a stand-in in a test."""

    device: str

    def load(self, avatar: str) -> LoadedAvatar:
        """Loads an avatar by path ("builtin" for the one that comes with JGHand)."""
        ...

    def render(self, hands: list[Hand], view: View) -> Painting:
        """Draws all hands (at least one) into one picture, the nearer in front."""
        ...

    def encode_png(self, rgba: np.ndarray) -> bytes:
        """A premultiplied (H, W, 4) float32 picture as the bytes of an RGBA8 PNG (straight alpha)."""
        ...


@dataclass(frozen=True)
class Reply:
    """Header entries and arrays of a successful reply; `last` ends the process after it was sent."""

    header: dict[str, Any]
    arrays: dict[str, Array]
    last: bool = False


class Commands:
    """Answers requests. `run` raises what goes wrong; `error_header` turns that into a reply."""

    def __init__(self, source: PictureSource) -> None:
        self.source = source
        self._kinds: dict[str, Callable[[Message], Reply]] = {
            "info": self._info,
            "load": self._load,
            "render_picture": self._render_picture,
            "shutdown": lambda _: Reply({}, {}, last=True),
        }

    @property
    def capabilities(self) -> list[str]:
        """What a client may ask for."""
        return [*self._kinds, *OUTPUT_BYTES]

    def run(self, message: Message) -> Reply:
        """The reply to one request."""
        kind = message.header.get("kind")
        command = self._kinds.get(kind) if isinstance(kind, str) else None
        if command is None:
            raise InputError("request", wanted=" | ".join(self._kinds), came=repr(kind)[:80])
        return command(message)

    def _info(self, _: Message) -> Reply:
        facts = {"engine_version": __version__, "protocol": PROTOCOL_VERSION, "pid": os.getpid()}
        return Reply({**facts, "device": self.source.device, "capabilities": self.capabilities}, {})

    def _load(self, message: Message) -> Reply:
        loaded = self.source.load(_text(message.header, "avatar"))
        return Reply(loaded.facts, {"canonical_joints": _array(loaded.canonical_joints_m, np.float64)})

    def _render_picture(self, message: Message) -> Reply:
        outputs = _outputs(message.header)
        view = _view(message.header, depth="depth" in outputs)
        _check_size(view, outputs)
        hands = _hands(message)
        picture = self.source.render(hands, view) if hands else _empty(view)
        rgba = picture.rgba
        makers = {
            "rgba_f32": lambda: _array(rgba, np.float32),
            "rgba_u8": lambda: _array(np.rint(np.clip(rgba, 0.0, 1.0) * 255.0), np.uint8),
            "depth": lambda: _array(picture.depth_m, np.float32),
            "png": lambda: Array.of(self.source.encode_png(rgba)),
        }
        return Reply({"reports": [picture.report] if hands else []}, {name: makers[name]() for name in outputs})


def error_header(error: BaseException) -> dict[str, str]:
    """kind, sentence and detail of what went wrong, for the wire. Out of memory is an answer, not an end."""
    kinds = ((MemoryLimitError, "out_of_memory"), (RetryError, "retry"), (InputError, "bad_input"))
    kind = next((name for known, name in kinds if isinstance(error, known)), "")
    if kind:
        return {"kind": kind, "sentence": str(error)[: limits.DETAIL_MAX], "detail": ""}
    if is_out_of_memory(error):
        return {"kind": "out_of_memory", "sentence": "The picture does not fit into memory.", "detail": _short(error)}
    sentence = str(error) if isinstance(error, JGHandError) else f"The engine failed: {type(error).__name__}."
    trace = "".join(traceback.format_exception(error))[-limits.DETAIL_MAX :]
    return {"kind": "internal", "sentence": sentence[: limits.DETAIL_MAX], "detail": trace}


def _short(error: BaseException) -> str:
    return str(error)[: limits.DETAIL_MAX]


def _view(header: dict[str, Any], *, depth: bool) -> View:
    width, height = (_whole(header, name, limits.PICTURE_MAX_PX) for name in ("width", "height"))
    fx, fy, cx, cy = (_number(header, name) for name in ("fx", "fy", "cx", "cy"))
    return View(width, height, fx, fy, cx, cy, _text(header, "preset"), depth)


def _outputs(header: dict[str, Any]) -> list[str]:
    outputs = header.get("outputs")
    if not (isinstance(outputs, list) and outputs and all(isinstance(o, str) and o in OUTPUT_BYTES for o in outputs)):
        raise InputError("outputs", wanted="a list of " + " | ".join(OUTPUT_BYTES), came=repr(outputs)[:80])
    return list(dict.fromkeys(outputs))


def _check_size(view: View, outputs: list[str]) -> None:
    """Refuses a picture that one message cannot carry, before it is drawn."""
    size = view.width * view.height * sum(OUTPUT_BYTES[name] for name in outputs)
    if size > PAYLOAD_MAX_BYTES:
        raise MemoryLimitError(
            f"a picture of {view.width} x {view.height} pixels",
            wanted=f"at most {PAYLOAD_MAX_BYTES} bytes in one message",
            came=f"{size}",
            remedy="Ask for a smaller picture or fewer outputs.",
        )


def _empty(view: View) -> Painting:
    """The picture of no hand."""
    size = (view.height, view.width)
    return Painting(np.zeros((*size, 4), np.float32), np.zeros(size, np.float32), {})


def _hands(message: Message) -> list[Hand]:
    entries = message.header.get("hands")
    if not (isinstance(entries, list) and len(entries) <= limits.PICTURE_HANDS_MAX):
        raise InputError("hands", wanted=f"a list of at most {limits.PICTURE_HANDS_MAX}", came=repr(entries)[:80])
    count = len(entries)
    if count == 0:
        return []
    joints_m = _numbers(message, "joints", (count, JOINTS, 3))
    cameras = _numbers(message, "camera_from_hand", (count, 4, 4))
    if not all(_is_rigid(camera) for camera in cameras):
        raise InputError("camera_from_hand", wanted="a rotation and a translation", came="a scaled or mirrored map")
    hands = []
    for entry, joints, camera in zip(entries, joints_m, cameras, strict=True):
        if not isinstance(entry, dict):
            raise InputError("hand", wanted="an object with avatar and handedness", came=repr(entry)[:80])
        hands.append(Hand(_text(entry, "avatar"), _text(entry, "handedness"), joints, camera))
    return hands


def _is_rigid(matrix: np.ndarray) -> bool:
    rotation = matrix[:3, :3]
    error = np.abs(rotation.T @ rotation - np.eye(3)).max()
    return bool(error < limits.RIGID_MAX and np.linalg.det(rotation) > 0 and (matrix[3] == (0, 0, 0, 1)).all())


def _numbers(message: Message, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """A finite float array of the message as float64 of exactly this shape."""
    array = message.arrays.get(name)
    if array is None or array.dtype not in ("<f4", "<f8") or array.shape != shape:
        came = "nothing" if array is None else f"{array.dtype} {array.shape}"
        raise InputError(f"array {name}", wanted=f"floats of shape {shape}", came=came)
    values = np.asarray(array.view()).astype(np.float64)
    if not np.isfinite(values).all():
        raise InputError(f"array {name}", wanted="finite numbers", came="NaN or infinity")
    return values


def _whole(header: dict[str, Any], name: str, largest: int) -> int:
    value = header.get(name)
    if type(value) is not int or not 1 <= value <= largest:
        raise InputError(name, wanted=f"a whole number from 1 to {largest}", came=repr(value)[:80])
    return value


def _number(header: dict[str, Any], name: str) -> float:
    value = header.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < limits.PINHOLE_MAX_PX:
        raise InputError(name, wanted="a number of pixels", came=repr(value)[:80])
    return float(value)


def _text(header: dict[str, Any], name: str) -> str:
    value = header.get(name)
    if not isinstance(value, str) or not value:
        raise InputError(name, wanted="a text", came=repr(value)[:80])
    return value


def _array(values: np.ndarray, dtype: type) -> Array:
    return Array.of(np.ascontiguousarray(values, dtype))
