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
import json
import re
import signal
import sys
import time
import traceback
from pathlib import Path
from typing import Any

import bpy

from .. import versions
from ..core.files import write_whole
from ..errors import BAD_INPUT, JGHandFailure
from ..hand import seen_hands
from ..renderer import runtime
from . import ENGINE, composite
from .properties import PRESETS

_FRAMES = re.compile(r"(-?\d+)(?:-(-?\d+))?(?:,([1-9]\d*))?")
_handle: Any = None


def command(arguments: list[str]) -> int:
    """`blender --command jghand …`; returns the exit code."""
    if arguments[:1] != ["render"]:
        print("usage: blender --command jghand render FILE.blend --out FOLDER [--help]", file=sys.stderr)
        return 0 if arguments[:1] in (["--help"], ["-h"]) else BAD_INPUT
    try:
        return main(arguments[1:], program="blender --command jghand render")
    except SystemExit as ended:  # argparse ends so; Blender wants a number
        return ended.code if isinstance(ended.code, int) else BAD_INPUT


def main(arguments: list[str], *, program: str = "jghand render") -> int:
    """Renders what the command line asks for; returns the exit code."""
    options = _parser(program).parse_args(arguments)
    report: dict[str, Any] = {"blend": str(options.file), "wanted": 0, "failure": None, "pictures": []}
    failure = None
    try:
        _render(options, report)
    except JGHandFailure as reason:
        failure = reason
    except KeyboardInterrupt:
        failure = JGHandFailure("interrupted")
    except Exception as error:  # a mistake of ours: the report must not look like that of a run that went well
        traceback.print_exc()
        failure = JGHandFailure("internal", f"{type(error).__name__}: {error}")
    runtime.use_link(None)
    if failure is not None:
        words = {"kind": failure.kind, "sentence": failure.advice.sentence, "remedy": failure.advice.remedy}
        report["failure"] = {**words, "detail": failure.detail}
    if options.report is not None:
        try:
            write_whole(options.report, json.dumps(report, indent=1).encode())
        except JGHandFailure as unwritten:
            failure = failure or unwritten
    if failure is not None:
        print(f"{program}: {failure}", file=sys.stderr)
    return failure.advice.exit_code if failure else 0


def _parser(program: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(program, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("file", type=Path, help="a .blend file with a JGHand armature")
    add("--out", type=Path, required=True, help="folder for the images")
    cameras = "cameras; may be given again; default: the scene's camera, or those of its markers"
    add("--camera", action="append", default=[], metavar="NAME[,NAME]", help=cameras)
    add("--frames", type=_frames, metavar="A-B[,STEP]", help="e.g. 1-240 or 1-240,2; default: the scene's range")
    add("--preset", choices=[preset[0] for preset in PRESETS], help="default: the scene's")
    add("--overwrite", action="store_true", help="render pictures that are there already again")
    add("--report", type=Path, metavar="FILE.json", help="write what was done, with times, as JSON")
    add("--allow-scripts", action="store_true", help="let the file run the Python scripts inside it")
    return parser


def _frames(text: str) -> range:
    match = _FRAMES.fullmatch(text)
    first, last, step = (int(part) if part else None for part in match.groups()) if match else (None,) * 3
    if first is None or (last is not None and last < first):
        raise argparse.ArgumentTypeError(f"frames {text!r}: wanted FIRST, FIRST-LAST or FIRST-LAST,STEP")
    return range(first, (first if last is None else last) + 1, step or 1)


def _render(options: argparse.Namespace, report: dict[str, Any]) -> None:
    """Renders every camera's frames; JGHandFailure as soon as one fails."""
    try:
        bpy.ops.wm.open_mainfile(filepath=str(options.file.resolve()), load_ui=False, use_scripts=options.allow_scripts)
    except RuntimeError as error:
        raise JGHandFailure("bad_file", f"{options.file}: {error}") from error
    if bpy.app.autoexec_fail:  # nobody is there to see that Blender says so
        raise JGHandFailure("scripts_blocked", bpy.app.autoexec_fail_message)
    current = bpy.context.scene
    if not seen_hands.sources_at_any_frame(bpy.context.view_layer):
        raise JGHandFailure("no_hand", str(options.file))
    frames = options.frames or range(current.frame_start, current.frame_end + 1, current.frame_step)
    folders = _folders(current, options.camera, frames[0])
    # the scene, and that of its hands where it is combined with one
    scenes = [each for each in (current, composite.hands_scene_of(current)) if each is not None]
    if len(scenes) == 1:
        current.render.engine = ENGINE
    for each in scenes:
        each.jghand.render_preset = options.preset or each.jghand.render_preset
    _write_png(current.render, overwrite=options.overwrite)
    current.frame_start, current.frame_end, current.frame_step = frames[0], frames[-1], frames.step
    report |= {"preset": current.jghand.render_preset, "wanted": len(frames) * len(folders)}
    for name, eye in folders.items():
        for each in scenes if options.camera else ():
            each.camera = eye
            for marker in each.timeline_markers:
                marker.camera = None  # which else would choose the camera
        _render_camera(current, eye.name, options.out.resolve() / name, report)


def _folders(scene: bpy.types.Scene, names: list[str], frame: int) -> dict[str, bpy.types.Object]:
    """The cameras of these names, of several between commas too; without names the scene's own, or that of its markers.
    By the names of their folders. JGHandFailure: not_a_camera, no_camera, same_folder."""
    known = {thing.name: thing for thing in scene.objects if thing.type == "CAMERA"}
    if names:
        wanted = [part for name in names for part in ([name] if name in known else name.split(","))]
        unknown = [name for name in wanted if name not in known]
        if unknown:
            raise JGHandFailure("not_a_camera", f"{', '.join(unknown)}; the scene has {', '.join(known) or 'none'}")
        eyes = [known[name] for name in dict.fromkeys(wanted)]
    else:
        # as Blender chooses: the last marker until now, else the first; of several at one frame the one made first
        marked = [each for each in scene.timeline_markers if each.camera is not None]
        before = [each for each in marked if each.frame <= frame]
        first = min(marked, key=lambda each: each.frame, default=None)
        now = max(before, key=lambda each: each.frame, default=first)
        eye = scene.camera or (now.camera if now is not None else None)
        eyes = [eye] if eye is not None else []
    if not eyes:
        raise JGHandFailure("no_camera")
    found = {re.sub(r"[^\w. -]", "_", eye.name).strip(". ") or "camera": eye for eye in eyes}
    if len({name.casefold() for name in found}) < len(eyes):
        raise JGHandFailure("same_folder", ", ".join(eye.name for eye in eyes))
    return found


def _write_png(render: bpy.types.RenderSettings, *, overwrite: bool) -> None:
    """PNG files of which nothing depends on the clock."""
    versions.write_png(render.image_settings)
    render.use_file_extension, render.use_overwrite = True, overwrite
    render.use_stamp_date = render.use_stamp_render_time = render.use_stamp_memory = render.use_stamp_hostname = False


def _render_camera(current: bpy.types.Scene, eye: str, folder: Path, report: dict[str, Any]) -> None:
    """One animation of Blender's: FOLDER/0001.png and so on. JGHandFailure: that of a frame, cannot_write."""
    current.render.filepath = versions.literal_path(folder) + "/####"
    failures: list[JGHandFailure] = []
    began_s = time.perf_counter()

    def tell(frame: int, end: str, **more: Any) -> None:
        path = bpy.path.abspath(current.render.frame_path(frame=frame))
        report["pictures"].append({"frame": frame, "camera": eye, "file": path, **more})
        print(f"frame {frame} · {eye} · {len(report['pictures'])} of {report['wanted']} · {end}", flush=True)

    def written(which: bpy.types.Scene, *_: object) -> None:
        nonlocal began_s
        note, now_s = runtime.render_note or runtime.RenderNote(None), time.perf_counter()
        runtime.render_note = None
        failures.extend([note.failure] if note.failure else [])
        whole_ms, began_s = 1e3 * (now_s - began_s), now_s
        times = {"evaluate_ms": note.evaluate_ms, "request_ms": note.request_ms}
        times["write_ms"] = whole_ms - note.evaluate_ms - note.request_ms
        tell(which.frame_current, f"{whole_ms:.0f} ms", skipped=False, **times, reports=list(note.reports))

    for frame in range(current.frame_start, current.frame_end + 1, current.frame_step):
        if not current.render.use_overwrite and Path(current.render.frame_path(frame=frame)).exists():
            tell(frame, "there already", skipped=True)
    told = ""
    runtime.render_note = None
    bpy.app.handlers.render_write.append(written)
    # as an exception it would be lost in Blender, which goes on
    before = signal.signal(signal.SIGINT, lambda *_: runtime.render_canceled.set())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        bpy.ops.render.render(animation=True, scene=current.name)
    except OSError as error:
        told = f"{folder}: {error.strerror or error}"
    except RuntimeError as error:  # an error report of the engine, or of Blender
        told = str(error)
    finally:
        bpy.app.handlers.render_write.remove(written)
        # None: Blender's own program handled it, which Python cannot put back; the system's way ends it as well
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
    if runtime.render_canceled.is_set():
        runtime.render_canceled.clear()
        raise JGHandFailure("interrupted")
    note = runtime.render_note  # of a frame that was not written
    failures += [note.failure] if note is not None and note.failure else []
    if failures:
        raise failures[0]
    if told:
        raise JGHandFailure("cannot_write", told)


def register() -> None:
    global _handle
    if _handle is None:
        _handle = bpy.utils.register_cli_command("jghand", command)


def unregister() -> None:
    global _handle
    if _handle is not None:
        bpy.utils.unregister_cli_command(_handle)
        _handle = None
