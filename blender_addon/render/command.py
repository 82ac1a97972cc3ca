# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders the hands of a .blend file without a window, as F12 does: `blender_addon.render.engine` draws, Blender saves.

    blender --command jghand render FILE.blend --out FOLDER
    render_blend.py FILE.blend --camera CamPalm,CamSide --frames 1-60 --out FOLDER

The engine runs in a process of its own (--engine-python, the preferences, the variable JGHAND_ENGINE_PYTHON,
.envs/engine of this checkout, or `jghand` on the PATH). Writes FOLDER/CAMERA/0001.png with the file's own settings of
film, colors, size and region, whatever engine the file is set to; pictures that are there already are skipped, when
they were made from the same file with the same settings and the same engine. Every hand of the file that is not
disabled in renders is drawn, several hands in one picture.

`blender -b FILE.blend -a` with the engine set to JGHand writes the same pictures, to the file's own output path. They
are the same bytes where the file's metadata leave out date and render time, which these never have.

Exit codes: 0 done, 1 a mistake in JGHand, 2 bad input, 3 try again, 4 out of memory, 130 interrupted. The report is
written whatever the end.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy

from .. import registration, versions
from ..core import limits
from ..core.view import BUILTIN_AVATAR, SHIPPED_AVATARS
from ..errors import BAD_INPUT, JGHandFailure
from ..hand import armature, seen_hands
from ..preferences import preferences
from ..properties import PRESETS
from ..renderer import runtime
from ..renderer.engine_command import engine_command
from ..renderer.link import EngineLink
from . import batch, camera, scene, stamp
from .engine import JGHandRenderEngine


def main(arguments: list[str] | None = None, *, checkout: Path | None = None, program: str = "render_blend.py") -> int:
    """Renders what the command line asks for; returns the exit code.

    checkout: a folder that may hold .envs/engine · program: what was called, for the help.
    """
    options = _parser(program).parse_args(arguments)
    report = batch.BatchReport(str(options.file), options.preset or "", total=0)
    ours = not registration.is_registered()
    registration.register()
    try:
        with _interrupts():
            failure = _failure_of(lambda: _render(options, report, checkout))
    finally:
        runtime.use_link(None)
        runtime.use_render_timeout(None)
        if ours:
            registration.unregister()
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


_rendering = False


@contextlib.contextmanager
def _interrupts() -> Iterator[None]:
    """Ctrl-C ends the run: while Blender renders by giving the picture up, for an exception would be lost there."""

    def interrupt(*_: object) -> None:
        runtime.give_up_render(True)
        if not _rendering:
            raise KeyboardInterrupt

    try:
        before = signal.signal(signal.SIGINT, interrupt)
    except ValueError:  # not the main thread: it is somebody else's business
        yield
        return
    try:
        yield
    finally:
        runtime.give_up_render(False)
        # None: Blender's own program handled it, which Python cannot put back; the system's way ends it as well
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)


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


def _parser(program: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=program, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path, help="a .blend file with a JGHand armature")
    parser.add_argument("--out", type=Path, required=True, help="folder for the pictures")
    parser.add_argument(
        "--camera",
        action="append",
        default=[],
        metavar="NAME[,NAME]",
        help="cameras; may be given again; default: the scene's camera, or those of its markers",
    )
    parser.add_argument(
        "--frames", type=_frames, metavar="A-B[,STEP]", help="e.g. 1-240 or 1-240,2; default: the scene's range"
    )
    parser.add_argument("--preset", choices=[preset[0] for preset in PRESETS], help="default: the scene's")
    parser.add_argument("--avatar", help="a .jghand file, builtin or painted, for all hands; default: each hand's own")
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
    scene: bpy.types.Scene
    cameras: list[bpy.types.Object]
    frames: list[int]

    def path(self, eye: bpy.types.Object, frame: int) -> Path:
        return batch.picture_path(self.options.out, eye.name, frame)

    @property
    def avatars(self) -> list[str]:
        """Of all hands, as the engine knows them."""
        hands = armature.hands_at_any_frame(bpy.context.view_layer)
        return sorted({seen_hands.avatar_of(hand) for hand in hands})

    def stamp_folders(self, engine_version: str) -> None:
        """Makes sure that no picture of something else lies among this run's."""
        names = [avatar for avatar in self.avatars if avatar in SHIPPED_AVATARS]
        files = [Path(avatar) for avatar in self.avatars if avatar not in SHIPPED_AVATARS]
        by_markers = not self.options.camera and scene.has_marked_cameras(self.scene)
        made_from = {
            "file": stamp.digest(scene.source_files()),
            "avatar": " ".join([*names, *([stamp.digest(files)] if files else [])]),
            "preset": self.scene.jghand.render_preset,
            "size": "{} x {}".format(*camera.picture_size(self.scene.render)),
            "engine version": engine_version,
            "Blender version": bpy.app.version_string,
        }
        for eye in self.cameras:
            replaced = [self.path(eye, frame) for frame in self.frames] if self.options.overwrite else None
            seen_by = {"camera": "markers" if by_markers else eye.name}
            stamp.settle(batch.picture_folder(self.options.out, eye.name), made_from | seen_by, replaced)


def _job(options: argparse.Namespace) -> _Job:
    """Opens the file and finds in it what is wanted."""
    opened = scene.open_file(options.file, allow_scripts=options.allow_scripts)
    frames = options.frames or list(range(opened.frame_start, opened.frame_end + 1, opened.frame_step))
    cameras = scene.chosen_cameras(opened, options.camera, frames[0])
    batch.check_folders(options.out, [eye.name for eye in cameras])
    hands = armature.hands_at_any_frame(bpy.context.view_layer)
    if not hands:
        instanced = "; ".join(scene.instanced_hands(opened.objects))
        raise JGHandFailure("no_hand", f"{options.file}; not rendered: {instanced}" if instanced else str(options.file))
    if options.avatar is not None:
        chosen = options.avatar if options.avatar in SHIPPED_AVATARS else str(Path(options.avatar).resolve())
        for hand in hands:
            hand.jghand.avatar = "" if chosen == BUILTIN_AVATAR else chosen
    if options.preset is not None:
        opened.jghand.render_preset = options.preset
    return _Job(options, opened, cameras, frames)


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
    report.preset = job.scene.jghand.render_preset
    report.total = len(job.frames) * len(job.cameras)
    report.notes = scene.notes_on(job.scene)
    for note in report.notes:
        print(f"note: {note}", flush=True)
    link = _start_engine(options, checkout)
    report.engine = {key: link.status.handshake.get(key) for key in ("engine_version", "device")}
    for avatar in job.avatars:
        _load(link, avatar, max(limits.LOAD_S, options.timeout))
    job.stamp_folders(str(report.engine["engine_version"]))
    _prepare(job)
    with tempfile.TemporaryDirectory(prefix="jghand_") as folder:
        for frame in job.frames:
            for line in _render_frame(frame, job, report, Path(folder)):
                print(line, flush=True)


def _start_engine(options: argparse.Namespace, checkout: Path | None) -> EngineLink:
    chosen = preferences()
    python = options.engine_python or (chosen.engine_python if chosen is not None else None) or None
    words = engine_command(python, checkout=checkout)
    link = EngineLink(lambda: words)
    runtime.use_link(link)
    runtime.use_render_timeout(options.timeout)
    link.start()
    link.wait_until_ready()
    return link


def _prepare(job: _Job) -> None:
    """Sets the scene, in memory, so that Blender writes what is wanted; nothing that depends on the clock."""
    render = job.scene.render
    render.engine = JGHandRenderEngine.bl_idname
    versions.write_png(render.image_settings)
    render.use_file_extension = True
    render.use_stamp_date = render.use_stamp_render_time = False
    render.use_stamp_memory = render.use_stamp_hostname = False
    if job.options.camera:
        for marker in job.scene.timeline_markers:
            marker.camera = None  # which else would choose the camera


def _render_frame(frame: int, job: _Job, report: batch.BatchReport, folder: Path) -> Iterator[str]:
    """Renders one frame from every camera whose picture is wanted; yields progress lines."""
    wanted = [eye for eye in job.cameras if job.options.overwrite or not job.path(eye, frame).exists()]
    for eye in job.cameras:
        if eye not in wanted:
            yield report.skipped(eye.name, frame, job.path(eye, frame))
    if not wanted:
        return
    job.scene.frame_set(frame)
    scene.check_scripts()
    for eye in wanted:
        if job.options.camera:
            job.scene.camera = eye
        clock = _Clock()
        content, note = _picture(job.scene, folder / "picture.png")
        request_ms = clock.lap_ms()
        path = job.path(eye, frame)
        batch.write_whole(path, content)
        times = batch.PictureTimes(note.evaluate_ms, request_ms - note.evaluate_ms, clock.lap_ms())
        size = list(camera.picture_size(job.scene.render))
        yield report.rendered(eye.name, frame, path, times, {"size": size, "reports": list(note.reports)})


class _Clock:
    """Milliseconds since the last lap."""

    def __init__(self) -> None:
        self._then = time.perf_counter()

    def lap_ms(self) -> float:
        then, self._then = self._then, time.perf_counter()
        return 1e3 * (self._then - then)


def _picture(current: bpy.types.Scene, path: Path) -> tuple[bytes, runtime.RenderNote]:
    """One picture as Blender renders and saves it. Raises JGHandFailure: what the render engine does, cannot_write.

    It is saved where no name can be a template, and moved by us: a path of Blender's is not always what it says.
    """
    global _rendering
    runtime.note_render(None)
    current.render.filepath = str(path)
    path.unlink(missing_ok=True)
    told, _rendering = "", True
    try:
        bpy.ops.render.render(write_still=True, scene=current.name)
    except RuntimeError as error:  # an error report of the engine, or of Blender
        told = str(error)
    finally:
        _rendering = False
    if runtime.render_given_up():
        raise JGHandFailure("interrupted")
    note = runtime.last_render()
    if note is not None and note.failure is not None:
        raise JGHandFailure("interrupted") if note.failure.kind == "canceled" else note.failure
    if told or note is None:
        raise JGHandFailure("internal", told or "Blender did not render")
    try:
        return path.read_bytes(), note
    except OSError as error:
        raise JGHandFailure("cannot_write", f"{path}: {error.strerror or error}") from error


def _load(link: EngineLink, avatar: str, timeout_s: float) -> None:
    try:
        link.request({"kind": "load", "avatar": avatar}, timeout_s=timeout_s)
    except JGHandFailure as failure:
        if failure.kind == "bad_input":
            raise JGHandFailure("bad_avatar", failure.detail) from failure
        raise
