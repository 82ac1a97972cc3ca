"""Where the milliseconds of a frame go: what `jghand bench` and scripts/benchmark_frame.py measure.

Every figure is run end to end; a frame is never the sum of its stages. Files and sockets are not part of it.
"""

from __future__ import annotations

import itertools
import os
import platform
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.posing import Poser
from jghand_engine.avatar.tiers import Tier
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.reference import rasterize_reference
from jghand_engine.learn.shadow import darken
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.native.binding import Library
from jghand_engine.native.build import read_stamp
from jghand_engine.native.library import load
from jghand_engine.native.machine import processor
from jghand_engine.native.rasterizer import NativeRasterizer
from jghand_engine.native.threads import shared_pool, thread_count
from jghand_engine.render.backend import view_of
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.report import FrameReport
from jghand_engine.render.settings import RenderSettings, ShadowMode
from jghand_engine.render.shadow import NativeShade, ShadowStyle
from jghand_engine.render.subject import Subject, moving_subject
from jghand_engine.study.synthetic_hands import synthetic_hand
from jghand_engine.study.timing import Case, Measurement

SIZES = ((512, 334), (512, 512), (1024, 1024))
SAMPLES = 64
# rounds of what takes seconds
FEW = 3


def builtin_subject(width: int, height: int, avatar: HandAvatar | None = None, name: str = "painted") -> Subject:
    """The painted avatar (or another) in motion; the hand fills the height of the picture."""
    return moving_subject(name, avatar or load_painted(handedness=Handedness.RIGHT), width, height)


def volume_subject(name: str, width: int, height: int) -> Subject:
    """Volume A or B of RENDERING."""
    hand = synthetic_hand(name)
    return Subject(f"volume {name}", hand.avatar, hand.poses(200), hand.camera(width, height))


def subjects(width: int, height: int) -> list[Subject]:
    return [builtin_subject(width, height), *(volume_subject(name, width, height) for name in "AB")]


# ---- cases ----------------------------------------------------------------------------------------------------------


def whole_frame_cases(settings: RenderSettings) -> Iterator[Case]:
    """From joints to the finished picture, with stages, at every size."""
    for width, height in SIZES:
        for subject in subjects(width, height):
            yield frame_case(subject, settings, "whole frame, 64 samples on every frame")
    viewport = RenderSettings(threads=settings.threads, backend=settings.backend)
    yield frame_case(builtin_subject(*SIZES[0]), viewport, "whole frame, preset viewport (gated, 16 samples)")


def frame_case(subject: Subject, settings: RenderSettings, section: str) -> Case:
    renderer, poses = HandRenderer(subject.avatar, settings), itertools.cycle(subject.poses)

    def run() -> FrameReport:
        return renderer.render(next(poses), subject.camera).report

    return Case(section, _title(subject), run, threads=thread_count(settings.threads))


def trained_cases(settings: RenderSettings, avatar: HandAvatar | None = None) -> Iterator[Case]:
    """Whole frames of the trained hand, or another one, by every tier of its correctives that has a price, and by the
    network; then of a camera that moves around a hand that does not."""
    subject = builtin_subject(*SIZES[0], avatar or load_builtin(handedness=Handedness.RIGHT), "trained")
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

    return Case(section, _title(subject), run, threads=thread_count(settings.threads))


def every_frame_shadowed(threads: int, backend: str = "auto") -> RenderSettings:
    """The settings of the figures: every stage runs on every frame."""
    return RenderSettings(
        shadow=ShadowMode.ALWAYS, shadow_samples=SAMPLES, reuse=False, threads=threads, backend=backend
    )


def raster_and_shadow_cases(library: Library, threads: int) -> Iterator[Case]:
    """Posed Gaussians to the finished picture, and the gradients back, one after the other as a frame does it."""
    for width, height in SIZES:
        for subject in subjects(width, height):
            posed = _PosedScene(library, subject, threads)
            for section, run in (
                ("raster + shadow, 64 samples", posed.forward),
                ("backward of the raster", posed.backward),
                ("backward of shadow, then of the raster", posed.both_backward),
            ):
                if (width == SIZES[0][0] and height == SIZES[0][1]) or run == posed.forward:
                    yield Case(section, _title(subject), run, threads=threads)


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
    subject = builtin_subject(*SIZES[0])
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
    for subject in subjects(*SIZES[0]):
        gaussians = posed_gaussians(subject)
        yield Case(
            "torch reference, raster + shadow, 64 samples",
            _title(subject),
            lambda gaussians=gaussians, camera=subject.camera: reference_picture(gaussians, camera),
            rounds=FEW,
            threads=threads,
        )


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


def _title(subject: Subject) -> str:
    return f"{subject.name}, {subject.camera.width} x {subject.camera.height}"


def _nothing(_result: object) -> None:
    """A case returns a report or nothing."""


# ---- what it ran on -------------------------------------------------------------------------------------------------


def machine(threads: int, backend: str = "auto") -> dict[str, Any]:
    """Hardware, threads, variant and compiler, for the head of a table."""
    library = load(backend)
    stamp = read_stamp(library.path)
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "threads": thread_count(threads),
        "backend": library.variant,
        "compiler": stamp.compiler if stamp else "",
        "python": platform.python_version(),
        "torch": torch.__version__,
        "system": platform.platform(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }


def rows(measurements: list[Measurement]) -> list[tuple[str, ...]]:
    """Table rows: section or name, median, p95, processor time, samples kept of all."""
    out: list[tuple[str, ...]] = []
    for section in dict.fromkeys(one.section for one in measurements):
        out.append((section, "", "", "", ""))
        out += [_row(one) for one in measurements if one.section == section]
    return out


def _row(one: Measurement) -> tuple[str, ...]:
    samples = f"{one.samples}" + (f" of {one.samples + one.dropped}" if one.dropped else "")
    cpu = "" if one.cpu_ms is None else f"{one.cpu_ms:.2f}"
    mark = " disturbed" if one.disturbed else ""
    return (f"  {one.name}", f"{one.median_ms:.2f}", f"{one.p95_ms:.2f}", cpu, samples + mark)


COLUMNS = ("", "median ms", "p95 ms", "CPU ms", "samples")
