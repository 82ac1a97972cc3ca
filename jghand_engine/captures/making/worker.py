"""Starts Blender's Python with the extension's `capture/` and sees the images through. Knows no bpy.

What passes are lines of JSON; see blender_addon/capture/__main__.py, which is another program under another license.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from jghand_engine import __version__
from jghand_engine.captures.image_files import image_texts, probe_sized
from jghand_engine.captures.known_light import groups_file, read_groups
from jghand_engine.captures.making.plan import FOLDER, Job
from jghand_engine.errors import InputError, RetryError
from jghand_engine.files import write_file
from jghand_engine.json_files import JsonObject

# how long Blender may take to end, seconds, and how many lines of its last words are told
END_S = 20.0
LAST_WORDS = 4

PROJECT = Path(__file__).resolve().parents[3]
# the extension: in a checkout; around the engine in the extension's zip; else where the extension itself says it is
ADDONS = (PROJECT / "blender_addon", PROJECT)
ADDON_VARIABLE = "JGHAND_BLENDER_ADDON"
# what blender_addon/capture/scene.py writes
STAMP_KEY = "jghand-stamp"
MAKERS_FILE = "made_by.json"
_REMEDY = (
    "Give --blender-python the Python of an environment with bpy, make the project's own with scripts/test.py "
    "--only blender, or install the extra jghand[blender]."
)


@dataclass(frozen=True)
class Finished:
    """An image that is there now, how long it took, and how much of all processors."""

    job: Job
    seconds: float
    cpu_seconds: float


def fault_of(job: Job) -> str:
    """What is wrong with a job's image, by the test that opening the data set makes; '' for a whole one of the plan."""
    if not job.file.exists():
        return "missing"
    try:
        probe_sized(job.file, job.size_px, "the plan")
        stamps = {image_texts(job.file).get(STAMP_KEY)}
        if job.light:
            stamps.add(str(read_groups(groups_file(job.file), job.size_px)["stamp"]))
    except InputError as error:
        return f"broken: {error.came}"
    return "" if stamps == {job.stamp} else "made for another plan"


def find_blender_python(given: Path | None = None) -> Path:
    """A Python that can import bpy. InputError with the remedy when there is none."""
    if given is not None:
        if not given.is_file():
            raise InputError("--blender-python", wanted="a Python that can import bpy", came=f"no file {given}")
        return given
    places = ("Scripts/python.exe", "bin/python")
    for place in places:
        own = PROJECT / ".envs" / "blender" / place
        if own.is_file():
            return own
    if importlib.util.find_spec("bpy") is not None:
        return Path(sys.executable)
    raise InputError("Blender's Python", wanted="a Python that can import bpy", came="none found", remedy=_REMEDY)


def find_program() -> Path:
    """The program that Blender's Python runs. InputError where there is no extension."""
    given = os.environ.get(ADDON_VARIABLE)
    for addon in (Path(given),) if given else ADDONS:
        program = addon / "capture" / "__main__.py"
        if program.is_file():
            return program
    remedy = f"Run it from a checkout of JGHand, or set {ADDON_VARIABLE} to the folder of the Blender extension."
    raise InputError("what renders captures", wanted="JGHand's Blender extension", came="none found", remedy=remedy)


def render(folder: Path, jobs: Sequence[Job], python: Path, threads: int) -> Iterator[Finished]:
    """Renders jobs one after the other and gives each when its image is there.

    RetryError when Blender ends early or fails, with its last words; InputError when that Python has no bpy, or another
    Blender than the capture was begun with.
    """
    if not jobs:
        return
    program = find_program()
    _clear_leftovers({job.file for job in jobs})
    with tempfile.TemporaryFile() as log, _process([str(python), "-I", str(program)], folder, threads, log) as process:
        _keep_to(folder, str(_answer(process, log, python).get("ready")))
        for job in jobs:
            message = {
                "pose": job.pose, "camera": job.camera, "file": str(job.file.resolve()), "stamp": job.stamp,
                "light": job.light,
            }  # fmt: skip
            try:
                _stream(process.stdin).write(json.dumps(message) + "\n")
                _stream(process.stdin).flush()
            except OSError as error:
                raise _ended(process, log) from error
            answer = _answer(process, log, python)
            yield Finished(job, float(answer["seconds"]), float(answer["cpu_seconds"]))


def _clear_leftovers(files: set[Path]) -> None:
    """Removes what killed workers left of these images; those of other shards are of other poses, and so of other
    names. Each folder is listed once: it may hold thousands."""
    for folder in {file.parent for file in files}:
        for left in (*folder.glob(".*.*.png"), *folder.glob(".*.*.npz")):
            if left.with_name(f"{left.name[1:].split('.')[0]}.png") in files:
                left.unlink(missing_ok=True)


def _keep_to(folder: Path, blender: str) -> None:
    """Notes which programs begin the capture in `folder`. InputError when it was begun by another Blender, whose images
    differ; JGHand's version is for the reader."""
    file = folder / FOLDER / MAKERS_FILE
    if not file.exists():
        write_file(file, json.dumps({"Blender": blender, "JGHand": __version__}) + "\n")
        return
    remedy = "Take that Blender (--blender-python names its Python), or another --out."
    makers = JsonObject.of_file(file, remedy)
    makers.value("Blender", lambda begun: begun == blender, f"{blender}, which is here")


@contextlib.contextmanager
def _process(program: list[str], folder: Path, threads: int, log: IO[bytes]) -> Iterator[subprocess.Popen[str]]:
    """The worker; it ends with the block, whatever ends that."""
    command = [*program, str((folder / FOLDER).resolve()), "--threads", str(threads)]
    # Blender writes its own preferences' folder where it is told to, or in the home folder
    with tempfile.TemporaryDirectory(prefix="jghand_capture_") as profile:
        environment = {**os.environ, "BLENDER_USER_RESOURCES": profile}
        try:
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, encoding="utf-8",
                env=environment,
            )  # fmt: skip
        except OSError as error:
            raise InputError(f"cannot start {program[0]}: {error.strerror}", remedy=_REMEDY) from error
        try:
            yield process
            _stream(process.stdin).close()
            process.wait(END_S)
        finally:
            # between two images the end of its input is enough; in the middle of one nobody waits for it
            if process.poll() is None:
                process.kill()
                process.wait()
            for stream in (process.stdin, process.stdout):
                with contextlib.suppress(OSError):
                    _stream(stream).close()


def _answer(process: subprocess.Popen[str], log: IO[bytes], python: Path) -> dict[str, Any]:
    line = _stream(process.stdout).readline()
    try:
        message = json.loads(line)
    except ValueError as error:
        raise _ended(process, log) from error
    if message.get("missing"):
        raise InputError(f"{python}: {message['error']}", remedy=_REMEDY)
    if "error" in message:
        raise RetryError(
            f"Blender could not make {message.get('file', 'an image')}: {message['error']}",
            remedy="Check the disk and start the same command again: finished images are kept.",
        )
    return message


def _ended(process: subprocess.Popen[str], log: IO[bytes]) -> RetryError:
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(END_S)
    log.seek(0)
    words = log.read().decode(errors="replace").strip().splitlines()[-LAST_WORDS:]
    said = " | ".join(words) or "nothing"
    return RetryError(
        f"Blender's Python ended with exit code {process.poll()}; its last words: {said}",
        remedy="Start the same command again: finished images are kept.",
    )


def _stream(stream: IO[str] | None) -> IO[str]:
    if stream is None:
        raise RetryError("Blender's Python has no streams")
    return stream
