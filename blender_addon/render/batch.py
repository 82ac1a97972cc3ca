# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendering many frames without a window: which frames, which files, what is written down. Does not use bpy.

A picture appears under its name only when it is whole, and a picture that is there is not made again, so a run that
was cut off goes on where it stopped. Source: BLENDER 8.2.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ..core import limits
from ..errors import JGHandFailure

_FRAMES = re.compile(r"(-?\d+)(?:-(-?\d+))?(?:,([1-9]\d*))?")


def parse_frames(text: str) -> list[int]:
    """ "7", "1-240" or "1-240,2" (every second one) -> frame numbers. ValueError says what is wanted."""
    match = _FRAMES.fullmatch(text)
    if match is None:
        raise ValueError(f"frames {text!r}: wanted FIRST, FIRST-LAST or FIRST-LAST,STEP")
    first, last, step = (int(group) if group else None for group in match.groups())
    assert first is not None  # the pattern has it
    frames = list(range(first, (first if last is None else last) + 1, step or 1))
    if not frames:
        raise ValueError(f"frames {text!r}: the last frame comes before the first")
    return frames


def picture_folder(folder: Path, camera: str) -> Path:
    """FOLDER/CAMERA; letters that a file system may refuse become _."""
    return folder / (re.sub(r"[^\w. -]", "_", camera).strip(". ") or "camera")


def picture_path(folder: Path, camera: str, frame: int) -> Path:
    """FOLDER/CAMERA/0001.png."""
    return picture_folder(folder, camera) / f"{frame:04d}.png"


def check_folders(folder: Path, cameras: Iterable[str]) -> None:
    """JGHandFailure (same_folder) when two cameras would share one, on a disk that knows no capital letters either."""
    taken: dict[str, str] = {}
    for camera in cameras:
        name = picture_folder(folder, camera).name.casefold()
        if name in taken:
            raise JGHandFailure("same_folder", f"{taken[name]} and {camera}")
        taken[name] = camera


def write_whole(path: Path, content: bytes) -> None:
    """Writes a file under a temporary name, then renames it. JGHandFailure: cannot_write, disk_full."""
    with _arriving(path) as temporary:
        with temporary.open("wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.chmod(0o644)


def copy_whole(source: Path, path: Path) -> None:
    """Copies a file, its time too, under a temporary name, then renames it: what was at `path` stays until then.
    JGHandFailure: cannot_write, disk_full."""
    with _arriving(path) as temporary:
        shutil.copy2(source, temporary)


@contextlib.contextmanager
def _arriving(path: Path) -> Iterator[Path]:
    """A temporary file beside `path`, of this process alone, that takes its place in the end."""
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=".part", dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        _replace(temporary, path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def _cannot_write(path: Path, error: OSError) -> JGHandFailure:
    kind = "disk_full" if error.errno in (errno.ENOSPC, getattr(errno, "EDQUOT", -1)) else "cannot_write"
    return JGHandFailure(kind, f"{path}: {error.strerror or error}")


def _replace(temporary: Path, path: Path) -> None:
    """Renames over what may be there. Windows refuses that while somebody, a virus scanner or an index, looks at it."""
    for rest_s in limits.REPLACE_RESTS_S if sys.platform == "win32" else ():
        try:
            os.replace(temporary, path)
        except PermissionError:
            time.sleep(rest_s)
        else:
            return
    os.replace(temporary, path)


@dataclass(frozen=True)
class PictureTimes:
    """Milliseconds of one picture. evaluate: Blender's evaluation and the reading of hands and camera, a frame's share
    alike for all its cameras; request: the engine and the way there and back; write: the file onto the disk."""

    evaluate_ms: float
    request_ms: float
    write_ms: float


@dataclass
class BatchReport:
    """What a run did, for people (progress lines) and for machines (a JSON file)."""

    blend: str
    preset: str
    total: int
    engine: dict[str, Any] = field(default_factory=dict)
    pictures: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    failure: dict[str, str] | None = None
    _started: float = field(default_factory=time.monotonic)

    def rendered(self, camera: str, frame: int, path: Path, times: PictureTimes, details: dict[str, Any]) -> str:
        """Notes a picture; returns its progress line."""
        milliseconds = times.request_ms + times.write_ms
        spent = {name: round(value, 3) for name, value in {"milliseconds": milliseconds, **asdict(times)}.items()}
        self._note(camera, frame, path, skipped=False, **spent, **details)
        done = [picture for picture in self.pictures if not picture["skipped"]]
        left_s = (self.total - len(self.pictures)) * (time.monotonic() - self._started) / len(done)
        place = f"{len(self.pictures)} of {self.total}"
        return f"frame {frame} · {camera} · {place} · {milliseconds:.0f} ms · {left_s:.0f} s left"

    def skipped(self, camera: str, frame: int, path: Path) -> str:
        """Notes a picture that was there already; returns its progress line."""
        self._note(camera, frame, path, skipped=True)
        return f"frame {frame} · {camera} · {len(self.pictures)} of {self.total} · there already"

    def failed(self, failure: JGHandFailure, log: Path | None = None) -> None:
        """Notes why the run ended early, and the file with what the engine printed."""
        advice = failure.advice
        self.failure = {
            "kind": failure.kind,
            "sentence": advice.sentence,
            "remedy": advice.remedy,
            "detail": failure.detail,
            **({"log": str(log)} if log else {}),
        }

    def as_json(self) -> bytes:
        """The whole report."""
        content = {
            "blend": self.blend,
            "preset": self.preset,
            "engine": self.engine,
            "seconds": round(time.monotonic() - self._started, 3),
            "wanted": self.total,
            "rendered": sum(not picture["skipped"] for picture in self.pictures),
            "skipped": sum(picture["skipped"] for picture in self.pictures),
            "notes": self.notes,
            "failure": self.failure,
            "pictures": self.pictures,
        }
        return json.dumps(content, indent=1).encode()

    def _note(self, camera: str, frame: int, path: Path, **more: Any) -> None:
        self.pictures.append({"frame": frame, "camera": camera, "file": str(path), **more})
