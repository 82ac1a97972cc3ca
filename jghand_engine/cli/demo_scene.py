"""The demo's motion, its pictures, through Blender or by the engine alone, and what is made of them: a video of all
cameras side by side, a contact sheet, a page that explains."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.avatar import SHIPPED
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.cli.camera_file import camera_to_dict
from jghand_engine.cli.console import progress, write_json
from jghand_engine.cli.frame_files import FrameFiles, FrameWriter
from jghand_engine.cli.timings import Timings
from jghand_engine.errors import InputError, JGHandError, MemoryLimitError, RetryError
from jghand_engine.export.pictures import (
    VIDEO_BACKGROUND,
    Cell,
    SheetStyle,
    contact_sheet,
    flatten,
    premultiplied,
    read_png,
    write_png,
)
from jghand_engine.export.video import write_video
from jghand_engine.files import file_error, make_folder, writing
from jghand_engine.hand.poses import MotionOptions, pose_sequence_of_names
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
# rate, seconds of a move and of a stop: quick enough for a video of a few seconds, slow enough to see
FPS, MOVE_S, HOLD_S = 30.0, 0.6, 0.2
# how far the whole hand turns to either side, degrees: shows more than one side and stays recognizable
SWAY_DEG = 35.0
# moments of the motion on the contact sheet
SHEET_COLUMNS = 8
# key of report.json: the hand.blend that the demo wrote, to tell one that somebody has changed since
BLEND_HASH = "blend_sha256"
# what the engine printed before it failed
ENGINE_LOG = "engine.log"
# milliseconds of a picture in render_blend's report; the request holds the engine's whole frame
BLENDER_TIMES = {
    "evaluate_ms": "Blender's evaluation",
    "request_ms": "request (engine, transport)",
    "write_ms": "Blender's colors and the PNG",
}
# Blender counts frames from 1, so the demo's files do
FIRST_FRAME, FRAME_NAME = 1, "{:04d}.png"

WITHOUT_BLENDER = (
    "No --blender-python: the engine renders alone, and there will be no .blend file. "
    "python scripts/demo.py sets Blender up and includes it."
)


@dataclass(frozen=True)
class Scene:
    """What is shown: a motion, cameras by name, a preset, an avatar (file or built-in), and the demo's folder."""

    sequence: PoseSequence
    cameras: dict[str, Camera]
    preset: str
    avatar: str
    out: Path

    @property
    def blend(self) -> Path:
        return self.out / "hand.blend"

    def previous_blends(self) -> list[Path]:
        """Files that once were hand.blend and that somebody had changed."""
        return sorted(self.out.glob("hand.previous*.blend"))

    @property
    def report(self) -> Path:
        return self.out / "report.json"

    @property
    def cameras_file(self) -> Path:
        return self.out / "cameras.json"

    def frames(self, camera: str) -> FrameFiles:
        """Where the pictures of a camera are."""
        return FrameFiles(self.out / "frames" / camera, name=FRAME_NAME, first=FIRST_FRAME, text=f"Rendering {camera}")


def demo_motion(avatar: HandAvatar, poses: list[str]) -> PoseSequence:
    """Named poses while the whole hand sways about its long axis, so that more than one side is seen."""
    joints = avatar.canonical_joints_m
    options = MotionOptions(fps=FPS, move_s=MOVE_S, hold_s=HOLD_S)
    sequence = pose_sequence_of_names(poses, joints, handedness=avatar.handedness, options=options)
    phase = np.linspace(0, 2 * np.pi, len(sequence))
    angle_rad = np.radians(SWAY_DEG) * np.sin(phase)
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    # about +y, the hand's long axis in the canonical frame
    turn = np.stack([cosine, zero, sine, zero, one, zero, -sine, zero, cosine], -1).reshape(-1, 1, 3, 3)
    root_m = sequence.joints_m[:, :1]
    swayed = (turn @ (sequence.joints_m - root_m)[..., None])[..., 0] + root_m
    return dataclasses.replace(sequence, joints_m=swayed)


def remove_old_results(scene: Scene, *, keeps_blend: bool) -> str:
    """Removes what an earlier demo made and this one may not make: a longer demo's pictures, a .blend file.

    A hand.blend that somebody has changed is kept under another name; the sentence that says so is returned, else ''.
    keeps_blend: leave a hand.blend that nobody has changed; it will be replaced when the new one is whole.
    """
    note = _set_aside_changed_blend(scene)
    for path in (scene.out / "hand.mp4", scene.out / ENGINE_LOG, *(() if keeps_blend else (scene.blend,))):
        path.unlink(missing_ok=True)
    scene.cameras_file.unlink(missing_ok=True)
    for name in scene.cameras:
        folder = scene.frames(name).folder
        for path in folder.glob("*.png") if folder.is_dir() else ():
            if re.fullmatch(r"\d{4}\.png", path.name):
                path.unlink()
    return note


def _set_aside_changed_blend(scene: Scene) -> str:
    """Renames a hand.blend that is not as the last demo wrote it; says so."""
    if not scene.blend.exists():
        return ""
    written = None
    with contextlib.suppress(OSError, ValueError, AttributeError):
        written = json.loads(scene.report.read_text(encoding="utf-8")).get(BLEND_HASH)
    try:
        if hash_of(scene.blend) == written:
            return ""
        names = itertools.chain(["hand.previous.blend"], (f"hand.previous.{i}.blend" for i in itertools.count(2)))
        kept = next(path for path in map(scene.out.joinpath, names) if not path.exists())
        scene.blend.rename(kept)
    except OSError as error:
        raise file_error(scene.blend, error) from error
    return f"{scene.blend} is not as the last demo wrote it: it is kept as {kept.name}."


def hash_of(path: Path) -> str:
    """SHA-256 of a file. Raises OSError."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def render_alone(scene: Scene, avatar: HandAvatar) -> Timings:
    """Renders every camera in this process."""
    renderer = HandRenderer(avatar, preset(scene.preset))
    timings = Timings()
    for name, camera in scene.cameras.items():
        files = scene.frames(name)
        make_folder(files.folder)
        FrameWriter(renderer, scene.sequence.joints_m, camera, files, timings).write_all()
    return timings


@dataclass(frozen=True)
class Blender:
    """Blender's side, in its own Python: it never meets torch, and this process never meets bpy."""

    python: Path

    def build(self, scene: Scene) -> str:
        """Makes the .blend file: the rigged armature with the motion on it, and the cameras. Returns its hash.

        report.json has the hash at once: a demo that breaks off later must not make its own file look changed.
        """
        cameras = scene.cameras_file
        write_json(cameras, {name: camera_to_dict(camera) for name, camera in scene.cameras.items()})
        # a folder, not a temporary file: Blender would keep a backup of a file that is there
        with tempfile.TemporaryDirectory(prefix=".blend.", dir=scene.out) as folder:
            made = Path(folder) / scene.blend.name
            arguments = ["--motion", scene.out / "motion.npz", "--cameras", cameras, "--out", made]
            ended = self._run("build_demo_scene.py", arguments)
            if ended.code:
                raise _failure(ended)
            try:
                written = hash_of(made)
                os.replace(made, scene.blend)
            except OSError as error:
                raise file_error(scene.blend, error) from error
        write_json(scene.report, {"command": "demo", "finished": False, BLEND_HASH: written})
        return written

    def render(self, scene: Scene) -> Timings:
        """Renders every camera of the .blend file: joints from Blender, pictures from an engine process."""
        with tempfile.TemporaryDirectory() as folder:
            report = Path(folder) / "report.json"
            arguments: list[str | Path] = [
                scene.blend, "--camera", ",".join(scene.cameras), "--out", scene.out / "frames", "--preset",
                scene.preset, "--overwrite", "--report", report, "--engine-python", sys.executable,
            ]  # fmt: skip
            if scene.avatar not in SHIPPED:
                arguments += ["--avatar", Path(scene.avatar).resolve()]
            total = len(scene.sequence) * len(scene.cameras)
            with progress("Rendering in Blender", total) as bar:
                ended = self._run("render_blend.py", arguments, on_line=lambda line: _advance(bar, line))
            if ended.code:
                told = _told_failure(report)
                raise _failure(ended, told, _keep_engine_log(told, scene.out) if told else "")
            return _timings_of(json.loads(report.read_text(encoding="utf-8")))

    def _run(
        self, script: str, arguments: list[str | Path], on_line: Callable[[str], None] = lambda line: None
    ) -> _Ended:
        """Runs one of the project's scripts in Blender's Python. Raises InputError when one of the two is missing."""
        path = SCRIPTS / script
        if not self.python.is_file():
            raise InputError(f"--blender-python {self.python}", wanted="a Python that has bpy", came="no such file")
        if not path.is_file():
            raise InputError(f"cannot find {path}", remedy="Blender's part needs the project's checkout.")
        with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as log:
            command = [str(self.python), str(path), *map(str, arguments)]
            process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=log, text=True, encoding="utf-8", errors="replace"
            )
            try:
                assert process.stdout is not None
                for line in process.stdout:
                    on_line(line)
                code = process.wait()
            finally:
                process.kill()
            log.seek(0)
            lines = [line for line in log.read().splitlines() if line.strip()]
            return _Ended(script, code, lines[-1] if lines else "")


@dataclass(frozen=True)
class _Ended:
    """How a script ended. last_line: of what it printed on standard error"""

    script: str
    code: int
    last_line: str


def _advance(bar: Any, line: str) -> None:
    if line.startswith("frame "):
        bar.advance(bar.task_ids[0])


def _failure(ended: _Ended, told: dict[str, str] | None = None, more: str = "") -> JGHandError:
    """The error that the end of a script means.

    told: what render_blend's report says of the failure: sentence, remedy, detail · more: a sentence after the remedy
    """
    kinds = {1: JGHandError, 2: InputError, 4: MemoryLimitError}
    kind = kinds.get(ended.code, RetryError)
    if not told:
        return kind(f"{ended.script} failed", came=ended.last_line or f"exit code {ended.code}")
    detail = f" ({told['detail']})" if told.get("detail") else ""
    return kind(f"{told['sentence']}{detail}", remedy=f"{told['remedy']}. {more}".strip())


def _told_failure(report: Path) -> dict[str, str] | None:
    """What the report of render_blend says about why it ended early; None if there is none."""
    with contextlib.suppress(OSError, ValueError):
        return json.loads(report.read_text(encoding="utf-8"))["failure"]
    return None


def _keep_engine_log(told: dict[str, str], out: Path) -> str:
    """Copies what the engine printed last, where the report names it, into the demo's folder; says where."""
    if "log" not in told:
        return ""
    try:
        shutil.copyfile(told["log"], out / ENGINE_LOG)
    except OSError:
        return ""  # the failure itself matters more
    return f"What the engine printed is in {out / ENGINE_LOG}."


def _timings_of(report: dict[str, Any]) -> Timings:
    """The engine's stages, and what Blender and the way between the processes add to a picture."""
    timings = Timings()
    for picture in report["pictures"]:
        if picture["skipped"]:
            continue
        for frame in picture["reports"]:
            timings.add(frame)
        for key, name in BLENDER_TIMES.items():
            if key in picture:
                timings.add_ms(name, picture[key])
    return timings


# ---- what is made of the pictures ------------------------------------------------------------------------------------


def write_video_of(scene: Scene) -> None:
    """hand.mp4: the cameras side by side."""
    write_video(scene.out / "hand.mp4", _side_by_side(scene), scene.sequence.fps)


def _side_by_side(scene: Scene) -> Iterator[np.ndarray]:
    with progress("Writing the video", len(scene.sequence)) as bar:
        for index in range(len(scene.sequence)):
            yield np.concatenate([_shown(scene, name, index) for name in scene.cameras], axis=1)
            bar.advance(bar.task_ids[0])


def write_sheet_of(scene: Scene) -> None:
    """contact_sheet.png: moments of the motion in columns, one row per camera."""
    count = min(SHEET_COLUMNS, len(scene.sequence))
    moments = np.linspace(0, len(scene.sequence) - 1, count).round().astype(int)
    cells = [
        Cell(f"{name} · {index / scene.sequence.fps:.1f} s", _shown(scene, name, int(index)))
        for name in scene.cameras
        for index in moments
    ]
    write_png(scene.out / "contact_sheet.png", contact_sheet(cells, SheetStyle(columns=count)))


def _shown(scene: Scene, camera: str, index: int) -> np.ndarray:
    return flatten(premultiplied(read_png(scene.frames(camera).path(index))), VIDEO_BACKGROUND)


def write_readme(scene: Scene) -> None:
    """README.txt: what is where, and how to look at it."""
    cameras = ", ".join(scene.cameras)
    files = {
        "hand.mp4": f"the motion seen from {cameras}, side by side",
        "contact_sheet.png": "moments of it at one glance",
        "frames/": f"PNG pictures with alpha, one folder per camera ({cameras})",
        "motion.npz": "the 21 joint positions of every frame, meters, standard order",
        "hand.blend": "the rigged armature with the motion on it, and the cameras",
        "cameras.json": "its cameras: pixels, meters, OpenCV axes",
        "usd/hand.usda": "the animated hand for other programs; choose its variant splats, points or mesh",
        "usd/hand.shot.usda": "the hand with the cameras of this demo",
    }
    files |= {path.name: "a hand.blend that was changed before a later demo" for path in scene.previous_blends()}
    there = {name: text for name, text in files.items() if (scene.out / name).exists()}
    lines = ["What this folder holds", ""]
    there["report.json"] = "how long everything took"
    width = max(map(len, there)) + 2
    lines += [f"{name:<{width}}{text}" for name, text in there.items()]
    if scene.blend.exists():
        lines += [
            "",
            "Change the motion in hand.blend and render it anew, from the folder of the project:",
            f"  .envs/blender/bin/python scripts/render_blend.py {scene.blend} --camera {','.join(scene.cameras)} "
            "--out new_frames",
        ]
    with writing(scene.out / "README.txt") as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
