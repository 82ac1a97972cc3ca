"""H.264 video, made by an ffmpeg program that runs as a separate process and is fed raw pictures through a pipe.

The program comes with the optional package imageio-ffmpeg (extra `video`).
"""

from __future__ import annotations

import contextlib
import itertools
import math
import mmap
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO

import numpy as np

from jghand_engine.errors import InputError, RetryError, install_extra
from jghand_engine.files import writing

# constant rate factor of H.264: 18 is visually without loss
CRF = 18
# what a video says of itself
_MADE_BY = "Made by JGHand"
# how the numbers are to be read: without these a player may take small pictures for the older standard of television
COLOR_TAGS = "range=tv:colorspace=bt709:color_primaries=bt709:color_trc=iec61966-2-1"


def ffmpeg_program() -> str:
    try:
        import imageio_ffmpeg

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        raise InputError(
            "video", wanted="an ffmpeg program", came="none",
            remedy=f"{install_extra('video')} Or set IMAGEIO_FFMPEG_EXE to your own ffmpeg.",
        ) from error  # fmt: skip


def check_video_name(option: str, path: Path) -> None:
    """InputError unless `path`, which `option` gave, says that it is what `write_video` writes."""
    if path.suffix.lower() != ".mp4":
        raise InputError(f"{option} {path}", wanted="a name that ends in .mp4", came=repr(path.suffix))


def refuse_foreign_video(option: str, path: Path) -> None:
    """InputError where `path`, which `option` gave, is a file that `write_video` did not write: it would be lost."""
    if not path.is_file() or not path.stat().st_size:
        return
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        ours = content.find(_MADE_BY.encode()) >= 0
    if not ours:
        raise InputError(
            f"{option} {path}", wanted="a new name, or that of a video by JGHand", came="another file",
            remedy="Choose another name.",
        )  # fmt: skip


def padded_to_even(rgb8: np.ndarray) -> np.ndarray:
    """(H, W, 3) with the last row or column repeated where H or W is odd: H.264 in yuv420p wants even sizes."""
    height, width, _ = rgb8.shape
    return np.pad(rgb8, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def write_video(path: Path | str, pictures: Iterable[np.ndarray], fps: float) -> int:
    """Writes pictures (H, W, 3) uint8, all of one size, as an MP4 (H.264, yuv420p); returns how many there were.

    The file appears only when it is complete. Raises InputError for no pictures, for unequal sizes, for a rate that is
    none, where ffmpeg is missing or does not start, and where the folder may not be written; RetryError when ffmpeg
    fails, with its last words, or the disk is full.
    """
    if not (math.isfinite(fps) and fps > 0):
        raise InputError("video fps", wanted="a finite number above 0", came=str(fps))
    program = ffmpeg_program()
    stream = iter(pictures)
    first = next(stream, None)
    if first is None:
        raise InputError(f"video {path}", wanted="at least one picture", came="none")
    first = padded_to_even(_checked(first, None))
    height, width, _ = first.shape
    with writing(path) as temporary, tempfile.TemporaryFile() as log:
        command = _command(program, (width, height), fps, temporary)
        count = 0
        with _running(command, log, path) as pipe:
            for picture in itertools.chain([first], stream):
                pipe.write(np.ascontiguousarray(padded_to_even(_checked(picture, (height, width)))).tobytes())
                count += 1
    return count


def _command(program: str, size: tuple[int, int], fps: float, target: Path) -> list[str]:
    """ffmpeg's arguments: raw pictures of `size` (width, height) on standard input become an H.264 file."""
    colors = f"scale=out_color_matrix=bt709:out_range=tv,setparams={COLOR_TAGS}"
    return [
        program, "-y", "-loglevel", "error",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:g}", "-i", "-",
        "-an", "-vf", colors, "-c:v", "libx264", "-preset", "medium", "-crf", str(CRF),
        "-pix_fmt", "yuv420p", "-metadata", f"comment={_MADE_BY}", "-movflags", "+faststart", "-f", "mp4", str(target),
    ]  # fmt: skip


@contextlib.contextmanager
def _running(command: list[str], log: IO[bytes], path: Path | str) -> Iterator[IO[bytes]]:
    """Runs ffmpeg, gives its standard input, waits for its end and turns a failure into a typed error."""
    try:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=log)
    except OSError as error:
        raise InputError(
            "video", wanted="an ffmpeg program that starts", came=f"{command[0]}: {error.strerror or error}"
        ) from error
    assert process.stdin is not None
    broken = False
    try:
        yield process.stdin
    except BrokenPipeError:
        broken = True
    except BaseException:
        process.kill()
        raise
    finally:
        with contextlib.suppress(OSError):
            process.stdin.close()
        code = process.wait()
    if code or broken:
        log.seek(0)
        lines = log.read().decode("utf-8", "replace").strip().splitlines()
        reason = lines[-1] if lines else f"it ended with code {code}"
        if any("No space left" in line for line in lines):
            raise RetryError(f"cannot write {path}: the disk is full", remedy="Free some space and try again.")
        raise RetryError(f"ffmpeg could not write {path}", came=reason, remedy="Try again, or leave the video out.")


def _checked(picture: np.ndarray, even_size: tuple[int, int] | None) -> np.ndarray:
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise InputError("video picture", wanted="shape (H, W, 3) uint8", came=f"{picture.shape} {picture.dtype}")
    size = tuple(edge + edge % 2 for edge in picture.shape[:2])
    if even_size and size != even_size:
        raise InputError("video picture", wanted=f"the size of the first, {even_size}", came=str(size))
    return picture
