"""What each request to the renderer does. No socket here: images come from an `ImageSource`.

What an image may be asked for stands in `image_request`. Source: BLENDER 3.2.
"""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from jghand_engine import __version__
from jghand_engine.color import displayed
from jghand_engine.errors import InputError, JGHandError, MemoryLimitError, RetryError, is_out_of_memory
from jghand_engine.gpu.device import is_installed
from jghand_engine.native.library import GPU
from jghand_engine.service.image_request import OUTPUT_BYTES, ImageRequest, read_request, text_of
from jghand_engine.service.protocol import PROTOCOL_VERSION, Array, Message

# letters of an error's detail on the wire: with the sentence it must fit the 64 kB header
DETAIL_MAX = 8000


class Canceled(Exception):  # noqa: N818 - not an error: the client does not want the answer any more
    """A request was given up half way, because its client asked for that."""


class AvatarError(InputError):
    """An avatar that cannot be read. missing: there is no file of that name."""

    missing = False


def never() -> bool:
    """For requests that nobody cancels."""
    return False


@dataclass(frozen=True)
class RenderedImage:
    """An image with the maps that were requested.

    rgba:            (H, W, 4) float32 premultiplied, display-referred sRGB or scene-linear
    linear:          whether it is scene-linear
    report:          FrameReport as plain data
    depth_m:         (H, W) float32 along the view axis, 0 = nothing
    ids:             (H, W) uint8, 1..20 the bone that ends at that joint of the standard order, 0 = nothing
    covered_depth_m: (H, W) float32, the mean depth of all that covers a pixel, also where only blur does
    """

    rgba: np.ndarray
    report: dict[str, Any]
    depth_m: np.ndarray | None = None
    ids: np.ndarray | None = None
    covered_depth_m: np.ndarray | None = None
    linear: bool = False


@dataclass(frozen=True)
class LoadedAvatar:
    """facts: plain data for the reply; canonical_joints_m: (21, 3) float64, standard order, right hand."""

    facts: dict[str, Any]
    canonical_joints_m: np.ndarray


class ImageSource(Protocol):
    """Whoever makes the images. doing: what takes long just now, else ""."""

    doing: str

    def load(self, avatar: str) -> LoadedAvatar:
        """Loads an avatar by path ("builtin" for the one that comes with JGHand)."""
        ...

    def render(self, request: ImageRequest, canceled: Callable[[], bool]) -> RenderedImage:
        """Draws all hands (at least one) into one image, the nearer in front. `canceled` is asked between parts of
        it that take long; Canceled ends it then."""
        ...

    def rest(self) -> None:
        """Gives back the memory that only images need: nobody has asked for one for some time."""
        ...


@dataclass(frozen=True)
class Reply:
    """Header entries and arrays of a successful reply; `last` ends the process after it was sent."""

    header: dict[str, Any]
    arrays: dict[str, Array]
    last: bool = False


class Commands:
    """Answers requests. `run` raises what goes wrong; `error_header` turns that into a reply."""

    def __init__(self, source: ImageSource) -> None:
        self.source = source
        self._kinds: dict[str, Callable[[Message, Callable[[], bool]], Reply]] = {
            "info": self._info,
            "load": self._load,
            "render_picture": self._render_picture,
            "shutdown": lambda *_: Reply({}, {}, last=True),
        }

    @property
    def capabilities(self) -> list[str]:
        """What a client may ask for; "gpu" where the package is there by which a graphics card draws."""
        return [*self._kinds, *OUTPUT_BYTES, *([GPU] if is_installed() else [])]

    def run(self, message: Message, canceled: Callable[[], bool] = never) -> Reply:
        """The reply to one request. canceled: asked from time to time; Canceled is raised when it says so."""
        kind = message.header.get("kind")
        command = self._kinds.get(kind) if isinstance(kind, str) else None
        if command is None:
            raise InputError("request", wanted=" | ".join(self._kinds), came=repr(kind)[:80])
        return command(message, canceled)

    def _info(self, _: Message, _canceled: Callable[[], bool]) -> Reply:
        facts = {"engine_version": __version__, "protocol": PROTOCOL_VERSION, "pid": os.getpid()}
        return Reply({**facts, "capabilities": self.capabilities}, {})

    def _load(self, message: Message, _canceled: Callable[[], bool]) -> Reply:
        loaded = self.source.load(text_of(message.header, "avatar"))
        return Reply(loaded.facts, {"canonical_joints": _array(loaded.canonical_joints_m, np.float64)})

    def _render_picture(self, message: Message, canceled: Callable[[], bool]) -> Reply:
        request, outputs = read_request(message)
        size = (request.height, request.width)
        image = self.source.render(request, canceled) if request.hands else RenderedImage(np.zeros((*size, 4)), {})
        rgba = image.rgba

        def shown() -> np.ndarray:
            return displayed(rgba) if image.linear else rgba

        makers = {
            "rgba_f32": lambda: _array(rgba, np.float32),
            "rgba_u8": lambda: _array(np.rint(np.clip(shown(), 0.0, 1.0) * 255.0), np.uint8),
            "depth": lambda: _array(_or_nothing(image.depth_m, size), np.float32),
            "depth_covered": lambda: _array(_or_nothing(image.covered_depth_m, size), np.float32),
            "ids": lambda: _array(_or_nothing(image.ids, size), np.uint8),
        }
        reports = [image.report] if request.hands else []
        return Reply({"reports": reports, "linear": image.linear}, {name: makers[name]() for name in outputs})


def error_header(error: BaseException) -> dict[str, str]:
    """kind, sentence and detail of what went wrong, for the wire. Out of memory is an answer, not an end."""
    if isinstance(error, Canceled):
        return {"kind": "canceled", "sentence": "The request was canceled.", "detail": ""}
    kinds = ((MemoryLimitError, "out_of_memory"), (RetryError, "retry"), (InputError, "bad_input"))
    kind = next((name for known, name in kinds if isinstance(error, known)), "")
    if isinstance(error, AvatarError):
        kind = "no_avatar" if error.missing else "bad_avatar"
    if kind:
        return {"kind": kind, "sentence": str(error)[:DETAIL_MAX], "detail": ""}
    if is_out_of_memory(error):
        return {"kind": "out_of_memory", "sentence": "The image does not fit into memory.", "detail": _short(error)}
    sentence = str(error) if isinstance(error, JGHandError) else f"The renderer failed: {type(error).__name__}."
    trace = "".join(traceback.format_exception(error))[-DETAIL_MAX:]
    return {"kind": "internal", "sentence": sentence[:DETAIL_MAX], "detail": trace}


def _short(error: BaseException) -> str:
    return str(error)[:DETAIL_MAX]


def _or_nothing(values: np.ndarray | None, size: tuple[int, int]) -> np.ndarray:
    return np.zeros(size) if values is None else values


def _array(values: np.ndarray, dtype: type) -> Array:
    return Array.of(np.ascontiguousarray(values, dtype))
