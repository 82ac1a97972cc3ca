"""The detector: MediaPipe's hand landmarker (Apache-2.0), an optional package that works without a network."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError, install_extra
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.track.detection import HANDS_MAX, HandDetector, SeenHand
from jghand_engine.track.model_file import model_file
from jghand_engine.track.second_look import SecondLook

# MediaPipe's own thresholds for finding a hand, for its presence and for following it
DETECTION_MIN = 0.5
PRESENCE_MIN = 0.5
FOLLOWING_MIN = 0.5

# from this version on the label is that of the hand itself; before, that of its mirror image
_FIRST_VERSION = 1


class MediaPipeHands:
    """Finds hands in the pictures of one video. It is a `HandDetector`, and a context that closes it.

    InputError without the package, with one that is too old, or without its networks.
    """

    def __init__(self, model: Path | None = None, *, follows: bool = True) -> None:
        """model: its networks, see `model_file` · follows: pictures of a video, in which the place of a hand helps to
        find it again; else each is looked at for itself."""
        package = _package()
        path = model_file(model)
        tasks = package.tasks
        mode = tasks.vision.RunningMode
        options = tasks.vision.HandLandmarkerOptions(
            base_options=tasks.BaseOptions(model_asset_path=str(path)),
            running_mode=mode.VIDEO if follows else mode.IMAGE,
            num_hands=HANDS_MAX,
            min_hand_detection_confidence=DETECTION_MIN,
            min_hand_presence_confidence=PRESENCE_MIN,
            min_tracking_confidence=FOLLOWING_MIN,
        )
        self._package, self._follows, self._last_ms, self._warm = package, follows, -1, False
        try:
            with _quiet():
                self._landmarker: Any = tasks.vision.HandLandmarker.create_from_options(options)
        except (RuntimeError, ValueError, OSError) as error:
            raise InputError(
                f"hand model {path}", wanted="MediaPipe's hand landmarker", came=str(error)[:200]
            ) from error

    def detect(self, rgb8: np.ndarray, time_s: float) -> list[SeenHand]:
        """Hands in a picture (H, W, 3) uint8, at most two."""
        picture = self._package.Image(
            image_format=self._package.ImageFormat.SRGB, data=np.ascontiguousarray(rgb8, dtype=np.uint8)
        )
        # its first picture makes it print a warning of no use
        with contextlib.nullcontext() if self._warm else _quiet():
            if self._follows:
                # whole milliseconds that must grow
                self._last_ms = max(round(1000 * time_s), self._last_ms + 1)
                found = self._landmarker.detect_for_video(picture, self._last_ms)
            else:
                found = self._landmarker.detect(picture)
        self._warm = True
        height, width = rgb8.shape[:2]
        hands = []
        for flat, space, label in zip(found.hand_landmarks, found.hand_world_landmarks, found.handedness, strict=True):
            image = np.array([(point.x * width, point.y * height) for point in flat])
            image = np.concatenate([image, np.zeros((len(image), 1))], 1)
            solid = np.array([(point.x, point.y, point.z) for point in space])
            if not (np.isfinite(image).all() and np.isfinite(solid).all()):
                continue
            hand = Handedness.RIGHT if label[0].category_name == "Right" else Handedness.LEFT
            level_px = to_level(image, JointOrder.STANDARD)[:, :2]
            hands.append(SeenHand(level_px, to_level(solid, JointOrder.STANDARD), hand, float(label[0].score)))
        return hands

    def close(self) -> None:
        """Gives back its networks."""
        self._landmarker.close()

    def __enter__(self) -> MediaPipeHands:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextlib.contextmanager
def video_detector(model: Path | None = None) -> Iterator[HandDetector]:
    """The detector for the pictures of one video: it follows hands, and looks twice where it sees none.

    InputError as of MediaPipeHands.
    """
    with MediaPipeHands(model) as whole, MediaPipeHands(model, follows=False) as part:
        yield SecondLook(whole, part)


def check_package() -> None:
    """InputError without the package, and with one that is too old."""
    _package()


def _package() -> Any:
    try:
        with _quiet():
            import mediapipe
            from mediapipe.tasks import python as tasks
            from mediapipe.tasks.python import vision
    except ImportError as error:
        raise InputError(
            "tracking", wanted="the package MediaPipe", came=str(error)[:200],
            remedy=install_extra("track"),
        ) from error  # fmt: skip
    version = str(getattr(mediapipe, "__version__", "0"))
    if not version.split(".")[0].isdigit() or int(version.split(".")[0]) < _FIRST_VERSION:
        raise InputError(
            "tracking", wanted=f"MediaPipe {_FIRST_VERSION}.0 or newer, which tells left from right as hands are",
            came=version, remedy=install_extra("track"),
        )  # fmt: skip
    return _Package(mediapipe, tasks, vision)


class _Package:
    """The parts of MediaPipe that are used, under names that do not depend on how it is imported."""

    def __init__(self, mediapipe: Any, tasks: Any, vision: Any) -> None:
        self.Image, self.ImageFormat = mediapipe.Image, mediapipe.ImageFormat
        self.tasks = tasks
        self.tasks.vision = vision


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without the lines that its C++ part prints while it starts: they say nothing to a user."""
    try:
        number = sys.stderr.fileno()
        kept = os.dup(number)
    except (AttributeError, OSError, ValueError):  # no real standard error, as in tests
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            sys.stderr.flush()
            os.dup2(nowhere.fileno(), number)
            yield
    finally:
        os.dup2(kept, number)
        os.close(kept)
