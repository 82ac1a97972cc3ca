"""What draws a frame: skin, raster, shadow and composition by the kernels, in buffers that live as long as the backend.

`renderer.py` says what is drawn, the backend obeys.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import padded_rows
from jghand_engine.avatar.cast_task import Capsules
from jghand_engine.avatar.end_cap import SEEN_BARE
from jghand_engine.avatar.posing import Poser, new_rows
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.avatar.scene_light_step import NO_DEPTHS, Apart
from jghand_engine.gpu.choice import device_for, new_rasterizer
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native import library as native_library
from jghand_engine.native.binding import aligned_zeros
from jghand_engine.native.rasterizer import PLANES, GaussianArrays, NativeRasterizer, SeenSurface, View
from jghand_engine.native.scene_light_task import LampDepth
from jghand_engine.native.threads import WorkerPool, shared_pool, thread_count
from jghand_engine.render.blur import LinearMean
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import DetailedHand, NativeDetail
from jghand_engine.render.effect_plan import Sharp
from jghand_engine.render.lamp_depth import LampPictures
from jghand_engine.render.light_effects import layers_of, limits_of
from jghand_engine.render.passes import hand_weights, heaviest_part, owners, part_colors
from jghand_engine.render.report import FrameReport
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.shadow import NativeShade, ShadowStyle

# names of the stages
LAMP_DEPTH, SKIN, LIGHT, GLOSS, RASTER, SHADOW, COMPOSE, DETAIL = (
    "lamp pictures",
    "skin",
    "light",
    "gloss",
    "raster",
    "shadow + compose",
    "compose",
    "detail",
)


@dataclass(frozen=True)
class Pose:
    """One hand of an image.

    bones:            its bone transforms
    shift_m:          (3,) its root relative to the image's origin, meters
    keep_correctives: whether those of the last pose are used again
    others:           flesh of the hands that cast a shadow on it; None where none is near
    """

    bones: Bones
    shift_m: np.ndarray
    keep_correctives: bool = False
    others: Capsules | None = None


@dataclass(frozen=True)
class Canvas:
    """What to draw.

    camera:    of the image's origin, that is camera_from_world @ translation(origin)
    near_m:    depth of the origin, meters
    style:     of the shadow, None for none
    posed:     per hand whether it stands in its pose; the others were outside the image when it was new
    alpha_min: cut-off of the blend
    depth:     whether somebody wants it
    light:     of the scene; None for that of the capture
    seen:      per hand whether it can be in the image
    detail:    strength of each hand's, 0..1; empty for none
    sharp:     per hand which shadows on it have the edges of surfaces; empty for none
    """

    camera: Camera
    near_m: float
    style: ShadowStyle | None
    posed: tuple[bool, ...]
    alpha_min: float
    depth: bool = False
    light: SceneLight | None = None
    seen: tuple[bool, ...] = ()
    detail: tuple[float, ...] = ()
    sharp: tuple[Sharp, ...] = ()

    @cached_property
    def layers(self) -> tuple[int, ...]:
        """Numbers of the lamps whose light is drawn apart, to be shadowed at each pixel."""
        return layers_of(self.sharp, self.seen)

    def same_view(self, other: Canvas | None) -> bool:
        """Whether the two see the same Gaussians in the same way, shadow aside."""
        if other is None or self.alpha_min != other.alpha_min or self.light != other.light:
            return False
        if self.detail != other.detail:
            return False
        mine, theirs = self.camera, other.camera
        numbers = ("width", "height", "fx", "fy", "cx", "cy", "orthographic")
        if any(getattr(mine, name) != getattr(theirs, name) for name in numbers):
            return False
        return np.array_equal(mine.camera_from_world, theirs.camera_from_world)


def view_of(camera: Camera) -> View:
    """The camera as the kernel takes it, for positions in the world frame."""
    pinhole = (camera.fx, camera.fy, camera.cx, camera.cy)
    return View(camera.width, camera.height, *pinhole, camera.camera_from_world[:3], camera.orthographic)


class Backend:
    """Draws hands, whose avatars it knows, again and again. One image at a time.

    variant: of the kernels, and the graphics card if one draws
    threads: how many draw
    light:   of the scene, in which the Gaussians stand
    draws_layers: whether light can be drawn apart
    """

    def __init__(self, avatars: Sequence[HandAvatar], settings: RenderSettings, detail_powers: Sequence[float]) -> None:
        """detail_powers: per avatar, of the ratios of its detail"""
        library = native_library.load(settings.backend)
        self._device, self.threads = device_for(settings.backend, library), thread_count(settings.threads)
        self.variant = library.variant if self._device is None else f"{library.variant}, {self._device.name}"
        self._library, self._settings, self.draws_layers = library, settings, self._device is None
        rows = sum(padded_rows(len(avatar)) for avatar in avatars)
        self._gaussians = new_rows(rows, ellipsoids=any(map(_has_ellipsoids, avatars)), fades=any(map(_fades, avatars)))
        self._hands: list[Poser] = []
        self._ends_hands = all(avatar.detail is not None and avatar.detail.ends_hand for avatar in avatars)
        if not self._ends_hands:
            avatars = [
                avatar if avatar.cap is None else replace(avatar, cap=replace(avatar.cap, seen_at=SEEN_BARE))
                for avatar in avatars
            ]
        self._pixels_m = [avatar.pixel_m for avatar in avatars]
        limits, sweeps, first = limits_of(settings.effects), settings.swept_light, 0
        for avatar in avatars:
            mine = _part(self._gaussians, slice(first, first + padded_rows(len(avatar))))
            self._hands.append(Poser(library, avatar, mine, limits, sweeps=sweeps))
            first += len(mine)
        self._counts = [len(avatar) for avatar in avatars]
        self._padding = rows - sum(self._counts)
        # numbers of the hands that have one
        self._detailed = [place for place, avatar in enumerate(avatars) if avatar.detail is not None]
        self._detail: NativeDetail | None = None
        if self._detailed:
            self._detail = NativeDetail(
                library,
                [DetailedHand.of(avatars[place], detail_powers[place], self._hands[place]) for place in self._detailed],
                outline_px=settings.outline_px,
            )
        self._pictures = LampPictures(self._detail, avatars) if self._detail and self._ends_hands else None
        # scales of the hands as they are posed, and the origin of their positions
        self._stand: tuple[list[float], np.ndarray] = [], np.zeros(3)
        # of the light that is drawn apart: numbers of the lamps, per hand their pictures, and what it makes of colors
        self._layers: tuple[int, ...] = ()
        self._depths: Sequence[Mapping[int, LampDepth]] = [NO_DEPTHS] * len(avatars)
        self._layer_rows = aligned_zeros((0, rows, 4))
        self.light: SceneLight | None = None
        self.rest()

    def draw(
        self, poses: Sequence[Pose] | None, canvas: Canvas, report: FrameReport, *, keep_image: bool = False
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """-> rgba (H, W, 4) float32 premultiplied, depth (H, W) float32 meters or None. Both belong to the caller.

        poses: one per avatar; None keeps the Gaussians of the last call · keep_image: also what was drawn of them, in
        the same view
        """
        camera, light, layers = canvas.camera, canvas.light, canvas.layers
        skins: list[Poser] = []
        if poses is not None:
            skins = [hand for hand, stands in zip(self._hands, canvas.posed, strict=True) if stands]
            # hands of one image share its low pass: it is that of the finest pictures that are known
            pixels_m = (pixel_m * pose.bones.scale for pixel_m, pose in zip(self._pixels_m, poses, strict=True))
            self._gaussians = replace(self._gaussians, pixel_m=min(filter(None, pixels_m), default=0.0))
            if self._detail is not None:
                posed = [poses[place] for place in self._detailed]
                self._detail.pose([pose.bones for pose in posed], [pose.shift_m for pose in posed])
            self._stand = [pose.bones.scale for pose in poses], poses[0].bones.root_m - poses[0].shift_m
            depths = self._take_depths(canvas, report)
            for place, (hand, pose) in enumerate(zip(self._hands, poses, strict=True)):
                if not canvas.posed[place]:
                    hand.hide()
                    continue
                keeps, mine = pose.keep_correctives, None if light is None else light.on_hand(place)
                hand.prepare(
                    pose.bones,
                    pose.shift_m,
                    keep_correctives=keeps,
                    others=pose.others,
                    light=mine,
                    depths=depths[place],
                )
        elif light is not None and (light != self.light or layers != self._layers):
            lit = zip(self._hands, self._take_depths(canvas, report), strict=True)
            skins = [hand for place, (hand, own) in enumerate(lit) if hand.prepare_light(light.on_hand(place), own)]
        self.light, self._layers = light, layers
        if not keep_image:
            self._planes, self._surface = self._prepare_raster(canvas), None
        # an image that is kept has its own
        detail = self._detail if canvas.detail and not keep_image else None
        if detail is not None:
            strengths = [canvas.detail[place] for place in self._detailed]
            seen = [canvas.seen[place] for place in self._detailed]
            detail.prepare(self._planes, camera, strengths, ends_hands=self._ends_hands, seen=seen)
            depths = [self._depths[place] for place in self._detailed]
            detail.shadow_pixels(self._rasterizer.layer_planes[: len(layers)], depths)
            if self._device is None and self._gaussians.front is not None:
                self._surface = detail.seen_surface
            if self._surface is not None:
                self._rasterizer.set_surface(self._surface)
        assert not layers or detail is not None or keep_image, "light that is drawn apart is added with the detail"
        rgba = np.empty((camera.height, camera.width, 4), np.float32)
        depth_m = np.empty((camera.height, camera.width), np.float32) if canvas.depth else None
        shade = self._shade_for(camera.width, camera.height)
        shade.prepare(self._planes, camera, canvas.style, near_m=canvas.near_m, rgba=rgba, depth_m=depth_m)
        if self._surface is not None:
            shade.set_surface(self._surface)
        work = _Work(
            skins=skins,
            # an image that is kept is of the same camera
            shining=[] if keep_image else self._prepare_gloss(canvas),
            rasterizer=None if keep_image else self._rasterizer,
            detail=detail,
            shade=shade,
        )
        work.run(shared_pool(self.threads))
        work.report_to(report, LIGHT if poses is None else SKIN, COMPOSE if canvas.style is None else SHADOW)
        report.visible_gaussians = self._rasterizer.visible
        hidden = sum(count for count, stands in zip(self._counts, canvas.posed, strict=True) if not stands)
        report.invalid_gaussians = self._rasterizer.invalid - self._padding - hidden
        if self._rasterizer.fell_back:
            report.backend = self._library.variant
            report.notes.append(self._rasterizer.fell_back)
        return rgba, depth_m

    def _prepare_raster(self, canvas: Canvas) -> np.ndarray:
        """Planes of the image."""
        count, gaussians = len(canvas.layers), self._gaussians
        if count:
            if len(self._layer_rows) < count:
                self._layer_rows = aligned_zeros((count, len(gaussians), 4))
            gaussians = replace(gaussians, layers=self._layer_rows[:count])
        view, alpha_min = view_of(canvas.camera), canvas.alpha_min
        return self._rasterizer.prepare(gaussians, view, alpha_min=alpha_min, t_stop=self._settings.t_stop)

    def _prepare_gloss(self, canvas: Canvas) -> list[Poser]:
        """The hands that are seen from elsewhere, or with other light apart."""
        shining, first = [], 0
        for place, hand in enumerate(self._hands):
            apart, rows = None, slice(first, first + hand.blocks.rows)
            if canvas.layers:
                at_pixels = np.array([canvas.sharp[place].at_pixels[lamp] for lamp in canvas.layers], np.float32)
                apart = Apart(at_pixels, self._layer_rows[: len(canvas.layers), rows])
            if hand.prepare_gloss(canvas.camera.eye_m, apart):
                shining.append(hand)
            first = rows.stop
        return shining

    def _take_depths(self, canvas: Canvas, report: FrameReport) -> Sequence[Mapping[int, LampDepth]]:
        """Per hand what stands before lamps, as it is posed."""
        self._depths = [NO_DEPTHS] * len(self._hands)
        if self._pictures is None or canvas.light is None or not canvas.sharp:
            return self._depths
        started = time.perf_counter()
        sharp = [
            one if stands else replace(one, weights=()) for one, stands in zip(canvas.sharp, canvas.posed, strict=True)
        ]
        pool = shared_pool(self.threads)
        self._depths = self._pictures.take(canvas.light.lamps, sharp, *self._stand, pool, canvas.layers)
        report.ran(LAMP_DEPTH, 1e3 * (time.perf_counter() - started))
        return self._depths

    def rest(self) -> None:
        """Lets go of the buffers of the last image; those of the Gaussians stay. The next one is drawn anew."""
        self._rasterizer = self._new_rasterizer()
        self._shade: NativeShade | None = None
        self._planes: np.ndarray = aligned_zeros((PLANES, 0, 0))
        # the skin that is drawn in them
        self._surface: SeenSurface | None = None
        if self._detail is not None:
            self._detail.rest()

    def mean(self, width: int, height: int, *, linear: bool) -> LinearMean:
        """A mean of images of that size, empty. linear: whether they are scene-linear"""
        return LinearMean(self._library, self.threads, width, height, linear=linear)

    def hand_weights(self, canvas: Canvas) -> np.ndarray:
        """(H, W, hands) how much of a pixel each hand covers, of the Gaussians of the last call."""
        numbers = owners([hand.blocks.rows for hand in self._hands])
        rasterizer = self._new_rasterizer()
        return hand_weights(len(self._hands), lambda first: self._coverage(rasterizer, canvas, numbers, first))

    def part_map(self, canvas: Canvas, parts: Sequence[np.ndarray]) -> np.ndarray:
        """(H, W) uint8 number of the part that covers most of the pixel, 0 where hardly anything does, of the Gaussians
        of the last call. parts: per hand the number, from 1, of the part that each of its Gaussians belongs to."""
        numbers = np.concatenate([hand.blocks.in_rows(one) for hand, one in zip(self._hands, parts, strict=True)])
        rasterizer = self._new_rasterizer()
        return heaviest_part(int(numbers.max()), lambda first: self._coverage(rasterizer, canvas, numbers, first))

    def _coverage(self, rasterizer: NativeRasterizer, canvas: Canvas, numbers: np.ndarray, first: int) -> np.ndarray:
        """(H, W, 3) how much of a pixel the Gaussians of these numbers cover: `first` and the next two."""
        colored = replace(self._gaussians, rgb=part_colors(numbers, first), front=None)
        drawn = rasterizer.forward(
            colored, view_of(canvas.camera), alpha_min=canvas.alpha_min, t_stop=self._settings.t_stop
        )
        return drawn[:3].transpose(1, 2, 0).copy()

    def _new_rasterizer(self) -> NativeRasterizer:
        return new_rasterizer(self._library, self.threads, self._device)

    def _shade_for(self, width: int, height: int) -> NativeShade:
        if self._shade is None or (self._shade.task.width, self._shade.task.height) != (width, height):
            self._shade = None  # the old buffers first: both together may not fit
            self._shade = NativeShade(self._library, width, height)
        return self._shade


def _has_ellipsoids(avatar: HandAvatar) -> bool:
    return avatar.learned is not None and avatar.learned.ellipsoid is not None


def _fades(avatar: HandAvatar) -> bool:
    return avatar.learned is not None and avatar.learned.fades


def _part(every: GaussianArrays, rows: slice) -> GaussianArrays:
    covariance, front = (None if a is None else a[rows] for a in (every.covariance_m2, every.front))
    arrays = (every.position_m[rows], every.sigma_m[rows], every.opacity[rows], every.rgb[rows])
    return GaussianArrays(*arrays, covariance, front)


class _Work:
    """The stages of one image. Every thread walks through all of them in one call of the pool: waking a thread costs
    more than a small stage, and a stage ends when its items are done, not when all threads have come (native/team.h).

    skins: hands in a new pose or light · shining: hands whose gloss is seen from elsewhere
    """

    def __init__(
        self,
        skins: Sequence[Poser],
        shining: Sequence[Poser],
        rasterizer: NativeRasterizer | None,
        detail: NativeDetail | None,
        shade: NativeShade,
    ) -> None:
        self._skins, self._shining, self._rasterizer, self._shade = skins, shining, rasterizer, shade
        self._detail, self._times = detail, [0.0] * 7

    def run(self, pool: WorkerPool) -> None:
        if self._rasterizer is not None and self._rasterizer.finishes_elsewhere:
            self._run_in_two(pool, self._rasterizer)
            return
        pool.run(self._walk)
        while self._rasterizer is not None and not self._rasterizer.finished():
            # the lists of the tiles had no room: everything again, which costs least where it never happens
            after = [self._shade.team, *([] if self._detail is None else [self._detail.team])]
            for team in (*after, *(team for hand in (*self._skins, *self._shining) for team in hand.teams)):
                team.fill(0)
            pool.run(self._walk)

    def _run_in_two(self, pool: WorkerPool, rasterizer: NativeRasterizer) -> None:
        """The threads wait while another device draws."""
        pool.run(self._walk_to_lists)
        while not rasterizer.finished():
            pool.run(rasterizer.run)
        pool.run(self._walk_from_planes)

    def _walk(self, thread: int) -> None:
        self._walk_to_lists(thread)
        self._walk_from_planes(thread)

    def _walk_to_lists(self, thread: int) -> None:
        times = self._times if thread == 0 else [0.0] * 7
        times[0] = time.perf_counter()
        for hand in self._skins:
            hand.run()
        times[1] = time.perf_counter()
        for hand in self._shining:
            hand.run_gloss()
        times[2] = time.perf_counter()
        if self._detail is not None:
            self._detail.find_surface()
        times[3] = time.perf_counter()
        if self._rasterizer is not None:
            self._rasterizer.run()

    def _walk_from_planes(self, thread: int) -> None:
        times = self._times if thread == 0 else [0.0] * 7
        times[4] = time.perf_counter()
        if self._detail is not None:
            self._detail.run()
        times[5] = time.perf_counter()
        self._shade.run()
        times[6] = time.perf_counter()

    def report_to(self, report: FrameReport, first: str, last: str) -> None:
        """Writes the stages into the report; `first` is what was done to the skins, `last` what the shade call did."""
        steps = itertools.pairwise(self._times)
        skin_ms, gloss_ms, surface_ms, raster_ms, detail_ms, shade_ms = (1e3 * (end - start) for start, end in steps)
        if self._skins:
            report.ran(first, skin_ms)
        if self._shining:
            report.ran(GLOSS, gloss_ms)
        if self._rasterizer is not None:
            report.ran(RASTER, raster_ms)
        if self._detail is not None:
            report.ran(DETAIL, surface_ms + detail_ms)
        report.ran(last, shade_ms)
