"""Painting with the native library: skin, raster, shadow and composition, in buffers that live as the painter does."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.fast_skinning import FastSkinning, PosedArrays
from jghand_engine.native.binding import Library, aligned_zeros
from jghand_engine.native.rasteriser import PLANES, GaussianArrays, NativeRasteriser
from jghand_engine.native.threads import WorkerPool, shared_pool, thread_count
from jghand_engine.splat.painter import COMPOSE, RASTER, SAME_PICTURE, SHADOW, SKIN, Canvas, Pose
from jghand_engine.splat.rasterise import view_of
from jghand_engine.splat.report import FrameReport
from jghand_engine.splat.settings import RenderSettings
from jghand_engine.splat.shadow_native import NativeShade


class NativePainter:
    """See painter.Painter. One picture at a time."""

    def __init__(self, library: Library, avatars: Sequence[HandAvatar], settings: RenderSettings) -> None:
        self.backend, self.threads = library.variant, thread_count(settings.threads)
        self._library, self._settings = library, settings
        self._skins = [FastSkinning(library, avatar) for avatar in avatars]
        rows = sum(skin.rows for skin in self._skins)
        self._gaussians = GaussianArrays(
            position_m=aligned_zeros((rows, 3)),
            sigma_m=aligned_zeros((rows,)),
            opacity=aligned_zeros((rows,)),
            rgb=aligned_zeros((rows, 3)),
        )
        self._places: list[PosedArrays] = []
        first = 0
        for skin in self._skins:
            place = slice(first, first + skin.rows)
            self._gaussians.opacity[place], self._gaussians.rgb[place] = skin.opacity, skin.rgb
            self._places.append(PosedArrays(self._gaussians.position_m[place], self._gaussians.sigma_m[place]))
            first += skin.rows
        self._padding = rows - sum(len(avatar) for avatar in avatars)
        self._rasteriser = NativeRasteriser(library, self.threads)
        self._shade: NativeShade | None = None
        self._planes: np.ndarray = aligned_zeros((PLANES, 0, 0))
        self._drawn: Canvas | None = None  # what the planes show

    def paint(
        self, poses: Sequence[Pose] | None, canvas: Canvas, report: FrameReport
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """See Painter."""
        if poses is not None:
            for skin, pose, place in zip(self._skins, poses, self._places, strict=True):
                skin.prepare(pose.bones, place, pose.shift_m)
            self._drawn = None
        keeps_picture = self._drawn is not None and canvas.same_view(self._drawn)
        self._drawn = None  # what follows may fail half way
        camera, settings = canvas.camera, self._settings
        if not keeps_picture:
            self._planes = self._rasteriser.prepare(
                self._gaussians, view_of(camera), alpha_min=settings.alpha_min, t_stop=settings.t_stop
            )
        rgba = np.empty((camera.height, camera.width, 4), np.float32)
        depth_m = np.empty((camera.height, camera.width), np.float32) if settings.depth else None
        shade = self._shade_for(camera.width, camera.height)
        shade.prepare(self._planes, camera, canvas.style, near_m=canvas.near_m, rgba=rgba, depth_m=depth_m)
        work = _Work([] if poses is None else self._skins, None if keeps_picture else self._rasteriser, shade)
        work.run(shared_pool(self.threads))
        self._drawn = canvas
        work.tell(report, COMPOSE if canvas.style is None else SHADOW)
        report.visible_gaussians = self._rasteriser.visible
        report.invalid_gaussians = self._rasteriser.invalid - self._padding
        return rgba, depth_m

    def _shade_for(self, width: int, height: int) -> NativeShade:
        if self._shade is None or (self._shade.task.width, self._shade.task.height) != (width, height):
            self._shade = None  # the old buffers first: both together may not fit
            self._shade = NativeShade(self._library, width, height)
        return self._shade


class _Work:
    """The stages of one picture. Every thread walks through all of them in one call of the pool: waking a thread costs
    more than a small stage, and a stage ends when its items are done, not when all threads have come (native/team.h).
    """

    def __init__(self, skins: list[FastSkinning], rasteriser: NativeRasteriser | None, shade: NativeShade) -> None:
        self._skins, self._rasteriser, self._shade = skins, rasteriser, shade
        self._times = [0.0] * 4

    def run(self, pool: WorkerPool) -> None:
        pool.run(self._walk)
        while self._rasteriser is not None and not self._rasteriser.finished():
            # the lists of the tiles had no room: everything again, which costs least where it never happens
            for part in (*self._skins, self._shade):
                part.team.fill(0)
            pool.run(self._walk)

    def _walk(self, thread: int) -> None:
        times = self._times if thread == 0 else [0.0] * 4
        times[0] = time.perf_counter()
        for skin in self._skins:
            skin.run()
        times[1] = time.perf_counter()
        if self._rasteriser is not None:
            self._rasteriser.run()
        times[2] = time.perf_counter()
        self._shade.run()
        times[3] = time.perf_counter()

    def tell(self, report: FrameReport, last: str) -> None:
        """Writes the stages into the report; `last` is what the shade call did."""
        skin_ms, raster_ms, shade_ms = (1e3 * float(step) for step in np.diff(self._times))
        if self._skins:
            report.ran(SKIN, skin_ms)
        if self._rasteriser is None:
            report.skipped(RASTER, SAME_PICTURE, "0")
        else:
            report.ran(RASTER, raster_ms)
        report.ran(last, shade_ms)
