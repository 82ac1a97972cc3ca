"""How the time of a picture grows: with Gaussians, pixels, hands in the scene; and that of poses with their number."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.learn.baselines import transform_of
from jghand_engine.native.threads import thread_count
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.report import FrameReport
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.subject import Subject, moving_subject
from jghand_engine.render.timing import Case, Measurement, frame_case

GAUSSIANS, PIXELS, HANDS, POSES = (
    "Gaussians in the hand",
    "pixels of the picture",
    "hands in the scene",
    "poses in a batch",
)
PANELS = (GAUSSIANS, PIXELS, HANDS, POSES)
_SECTION = "growth: "
# frames of each point
GROWTH_ROUNDS = 12


@dataclass(frozen=True)
class Growth:
    """A point of a curve."""

    # one of PANELS
    panel: str
    # how many
    x: int
    # of one picture; of POSES, of one call that finds the bones of x poses (torch)
    median_ms: float
    p95_ms: float
    # see Measurement
    disturbed: bool

    @classmethod
    def of(cls, measured: Iterable[Measurement]) -> list[Growth]:
        """The points among measurements; stages of frames are left out."""
        return [
            cls(one.section.removeprefix(_SECTION), int(one.name), one.median_ms, one.p95_ms, one.disturbed)
            for one in measured
            if one.section.startswith(_SECTION) and not one.name.startswith(" ")
        ]


@dataclass(frozen=True)
class Reach:
    """How far each curve goes; sizes up to 4K."""

    gaussians: Sequence[int] = (10_000, 30_000, 100_000, 300_000, 1_000_000)
    sizes_px: Sequence[tuple[int, int]] = ((256, 167), (512, 334), (1024, 668), (1920, 1080), (3840, 2160))
    hands: Sequence[int] = (1, 2, 4)
    poses: Sequence[int] = (1, 10, 100, 1000)


QUICK_REACH = Reach((10_000, 30_000, 100_000), ((256, 167), (512, 334), (1024, 668)), (1, 2), (1, 10, 100))


def growth_cases(
    avatar: HandAvatar, size_px: tuple[int, int], settings: RenderSettings, reach: Reach
) -> Iterator[Case]:
    """Cases whose names are the x of their curves."""
    # small and distant hands would be drawn larger: as all times of this study these are without that filter
    settings = replace(settings, antialias=False)
    subject = moving_subject(avatar.info.name, avatar, *size_px)
    for count in reach.gaussians:
        yield _grown(frame_case(replace(subject, avatar=resampled(avatar, count)), settings, ""), GAUSSIANS, count)
    for width, height in reach.sizes_px:
        sized = moving_subject(avatar.info.name, avatar, width, height)
        yield _grown(frame_case(sized, settings, ""), PIXELS, width * height)
    for hands in reach.hands:
        yield _grown(_scene_case(subject, hands, settings), HANDS, hands)
    transform = transform_of(avatar)
    for count in reach.poses:
        poses = torch.from_numpy(np.resize(subject.poses, (count, *subject.poses.shape[1:]))).float()
        case = Case("", "", lambda poses=poses: _nothing(transform.bones(poses)), threads=torch.get_num_threads())
        yield _grown(case, POSES, count)


def _grown(case: Case, panel: str, x: int) -> Case:
    return replace(case, section=_SECTION + panel, name=str(x), rounds=GROWTH_ROUNDS)


def resampled(avatar: HandAvatar, count: int) -> HandAvatar:
    """The hand of `count` Gaussians that fill the same volume: its own taken again and again, each a little beside its
    place and smaller the more they are. Without what training added to a pose."""
    random, taken = np.random.default_rng(0), np.arange(count) % len(avatar)
    size = (count / len(avatar)) ** (-1 / 3)
    beside = random.normal(size=(count, 3)).astype(np.float32) * avatar.sigma_m[taken, None]
    names = ("opacity", "rgb", "bone_weights", "uvd")
    return HandAvatar(
        info=avatar.info, handedness=avatar.handedness, canonical_joints_m=avatar.canonical_joints_m,
        position_m=avatar.position_m[taken] + beside, sigma_m=avatar.sigma_m[taken] * np.float32(size),
        **{name: getattr(avatar, name)[taken] for name in names},
    )  # fmt: skip


def _scene_case(subject: Subject, hands: int, settings: RenderSettings) -> Case:
    """So many hands side by side, farther away the more they are."""
    renderer, poses = SceneRenderer([subject.avatar] * hands, settings), itertools.cycle(subject.poses)
    beside_m = np.array([[0.12 * (i - (hands - 1) / 2), 0, 0] for i in range(hands)])
    nearer = 1 / math.sqrt(hands)
    camera = replace(subject.camera, fx=subject.camera.fx * nearer, fy=subject.camera.fy * nearer)

    def run() -> FrameReport:
        pose_m = next(poses)
        return renderer.render([pose_m + offset_m for offset_m in beside_m], camera).report

    return Case("", "", run, threads=thread_count(settings.threads))


def _nothing(_result: object) -> None:
    """A case returns a report or nothing."""
