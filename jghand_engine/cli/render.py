"""`jghand render`: a motion becomes numbered PNG pictures with alpha, and a video if asked for."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jghand_engine.cli.console import progress, say, write_json
from jghand_engine.cli.options import (
    AvatarOptions,
    EffectOptions,
    File,
    MotionOptions,
    PictureOptions,
    ReportOptions,
    pixels,
)
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np

    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.avatar.pose_range import OutOfRange
    from jghand_engine.cli.inputs import Motion
    from jghand_engine.cli.receipts import Receipts
    from jghand_engine.cli.render_passes import PassWriter
    from jghand_engine.cli.timings import Timings
    from jghand_engine.splat.camera import Camera
    from jghand_engine.splat.effect_plan import Choice
    from jghand_engine.splat.frame import HandRenderer
    from jghand_engine.splat.settings import RenderSettings

DESCRIPTION = """Render a motion as numbered PNG pictures with alpha, and as a video if you name one.

Examples:
  jghand render --poses open,fist,point --hand right --out pictures --video hand.mp4
  jghand render --motion capture.npy --order mediapipe --hand right --fps 30 --out pictures
  jghand render --motion wave.npz --camera front --size 1024x1024 --frames 0:99 --out pictures
  jghand render --poses open,fist --budget-ms 16 --out pictures
  jghand render --motion wave.npz --out truth --passes depth,normal,ids,alpha,joints"""

# what a transparent picture lies on in a video
VIDEO_BACKGROUND = (0.91, 0.90, 0.89)


@dataclass(frozen=True)
class Render:
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """Where frame_00000.png and so on, and camera.json, are written."""
    video: File = None
    """Also write an MP4 video to this file."""
    budget_ms: Annotated[float | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="")] = None
    """Instead of a preset: the best settings that draw a picture in so many milliseconds on this machine."""
    passes: Annotated[str | None, tyro.conf.arg(metavar="NAME,NAME,…", help_behavior_hint="")] = None
    """Ground truth beside the pictures: depth, normal, ids (of hand and bones) and alpha as EXR (extra formats), joints
    in 3D and 2D and which are visible; and the cameras for COLMAP and nerfstudio. docs/FORMATS.md says what is what."""
    motion: MotionOptions = field(default_factory=MotionOptions)
    avatar: AvatarOptions = field(default_factory=AvatarOptions)
    picture: PictureOptions = field(default_factory=PictureOptions)
    effect: EffectOptions = field(default_factory=EffectOptions)
    report: ReportOptions = field(default_factory=ReportOptions)

    def run(self) -> None:
        from dataclasses import replace

        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.cli.camera_file import camera_to_dict
        from jghand_engine.cli.inputs import load_motion
        from jghand_engine.cli.receipts import Receipts
        from jghand_engine.cli.render_passes import refuse_older_truth
        from jghand_engine.cli.timings import Timings
        from jghand_engine.exporters.video import ffmpeg_program
        from jghand_engine.files import make_folder
        from jghand_engine.splat.frame import HandRenderer

        # what can be refused is refused before anything is written
        size, background = pixels(self.picture.size), self.picture.background_rgb()
        effects = self._effects()
        passes = self._passes()
        if self.video is not None:
            ffmpeg_program()
        avatar = load_avatar_called(self.avatar.avatar)
        motion = load_motion(self.motion, avatar)
        avatar = avatar.for_hand(motion.sequence.handedness)
        for note in motion.notes:
            say(note)
        refuse_longer_render(self.out, len(motion.sequence))
        refuse_older_truth(self.out, () if passes is None else passes.names)
        camera = self._camera(motion, size)
        settings, chosen = self._settings(avatar, camera)
        settings = replace(settings, effects=effects, antialias=True, depth=False)
        renderer = HandRenderer(avatar, settings if passes is None else passes.settings(settings))
        through = self._with_lens(camera, motion)
        if passes is not None:
            passes.start(avatar, renderer, motion.sequence.joints_m, camera)
        make_folder(self.out)
        timings = Timings()
        started = time.perf_counter()
        write_json(self.out / "camera.json", camera_to_dict(camera))
        receipts, target = Receipts(), Target(self.out, background, shutter=self.effect.shutter)
        pictures = render_pictures(renderer, motion.sequence.joints_m, through, target, timings, receipts, passes)
        if self.video is not None:
            from jghand_engine.exporters.video import write_video

            write_video(self.video, pictures, motion.sequence.fps)
        else:
            for _ in pictures:
                pass
        if passes is not None:
            passes.finish()
        seconds = time.perf_counter() - started
        unseen = out_of_range(avatar, motion)
        timings.show(f"{timings.frames} pictures of {camera.width} x {camera.height}, {len(avatar)} Gaussians")
        if self.effect.explain:
            receipts.show()
        say(f"Done in {seconds:.1f} s: {self.out}" + (f" and {self.video}" if self.video else ""))
        for one in unseen:
            say(f"Frame {one.frame}: {one.sentence()}.")
        if self.report.json is not None:
            write_json(self.report.json, {
                "command": "render", "motion": motion.source, "notes": motion.notes, "avatar": avatar.info.name,
                "out_of_range": [one.as_dict() for one in unseen],
                "frames": timings.frames, "size_px": [camera.width, camera.height], "preset": chosen,
                "backend": timings.backend, "seconds": seconds, "stages": timings.figures(),
                "effects": receipts.figures(),
            })  # fmt: skip

    def _effects(self) -> Choice:
        from jghand_engine.splat.effect_plan import Choice

        self.effect.check()
        return Choice.parse(self.effect.effects)

    def _passes(self) -> PassWriter | None:
        if self.passes is None:
            return None
        from jghand_engine.cli.render_passes import PassWriter

        return PassWriter(self.passes, self.out, self.effect)

    def _with_lens(self, camera: Camera, motion: Motion) -> Camera:
        """The camera with its lens, focused on the middle of the motion unless told otherwise."""
        if self.effect.aperture == 0:
            return camera
        from dataclasses import replace

        import torch

        from jghand_engine.splat.camera import Lens

        middle_m = torch.from_numpy(motion.sequence.joints_m.reshape(-1, 3).mean(0))
        focus_m = float(camera.project(middle_m)[1]) if self.effect.focus is None else self.effect.focus
        return replace(camera, lens=Lens(1e-3 * self.effect.aperture, focus_m))

    def _settings(self, avatar: HandAvatar, camera: Camera) -> tuple[RenderSettings, str]:
        """How pictures are made, and what that is called."""
        from dataclasses import replace

        from jghand_engine.splat.settings import preset

        if self.budget_ms is None:
            return replace(preset(self.picture.preset), threads=self.picture.threads), self.picture.preset
        from jghand_engine.splat.budget import best_for

        chosen = best_for(self.budget_ms, avatar, (camera.width, camera.height), self.picture.threads)
        say(chosen.sentence())
        return chosen.settings, chosen.rated.name

    def _camera(self, motion: Motion, size: tuple[int, int]) -> Camera:
        if self.picture.camera_file is not None:
            from jghand_engine.cli.camera_file import read_camera

            return read_camera(self.picture.camera_file)
        from jghand_engine.cli.framing import framing_camera

        sequence = motion.sequence
        return framing_camera(
            sequence.joints_m, sequence.handedness, self.picture.camera, width=size[0], height=size[1]
        )


def out_of_range(avatar: HandAvatar, motion: Motion) -> list[OutOfRange]:
    """Angles that the avatar was not trained on, each once, in the frame where it is farthest outside."""
    import torch

    from jghand_engine.avatar.pose_range import range_report

    return range_report(avatar, avatar.bone_transform().frames(torch.from_numpy(motion.sequence.joints_m)))


def refuse_longer_render(folder: Path, count: int) -> None:
    """InputError when the folder holds pictures that `count` new ones would not replace: two motions would be mixed.

    They are not removed: nothing tells whether they are still wanted.
    """
    found = (re.fullmatch(r"frame_(\d{5,})\.png", path.name) for path in folder.glob("frame_*.png"))
    left = sorted(match[0] for match in found if match and int(match[1]) >= count)
    if left:
        raise InputError(
            f"--out {folder}",
            wanted=f"a folder without pictures beyond the {count} of this run",
            came=f"{len(left)} of an earlier one ({left[0]} to {left[-1]})",
            remedy="Remove them or choose another folder.",
        )


@dataclass(frozen=True)
class Target:
    """Where pictures go. background: sRGB 0..1 that they are laid on, None keeps them transparent · name: pattern of
    the files, filled with the frame's number · first: number of the first frame · text: of the progress bar ·
    shutter: the part of the time between frames that it is open."""

    folder: Path
    background: tuple[float, float, float] | None = None
    name: str = "frame_{:05d}.png"
    first: int = 0
    text: str = "Rendering"
    shutter: float = 0.0

    def path(self, index: int) -> Path:
        return self.folder / self.name.format(self.first + index)


def render_pictures(
    renderer: HandRenderer,
    joints_m: np.ndarray,
    camera: Camera,
    target: Target,
    timings: Timings,
    receipts: Receipts | None = None,
    passes: PassWriter | None = None,
) -> Iterator[np.ndarray]:
    """Renders (F, 21, 3) level-order joints, writes every frame's PNG and passes, and yields the frame as (H, W, 3)
    uint8 on a background, as a video wants it."""
    from jghand_engine.exporters.pictures import flatten, write_png
    from jghand_engine.splat.exposure import shutter_at

    with progress(target.text, len(joints_m)) as bar:
        for index, pose_m in enumerate(joints_m):
            frame = renderer.render(pose_m, camera, shutter_at(joints_m, index, target.shutter))
            timings.add(frame.report.as_dict())
            if receipts is not None:
                receipts.add(frame.report)
            flat = flatten(frame.rgba, target.background or VIDEO_BACKGROUND)
            started = time.perf_counter()
            write_png(target.path(index), frame.rgba if target.background is None else flat)
            timings.add_ms("writing the PNG", 1e3 * (time.perf_counter() - started))
            if passes is not None:
                started = time.perf_counter()
                passes.add(index, frame, target.path(index))
                timings.add_ms("passes", 1e3 * (time.perf_counter() - started))
            bar.advance(bar.task_ids[0])
            yield flat
