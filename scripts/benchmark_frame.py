"""Where the milliseconds of a frame go, on this machine, beside the torch reference.

    python scripts/benchmark_frame.py [--rounds 100] [--threads 0] [--only frame,trained] [--json FILE]

Cases take turns, after a warm-up; samples during which the machine was not free are dropped; medians and p95. Nothing
is a sum of stages. Files and sockets are not part of it.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parents[1]))

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.posing import Poser
from jghand_engine.avatar.tiers import Tier
from jghand_engine.cli.console import progress, say, say_table
from jghand_engine.files import writing
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.reference import rasterize_reference
from jghand_engine.learn.shadow import darken
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.native.binding import Library
from jghand_engine.native.library import load
from jghand_engine.native.rasterizer import NativeRasterizer
from jghand_engine.native.threads import shared_pool, thread_count
from jghand_engine.render.backend import view_of
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.report import FrameReport
from jghand_engine.render.settings import RenderSettings, ShadowMode
from jghand_engine.render.shadow import NativeShade, ShadowStyle
from jghand_engine.render.subject import Subject, moving_subject
from jghand_engine.render.timing import COLUMNS, Case, frame_case, machine, measure, table_rows, title_of

SIZES = ((512, 334), (512, 512), (1024, 1024))
SAMPLES = 64
# rounds of what takes seconds
FEW = 3
WARM_UP = 10
PARTS = ("frame", "trained", "raster", "parts", "reference")


def cases(parts: list[str], threads: int) -> Iterator[Case]:
    library = load("auto")
    count = thread_count(threads)
    if "frame" in parts:
        yield from whole_frame_cases(every_frame_shadowed(threads))
    if "trained" in parts:
        yield from trained_cases(every_frame_shadowed(threads))
    if "raster" in parts:
        yield from raster_and_shadow_cases(library, count)
    if "parts" in parts:
        yield from part_cases(library, count)
    if "reference" in parts:
        yield from reference_cases(count)


def painted_subject(width: int, height: int) -> Subject:
    """The painted hand in motion; it fills the height of the picture."""
    return moving_subject("painted", load_painted(handedness=Handedness.RIGHT), width, height)


def whole_frame_cases(settings: RenderSettings) -> Iterator[Case]:
    """From joints to the finished picture, with stages, at every size."""
    for size in SIZES:
        yield frame_case(painted_subject(*size), settings, "whole frame, 64 samples on every frame")
    viewport = RenderSettings(threads=settings.threads)
    yield frame_case(painted_subject(*SIZES[0]), viewport, "whole frame, preset viewport (gated, 16 samples)")


def trained_cases(settings: RenderSettings, avatar: HandAvatar | None = None) -> Iterator[Case]:
    """Whole frames of the trained hand, or another one, by every tier of its correctives that has a price, and by the
    network; then of a camera that moves around a hand that does not."""
    subject = moving_subject("trained", avatar or load_builtin(handedness=Handedness.RIGHT), *SIZES[0])
    for tier in tiers_of(subject.avatar):
        section = f"whole frame, 64 samples where the pose asks for them, correctives {tier}"
        yield frame_case(subject, replace(settings, correctives=tier), section)
    yield moving_camera_case(subject, replace(settings, reuse=True), "the same pose from another camera, 64 samples")


def tiers_of(avatar: HandAvatar) -> list[Tier]:
    """The tiers that its correctives can be found by."""
    distilled = None if avatar.learned is None else avatar.learned.distilled
    priced = [] if distilled is None else [price.tier for price in distilled.prices]
    return list(dict.fromkeys([Tier.EXACT, *priced]))


def moving_camera_case(subject: Subject, settings: RenderSettings, section: str) -> Case:
    """One pose, seen from two places in turn."""
    renderer, sideways = HandRenderer(subject.avatar, settings), np.eye(4)
    sideways[0, 3] = 0.01
    moved = replace(subject.camera, camera_from_world=sideways @ subject.camera.camera_from_world)
    cameras = itertools.cycle([subject.camera, moved])

    def run() -> FrameReport:
        return renderer.render(subject.poses[0], next(cameras)).report

    return Case(section, title_of(subject), run, threads=thread_count(settings.threads))


def every_frame_shadowed(threads: int) -> RenderSettings:
    """The settings of the figures: every stage runs on every frame."""
    return RenderSettings(shadow=ShadowMode.ALWAYS, shadow_samples=SAMPLES, reuse=False, threads=threads)


def raster_and_shadow_cases(library: Library, threads: int) -> Iterator[Case]:
    """Posed Gaussians to the finished picture, and the gradients back, one after the other as a frame does it."""
    for size in SIZES:
        subject = painted_subject(*size)
        posed = _PosedScene(library, subject, threads)
        runs = {"raster + shadow, 64 samples": posed.forward, "raster alone": posed.raster_alone}
        if size == SIZES[0]:
            runs |= {
                "backward of the raster": posed.backward,
                "backward of shadow, then of the raster": posed.both_backward,
            }
        for section, run in runs.items():
            yield Case(section, title_of(subject), run, threads=threads)


class _PosedScene:
    """The first pose of a subject, ready to be drawn."""

    def __init__(self, library: Library, subject: Subject, threads: int) -> None:
        self._pool, self._camera = shared_pool(threads), subject.camera
        poser = Poser(library, replace(subject.avatar, learned=None))
        poser.prepare(subject.avatar.skeleton().bones(subject.poses[0]), subject.poses[0, 0])
        poser.run()
        self._gaussians = poser.into
        self._rasterizer = NativeRasterizer(library, threads)
        size = (subject.camera.height, subject.camera.width)
        self._shade = NativeShade(library, size[1], size[0])
        self._near_m = float(subject.camera.project(subject.poses[0, 0])[1])
        self._style = ShadowStyle(samples=SAMPLES)
        self._rgba, self._visibility = np.zeros((*size, 4), np.float32), np.zeros(size, np.float32)
        self._gradient = np.random.default_rng(3).normal(size=(5, *size)).astype(np.float32)
        self._through = np.zeros((5, *size), np.float32)
        self.forward()

    def raster_alone(self) -> None:
        self._rasterizer.forward(self._gaussians, view_of(self._camera))

    def forward(self) -> None:
        planes = self._rasterizer.forward(self._gaussians, view_of(self._camera))
        self._shade.prepare(
            planes, self._camera, self._style, near_m=self._near_m, visibility=self._visibility, rgba=self._rgba
        )
        self._pool.run(self._shade.run)

    def backward(self) -> None:
        self._rasterizer.backward(self._gradient)

    def both_backward(self) -> None:
        task = self._shade.prepare_backward(self._visibility, self._gradient[:3], self._through)
        self._pool.run(lambda _thread: self._shade.run_backward(task))
        self._rasterizer.backward(self._through)


def part_cases(library: Library, threads: int) -> Iterator[Case]:
    """The transform of one pose and the skinning of 60,000 Gaussians, native and in torch with the threads it has."""
    torch_threads = torch.get_num_threads()
    in_torch = f"torch, {torch_threads} threads"
    subject = painted_subject(*SIZES[0])
    avatar, poses = subject.avatar, itertools.cycle(subject.poses)
    fast = avatar.skeleton()
    yield Case("bone transforms of one pose", "native", lambda: _nothing(fast.bones(next(poses))), threads=1)
    exact = transform_of(avatar)
    tensors = itertools.cycle(torch.from_numpy(subject.poses).float())
    section = "bone transforms of one pose"
    yield Case(section, in_torch, lambda: _nothing(exact.bones(next(tensors))), threads=torch_threads)
    poser = Poser(library, replace(avatar, learned=None))
    bones, matrices = fast.bones(subject.poses[0]), exact.bones(torch.from_numpy(subject.poses[0]).float())

    def skin_with(count: int):
        def run() -> None:
            poser.prepare(bones, np.zeros(3))
            shared_pool(count).run(lambda _thread: poser.run())

        return run

    section = f"skinning of {len(avatar):,} Gaussians"
    for count in sorted({1, threads}):
        yield Case(section, f"native, {count} threads", skin_with(count), threads=count)
    yield Case(section, in_torch, lambda: _nothing(pose_gaussians(avatar, matrices)), threads=torch_threads)


def reference_cases(threads: int) -> Iterator[Case]:
    """The torch reference on the same pictures, with as many threads as torch was given."""
    subject = painted_subject(*SIZES[0])
    gaussians = posed_gaussians(subject)
    section, run = "torch reference, raster + shadow, 64 samples", lambda: reference_picture(gaussians, subject.camera)
    yield Case(section, title_of(subject), run, rounds=FEW, threads=threads)


def posed_gaussians(subject: Subject) -> Gaussians:
    """The Gaussians of the subject's first pose, world frame, float32."""
    bones = transform_of(subject.avatar).bones(torch.from_numpy(subject.poses[0]))
    with torch.no_grad():
        exact = pose_gaussians(subject.avatar, bones, frames=bones.frames)
    spheres = Gaussians(*(getattr(exact, name).float() for name in ("position_m", "sigma_m", "opacity", "rgb")))
    covariance_m2 = exact.covariance_m2
    return spheres if covariance_m2 is None else replace(spheres, covariance_m2=covariance_m2.float())


def reference_picture(gaussians: Gaussians, camera: Camera) -> None:
    """Raster and shadow in float32 torch."""
    with torch.no_grad():
        picture = rasterize_reference(gaussians, camera, alpha_min=RenderSettings().alpha_min)
        planes = torch.cat([picture.rgb.permute(2, 0, 1), picture.alpha[None], picture.depth_sum[None]])
        darken(planes, camera, ShadowStyle(samples=SAMPLES))


def _nothing(_result: object) -> None:
    """A case returns a report or nothing."""


def parts_of(text: str) -> list[str]:
    """The parts named in a list with commas; a misspelt one must not be measured as nothing."""
    parts = [part.strip() for part in text.split(",")]
    if unknown := [part for part in parts if part not in PARTS]:
        raise argparse.ArgumentTypeError(f"wanted some of {','.join(PARTS)}, got {','.join(unknown)}")
    return parts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=100, help="samples of every case")
    parser.add_argument("--threads", type=int, default=0, help="0: as many as is sensible")
    parser.add_argument("--only", type=parts_of, default=list(PARTS), help=f"some of {','.join(PARTS)}")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args()
    torch.set_num_threads(thread_count(options.threads))
    facts = machine(options.threads) | {"torch": torch.__version__}
    say(", ".join(f"{name} {value}" for name, value in facts.items()))
    chosen = list(cases(options.only, options.threads))
    with progress("Measuring", WARM_UP + options.rounds) as bar:
        measured = measure(chosen, rounds=options.rounds, warm_up=WARM_UP, tick=bar.advance)
    say_table("Milliseconds", COLUMNS, table_rows(measured))
    if options.json:
        content = {"machine": facts, "warm_up": WARM_UP, "measurements": [asdict(one) for one in measured]}
        with writing(options.json) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
