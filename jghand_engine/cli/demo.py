"""`jghand demo`: the main job from nothing to pictures, a video, a .blend file and a USD stage, in one folder."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from jghand_engine.cli.console import say, say_table, write_json
from jghand_engine.cli.options import AvatarOptions, File, HandName, PresetName, ReportOptions, pixels, pose_list
from jghand_engine.errors import InputError

DESCRIPTION = """The whole job at once: a motion, a rigged .blend file, pictures from two sides, a video, a USD stage.

Examples:
  jghand demo --out demo_output
  jghand demo --out demo_output --blender-python .envs/blender/bin/python --hand left"""

# the two sides that are shown
CAMERAS = ("front", "back")


@dataclass(frozen=True)
class Demo:
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("demo_output")
    """Where everything is put."""
    blender_python: File = None
    """A Python that has bpy: Blender then makes the .blend file and drives the pictures. scripts/demo.py gives one."""
    hand: HandName = "right"
    """Which hand."""
    poses: Annotated[str, tyro.conf.arg(metavar="NAME,NAME,…")] = "relaxed,spread,fist,point,ok,relaxed"
    """What it does: poses by name, with smooth ways between them."""
    size: Annotated[str, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = "512x512"
    """Pixels of one picture."""
    preset: PresetName = "final"
    """Accuracy against time."""
    avatar: AvatarOptions = field(default_factory=AvatarOptions)
    report: ReportOptions = field(default_factory=ReportOptions)

    def run(self) -> None:
        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.cli import demo_scene
        from jghand_engine.cli.export import export_stage, usd_figures
        from jghand_engine.export.usd.package import UsdOptions
        from jghand_engine.export.video import ffmpeg_program
        from jghand_engine.files import make_folder
        from jghand_engine.hand.joints import Handedness
        from jghand_engine.motion.files import write_motion
        from jghand_engine.render.framing import framing_camera

        width, height = pixels(self.size)
        try:
            ffmpeg_program()
            with_video = True
        except InputError as error:
            say(f"{error} The demo goes on without a video.")
            with_video = False
        out = make_folder(self.out)
        clock = Clock()
        with clock("hand and motion"):
            handedness = Handedness(self.hand)
            avatar = load_avatar_called(self.avatar.avatar).for_hand(handedness)
            sequence = demo_scene.demo_motion(avatar, pose_list(self.poses))
            cameras = {
                name: framing_camera(sequence.joints_m, handedness, name, width=width, height=height)
                for name in CAMERAS
            }
            write_motion(out / "motion.npz", sequence)
        say(f"{len(sequence)} frames of a {handedness} hand, seen from {' and '.join(CAMERAS)}")
        scene = demo_scene.Scene(sequence, cameras, self.preset, self.avatar.avatar, out)
        if note := demo_scene.remove_old_results(scene, keeps_blend=self.blender_python is not None):
            say(note)
        if self.blender_python is None:
            say(demo_scene.WITHOUT_BLENDER)
            blend_hash = None
            with clock("pictures"):
                timings = demo_scene.render_alone(scene, avatar)
        else:
            blender = demo_scene.Blender(self.blender_python)
            with clock("Blender file"):
                blend_hash = blender.build(scene)
            with clock("pictures, through Blender"):
                timings = blender.render(scene)
        with clock("video and contact sheet"):
            if with_video:
                demo_scene.write_video_of(scene)
            demo_scene.write_sheet_of(scene)
        with clock("USD"):
            usd = export_stage(out / "usd", avatar, sequence, cameras, UsdOptions(overwrite=True))
        demo_scene.write_readme(scene)
        timings.show(f"One picture of {width} x {height} with {len(avatar)} Gaussians, median of {timings.frames}")
        say_table("The whole job", ("step", "seconds"), [(name, f"{s:.1f}") for name, s in clock.seconds.items()])
        say(f"Done in {sum(clock.seconds.values()):.0f} s. Open {out / 'README.txt'} to see what is where.")
        figures = {
            "command": "demo", "hand": self.hand, "frames": len(sequence), "size_px": [width, height],
            "preset": self.preset, "blender": self.blender_python is not None, "seconds": clock.seconds,
            "backend": timings.backend, "stages": timings.figures(), "usd": usd_figures(usd), "finished": True,
            demo_scene.BLEND_HASH: blend_hash,
        }  # fmt: skip
        for path in {scene.report, self.report.json or scene.report}:
            write_json(path, figures)


class Clock:
    """Seconds by step, in their order."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, step: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self.seconds[step] = time.perf_counter() - started
