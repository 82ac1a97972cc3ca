"""`jghand render`: a motion becomes numbered PNG pictures with alpha, and a video if asked for."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jghand_engine.cli.console import say, write_figures
from jghand_engine.cli.options import (
    EffectOptions,
    FiguresFile,
    File,
    LightOptions,
    MotionOptions,
    PictureOptions,
    ShownAvatarOptions,
    parse_shard,
)
from jghand_engine.errors import InputError
from jghand_engine.json_files import write_json

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.cli.inputs import Motion
    from jghand_engine.export.frame_folder import Shard
    from jghand_engine.export.pass_writer import PassWriter
    from jghand_engine.render.camera import Camera
    from jghand_engine.render.effect_plan import Choice
    from jghand_engine.render.settings import RenderSettings

DESCRIPTION = """Render a motion as numbered PNG pictures with alpha, and as a video if you name one.

Examples:
  jghand render --poses open,fist,point --hand right --out pictures --video hand.mp4
  jghand render --motion capture.npy --order mediapipe --hand right --fps 30 --out pictures
  jghand render --motion wave.npz --camera front --size 1024x1024 --frames 0:99 --out pictures
  jghand render --poses open,fist --budget-ms 16 --out pictures
  jghand render --poses open,fist --light studio.hdr --out pictures
  jghand render --motion wave.npz --out truth --passes depth,normal,ids,alpha,joints
  jghand render --motion wave.npz --out pictures --frames 0-2399 --shard 3/8 --skip-existing"""


# angles told on the screen, of the thirty that a hand has
_OUT_OF_RANGE_SAID = 3


@dataclass(frozen=True)
class Render:
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """Where frame_00000.png and so on, and camera.json, are written."""
    video: File = None
    """Also write an MP4 video to this file, which ends in .mp4."""
    budget_ms: Annotated[float | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="")] = None
    """Instead of a preset: the best settings that draw a picture in so many milliseconds on this machine."""
    passes: Annotated[str | None, tyro.conf.arg(metavar="NAME,NAME,…", help_behavior_hint="")] = None
    """Ground truth beside the pictures: depth, normal, ids (of hand and bones) and alpha as EXR (extra formats), joints
    in 3D and 2D and which are visible; and the cameras for COLMAP and nerfstudio. docs/FORMATS.md says what is what."""
    shard: Annotated[str, tyro.conf.arg(metavar="NUMBER/COUNT")] = "1/1"
    """Make only this part of the pictures, every COUNT-th; other processes or machines make the others, into the same
    folder, and a folder with pictures of another render is refused. All parts together are, byte for byte, what one
    run makes (docs/SCALE.md)."""
    skip_existing: bool = False
    """Keep the pictures that this very command has made before, of whatever shard; make the missing and the broken
    ones. A folder with pictures of another render is refused."""
    motion: MotionOptions = field(default_factory=MotionOptions)
    avatar: ShownAvatarOptions = field(default_factory=ShownAvatarOptions)
    lighting: LightOptions = field(default_factory=LightOptions)
    picture: PictureOptions = field(default_factory=PictureOptions)
    effect: EffectOptions = field(default_factory=EffectOptions)
    json: FiguresFile = None

    def run(self) -> None:
        # before what takes seconds to import
        self.motion.check()
        from dataclasses import replace

        from jghand_engine.avatar.forearm import capped
        from jghand_engine.avatar.pose_range import range_report
        from jghand_engine.cli.frame_files import FrameFiles, FrameWriter
        from jghand_engine.cli.inputs import load_motion
        from jghand_engine.cli.timings import Receipts, Timings
        from jghand_engine.export.camera_file import camera_to_dict
        from jghand_engine.export.frame_folder import refuse_other_frames, settle_folder
        from jghand_engine.export.pass_writer import refuse_older_truth
        from jghand_engine.export.video import check_video_name, ffmpeg_program, refuse_foreign_video, write_video
        from jghand_engine.files import make_folder
        from jghand_engine.render.renderer import HandRenderer

        # what can be refused is refused before anything is written
        size, background = self.picture.size_px(), self.picture.background_rgb()
        effects = self._effects()
        passes = self._passes()
        shard = self._shard()
        if self.video is not None:
            check_video_name("--video", self.video)
            refuse_foreign_video("--video", self.video)
            ffmpeg_program()
        light = self.lighting.read()
        avatar = capped(self.avatar.load())
        motion = load_motion(self.motion, avatar)
        avatar = avatar.for_hand(motion.sequence.handedness)
        for note in motion.notes:
            say(note)
        refuse_other_frames(self.out, motion.frames)
        refuse_older_truth(self.out, () if passes is None else passes.names)
        camera = self._camera(motion, size)
        settings, chosen = self._settings(avatar, camera)
        # repeatable: any part of the pictures is the same as in the whole
        settings = replace(settings, depth=False, repeatable=True)
        if effects is not None:
            settings = replace(settings, effects=effects)
        renderer = HandRenderer(avatar, settings if passes is None else passes.settings(settings), light)
        joints_m = motion.sequence.joints_m
        files = FrameFiles(self.out, background, first=motion.frames.start, step=motion.frames.step)
        writer = FrameWriter(
            renderer, motion.sequence.poses, self._with_lens(camera, motion), files, Timings(), Receipts(), passes,
            self.effect.shutter,
        )  # fmt: skip
        if passes is not None:
            passes.start(avatar, renderer, joints_m, camera)
        stamp, paths = self._stamp(renderer.settings, motion), [files.path(k) for k in range(len(joints_m))]
        make_folder(self.out)
        settle_folder(self.out, stamp, paths, shard)
        started = time.perf_counter()
        write_json(self.out / "camera.json", camera_to_dict(camera))
        outcome = writer.write_all(shard)
        if passes is not None and outcome.complete:
            passes.finish(paths)
        if self.video is not None:
            write_video(self.video, writer.shown(), motion.sequence.fps)
        seconds = time.perf_counter() - started
        unseen, timings = range_report(avatar, joints_m), writer.timings
        timings.show(f"{timings.frames} pictures of {camera.width} x {camera.height}, {len(avatar)} Gaussians")
        if self.effect.explain and writer.receipts is not None:
            writer.receipts.show()
        if shard.is_shared:
            which = f"Shard {self.shard} of " if shard.count > 1 else ""
            say(f"{which}{len(joints_m)} pictures: {outcome.sentence()}")
        say(f"Done in {seconds:.1f} s: {self.out}" + (f" and {self.video}" if self.video else ""))
        for one in unseen[:_OUT_OF_RANGE_SAID]:
            say(f"Frame {one.frame}: {one.sentence()}.")
        if len(unseen) > _OUT_OF_RANGE_SAID:
            say(f"… and {len(unseen) - _OUT_OF_RANGE_SAID} angles more, less far outside; --json FILE lists all.")
        write_figures(self.json, {
            "command": "render", "motion": motion.source, "notes": motion.notes, "avatar": avatar.info.name,
            "out_of_range": [vars(one) for one in unseen],
            "frames": timings.frames, "size_px": [camera.width, camera.height], "preset": chosen,
            "backend": timings.backend, "seconds": seconds, "stages": timings.figures(),
            "effects": writer.receipts.figures() if writer.receipts is not None else {},
            "shard": self.shard, **vars(outcome),
        })  # fmt: skip

    def _shard(self) -> Shard:
        """Which pictures are made. InputError for what the processes of a shared render would not agree on."""
        from jghand_engine.export.frame_folder import Shard

        shard = Shard(*parse_shard(self.shard), self.skip_existing)
        if self.video is not None and shard.count > 1:
            raise InputError(
                "--video", wanted="all pictures", came=f"--shard {self.shard}",
                remedy="When all shards are done, the same command with --skip-existing, without --shard, makes it.",
            )  # fmt: skip
        if self.budget_ms is not None and self.picture.preset is not None:
            raise InputError("--budget-ms", wanted="no preset beside it: it finds the settings itself",
                             came=f"--preset {self.picture.preset}", remedy="Leave one of them out.")  # fmt: skip
        if self.budget_ms is not None and shard.is_shared:
            raise InputError(
                "--budget-ms", wanted="the same settings for every part of the pictures",
                came="settings that are found on each machine",
                remedy="Name a --preset, or leave out --shard and --skip-existing.",
            )  # fmt: skip
        return shard

    def _stamp(self, settings: RenderSettings, motion: Motion) -> dict[str, str]:
        from dataclasses import asdict

        from jghand_engine.avatar.builtin import avatar_sha256
        from jghand_engine.cli.frame_files import file_digest, render_stamp
        from jghand_engine.export.light_file import files_of
        from jghand_engine.gpu.choice import device_for
        from jghand_engine.native.library import load

        picture, effect, file = asdict(self.picture), asdict(self.effect), self.picture.camera_file
        # how fast, and what is told
        del picture["threads"], effect["explain"]
        picture |= {"size": self.picture.size_px(), "preset": self.picture.preset or "final"}
        # of a file what it holds, not what it is called
        camera = self.picture.camera if file is None else file_digest(file)
        look = {**picture, **effect, "forearm": self.avatar.forearm, "passes": self.passes, "camera": camera}
        if self.lighting.light is not None:
            look["light"] = [file_digest(each) for each in files_of(self.lighting.light)]
        if self.lighting.lamp:
            look["lamps"] = self.lighting.lamp
        whole = file is None or self.effect.shutter > 0 or self.effect.aperture > 0
        avatar = avatar_sha256(self.avatar.avatar)
        stamp = render_stamp(avatar, self.motion, motion, settings, look, whole=whole)
        # its pictures differ from the kernels' by single steps of a byte, and `auto` takes one on some machines
        on_card = device_for(settings.backend, load(settings.backend)) is not None
        return stamp | ({"device": "graphics card"} if on_card else {})

    def _effects(self) -> Choice | None:
        """Those that were asked for; None where what is called for runs, but for what a budget leaves out."""
        from jghand_engine.render.effect_plan import AUTO, Choice

        self.effect.check()
        choice = Choice.parse(self.effect.effects)
        return None if choice == AUTO else choice

    def _passes(self) -> PassWriter | None:
        if self.passes is None:
            return None
        from jghand_engine.export.pass_writer import PassWriter

        if self.effect.shutter or self.effect.aperture:
            # a pixel shows more than one place then
            raise InputError("--passes", wanted="a moment through a pinhole", came="--shutter or --aperture",
                             remedy="Render the passes in a run of their own, without them.")  # fmt: skip
        return PassWriter(self.passes, self.out)

    def _with_lens(self, camera: Camera, motion: Motion) -> Camera:
        """The camera with its lens, focused on the middle of the motion unless told otherwise."""
        if self.effect.aperture == 0:
            return camera
        from dataclasses import replace

        from jghand_engine.render.camera import Lens

        middle_m = motion.sequence.joints_m.reshape(-1, 3).mean(0)
        focus_m = float(camera.project(middle_m)[1]) if self.effect.focus is None else self.effect.focus
        return replace(camera, lens=Lens(1e-3 * self.effect.aperture, focus_m))

    def _settings(self, avatar: HandAvatar, camera: Camera) -> tuple[RenderSettings, str]:
        """How pictures are made, and what that is called."""
        from dataclasses import replace

        from jghand_engine.render.settings import preset

        if self.budget_ms is None:
            name = self.picture.preset or "final"
            return replace(preset(name), threads=self.picture.threads, backend=self.picture.backend), name
        from jghand_engine.render.budget import best_for

        size = (camera.width, camera.height)
        chosen = best_for(self.budget_ms, avatar, size, self.picture.threads, self.picture.backend)
        say(chosen.sentence)
        return chosen.settings, chosen.name

    def _camera(self, motion: Motion, size: tuple[int, int]) -> Camera:
        if (file := self.picture.camera_file) is not None:
            from jghand_engine.export.camera_file import read_camera

            return read_camera(file)
        from jghand_engine.render.framing import framing_camera

        sequence = motion.sequence
        return framing_camera(
            sequence.joints_m, sequence.handedness, self.picture.camera, width=size[0], height=size[1]
        )
