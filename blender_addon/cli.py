# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders the hands of a .blend file without a window: joints from Blender, pictures from the engine.

    render_blend.py FILE.blend --camera CamPalm,CamSide --frames 1-60 --out FOLDER

The engine runs in a process of its own (--engine-python, the variable
JGHAND_ENGINE_PYTHON, .envs/engine of this checkout, or `jghand` on the PATH). Writes FOLDER/CAMERA/0001.png, RGBA with
straight alpha; pictures that are there already are skipped, when they were made from the same file with the same
settings and the same engine. Every armature of the file that is a JGHand hand and not
disabled in renders is drawn, several hands in one picture.

Exit codes: 0 done, 1 a mistake in JGHand, 2 bad input, 3 try again, 4 out of memory, 130 interrupted. The report is
written whatever the end.
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import bpy

from .bridge import armature, camera, scene, sources
from .core import batch, limits, stamp
from .core.client import EngineClient
from .core.engine_command import engine_command
from .core.messages import BAD_INPUT, JGHandFailure
from .core.view import BUILTIN_AVATAR, SHIPPED_AVATARS, HandInSpace, Pinhole, picture_request


def main(arguments: list[str] | None = None, *, checkout: Path | None = None) -> int:
    """Renders what the command line asks for; returns the exit code.

    checkout: a folder that may hold .envs/engine.
    """
    options = _parser().parse_args(arguments)
    report = batch.BatchReport(str(options.file), options.preset, total=0)
    failure = _failure_of(lambda: _render(options, report, checkout))
    if failure is not None:
        log = _keep_log(failure, options)
        report.failed(failure, log)
        _tell(failure, log)
    if options.report is not None:
        unwritten = _failure_of(lambda: batch.write_whole(options.report, report.as_json()))
        if unwritten is not None:
            _tell(unwritten)
            failure = failure or unwritten
    return failure.advice.exit_code if failure else 0


def _failure_of(step: Callable[[], None]) -> JGHandFailure | None:
    """Does one step of a run; returns what ended it early, whatever that was."""
    try:
        step()
    except JGHandFailure as failure:
        return failure
    except KeyboardInterrupt:
        return JGHandFailure("interrupted")
    except Exception as error:  # a mistake of ours: the report must not look like that of a run that went well
        traceback.print_exc()
        return JGHandFailure("internal", f"{type(error).__name__}: {error}")
    return None


def _tell(failure: JGHandFailure, log: Path | None = None) -> None:
    print(f"render_blend: {failure}", file=sys.stderr)
    if log is not None:
        print(f"render_blend: what the engine printed is in {log}", file=sys.stderr)


def _keep_log(failure: JGHandFailure, options: argparse.Namespace) -> Path | None:
    """What the engine printed before it failed, as a file beside the report, else in the pictures' folder."""
    if not failure.log or failure.advice.exit_code == BAD_INPUT:
        return None
    path = options.report.with_suffix(".engine.log") if options.report else options.out / "engine.log"
    return None if _failure_of(lambda: batch.write_whole(path, failure.log.encode())) else path


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="render_blend.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path, help="a .blend file with a JGHand armature")
    parser.add_argument("--out", type=Path, required=True, help="folder for the pictures")
    parser.add_argument(
        "--camera",
        action="append",
        default=[],
        metavar="NAME[,NAME]",
        help="cameras; may be given again; default: the scene's camera",
    )
    parser.add_argument(
        "--frames", type=_frames, metavar="A-B[,STEP]", help="e.g. 1-240 or 1-240,2; default: the scene's range"
    )
    parser.add_argument("--preset", default="final", help="draft, viewport, final (default) or reference")
    parser.add_argument("--avatar", default=BUILTIN_AVATAR, help="a .jghand file, builtin or painted")
    parser.add_argument("--engine-python", metavar="PATH", help="a Python that has jghand installed")
    parser.add_argument("--overwrite", action="store_true", help="render pictures that are there already again")
    parser.add_argument("--report", type=Path, metavar="FILE.json", help="write what was done, with times, as JSON")
    parser.add_argument(
        "--timeout",
        type=_seconds,
        default=limits.REQUEST_S,
        metavar="SECONDS",
        help=f"how long one picture may take (default {limits.REQUEST_S:g})",
    )
    parser.add_argument("--allow-scripts", action="store_true", help="let the file run the Python scripts inside it")
    return parser


def _frames(text: str) -> list[int]:
    try:
        return batch.parse_frames(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


@dataclass(frozen=True)
class _Job:
    """What one run renders."""

    options: argparse.Namespace
    cameras: list[bpy.types.Object]
    hands: list[bpy.types.Object]
    frames: list[int]
    size: tuple[int, int]

    def path(self, eye: bpy.types.Object, frame: int) -> Path:
        return batch.picture_path(self.options.out, eye.name, frame)

    @property
    def avatar(self) -> str:
        """As the engine knows it."""
        avatar = self.options.avatar
        return avatar if avatar in SHIPPED_AVATARS else str(Path(avatar).resolve())

    def stamp_folders(self, engine_version: str) -> None:
        """Makes sure that no picture of something else lies among this run's."""
        made_from = {
            "file": stamp.digest(scene.source_files()),
            "avatar": self.avatar if self.avatar in SHIPPED_AVATARS else stamp.digest([Path(self.avatar)]),
            "preset": self.options.preset,
            "size": f"{self.size[0]} x {self.size[1]}",
            "engine version": engine_version,
        }
        for eye in self.cameras:
            replaced = [self.path(eye, frame) for frame in self.frames] if self.options.overwrite else None
            stamp.settle(batch.picture_folder(self.options.out, eye.name), made_from, replaced)


def _job(options: argparse.Namespace) -> _Job:
    """Opens the file and finds in it what is wanted."""
    opened = scene.open_file(options.file, allow_scripts=options.allow_scripts)
    cameras = scene.chosen_cameras(opened, options.camera)
    batch.check_folders(options.out, [eye.name for eye in cameras])
    frames = options.frames or list(range(opened.frame_start, opened.frame_end + 1, opened.frame_step))
    hands = scene.make_evaluated(cameras)
    if not hands:
        instanced = "; ".join(scene.instanced_hands(opened))
        raise JGHandFailure("no_hand", f"{options.file}; not rendered: {instanced}" if instanced else str(options.file))
    return _Job(options, cameras, hands, frames, camera.picture_size(opened.render))


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds <= limits.REQUEST_MAX_S:
        raise argparse.ArgumentTypeError(f"{text!r}: wanted seconds, more than 0, at most {limits.REQUEST_MAX_S:g}")
    return seconds


def _render(options: argparse.Namespace, report: batch.BatchReport, checkout: Path | None) -> None:
    job = _job(options)
    report.total = len(job.frames) * len(job.cameras)
    report.notes = scene.ignored_settings(bpy.context.scene)
    for note in report.notes:
        print(f"note: {note}", flush=True)
    with EngineClient.start(engine_command(options.engine_python, checkout=checkout)) as engine:
        report.engine = {key: engine.handshake.get(key) for key in ("engine_version", "device")}
        _load(engine, job.avatar, max(limits.LOAD_S, options.timeout))
        job.stamp_folders(str(report.engine["engine_version"]))
        for frame in job.frames:
            for line in _render_frame(engine, frame, job, report):
                print(line, flush=True)


def _render_frame(engine: EngineClient, frame: int, job: _Job, report: batch.BatchReport) -> Iterator[str]:
    """Renders one frame from every camera whose picture is wanted; yields progress lines."""
    wanted = [eye for eye in job.cameras if job.options.overwrite or not job.path(eye, frame).exists()]
    for eye in job.cameras:
        if eye not in wanted:
            yield report.skipped(eye.name, frame, job.path(eye, frame))
    if not wanted:
        return
    clock = _Clock()
    depsgraph = scene.evaluated_at(bpy.context.scene, frame, (*job.hands, *job.cameras))
    things = armature.hand_armatures(bpy.context.view_layer)
    read = [hand for thing in things for hand in sources.read_hands(thing, depsgraph)]
    hands = [replace(hand, avatar=job.avatar) for hand in read]
    views = [camera.pinhole(eye, depsgraph) for eye in wanted]
    evaluate_ms = clock.lap_ms() / len(wanted)
    for eye, view in zip(wanted, views, strict=True):
        clock = _Clock()
        content, details = _picture(engine, view, hands, job.options)
        request_ms = clock.lap_ms()
        path = job.path(eye, frame)
        batch.write_whole(path, content)
        times = batch.PictureTimes(evaluate_ms, request_ms, clock.lap_ms())
        yield report.rendered(eye.name, frame, path, times, details)


class _Clock:
    """Milliseconds since the last lap."""

    def __init__(self) -> None:
        self._then = time.perf_counter()

    def lap_ms(self) -> float:
        then, self._then = self._then, time.perf_counter()
        return 1e3 * (self._then - then)


def _picture(
    engine: EngineClient, view: Pinhole, hands: list[HandInSpace], options: argparse.Namespace
) -> tuple[bytes, dict]:
    header, arrays = picture_request(view, hands, preset=options.preset, outputs=["png"])
    reply = engine.request(header, arrays, timeout_s=options.timeout)
    return bytes(reply.arrays["png"].data), {"size": [view.width, view.height], "reports": reply.header["reports"]}


def _load(engine: EngineClient, avatar: str, timeout_s: float) -> None:
    try:
        engine.request({"kind": "load", "avatar": avatar}, timeout_s=timeout_s)
    except JGHandFailure as failure:
        if failure.kind == "bad_input":
            raise JGHandFailure("bad_avatar", failure.detail) from failure
        raise
