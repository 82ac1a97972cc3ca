"""The demo's job: a motion, a rigged .blend file, pictures from two sides, a video, a USD stage, in one folder.

    .envs/engine/bin/python scripts/demo_job.py --out demo_output [--blender-python .envs/blender/bin/python]

scripts/demo.py sets both environments up and runs this.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SCRIPTS = Path(__file__).resolve().parent
# what the demo shows: poses by name with ways between them
POSES = "relaxed,spread,fist,point,ok,relaxed"
# the two sides that are shown, and how accurately
SIDES, PRESET = ("front", "back"), "final"
# rate, seconds of a move and of a stop: quick enough for a video of a few seconds, slow enough to see
FPS, MOVE_S, HOLD_S = 30.0, 0.6, 0.2
# how far the whole hand turns to either side, degrees: shows more than one side and stays recognizable
SWAY_DEG = 35.0
# moments of the motion on the contact sheet
SHEET_COLUMNS = 8
# milliseconds of a picture in render_blend's report; the request holds the engine's whole frame
BLENDER_TIMES = {
    "evaluate_ms": "Blender's evaluation",
    "request_ms": "request (engine, transport)",
    "write_ms": "Blender's colors and the PNG",
}
# Blender counts frames from 1, so the demo's files do
FIRST_FRAME, FRAME_NAME = 1, "{:04d}.png"
FILES = {
    "hand.mp4": "the motion seen from both sides",
    "contact_sheet.png": "moments of it at one glance",
    "frames/": "PNG pictures with alpha, one folder per side",
    "motion.npz": "the 21 joint positions of every frame, meters, standard order",
    "hand.blend": "the rigged armature with the motion on it, and the cameras",
    "cameras.json": "its cameras: pixels, meters, OpenCV axes",
    "usd/hand.usda": "the animated hand for other programs; choose its variant splats, points or mesh",
    "usd/hand.shot.usda": "the hand with the cameras of this demo",
    "report.json": "how long everything took",
}


def options_of(words: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("demo_output"), help="where everything is put")
    parser.add_argument("--blender-python", type=Path, help="a Python that has bpy; left out, the engine draws alone")
    parser.add_argument("--hand", choices=("right", "left"), default="right", help="which hand")
    parser.add_argument("--poses", default=POSES, help="what it does: poses by name, with ways between them")
    parser.add_argument("--size", default="512x512", help="pixels of one picture, WIDTHxHEIGHT")
    parser.add_argument("--avatar", default="builtin", help="a .jghand file, builtin or painted")
    return parser.parse_args(words)


if __name__ == "__main__":
    # help must not wait for what takes seconds to import
    OPTIONS = options_of()
    sys.path.insert(0, str(SCRIPTS.parent))

import numpy as np

from jghand_engine.avatar import BUILTIN, SHIPPED
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_avatar_called
from jghand_engine.avatar.forearm import ended
from jghand_engine.cli.console import progress, say, say_error, say_table
from jghand_engine.cli.export import export_stage, usd_figures
from jghand_engine.cli.frame_files import FrameFiles, FrameWriter
from jghand_engine.cli.options import pixels, pose_list
from jghand_engine.cli.timings import Timings
from jghand_engine.errors import JGHandError
from jghand_engine.export.camera_file import camera_to_dict
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
from jghand_engine.export.usd.package import UsdOptions
from jghand_engine.export.video import write_video
from jghand_engine.files import make_folder
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import MotionOptions, pose_sequence_of_names
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.json_files import write_json
from jghand_engine.motion.files import write_motion
from jghand_engine.render.camera import Camera
from jghand_engine.render.framing import framing_camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset


@dataclass
class Demo:
    """What is shown, and where it goes."""

    out: Path
    avatar_name: str
    avatar: HandAvatar
    sequence: PoseSequence
    cameras: dict[str, Camera]
    # seconds by step
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def blend(self) -> Path:
        return self.out / "hand.blend"

    def frames(self, side: str) -> FrameFiles:
        """Where the pictures of a side are."""
        return FrameFiles(self.out / "frames" / side, name=FRAME_NAME, first=FIRST_FRAME, text=f"Rendering {side}")

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - started


def main(options: argparse.Namespace) -> int:
    try:
        return run(options)
    except JGHandError as error:
        say_error(str(error))
        return error.exit_code


def run(options: argparse.Namespace) -> int:
    width, height = pixels(options.size)
    handedness = Handedness(options.hand)
    avatar = ended(load_avatar_called(options.avatar)).for_hand(handedness)
    sequence = demo_motion(avatar, pose_list(options.poses))
    cameras = {side: framing_camera(sequence.joints_m, handedness, side, width=width, height=height) for side in SIDES}
    demo = Demo(make_folder(options.out), options.avatar, avatar, sequence, cameras)
    say(f"{len(sequence)} frames of a {handedness} hand, seen from {' and '.join(SIDES)}")
    remove_old_results(demo)
    write_motion(demo.out / "motion.npz", sequence)
    timings = Timings()
    if options.blender_python is None:
        say("No --blender-python: the engine renders alone, and there will be no .blend file.")
        with demo.step("pictures"):
            render_alone(demo, timings)
    else:
        with demo.step("Blender file"):
            build_blend(demo, options.blender_python)
        with demo.step("pictures, through Blender"):
            render_blend(demo, options.blender_python, timings)
    with demo.step("video and contact sheet"):
        write_video_of(demo)
        write_sheet_of(demo)
    with demo.step("USD"):
        usd = export_stage(demo.out / "usd", avatar, sequence, cameras, UsdOptions(overwrite=True))
    timings.show(f"One picture of {width} x {height} with {len(avatar)} Gaussians, median of {timings.frames}")
    say_table("The whole job", ("step", "seconds"), [(name, f"{s:.1f}") for name, s in demo.seconds.items()])
    write_json(demo.out / "report.json", {
        "hand": options.hand, "frames": len(sequence), "size_px": [width, height], "preset": PRESET,
        "blender": options.blender_python is not None, "seconds": demo.seconds, "backend": timings.backend,
        "stages": timings.figures(), "usd": usd_figures(usd),
    })  # fmt: skip
    there = {name: text for name, text in FILES.items() if (demo.out / name).exists()}
    lines = [f"{name:<20}{text}" for name, text in there.items()]
    (demo.out / "README.txt").write_text("\n".join(["What this folder holds", "", *lines, ""]), encoding="utf-8")
    say(f"Done in {sum(demo.seconds.values()):.0f} s. {demo.out / 'README.txt'} says what is where.")
    return 0


def demo_motion(avatar: HandAvatar, poses: list[str]) -> PoseSequence:
    """Named poses while the whole hand sways about its long axis, so that more than one side is seen."""
    motion = MotionOptions(fps=FPS, move_s=MOVE_S, hold_s=HOLD_S)
    sequence = pose_sequence_of_names(
        poses, avatar.rest_joints_m, handedness=avatar.handedness, options=motion, fist=avatar.fist
    )
    angle_rad = np.radians(SWAY_DEG) * np.sin(np.linspace(0, 2 * np.pi, len(sequence)))
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    # about +y, the hand's long axis in the canonical frame
    turn = np.stack([cosine, zero, sine, zero, one, zero, -sine, zero, cosine], -1).reshape(-1, 1, 3, 3)
    root_m = sequence.joints_m[:, :1]
    swayed = (turn @ (sequence.joints_m - root_m)[..., None])[..., 0] + root_m
    return dataclasses.replace(sequence, joints_m=swayed)


def remove_old_results(demo: Demo) -> None:
    """Removes what an earlier demo made and this one may not make; a hand.blend that somebody changed since is kept
    under another name."""
    report = demo.out / "report.json"
    if demo.blend.exists() and (not report.exists() or demo.blend.stat().st_mtime > report.stat().st_mtime):
        names = (f"hand.previous{'' if i == 1 else f'.{i}'}.blend" for i in itertools.count(1))
        kept = next(path for path in map(demo.out.joinpath, names) if not path.exists())
        demo.blend.rename(kept)
        say(f"{demo.blend} is not as the last demo wrote it: it is kept as {kept.name}.")
    old = [demo.out / name for name in ("hand.blend", "hand.mp4", "cameras.json", "report.json")]
    for side in demo.cameras:
        pictures = demo.frames(side).folder.glob("*.png")
        old += [path for path in pictures if re.fullmatch(r"\d{4}\.png", path.name)]
    for path in old:
        path.unlink(missing_ok=True)


# ---- pictures --------------------------------------------------------------------------------------------------------


def render_alone(demo: Demo, timings: Timings) -> None:
    """Renders every side in this process."""
    renderer = HandRenderer(demo.avatar, preset(PRESET))
    for side, camera in demo.cameras.items():
        files = demo.frames(side)
        make_folder(files.folder)
        FrameWriter(renderer, demo.sequence.poses, camera, files, timings).write_all()


def build_blend(demo: Demo, python: Path) -> None:
    """Makes the .blend file: the rigged armature with the motion on it, and the cameras."""
    cameras = demo.out / "cameras.json"
    write_json(cameras, {side: camera_to_dict(camera) for side, camera in demo.cameras.items()})
    words: list[str | Path] = ["--motion", demo.out / "motion.npz", "--cameras", cameras, "--out", demo.blend]
    if demo.avatar_name != BUILTIN:
        words += ["--avatar", demo.avatar_name if demo.avatar_name in SHIPPED else Path(demo.avatar_name).resolve()]
    in_blender(python, "build_demo_scene.py", words, frames=0)


def render_blend(demo: Demo, python: Path, timings: Timings) -> None:
    """Renders every camera of the .blend file: joints from Blender, pictures from an engine process."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        words: list[str | Path] = [
            demo.blend, "--camera", ",".join(demo.cameras), "--out", demo.out / "frames", "--preset", PRESET,
            "--overwrite", "--report", report, "--engine-python", sys.executable,
        ]  # fmt: skip
        in_blender(python, "render_blend.py", words, frames=len(demo.sequence) * len(demo.cameras))
        for picture in json.loads(report.read_text(encoding="utf-8"))["pictures"]:
            for frame in picture["reports"]:
                timings.add(frame)
            for key, name in BLENDER_TIMES.items():
                timings.add_ms(name, picture[key])


def in_blender(python: Path, script: str, words: list[Any], frames: int) -> None:
    """Runs one of these scripts in Blender's Python, which says itself what fails; SystemExit with its code then."""
    command = [str(python), str(SCRIPTS / script), *map(str, words)]
    with (
        progress(f"Blender: {script}", max(frames, 1)) as bar,
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True, encoding="utf-8", errors="replace") as process,
    ):
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("frame "):
                bar.advance()
    if process.returncode:
        raise SystemExit(process.returncode)


# ---- what is made of them --------------------------------------------------------------------------------------------


def write_video_of(demo: Demo) -> None:
    """hand.mp4: the sides beside each other."""

    def frames() -> Iterator[np.ndarray]:
        for index in range(len(demo.sequence)):
            yield np.concatenate([shown(demo, side, index) for side in demo.cameras], axis=1)

    write_video(demo.out / "hand.mp4", frames(), demo.sequence.fps)


def write_sheet_of(demo: Demo) -> None:
    """contact_sheet.png: moments of the motion in columns, one row per side."""
    count = min(SHEET_COLUMNS, len(demo.sequence))
    moments = np.linspace(0, len(demo.sequence) - 1, count).round().astype(int).tolist()
    cells = [
        Cell(f"{side} · {index / demo.sequence.fps:.1f} s", shown(demo, side, index))
        for side in demo.cameras
        for index in moments
    ]
    write_png(demo.out / "contact_sheet.png", contact_sheet(cells, SheetStyle(columns=count)))


def shown(demo: Demo, side: str, index: int) -> np.ndarray:
    return flatten(premultiplied(read_png(demo.frames(side).path(index))), VIDEO_BACKGROUND)


if __name__ == "__main__":
    sys.exit(main(OPTIONS))
