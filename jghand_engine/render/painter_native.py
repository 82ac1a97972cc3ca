"""Painting with the native library: skin, raster, shadow and composition, in buffers that live as the painter does."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.fast_learned import FastLearnedSkin
from jghand_engine.avatar.fast_skinning import FastSkinning, PosedArrays, padded_rows
from jghand_engine.native.binding import Library, aligned_zeros
from jghand_engine.native.rasterizer import PLANES, GaussianArrays, NativeRasterizer
from jghand_engine.native.threads import WorkerPool, shared_pool, thread_count
from jghand_engine.render.painter import (
    COMPOSE,
    GLOSS,
    RASTER,
    SAME_PICTURE,
    SHADOW,
    SKIN,
    Canvas,
    Pose,
    hand_weights,
    heaviest_part,
    owners,
    part_colors,
)
from jghand_engine.render.rasterize import view_of
from jghand_engine.render.report import FrameReport
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.shadow_native import NativeShade


class NativePainter:
    """See painter.Painter. One picture at a time."""

    keeps_correctives = True

    def __init__(self, library: Library, avatars: Sequence[HandAvatar], settings: RenderSettings) -> None:
        self.backend, self.threads = library.variant, thread_count(settings.threads)
        self._library, self._settings = library, settings
        rows = sum(padded_rows(len(avatar)) for avatar in avatars)
        self._gaussians = GaussianArrays(
            position_m=aligned_zeros((rows, 3)),
            sigma_m=aligned_zeros((rows,)),
            opacity=aligned_zeros((rows,)),
            rgb=aligned_zeros((rows, 3)),
            covariance_m2=aligned_zeros((rows, 6)) if any(map(_has_ellipsoids, avatars)) else None,
        )
        self._hands: list[_PaintedHand | _TrainedHand] = []
        first = 0
        for avatar in avatars:
            mine = _part(self._gaussians, slice(first, first + padded_rows(len(avatar))))
            self._hands.append((_PaintedHand if avatar.learned is None else _TrainedHand)(library, avatar, mine))
            first += len(mine)
        self._padding = rows - sum(len(avatar) for avatar in avatars)
        self._rasterizer = NativeRasterizer(library, self.threads)
        self._shade: NativeShade | None = None
        self._planes: np.ndarray = aligned_zeros((PLANES, 0, 0))

    def paint(
        self, poses: Sequence[Pose] | None, canvas: Canvas, report: FrameReport, *, keeps_picture: bool = False
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """See Painter."""
        if poses is not None:
            for hand, pose in zip(self._hands, poses, strict=True):
                hand.prepare(pose)
        camera, settings = canvas.camera, self._settings
        if not keeps_picture:
            self._planes = self._rasterizer.prepare(
                self._gaussians, view_of(camera), alpha_min=canvas.alpha_min, t_stop=settings.t_stop
            )
        rgba = np.empty((camera.height, camera.width, 4), np.float32)
        depth_m = np.empty((camera.height, camera.width), np.float32) if canvas.depth else None
        shade = self._shade_for(camera.width, camera.height)
        shade.prepare(self._planes, camera, canvas.style, near_m=canvas.near_m, rgba=rgba, depth_m=depth_m)
        work = _Work(
            skins=[] if poses is None else self._hands,
            # a picture that is kept is of the same camera
            shining=[] if keeps_picture else [hand for hand in self._hands if hand.prepare_gloss(canvas.eye_m)],
            rasterizer=None if keeps_picture else self._rasterizer,
            shade=shade,
        )
        work.run(shared_pool(self.threads))
        work.tell(report, COMPOSE if canvas.style is None else SHADOW)
        report.visible_gaussians = self._rasterizer.visible
        report.invalid_gaussians = self._rasterizer.invalid - self._padding
        return rgba, depth_m

    def hand_weights(self, canvas: Canvas) -> np.ndarray:
        """See Painter."""
        numbers = owners([hand.rows for hand in self._hands])
        rasterizer = NativeRasterizer(self._library, self.threads)
        return hand_weights(len(self._hands), lambda first: self._coverage(rasterizer, canvas, numbers, first))

    def part_map(self, canvas: Canvas, parts: Sequence[np.ndarray]) -> np.ndarray:
        """See Painter."""
        numbers = np.concatenate([hand.in_rows(one) for hand, one in zip(self._hands, parts, strict=True)])
        rasterizer = NativeRasterizer(self._library, self.threads)
        return heaviest_part(int(numbers.max()), lambda first: self._coverage(rasterizer, canvas, numbers, first))

    def _coverage(self, rasterizer: NativeRasterizer, canvas: Canvas, numbers: np.ndarray, first: int) -> np.ndarray:
        """(H, W, 3) how much of a pixel the Gaussians of these numbers cover: `first` and the next two."""
        colored = replace(self._gaussians, rgb=part_colors(numbers, first))
        drawn = rasterizer.forward(
            colored, view_of(canvas.camera), alpha_min=canvas.alpha_min, t_stop=self._settings.t_stop
        )
        return drawn[:3].transpose(1, 2, 0).copy()

    def _shade_for(self, width: int, height: int) -> NativeShade:
        if self._shade is None or (self._shade.task.width, self._shade.task.height) != (width, height):
            self._shade = None  # the old buffers first: both together may not fit
            self._shade = NativeShade(self._library, width, height)
        return self._shade


def _has_ellipsoids(avatar: HandAvatar) -> bool:
    return avatar.learned is not None and avatar.learned.ellipsoid is not None


def _part(every: GaussianArrays, rows: slice) -> GaussianArrays:
    covariance = None if every.covariance_m2 is None else every.covariance_m2[rows]
    return GaussianArrays(every.position_m[rows], every.sigma_m[rows], every.opacity[rows], every.rgb[rows], covariance)


class _PaintedHand:
    """A hand whose colors stay as they are, and its rows in the arrays of the picture."""

    def __init__(self, library: Library, avatar: HandAvatar, into: GaussianArrays) -> None:
        self._skin = FastSkinning(library, avatar)
        into.opacity[:], into.rgb[:] = self._skin.opacity, self._skin.rgb
        self._into = PosedArrays(into.position_m, into.sigma_m, into.covariance_m2)
        self.run, self.teams, self.rows = self._skin.run, [self._skin.team], len(into)
        self.in_rows = self._skin.blocks.in_rows

    def prepare(self, pose: Pose) -> None:
        self._skin.prepare(pose.bones, self._into, pose.shift_m)

    def prepare_gloss(self, eye_m: np.ndarray) -> bool:
        return False

    def run_gloss(self) -> None:
        """It has none."""


class _TrainedHand:
    """A hand with light and gloss, and its rows in the arrays of the picture."""

    def __init__(self, library: Library, avatar: HandAvatar, into: GaussianArrays) -> None:
        self._skin = FastLearnedSkin(library, avatar)
        into.opacity[:] = self._skin.skin.opacity
        self._into, self._rgb = PosedArrays(into.position_m, into.sigma_m, into.covariance_m2), into.rgb
        self.run, self.teams, self.rows = self._skin.run, [self._skin.team, self._skin.gloss_team], len(into)
        self.prepare_gloss, self.run_gloss = self._skin.prepare_gloss, self._skin.run_gloss
        self.in_rows = self._skin.skin.blocks.in_rows

    def prepare(self, pose: Pose) -> None:
        self._skin.prepare(pose.bones, self._into, self._rgb, pose.shift_m, keeps_correctives=pose.keeps_correctives)


class _Work:
    """The stages of one picture. Every thread walks through all of them in one call of the pool: waking a thread costs
    more than a small stage, and a stage ends when its items are done, not when all threads have come (native/team.h).

    skins: hands in a new pose · shining: hands whose gloss is seen from elsewhere
    """

    def __init__(
        self,
        skins: Sequence[_PaintedHand | _TrainedHand],
        shining: Sequence[_PaintedHand | _TrainedHand],
        rasterizer: NativeRasterizer | None,
        shade: NativeShade,
    ) -> None:
        self._skins, self._shining, self._rasterizer, self._shade = skins, shining, rasterizer, shade
        self._times = [0.0] * 5

    def run(self, pool: WorkerPool) -> None:
        pool.run(self._walk)
        while self._rasterizer is not None and not self._rasterizer.finished():
            # the lists of the tiles had no room: everything again, which costs least where it never happens
            for team in (self._shade.team, *(team for hand in (*self._skins, *self._shining) for team in hand.teams)):
                team.fill(0)
            pool.run(self._walk)

    def _walk(self, thread: int) -> None:
        times = self._times if thread == 0 else [0.0] * 5
        times[0] = time.perf_counter()
        for hand in self._skins:
            hand.run()
        times[1] = time.perf_counter()
        for hand in self._shining:
            hand.run_gloss()
        times[2] = time.perf_counter()
        if self._rasterizer is not None:
            self._rasterizer.run()
        times[3] = time.perf_counter()
        self._shade.run()
        times[4] = time.perf_counter()

    def tell(self, report: FrameReport, last: str) -> None:
        """Writes the stages into the report; `last` is what the shade call did."""
        skin_ms, gloss_ms, raster_ms, shade_ms = (1e3 * float(step) for step in np.diff(self._times))
        if self._skins:
            report.ran(SKIN, skin_ms)
        if self._shining:
            report.ran(GLOSS, gloss_ms)
        if self._rasterizer is None:
            report.skipped(RASTER, SAME_PICTURE, "0")
        else:
            report.ran(RASTER, raster_ms)
        report.ran(last, shade_ms)
