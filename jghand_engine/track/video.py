"""Pictures of a video file, one at a time, upright, of square pixels, at an even rate. An ffmpeg program decodes.

A video with uneven times between its pictures (telephones do that) is brought to an even rate by ffmpeg: every picture
then stands for its own moment, so that a motion made of them has the right speed.
"""

from __future__ import annotations

import contextlib
import math
import re
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from jghand_engine.errors import InputError, MemoryLimitError
from jghand_engine.export.video import ffmpeg_program
from jghand_engine.hand.sequence import FPS_MIN
from jghand_engine.motion.clocks import NTSC_RATES

# pictures larger than 8K are refused: a decoder takes several times their bytes before anything can be looked at
VIDEO_PIXELS_MAX = 8192 * 4320
VIDEO_EDGE_MAX_PX = 16384
# edges below this show no hand
VIDEO_EDGE_MIN_PX = 16
# pictures longer than so many times their width are refused: the second look goes along them in squares of two thirds
# of their width, at this aspect 28 of them (0.4 s)
VIDEO_ASPECT_MAX = 5.0
# larger pictures are made smaller while they are read: the detector looks at hands of 224 pixels
TRACK_EDGE_PX = 1920
# longer videos are refused, or cut off there if they do not say how long they are: some kilobytes per frame and hand
# stay in memory; nearly two hours at 30 per second
TRACK_FRAMES_MAX = 200_000
NTSC_RATE_TOLERANCE = 6e-3
# times between pictures vary where the mean rate differs from the most frequent one by more than this part; less comes
# of printing them rounded
UNEVEN_RATE_PART = 2e-3
# rates beyond this are a time base, not a rate
VIDEO_FPS_MAX = 1000.0
# seconds after which looking at a video's header is given up
VIDEO_PROBE_S = 60.0

# containers of single films; playlists and lists of files would make the decoder open what they name
_CONTAINERS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,mpegvideo,h264,hevc,m4v,flv,asf,ogg,mxf,dv,gif"
_SIZE = re.compile(r"[ ,](\d{1,7})x(\d{1,7})(?=[ ,\[]|$)")
_PIXEL_SHAPE = re.compile(r"\bSAR (\d{1,9}):(\d{1,9})\b")


@dataclass(frozen=True)
class Video:
    """A video file as its header describes it.

    width, height: of the upright frames as they are read, pixels
    fps:           the even rate that it is read at
    frames:        how many that makes, about, by the longest stream; None when the header does not say
    lone:          there is no sound and no subtitle, which might be longer than the film
    uneven:        the times between its frames vary
    turned_deg:    by how much it was turned upright
    focal_35mm:    focal length in terms of a film of 36 x 24 mm, millimeters; None where the header does not say
    """

    path: Path
    width: int
    height: int
    fps: float
    frames: int | None
    lone: bool
    uneven: bool
    turned_deg: int
    focal_35mm: float | None = None


def open_video(path: Path | str, fps: float | None = None, *, most: int | None = None) -> Video:
    """Looks at a video. fps: another rate to read it at · most: so many pictures are wanted of it; all.

    InputError for a file that is absent, empty, no video, too large or too long, and without an ffmpeg program.
    """
    file = Path(path)
    try:
        if file.is_dir() or not file.stat().st_size:
            raise InputError(f"video {file}", wanted="a video file", came="a folder" if file.is_dir() else "no bytes")
    except OSError as error:
        raise InputError(f"cannot read video {file}", came=str(error.strerror or error)) from error
    video = _described(file, _header(file), fps)
    count = video.frames or 0
    if min(count, count if most is None else most) > TRACK_FRAMES_MAX:
        raise InputError(
            f"video {file}", wanted=f"at most {TRACK_FRAMES_MAX} pictures", came=f"about {count}",
            remedy="Cut it into shorter ones, or take its beginning with --most.",
        )  # fmt: skip
    return video


def read_frames(video: Video, notes: list[str] | None = None, *, most: int | None = None) -> Iterator[np.ndarray]:
    """The frames of a video, (H, W, 3) uint8 sRGB, at most `most`, and never more than TRACK_FRAMES_MAX.

    A damaged video gives those before the damage, and `notes` gets a sentence; so does one that turns out to be too
    long. InputError when there is not one.
    """
    filters = [f"fps={video.fps:.9g}", f"scale={video.width}:{video.height}:flags=area", "setsar=1"]
    # one more than may be tells that there are more
    wanted = min(TRACK_FRAMES_MAX + 1, math.inf if most is None else most)
    command = [
        *_input(video.path), "-map", "0:V:0", "-an", "-sn", "-dn", "-vf", ",".join(filters), "-frames:v", str(wanted),
        "-f", "image2pipe", "-c:v", "ppm", "-",
    ]  # fmt: skip
    count = 0
    sentence = ""
    with tempfile.TemporaryFile() as log, _started(command, log) as process:
        assert process.stdout is not None
        while (picture := _next_picture(process.stdout, video)) is not None:
            if count == TRACK_FRAMES_MAX:
                sentence = f"{video.path} has more than {count} pictures: its first {count} were read."
                break
            count += 1
            yield picture
        else:
            process.stdout.close()
            code, words = process.wait(), _last_words(log, video.path)
            if not count:
                raise InputError(f"video {video.path}", wanted="at least one picture", came=words or "none")
            if code or words:
                why = words or f"ffmpeg ended with {code}"
                sentence = f"{video.path} is damaged or cut off: {count} pictures could be read ({why})."
            elif video.lone and video.frames and most is None and count < video.frames - max(2, video.fps):
                sentence = f"{video.path} is cut off: {count} of about {video.frames} pictures could be read."
    if notes is not None and sentence:
        notes.append(sentence)


# ---- the header ------------------------------------------------------------------------------------------------------


def _input(file: Path) -> list[str]:
    return [
        ffmpeg_program(), "-hide_banner", "-nostdin", "-loglevel", "error", "-protocol_whitelist", "file",
        "-format_whitelist", _CONTAINERS, "-max_pixels", str(VIDEO_PIXELS_MAX), "-i", f"file:{file.absolute()}",
    ]  # fmt: skip


def _header(file: Path) -> str:
    """What ffmpeg prints about a file that it is given without being told what to do with it."""
    command = ["info" if word == "error" else word for word in _input(file)]
    try:
        done = subprocess.run(
            command, capture_output=True, stdin=subprocess.DEVNULL, timeout=VIDEO_PROBE_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(
            f"video {file}", wanted="one whose header can be read",
            came=f"nothing after {VIDEO_PROBE_S:.0f} seconds",
        ) from error  # fmt: skip
    except OSError as error:
        raise InputError("video", wanted="an ffmpeg program that starts", came=str(error.strerror or error)) from error
    return done.stderr.decode("utf-8", "replace")


def _described(file: Path, header: str, fps: float | None) -> Video:
    streams = [line for line in header.splitlines() if re.search(r"Stream #.*: Video: ", line)]
    films = [line for line in streams if "attached pic" not in line]
    if not films:
        lines = [
            line for line in header.splitlines() if line.startswith("file:") or "Error" in line or "nvalid" in line
        ]
        came = lines[-1].strip()[-200:] if lines else "a file without a film in it"
        raise InputError(
            f"video {file}", wanted="a film that ffmpeg can read", came=came.replace(f"file:{file.absolute()}: ", ""),
            remedy="Check that it plays, or convert it to MP4.",
        )  # fmt: skip
    film = films[0]
    width, height = _size(file, film)
    turned = _turn(header)
    if turned % 180:
        width, height = height, width
    rate, base = _rate(film, "fps"), _rate(film, "tbr")
    rate = base if rate is None else rate
    if fps is None and rate is None:
        raise InputError(
            f"video {file}", wanted="its frames per second", came="none in its header",
            remedy="Say the rate with --fps.",
        )  # fmt: skip
    used = _ntsc(rate) if fps is None and rate is not None else float(fps or 0)
    if not FPS_MIN <= used <= VIDEO_FPS_MAX:
        wanted = f"{FPS_MIN:g} to {VIDEO_FPS_MAX:g} frames per second"
        raise InputError(f"video {file}", wanted=wanted, came=f"{used:g}", remedy="Say the rate with --fps.")
    frames = _frames(header, used)
    smaller = min(1.0, TRACK_EDGE_PX / max(width, height))
    # a base that is no rate of pictures is the clock of times that vary
    uneven = base is None or (rate is not None and abs(rate - base) > UNEVEN_RATE_PART * base)
    even_width, even_height = (max(2, 2 * round(edge * smaller / 2)) for edge in (width, height))
    lone = not re.search(r"Stream #.*: (Audio|Subtitle|Data): ", header)
    return Video(file, even_width, even_height, used, frames, lone, uneven, turned, _focal_35mm(header))


def _size(file: Path, film: str) -> tuple[int, int]:
    """Width and height in square pixels, before it is turned upright."""
    found = _SIZE.search(film)
    if found is None:
        raise InputError(f"video {file}", wanted="the size of its pictures", came="none in its header")
    coded = int(found[1]), int(found[2])
    shortest, longest = VIDEO_EDGE_MIN_PX, VIDEO_EDGE_MAX_PX
    fits = shortest <= min(coded) and max(coded) <= longest
    if not fits or coded[0] * coded[1] > VIDEO_PIXELS_MAX:
        raise InputError(
            f"video {file}",
            wanted=f"pictures of {shortest} to {longest} pixels each way and at most {VIDEO_PIXELS_MAX} in all",
            came=f"{coded[0]} x {coded[1]}",
        )
    width, height = coded[0] * _pixel_width(film), coded[1]
    if max(width, height) > VIDEO_ASPECT_MAX * min(width, height):
        raise InputError(
            f"video {file}", wanted=f"pictures at most {VIDEO_ASPECT_MAX:g} times as long as wide",
            came=f"{width:.0f} x {height}",
        )  # fmt: skip
    return max(1, round(width)), height


def _pixel_width(film: str) -> float:
    """How wide a pixel is for its height: what the container says comes last, and counts."""
    shapes = [(int(wide), int(high)) for wide, high in _PIXEL_SHAPE.findall(film)]
    wide, high = shapes[-1] if shapes else (1, 1)
    return wide / high if wide and high else 1.0


def _turn(header: str) -> int:
    """By how many degrees ffmpeg turns the pictures, a multiple of 90."""
    found = re.search(r"rotation of (-?[\d.]+) degrees", header)
    return round(float(found[1]) / 90) * 90 % 360 if found else 0


def _focal_35mm(header: str) -> float | None:
    """As telephones write it among the metadata of QuickTime files."""
    found = re.search(r"focal_length\.35mm_equivalent\s*: (\d+(?:\.\d+)?)", header)
    return float(found[1]) or None if found else None


def _rate(film: str, name: str) -> float | None:
    found = re.search(rf"([\d.]+)(k?) {name}\b", film)
    if not found:
        return None
    rate = float(found[1]) * (1000 if found[2] else 1)
    return rate if 0 < rate <= VIDEO_FPS_MAX else None


def _ntsc(rate: float) -> float:
    """29.97 is printed where 30000/1001 is meant; over an hour the difference is a frame."""
    near = [exact for exact in NTSC_RATES if abs(rate - exact) < NTSC_RATE_TOLERANCE]
    return near[0] if near else rate


def _frames(header: str, fps: float) -> int | None:
    found = re.search(r"Duration: (\d+):(\d\d):(\d\d(?:\.\d+)?)", header)
    if not found:
        return None
    seconds = 3600 * int(found[1]) + 60 * int(found[2]) + float(found[3])
    # Matroska counts from 0 on, also where the first picture comes later
    start = re.search(r"Duration: [^\n]*\bstart: (\d+(?:\.\d+)?)", header)
    if start and re.search(r"Input #0, matroska,webm", header):
        seconds -= float(start[1])
    return max(1, math.floor(seconds * fps + 0.5))


# ---- the pictures ----------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _started(command: list[str], log: IO[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """The running decoder; it is ended when nobody wants more pictures."""
    try:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log)
    except OSError as error:
        raise InputError("video", wanted="an ffmpeg program that starts", came=str(error.strerror or error)) from error
    try:
        yield process
    finally:
        process.kill()
        if process.stdout is not None:
            process.stdout.close()
        process.wait()


def _next_picture(pipe: IO[bytes], video: Video) -> np.ndarray | None:
    """The next one of the decoder's pictures, each of which says its size; None after the last whole one."""
    if pipe.readline() != b"P6\n":
        return None
    if (
        pipe.readline().split() != [str(video.width).encode(), str(video.height).encode()]
        or pipe.readline() != b"255\n"
    ):
        return None
    try:
        content = pipe.read(3 * video.width * video.height)
    except MemoryError as error:
        raise MemoryLimitError(f"video {video.path}", wanted="memory for a picture", came="none left") from error
    if len(content) < 3 * video.width * video.height:
        return None
    return np.frombuffer(content, np.uint8).reshape(video.height, video.width, 3)


def _last_words(log: IO[bytes], file: Path) -> str:
    log.seek(0)
    lines = log.read(1 << 20).decode("utf-8", "replace").strip().splitlines()
    return lines[-1].replace(f"file:{file.absolute()}: ", "")[-200:] if lines else ""
