"""What the pictures of a film show that Gaussians cannot hold: lines of the palm, marks, nail edges, as the texture of
the skin (`avatar.detail`).

The fit puts the hand some pixels off, elsewhere in each picture: a mean of all pictures has no marks. So every picture
is laid out on the texture and moved there, by optical flow, onto the mean of those before it, and again onto that of
all, which gets sharper with each round. Compared are logarithms of light without what is wider than some millimeters,
which is the Gaussians' and the light's. The texture is what the pictures have in the mean less what the drawn Gaussians
have.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.detail import Detail, log_ratios, ratio_bytes
from jghand_engine.avatar.relief import Relief
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.hand.joints import Handedness
from jghand_engine.native.library import load as load_native
from jghand_engine.own.gather import Shown, trusted
from jghand_engine.own.light_and_skin import LEAST, OwnHand
from jghand_engine.own.masks import opencv
from jghand_engine.render.detail import DetailedHand, SurfaceHits
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.settings import preset
from jghand_engine.template.surface import vertex_normals
from jghand_engine.template.texture import rasterize_uv
from jghand_engine.track.track import MOTION_FROM_CAMERA

# texels along a side: a third of a millimeter, as a film's pixels are; pictures are laid onto one another with fewer
TEXELS, FLOW_TEXELS = 1024, 512
# what is wider is the Gaussians' business, millimeters
WIDE_MM = 4.0
# alpha of the Gaussians that is nothing but hand; the outline, where it fades out, pixels
WHOLLY, OUTLINE_PX = 0.9, 6.0
# how far a surface may be from where a texel is, to be that texel's, and a step of depth at which one finger ends
# before another, meters
HERE_M, STEP_M, STEP_PX = 0.002, 0.006, 5
# cosine to the camera below which a texel is not seen, and the power by which squarer pictures count more
COSINE_MIN, COSINE_POWER = 0.35, 2
# rounds of flow; how soft the pictures are in each, texels of the flow; gray levels of a logarithm of 1
FLOW_SOFT, GRAY = (1.0, 0.65, 0.3), 400.0
# flow is believed where there is something to see, gray levels (of Sobel's kernel); it is smooth over so many texels of
# the flow (4 mm), and no longer than this (5 mm): the fit is 3 mm off
STRUCTURE, FLOW_SMOOTH, FLOW_MAX = 30.0, 6.0, 8.0
# part of the squared difference between picture and mean that a flow must take away to be believed wholly
BETTER = 0.3
# what a picture shows less, of what one square to the skin does, it does not show
KNOWN_MIN = 0.02
# pictures that must show a texel, or so much of what shows the best tenth if that is less: few are one finger's shadow
# on another one. From twice as many on its detail is whole, and so many texels away from where there are too few
SEEN_MIN, SEEN_PART, BEST_PART, FADE_TEXELS = 2.0, 0.2, 0.9, 8.0
# a picture that is so far from the mean of the others, as a logarithm, counts half
DISAGREE = 0.08


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the texels of the skin are. detail: the surface · covered: (S, S) bool · corners: (T, 3) vertices of the
    faces of the T covered texels, row by row · shares: (T, 3) of these"""

    detail: Detail
    covered: np.ndarray
    corners: np.ndarray
    shares: np.ndarray

    @classmethod
    def of(cls, detail: Detail) -> Layout:
        count = len(detail.faces)
        at_corner = np.zeros((count, 3, 4))
        at_corner[..., :3], at_corner[..., 3] = np.eye(3), np.arange(count)[:, None]
        values, covered = rasterize_uv(detail.face_uv, at_corner, TEXELS)
        inside = values[covered].astype(np.float32)
        return cls(detail, covered, detail.faces[np.rint(inside[:, 3]).astype(int)], inside[:, :3])

    def spread(self, values: np.ndarray) -> np.ndarray:
        """(S, S) float32 of (T,), 0 elsewhere."""
        whole = np.zeros(self.covered.shape, np.float32)
        whole[self.covered] = values
        return whole

    def mean(self, values: np.ndarray) -> np.ndarray:
        """(T, C) of vertices (V, C)."""
        return np.einsum("tk,tkc->tc", self.shares, values[self.corners].astype(np.float32))

    @cached_property
    def bones(self) -> np.ndarray:
        """(T, 21)"""
        return self.mean(self.detail.bone_weights)


@dataclass(frozen=True, eq=False)
class Laid:
    """One picture as the texture sees it.

    x, y:   (S, S) float32 pixels of a texel, as OpenCV counts them
    weight: (S, S) float32 0..1 how well the texel is seen; 0: not
    film, drawn: (h, w, 3) float32 logarithms of the film's light and of the drawn Gaussians', without what is wide
    """

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    film: np.ndarray
    drawn: np.ndarray


def seen_detail(own: OwnHand, surface: Detail, shown: Sequence[Shown], joints_m: np.ndarray) -> Detail:
    """The surface with the texture that pictures show, and its own fine skin where they show nothing.

    surface: on which the hand's skin lies, of its shape, with that of the prior · shown: the pictures, and joints_m
    (F, 21, 3) of their hands, camera axes
    """
    layout = Layout.of(surface)
    laid = laid_out(own, layout, shown, joints_m)
    flows = flows_between(laid)
    drawn, _ = _mean((one, one.drawn) for one in laid)

    def moved() -> Iterator[tuple[Laid, np.ndarray]]:
        """One after the other: they are large."""
        return ((_moved(one, flow, layout.covered), one.film) for one, flow in zip(laid, flows, strict=True))

    film, seen = _mean(moved())
    film, _ = _mean(moved(), film)
    strength = _strength(seen, layout.covered)
    return filled(surface, strength, film - drawn)


def filled(surface: Detail, strength: np.ndarray, seen: np.ndarray) -> Detail:
    """The surface with logarithms of ratios that were seen (S, S, 3), so strongly (S, S); the rest, smooth skin beside
    which would look unreal, keeps its own texture and relief. Of what was seen the light on a relief is in the texture.
    """
    part, rest = strength[..., None], 1 - strength[..., None]
    relief = surface.relief
    if relief is not None:
        relief = Relief(np.rint(rest * _of_texels(relief.height)).astype(np.int8))
    likely = log_ratios(_of_texels(surface.texture))
    return replace(surface, texture=ratio_bytes(part * seen + rest * likely), relief=relief)


def _of_texels(square: np.ndarray) -> np.ndarray:
    """(S, S, C) float32 with as many texels as are filled here."""
    return opencv().resize(square.astype(np.float32), (TEXELS, TEXELS), interpolation=opencv().INTER_AREA)


def _strength(seen: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """(S, S) 0..1 by how well texels are seen, in pictures; nowhere sudden, but where the texture ends."""
    least = min(SEEN_MIN, SEEN_PART * float(np.quantile(seen[covered], BEST_PART)))
    known = ((seen > least) | ~covered).astype(np.uint8)
    inwards = opencv().distanceTransform(known, opencv().DIST_L2, 3) / FADE_TEXELS
    return np.where(covered, inwards.clip(0, 1) * (seen / max(least, 1e-6) - 1).clip(0, 1), 0)


# ---- pictures on the texture -----------------------------------------------------------------------------------------


def laid_out(own: OwnHand, layout: Layout, shown: Sequence[Shown], joints_m: np.ndarray) -> list[Laid]:
    """Each picture, and the avatar in its place, in the light of the film."""
    avatar: HandAvatar = replace(own.avatar.for_hand(Handedness.RIGHT), detail=layout.detail)
    hand, skeleton = DetailedHand.of(avatar, 1.0), avatar.skeleton()
    hits = SurfaceHits(load_native("auto"), hand)
    renderer = SceneRenderer([replace(avatar, detail=None)], preset("final"), SceneLight(own.world))
    laid = []
    for one, joints, trust in zip(shown, joints_m * MOTION_FROM_CAMERA, trusted(joints_m), strict=True):
        bones = skeleton.bones(joints)
        posed_m = hand.posed_m(bones)
        outwards = layout.mean(vertex_normals(posed_m, layout.detail.faces))
        place_m = layout.mean(posed_m)
        cosine = -(outwards * place_m).sum(1) / np.linalg.norm(outwards, axis=1) / np.linalg.norm(place_m, axis=1)
        at_px, depth_m = one.camera.project(place_m)
        x, y = (layout.spread(axis - 0.5) for axis in at_px.T)
        surface_m = hits(bones, one.camera)[1]
        rgba = renderer.render([joints], one.camera).rgba
        inside = one.counts.numpy() * (rgba[..., 3] > WHOLLY) * np.isfinite(surface_m)
        soft_px = 1e-3 * WIDE_MM * one.camera.fx / float(depth_m.mean())
        drawn = rgba[..., :3] / np.maximum(rgba[..., 3:], LEAST)
        here = _at(np.where(np.isfinite(surface_m), surface_m, 0), x, y)[layout.covered]
        seen = (np.abs(here - depth_m) < HERE_M) & (cosine > COSINE_MIN)
        clear = _at(_away_from_edges(inside, surface_m), x, y)[layout.covered]
        weight = seen * clear * cosine.clip(0, 1) ** COSINE_POWER * (layout.bones @ trust.astype(np.float32))
        film, drawn = (_fine(light, inside, soft_px) for light in (one.radiance.numpy(), drawn))
        laid.append(Laid(x, y, layout.spread(weight), film, drawn))
    return laid


def _away_from_edges(inside: np.ndarray, surface_m: np.ndarray) -> np.ndarray:
    """(h, w) float32 0..1: 0 at outlines, also at those of a finger before another one, and 1 inside."""
    cv2 = opencv()
    depth_m = np.where(np.isfinite(surface_m), surface_m, 0).astype(np.float32)
    around = np.ones((STEP_PX, STEP_PX), np.uint8)
    steps = cv2.dilate(depth_m, around) - cv2.erode(depth_m, around) > STEP_M
    clear = ((inside > 0) & ~steps).astype(np.uint8)
    return (cv2.distanceTransform(clear, cv2.DIST_L2, 3) / OUTLINE_PX).clip(0, 1).astype(np.float32)


def _fine(light: np.ndarray, inside: np.ndarray, soft_px: float) -> np.ndarray:
    """(h, w, 3) float32 logarithm of light without its mean around each pixel, of pixels inside."""
    cv2 = opencv()
    log_light, weight = np.log(np.maximum(light, LEAST)).astype(np.float32), inside.astype(np.float32)
    wide = cv2.GaussianBlur(log_light * weight[..., None], (0, 0), soft_px)
    return log_light - wide / np.maximum(cv2.GaussianBlur(weight, (0, 0), soft_px), 1e-3)[..., None]


def _at(picture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return opencv().remap(picture, x, y, opencv().INTER_LINEAR)


# ---- laying pictures onto one another --------------------------------------------------------------------------------


def flows_between(laid: Sequence[Laid]) -> list[np.ndarray]:
    """(S, S, 2) of each picture: how many texels farther its own texel lies that belongs onto one of the mean."""
    cv2, size = opencv(), (FLOW_TEXELS, FLOW_TEXELS)
    factor = len(laid[0].x) / FLOW_TEXELS
    weights = [cv2.resize(one.weight, size, interpolation=cv2.INTER_AREA) for one in laid]
    films = [_small(one, weight) for one, weight in zip(laid, weights, strict=True)]
    flows = [np.zeros((*size, 2), np.float32)] * len(laid)
    search = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    search.setFinestScale(0)
    mean, known = np.zeros(size, np.float32), np.zeros(size, bool)
    for turn, soft in enumerate(FLOW_SOFT):
        summed, counted = np.zeros(size, np.float32), np.zeros(size, np.float32)
        # what shows the most comes first
        for number in sorted(range(len(laid)), key=lambda one: -float(weights[one].sum())):
            film, weight = films[number], weights[number]
            both = known & (weight > KNOWN_MIN)
            goal = _gray(mean, soft)
            # what only one of them shows lies as it is
            found = search.calc(goal, _gray(np.where(both, film, mean), soft), flows[number].copy())
            steep = np.hypot(cv2.Sobel(goal, cv2.CV_32F, 1, 0), cv2.Sobel(goal, cv2.CV_32F, 0, 1))
            flow = _smooth(found, (both * steep**2 / (steep**2 + STRUCTURE**2)).astype(np.float32))
            flow = flows[number] = flow * _better(film, mean, flow, both)[..., None]
            x, y = _shifted(flow)
            lies, counts = _at(film, x, y), _at(weight, x, y)
            if turn:
                counts = counts ** (1 + turn) * _alike(lies, mean, counts * known)
            summed, counted = summed + counts * lies, counted + counts
            if not turn:
                mean, known = summed / np.maximum(counted, 1e-9), counted > KNOWN_MIN
        mean = summed / np.maximum(counted, 1e-9)
    return [cv2.resize(flow, laid[0].x.shape) * np.float32(factor) for flow in flows]


def _small(one: Laid, weight: np.ndarray) -> np.ndarray:
    """(s, s) float32 the gray of a picture, of the texels that it shows. weight: (s, s)"""
    gray = _at(one.film.mean(-1), one.x, one.y) * one.weight
    return opencv().resize(gray, weight.shape, interpolation=opencv().INTER_AREA) / np.maximum(weight, 1e-6)


def _better(film: np.ndarray, mean: np.ndarray, flow: np.ndarray, both: np.ndarray) -> np.ndarray:
    """(s, s) 0..1: what lies no better moved than it did stays. both: (s, s) bool, what both show"""
    apart = [both * np.square(there - mean) for there in (film, _at(film, *_shifted(flow)))]
    before, after = (opencv().GaussianBlur(one.astype(np.float32), (0, 0), FLOW_SMOOTH) for one in apart)
    return ((1 - after / np.maximum(before, 1e-9)) / BETTER).clip(0, 1).astype(np.float32)


def _alike(film: np.ndarray, mean: np.ndarray, counts: np.ndarray) -> float:
    """0..1 how much of the mean a picture has: blurred ones, and ones that lie elsewhere, have little."""
    norm = float(np.sqrt((counts * film**2).sum() * (counts * mean**2).sum()))
    return max(float((counts * film * mean).sum()) / max(norm, 1e-9), 0.0)


def _shifted(flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(S, S) columns and rows to which a flow points."""
    row, column = np.mgrid[: flow.shape[0], : flow.shape[1]].astype(np.float32)
    return column + flow[..., 0], row + flow[..., 1]


def _gray(light: np.ndarray, soft: float) -> np.ndarray:
    """(s, s) uint8"""
    blurred = opencv().GaussianBlur(light.astype(np.float32), (0, 0), soft)
    return np.clip(128 + GRAY * blurred, 0, 255).astype(np.uint8)


def _smooth(flow: np.ndarray, believed: np.ndarray) -> np.ndarray:
    """(s, s, 2) by what is believed (s, s) of it, and nothing far from that."""
    cv2 = opencv()
    weight = cv2.GaussianBlur(believed, (0, 0), FLOW_SMOOTH)[..., None]
    wide = cv2.GaussianBlur(flow * believed[..., None], (0, 0), FLOW_SMOOTH) / (weight + 5e-3)
    length = np.linalg.norm(wide, axis=-1, keepdims=True)
    return wide * np.minimum(1, FLOW_MAX / np.maximum(length, 1e-3))


def _moved(one: Laid, flow: np.ndarray, covered: np.ndarray) -> Laid:
    """The picture where it belongs; what would come from beyond the skin's part of the texture stays."""
    x, y = _shifted(flow)
    inside = _at(covered.astype(np.float32), x, y) > 0.999
    moved = [np.where(inside, _at(plane, x, y), plane) for plane in (one.x, one.y, one.weight)]
    return replace(one, x=moved[0], y=moved[1], weight=moved[2])


def _mean(shown: Iterable[tuple[Laid, np.ndarray]], middle: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(S, S, 3) of what pictures show, (h, w, 3), those that show a texel best before all; with `middle` (S, S, 3) what
    is unlike it counts less. And (S, S) how many pictures show it, of those that see it squarely."""
    total, counted, seen = (np.zeros((TEXELS, TEXELS, *rest), np.float32) for rest in ((3,), (), ()))
    for one, picture in shown:
        there = opencv().remap(picture, one.x, one.y, opencv().INTER_CUBIC)
        weight = one.weight ** len(FLOW_SOFT)
        if middle is not None:
            weight = weight / (1 + ((there - middle).mean(-1) / DISAGREE) ** 2)
        total, counted, seen = total + weight[..., None] * there, counted + weight, seen + one.weight
    return total / np.maximum(counted, 1e-9)[..., None], seen
