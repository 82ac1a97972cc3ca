"""The networks of the hand detector: where they are, and how they come there.

MediaPipe's package once held them and does no longer. They are taken out of the last one that did (Apache-2.0), which
pip fetches once; from then on nothing is asked of a network. JGHand ships none of it.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
from importlib.util import find_spec
from pathlib import Path

from jghand_engine.errors import InputError, RetryError
from jghand_engine.files import cache_folder, writing

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
        remedy="Fetch it once (35 MB) with --fetch-model, or name one with --model.",
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


def has_detector() -> bool:
    """Whether the detector's package and its networks are both here."""
    if find_spec("mediapipe") is None:
        return False
    try:
        model_file()
    except InputError:
        return False
    return True


def _places() -> tuple[Path, Path]:
    """Beside the Python that has the package, or among this user's caches."""
    return Path(sys.prefix) / "share" / "jghand" / FILE_NAME, cache_folder() / "models" / FILE_NAME


def _writable_place() -> Path:
    beside, cached = _places()
    return beside if sys.prefix != sys.base_prefix and os.access(sys.prefix, os.W_OK) else cached
