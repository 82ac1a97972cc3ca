"""Painting with the native library: skin, raster, shadow and composition, in buffers that live as the painter does."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.fast_skinning import FastSkinning, PosedArrays
from jghand_engine.native.library import Library, aligned_zeros
from jghand_engine.native.rasteriser import GaussianArrays, NativeRasteriser
from jghand_engine.native.threads import shared_pool, thread_count
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
        self._drawn: tuple[Canvas, np.ndarray] | None = None

    def paint(
        self, poses: Sequence[Pose] | None, canvas: Canvas, report: FrameReport
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """See Painter."""
        pool = shared_pool(self.threads)
        if poses is not None:
            started = time.perf_counter()
            for skin, pose, place in zip(self._skins, poses, self._places, strict=True):
                skin.prepare(pose.bones, place, pose.shift_m)
            pool.run(lambda _thread: [skin.run() for skin in self._skins])
            self._drawn = None
            report.ran(SKIN, 1e3 * (time.perf_counter() - started))
        camera, settings = canvas.camera, self._settings
        planes = self._planes(canvas, report)
        report.visible_gaussians = self._rasteriser.visible
        report.invalid_gaussians = self._rasteriser.invalid - self._padding
        started = time.perf_counter()
        rgba = np.empty((camera.height, camera.width, 4), np.float32)
        depth_m = np.empty((camera.height, camera.width), np.float32) if settings.depth else None
        shade = self._shade_for(camera.width, camera.height)
        shade.prepare(planes, camera, canvas.style, near_m=canvas.near_m, rgba=rgba, depth_m=depth_m)
        pool.run(shade.run)
        report.ran(COMPOSE if canvas.style is None else SHADOW, 1e3 * (time.perf_counter() - started))
        return rgba, depth_m

    def _planes(self, canvas: Canvas, report: FrameReport) -> np.ndarray:
        """(5, H, W), drawn now or still there from the last picture."""
        if self._drawn is not None and canvas.same_view(self._drawn[0]):
            report.skipped(RASTER, SAME_PICTURE, "0")
            return self._drawn[1]
        started = time.perf_counter()
        settings = self._settings
        self._drawn = None  # the next line may fail half way
        planes = self._rasteriser.forward(
            self._gaussians, view_of(canvas.camera), alpha_min=settings.alpha_min, t_stop=settings.t_stop
        )
        self._drawn = (canvas, planes)
        report.ran(RASTER, 1e3 * (time.perf_counter() - started))
        return planes

    def _shade_for(self, width: int, height: int) -> NativeShade:
        if self._shade is None or (self._shade.task.width, self._shade.task.height) != (width, height):
            self._shade = None  # the old buffers first: both together may not fit
            self._shade = NativeShade(self._library, width, height)
        return self._shade
