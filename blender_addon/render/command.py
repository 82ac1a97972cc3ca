# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders the hands of a .blend file without a window, as Blender renders an animation with the engine JGHand.

    blender --command jghand render FILE.blend --out FOLDER
    render_blend.py FILE.blend --camera CamPalm,CamSide --frames 1-60 --out FOLDER

Writes FOLDER/CAMERA/0001.png with the file's own settings of film, colors, size and region; pictures that are there
already stay unless --overwrite is given. A scene that is combined with its hands keeps its own engine.

Exit codes: 0 done, 1 a mistake in JGHand, 2 bad input, 3 try again, 4 out of memory, 130 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import re
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy

from .. import versions
from ..core import limits
from ..core.files import write_whole
from ..core.view import BUILTIN_AVATAR, SHIPPED_AVATARS
from ..errors import BAD_INPUT, JGHandFailure
from ..hand import armature, seen_hands
from ..preferences import preferences
from ..properties import PRESETS
from ..renderer import runtime
from ..renderer.engine_command import engine_command
from ..renderer.link import EngineLink
from . import camera, composite, scene
from .engine_name import ENGINE

_FRAMES = re.compile(r"(-?\d+)(?:-(-?\d+))?(?:,([1-9]\d*))?")
_handle: Any = None
# Blender renders now
_drawing = False


def command(arguments: list[str]) -> int:
    """`blender --command jghand …`; returns the exit code."""
    if arguments[:1] != ["render"]:
        print("usage: blender --command jghand render FILE.blend --out FOLDER [--help]", file=sys.stderr)
        return 0 if arguments[:1] in (["--help"], ["-h"]) else BAD_INPUT
    try:
        return main(arguments[1:], program="blender --command jghand render")
    except SystemExit as ended:  # argparse ends so; Blender wants a number
        return ended.code if isinstance(ended.code, int) else BAD_INPUT


def main(arguments: list[str], *, checkout: Path | None = None, program: str = "jghand render") -> int:
    """Renders what the command line asks for; returns the exit code. checkout: a folder that may hold .envs/engine."""
    options = _parser(program).parse_args(arguments)
    report: dict[str, Any] = {"blend": str(options.file), "wanted": 0, "failure": None, "pictures": []}
    with _interrupts():
        failure = _failure_of(lambda: _render(options, report, checkout))
    runtime.use_link(None)
    runtime.use_render_timeout(None)
    if failure is not None:
        words = {"kind": failure.kind, "sentence": failure.advice.sentence, "remedy": failure.advice.remedy}
        report["failure"] = {**words, "detail": failure.detail}
        if failure.log and failure.advice.exit_code != BAD_INPUT:
            log = options.report.with_suffix(".engine.log") if options.report else options.out / "engine.log"
            if _failure_of(lambda: write_whole(log, failure.log.encode())) is None:
                report["failure"]["log"] = str(log)
    if options.report is not None:
        unwritten = _failure_of(lambda: write_whole(options.report, json.dumps(report, indent=1).encode()))
        failure = failure or unwritten
    if failure is not None:
        print(f"{program}: {failure}", *filter(None, [(report["failure"] or {}).get("log")]), file=sys.stderr)
    return failure.advice.exit_code if failure else 0


def _failure_of(step: Callable[[], None]) -> JGHandFailure | None:
    """Does one step; returns what ended it early, whatever that was."""
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


@contextlib.contextmanager
def _interrupts() -> Iterator[None]:
    """Ctrl-C gives up the picture that Blender renders, where an exception would be lost; else it ends the run."""

    def interrupt(*_: object) -> None:
        runtime.give_up_render(True)
        if not _drawing:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        runtime.give_up_render(False)
        # None: Blender's own program handled it, which Python cannot put back; the system's way ends it as well
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)


def _parser(program: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(program, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("file", type=Path, help="a .blend file with a JGHand armature")
    add("--out", type=Path, required=True, help="folder for the images")
    cameras = "cameras; may be given again; default: the scene's camera, or those of its markers"
    add("--camera", action="append", default=[], metavar="NAME[,NAME]", help=cameras)
    add("--frames", type=_frames, metavar="A-B[,STEP]", help="e.g. 1-240 or 1-240,2; default: the scene's range")
    add("--preset", choices=[preset[0] for preset in PRESETS], help="default: the scene's")
    add("--avatar", help="a .jghand file, builtin or painted, for all hands; default: each hand's own")
    add("--engine-python", metavar="PATH", help="a Python that has jghand installed")
    add("--overwrite", action="store_true", help="render pictures that are there already again")
    add("--report", type=Path, metavar="FILE.json", help="write what was done, with times, as JSON")
    add("--timeout", type=_seconds, default=limits.REQUEST_S, metavar="SECONDS", help="longest time of one picture")
    add("--allow-scripts", action="store_true", help="let the file run the Python scripts inside it")
    return parser


def _frames(text: str) -> range:
    match = _FRAMES.fullmatch(text)
    first, last, step = (int(part) if part else None for part in match.groups()) if match else (None,) * 3
    if first is None or (last is not None and last < first):
        raise argparse.ArgumentTypeError(f"frames {text!r}: wanted FIRST, FIRST-LAST or FIRST-LAST,STEP")
    return range(first, (first if last is None else last) + 1, step or 1)


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds <= limits.REQUEST_MAX_S:
        raise argparse.ArgumentTypeError(f"{text!r}: wanted seconds, more than 0, at most {limits.REQUEST_MAX_S:g}")
    return seconds


def _render(options: argparse.Namespace, report: dict[str, Any], checkout: Path | None) -> None:
    """Renders every camera's frames; JGHandFailure as soon as one fails."""
    current = scene.open_file(options.file, allow_scripts=options.allow_scripts)
    frames = options.frames or range(current.frame_start, current.frame_end + 1, current.frame_step)
    eyes = scene.chosen_cameras(current, options.camera, frames[0])
    names = [re.sub(r"[^\w. -]", "_", eye.name).strip(". ") or "camera" for eye in eyes]
    if len({name.casefold() for name in names}) < len(names):
        raise JGHandFailure("same_folder", ", ".join(eye.name for eye in eyes))
    hands = armature.hands_at_any_frame(bpy.context.view_layer)
    if not hands:
        raise JGHandFailure("no_hand", "; ".join([str(options.file), *scene.instanced_hands(current.objects)]))
    if options.avatar is not None:
        chosen = options.avatar if options.avatar in SHIPPED_AVATARS else str(Path(options.avatar).resolve())
        for hand in hands:
            hand.jghand.avatar = "" if chosen == BUILTIN_AVATAR else chosen
    _prepare(current, frames, options)
    report |= {"preset": current.jghand.render_preset, "wanted": len(frames) * len(eyes)}
    report["notes"] = scene.notes_on(current)
    for note in report["notes"]:
        print(f"note: {note}", flush=True)
    link = _start_engine(options, checkout)
    report["engine"] = {key: link.status.handshake.get(key) for key in ("engine_version", "device")}
    for avatar in sorted({seen_hands.avatar_of(hand) for hand in hands}):
        try:
            link.request({"kind": "load", "avatar": avatar}, timeout_s=max(limits.LOAD_S, options.timeout))
        except JGHandFailure as failure:
            if failure.kind == "bad_input":
                raise JGHandFailure("bad_avatar", failure.detail) from failure
            raise
    for eye, name in zip(eyes, names, strict=True):
        if options.camera:
            for each in _scenes(current):
                each.camera = eye
        _render_camera(current, eye.name, options.out.resolve() / name, report)


def _scenes(current: bpy.types.Scene) -> list[bpy.types.Scene]:
    """The scene, and that of its hands where it is combined with one."""
    return [each for each in (current, composite.hands_scene_of(current)) if each is not None]


def _prepare(current: bpy.types.Scene, frames: range, options: argparse.Namespace) -> None:
    """Sets the scene, in memory, so that Blender writes what is wanted; nothing that depends on the clock."""
    render = current.render
    if composite.hands_scene_of(current) is None:
        render.engine = ENGINE
    versions.write_png(render.image_settings)
    render.use_file_extension, render.use_overwrite = True, options.overwrite
    render.use_stamp_date = render.use_stamp_render_time = render.use_stamp_memory = render.use_stamp_hostname = False
    current.frame_start, current.frame_end, current.frame_step = frames[0], frames[-1], frames.step
    for each in _scenes(current):
        each.jghand.render_preset = options.preset or each.jghand.render_preset
        for marker in each.timeline_markers if options.camera else ():
            marker.camera = None  # which else would choose the camera


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


def _render_camera(current: bpy.types.Scene, eye: str, folder: Path, report: dict[str, Any]) -> None:
    """One animation of Blender's: FOLDER/0001.png and so on. JGHandFailure: that of a frame, cannot_write."""
    global _drawing
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise JGHandFailure("cannot_write", f"{folder}: {error.strerror or error}") from error
    current.render.filepath = versions.literal_path(folder) + "/####"
    failures: list[JGHandFailure] = []
    began_s = time.perf_counter()

    def tell(frame: int, end: str, **more: Any) -> None:
        path = bpy.path.abspath(current.render.frame_path(frame=frame))
        report["pictures"].append({"frame": frame, "camera": eye, "file": path, **more})
        print(f"frame {frame} · {eye} · {len(report['pictures'])} of {report['wanted']} · {end}", flush=True)

    def written(which: bpy.types.Scene, *_: object) -> None:
        nonlocal began_s
        note, now_s = runtime.last_render() or runtime.RenderNote(None), time.perf_counter()
        runtime.note_render(None)
        failures.extend([note.failure] if note.failure else [])
        whole_ms, began_s = 1e3 * (now_s - began_s), now_s
        times = {"evaluate_ms": note.evaluate_ms, "request_ms": note.request_ms}
        times["write_ms"] = whole_ms - note.evaluate_ms - note.request_ms
        size = list(camera.picture_size(current.render))
        tell(which.frame_current, f"{whole_ms:.0f} ms", skipped=False, **times, size=size, reports=list(note.reports))

    for frame in range(current.frame_start, current.frame_end + 1, current.frame_step):
        if not current.render.use_overwrite and Path(current.render.frame_path(frame=frame)).exists():
            tell(frame, "there already", skipped=True)
    told, _drawing = "", True
    runtime.note_render(None)
    bpy.app.handlers.render_write.append(written)
    try:
        bpy.ops.render.render(animation=True, scene=current.name)
    except RuntimeError as error:  # an error report of the engine, or of Blender
        told = str(error)
    finally:
        _drawing = False
        bpy.app.handlers.render_write.remove(written)
    note = runtime.last_render()  # of a frame that was not written
    failures += [note.failure] if note is not None and note.failure else []
    if runtime.render_given_up() or any(failure.kind == "canceled" for failure in failures):
        raise JGHandFailure("interrupted")
    if failures:
        raise failures[0]
    if told:
        raise JGHandFailure("cannot_write", told)


def register() -> None:
    """Adds the command."""
    global _handle
    if _handle is None:
        _handle = bpy.utils.register_cli_command("jghand", command)


def unregister() -> None:
    """Takes it away."""
    global _handle
    if _handle is not None:
        bpy.utils.unregister_cli_command(_handle)
        _handle = None
