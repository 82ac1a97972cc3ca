"""The detector: MediaPipe's hand landmarker (Apache-2.0), an optional package, and where its networks come from.

The package once held its networks and does no longer. They are taken out of the last one that did (Apache-2.0), which
pip fetches once; from then on nothing is asked of a network. JGHand ships none of it.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError, RetryError, install_extra
from jghand_engine.files import cache_folder, writing
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.track.detection import HANDS_MAX, HandDetector, SecondLook, SeenHand

# MediaPipe's own thresholds for finding a hand, for its presence and for following it
DETECTION_MIN = 0.5
PRESENCE_MIN = 0.5
FOLLOWING_MIN = 0.5

# seconds after which fetching its networks, 35 MB, is given up
FETCH_MODEL_S = 600.0

VARIABLE = "JGHAND_HAND_MODEL"
FILE_NAME = "hand_landmarker.task"
HOLDER = "mediapipe==0.10.21"
# the package is the same for every system as far as the networks are concerned: one is named, so that any Python can
# fetch it
_HOLDER_PLATFORM = ("--python-version", "3.11", "--platform", "manylinux_2_28_x86_64", "--only-binary", ":all:")
# place in the package, name in the bundle, SHA-256
_NETWORKS = (
    (
        "mediapipe/modules/palm_detection/palm_detection_full.tflite",
        "hand_detector.tflite",
        "1b14e9422c6ad006cde6581a46c8b90dd573c07ab7f3934b5589e7cea3f89a54",
    ),
    (
        "mediapipe/modules/hand_landmark/hand_landmark_full.tflite",
        "hand_landmarks_detector.tflite",
        "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3",
    ),
)

# from this version on the label is that of the hand itself; before, that of its mirror image
_FIRST_VERSION = 1


class MediaPipeHands:
    """Finds hands in the pictures of one video. It is a `HandDetector`, and a context that closes it.

    InputError without the package, with one that is too old, or without its networks.
    """

    def __init__(self, model: Path | None = None, *, follows: bool = True) -> None:
        """model: its networks, see `model_file` · follows: frames of a video, in which the place of a hand helps
        to find it again; else each image is looked at for itself."""
        self._package = check_package()
        from mediapipe.tasks import python as tasks
        from mediapipe.tasks.python import vision

        path = model_file(model)
        options = vision.HandLandmarkerOptions(
            base_options=tasks.BaseOptions(model_asset_path=str(path)),
            running_mode=vision.RunningMode.VIDEO if follows else vision.RunningMode.IMAGE,
            num_hands=HANDS_MAX,
            min_hand_detection_confidence=DETECTION_MIN,
            min_hand_presence_confidence=PRESENCE_MIN,
            min_tracking_confidence=FOLLOWING_MIN,
        )
        self._follows, self._last_ms, self._warm = follows, -1, False
        try:
            with _quiet():
                self._landmarker: Any = vision.HandLandmarker.create_from_options(options)
        except OSError as error:  # the file of the networks was found before
            raise InputError(
                "tracking", wanted="the system's libraries that MediaPipe loads", came=str(error)[:200],
                remedy="Install what it names; on Debian and Ubuntu: apt-get install libgles2 libegl1.",
            ) from error  # fmt: skip
        except (RuntimeError, ValueError) as error:
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

    def __enter__(self) -> MediaPipeHands:
        return self

    def __exit__(self, *_: object) -> None:
        self._landmarker.close()


@contextlib.contextmanager
def video_detector(model: Path | None = None) -> Iterator[HandDetector]:
    """The detector for the pictures of one video: it follows hands, and looks twice where it sees none.

    InputError as of MediaPipeHands.
    """
    with MediaPipeHands(model) as whole, MediaPipeHands(model, follows=False) as part:
        yield SecondLook(whole, part)


def check_package() -> Any:
    """MediaPipe. InputError without the package, and with one that is too old."""
    try:
        with _quiet():
            import mediapipe
            import mediapipe.tasks.python.vision  # slow, and it prints
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
    return mediapipe


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


# ---- its networks ----------------------------------------------------------------------------------------------------


def model_file(named: Path | None = None) -> Path:
    """The bundle of networks: the one that is named, here or by JGHAND_HAND_MODEL, or the one that was fetched.

    InputError says how to get it where there is none.
    """
    given = named or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
    if given is not None:
        if not given.is_file():
            raise InputError(f"hand model {given}", wanted="a .task file", came="no file of that name")
        return given
    for place in _places():
        if place.is_file():
            return place
    raise InputError(
        "hand model", wanted=f"{FILE_NAME}, the networks that find a hand", came="none on this machine",
        remedy=f"Fetch it once (35 MB) with --fetch-model, or name one in {VARIABLE}.",
    )  # fmt: skip


def fetch_model() -> Path:
    """Fetches the networks with pip and bundles them; at once if they are there. RetryError when pip fails, InputError
    as of `bundle` when what came is something else."""
    for place in _places():
        if place.is_file():
            return place
    with tempfile.TemporaryDirectory(prefix="jghand_") as folder:
        command = [sys.executable, "-m", "pip", "download", HOLDER, "--no-deps", *_HOLDER_PLATFORM, "--dest", folder]
        try:
            done = subprocess.run(
                [*command, "--quiet", "--disable-pip-version-check"],
                stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", check=False,
                timeout=FETCH_MODEL_S,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as error:
            raise RetryError("cannot fetch the hand model with pip", came=str(error)[:200]) from error
        wheels = sorted(Path(folder).glob("*.whl"))
        if done.returncode or not wheels:
            lines = (done.stderr + done.stdout).strip().splitlines()
            raise RetryError(
                "cannot fetch the hand model with pip", came=lines[-1][:200] if lines else f"code {done.returncode}",
                remedy=f"Look whether this works: {' '.join(command)}",
            )  # fmt: skip
        return bundle(wheels[0], _writable_place())


def bundle(package: Path, target: Path) -> Path:
    """Writes the bundle from a wheel of the package that holds the networks. InputError when it does not hold them."""
    try:
        with zipfile.ZipFile(package) as wheel:
            contents = [wheel.read(place) for place, _, _ in _NETWORKS]
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(f"{package}", wanted=f"the package {HOLDER}", came=str(error)[:200]) from error
    for content, (place, _, digest) in zip(contents, _NETWORKS, strict=True):
        if hashlib.sha256(content).hexdigest() != digest:
            raise InputError(f"{package}: {place}", wanted=f"the network of {HOLDER}", came="another one")
    # stored, not packed: MediaPipe reads them where they lie. A date of its own would make every bundle another file
    with writing(target) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for content, (_, name, _) in zip(contents, _NETWORKS, strict=True):
            archive.writestr(zipfile.ZipInfo(name), content)
    return target


def _places() -> tuple[Path, Path]:
    """Beside the Python that has the package, or among this user's caches."""
    return Path(sys.prefix) / "share" / "jghand" / FILE_NAME, cache_folder() / "models" / FILE_NAME


def _writable_place() -> Path:
    beside, cached = _places()
    return beside if sys.prefix != sys.base_prefix and os.access(sys.prefix, os.W_OK) else cached
