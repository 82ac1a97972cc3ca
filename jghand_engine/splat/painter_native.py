"""Painting with the native library: skin, raster, shadow and composition, in buffers that live as the painter does."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.fast_skinning import FastSkinning, PosedArrays, padded_rows
from jghand_engine.native.binding import Library, aligned_zeros
from jghand_engine.native.rasteriser import PLANES, GaussianArrays, NativeRasteriser
from jghand_engine.native.threads import WorkerPool, shared_pool, thread_count
from jghand_engine.splat.painter import COMPOSE, RASTER, SAME_PICTURE, SHADOW, SKIN, Canvas, Pose
from jghand_engine.splat.rasterise import view_of
from jghand_engine.splat.report import FrameReport
from jghand_engine.splat.settings import RenderSettings
from jghand_engine.splat.shadow_native import NativeShade
from jghand_engine.splat.torch_rows import TorchRows


class NativePainter:
    """See painter.Painter. One picture at a time."""

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
        # by the place of their avatar: painted hands in the team of threads, trained ones by torch before it
        self._skins: dict[int, tuple[FastSkinning, PosedArrays]] = {}
        self._by_torch: dict[int, TorchRows] = {}
        first = 0
        for place, avatar in enumerate(avatars):
            mine = slice(first, first + padded_rows(len(avatar)))
            self._add_hand(place, avatar, mine)
            first = mine.stop
        self._padding = rows - sum(len(avatar) for avatar in avatars)
        self._rasteriser = NativeRasteriser(library, self.threads)
        self._shade: NativeShade | None = None
        self._planes: np.ndarray = aligned_zeros((PLANES, 0, 0))
        self._drawn: Canvas | None = None  # what the planes show

    def _add_hand(self, place: int, avatar: HandAvatar, rows: slice) -> None:
        every = self._gaussians
        mine = GaussianArrays(
            every.position_m[rows],
            every.sigma_m[rows],
            every.opacity[rows],
            every.rgb[rows],
            None if every.covariance_m2 is None else every.covariance_m2[rows],
        )
        if avatar.learnt is not None or mine.covariance_m2 is not None:
            self._by_torch[place] = TorchRows(avatar, mine)
            return
        skin = FastSkinning(self._library, avatar)
        mine.opacity[:], mine.rgb[:] = skin.opacity, skin.rgb
        self._skins[place] = (skin, PosedArrays(mine.position_m, mine.sigma_m))

    def paint(
        self, poses: Sequence[Pose] | None, canvas: Canvas, report: FrameReport
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """See Painter."""
        started = time.perf_counter()
        if poses is not None:
            self._pose(poses)
            self._drawn = None
        keeps_picture = self._drawn is not None and canvas.same_view(self._drawn)
        self._drawn = None  # what follows may fail half way
        camera, settings = canvas.camera, self._settings
        if not keeps_picture:
            for hand in self._by_torch.values():
                hand.colour(canvas.eye_m)
        before_ms = 1e3 * (time.perf_counter() - started) if self._by_torch else 0.0
        if not keeps_picture:
            self._planes = self._rasteriser.prepare(
                self._gaussians, view_of(camera), alpha_min=settings.alpha_min, t_stop=settings.t_stop
            )
        rgba = np.empty((camera.height, camera.width, 4), np.float32)
        depth_m = np.empty((camera.height, camera.width), np.float32) if settings.depth else None
        shade = self._shade_for(camera.width, camera.height)
        shade.prepare(self._planes, camera, canvas.style, near_m=canvas.near_m, rgba=rgba, depth_m=depth_m)
        skins = [] if poses is None else [skin for skin, _ in self._skins.values()]
        work = _Work(skins, None if keeps_picture else self._rasteriser, shade)
        work.run(shared_pool(self.threads))
        self._drawn = canvas
        if poses is not None or (self._by_torch and not keeps_picture):
            report.ran(SKIN, before_ms + work.skin_ms)
        work.tell(report, COMPOSE if canvas.style is None else SHADOW)
        report.visible_gaussians = self._rasteriser.visible
        report.invalid_gaussians = self._rasteriser.invalid - self._padding
        return rgba, depth_m

    def _pose(self, poses: Sequence[Pose]) -> None:
        for place, (skin, into) in self._skins.items():
            skin.prepare(poses[place].bones, into, poses[place].shift_m)
        for place, hand in self._by_torch.items():
            hand.pose(poses[place])

    def _shade_for(self, width: int, height: int) -> NativeShade:
        if self._shade is None or (self._shade.task.width, self._shade.task.height) != (width, height):
            self._shade = None  # the old buffers first: both together may not fit
            self._shade = NativeShade(self._library, width, height)
        return self._shade


def _has_ellipsoids(avatar: HandAvatar) -> bool:
    return avatar.learnt is not None and avatar.learnt.ellipsoid is not None


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

    @property
    def skin_ms(self) -> float:
        """How long posing took."""
        return 1e3 * (self._times[1] - self._times[0])

    def tell(self, report: FrameReport, last: str) -> None:
        """Writes the stages after the skin into the report; `last` is what the shade call did."""
        _, raster_ms, shade_ms = (1e3 * float(step) for step in np.diff(self._times))
        if self._rasteriser is None:
            report.skipped(RASTER, SAME_PICTURE, "0")
        else:
            report.ran(RASTER, raster_ms)
        report.ran(last, shade_ms)
