"""Images of hands for the service: avatars from files, one renderer per set of hands and settings."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jghand_engine.avatar import SHIPPED
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_avatar_called
from jghand_engine.avatar.forearm import capped, ended
from jghand_engine.avatar.light_records import lamps_of, light_of, turn_of
from jghand_engine.avatar.scene_light import Baked, SceneLight, Shades, World
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.hand.skeleton import Skeleton
from jghand_engine.json_files import JsonObject
from jghand_engine.native.machine import return_free_memory
from jghand_engine.render import budget
from jghand_engine.render.blur import middle
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.settings import RenderSettings, preset
from jghand_engine.service.commands import AvatarError, Canceled, LoadedAvatar, RenderedImage, never
from jghand_engine.service.image_request import (
    ImageRequest,
    ImageSettings,
    RequestedHand,
    RequestedLight,
)
from jghand_engine.template.builtin import load_template
from jghand_engine.template.mesh import posed_vertices

# renderers that are kept: one per set of hands and settings, each with its hands' arrays in memory
RENDERERS_MAX = 8
# searches for points near hands that are kept: two kinds, of eight hands
SEARCHES_MAX = 16
# avatars that are kept though no renderer shows them: those that were just loaded, before their first image
IDLE_AVATARS_MAX = 4
# lights that are kept: of some views and their last light
LIGHTS_MAX = 16
# light that was baked is, at each Gaussian, the mean of so many points around it, weighted by a Gaussian of that width,
# meters; they are found among so many around its nearest anchor. With the extension's points, 1.8 mm apart, a ninth of
# the paths' noise variance is left, and edges are 3.5 mm wide
POINTS_NEAR, SMOOTHED_M, POINTS_AROUND = 12, 1.5e-3, 48
# sizes that are measured for budgets: widths, px, each with about twice the pixels of the one before; width over height
BUDGET_WIDTHS_PX = (256, 384, 512, 640, 768, 1024, 1280, 1536, 1920, 2560, 3840)
BUDGET_ASPECT = 1.5
# an avatar and points (P, 3) on its hand at rest -> which of them are near
_Search = Callable[[HandAvatar, np.ndarray], tuple[np.ndarray, ...]]


class _Version(NamedTuple):
    """An avatar as its file is now. mtime_ns, size: 0 for one that comes with the engine, -1 where there is no file."""

    avatar: str
    mtime_ns: int
    size: int

    @classmethod
    def now(cls, avatar: str) -> _Version:
        if avatar in SHIPPED:
            return cls(avatar, 0, 0)
        try:
            found = Path(avatar).stat()
        except (OSError, ValueError):  # whoever reads it says what is wrong with it
            return cls(avatar, -1, -1)
        return cls(avatar, found.st_mtime_ns, found.st_size)


class _Key(NamedTuple):
    """What a renderer is made for; of each hand its avatar, handedness, and whether its forearm is shown."""

    hands: tuple[tuple[_Version, str, bool], ...]
    settings: ImageSettings
    depth: bool
    size_px: tuple[int, int] | None
    lit: bool


class _OnHands(NamedTuple):
    """A light, what is left of it and was baked at points of these hands, and both together."""

    light: SceneLight
    hands: list[tuple[_Version, str]]
    at_points: tuple[np.ndarray | None, ...]
    both: SceneLight


class HandImages:
    """An ImageSource (commands.py). The last few renderers are kept, and the avatars that they show, each as its file
    was: one that changed meanwhile is read anew. backend: as of RenderSettings, for all images"""

    def __init__(self, backend: str = "auto") -> None:
        self._backend = backend
        self.doing = ""
        self._avatars: OrderedDict[_Version, HandAvatar] = OrderedDict()
        self._renderers: OrderedDict[_Key, SceneRenderer] = OrderedDict()
        self._lights: OrderedDict[str, SceneLight] = OrderedDict()
        # the last light of which more is known at points of hands
        self._last_on_hands: _OnHands | None = None
        self._points: dict[tuple[_Version, bool, bytes, _Search], tuple[np.ndarray, ...]] = {}

    def load(self, avatar: str) -> LoadedAvatar:
        """Reads the file anew; renderers of what it held before are dropped."""
        loaded = self._load(_Version.now(avatar))
        facts = {
            "avatar": avatar,
            "name": loaded.info.name,
            "template": loaded.info.template,
            "licence": loaded.info.license,
            "handedness": str(loaded.handedness),
            "gaussians": len(loaded),
        }
        return LoadedAvatar(facts, from_level(loaded.canonical_joints_m, JointOrder.STANDARD))

    def render(self, request: ImageRequest, canceled: Callable[[], bool] = never) -> RenderedImage:
        """All hands in one image: their Gaussians are drawn together, so that hands may interlock. A request's world
        is the one of the renderer, in which trained hands have their light."""
        light = (
            None if request.light is None else self._on_hands(self._light(request.light, len(request.hands)), request)
        )
        renderer = self._renderer(request, light)

        def check() -> None:
            if canceled():
                raise Canceled

        frame = renderer.render_moments(request.moments, request.weights, check_canceled=check)
        ids = renderer.bone_ids(middle(request.moments).camera) if request.ids else None
        report = frame.report.as_dict()
        return RenderedImage(frame.rgba, report, frame.depth_m, ids, frame.covered_depth_m, frame.linear)

    def rest(self) -> None:
        """Gives back what the last images left in the renderers; avatars stay."""
        for renderer in self._renderers.values():
            renderer.rest()
        return_free_memory()

    @contextmanager
    def _telling(self, doing: str) -> Iterator[None]:
        """Says what takes long while it does."""
        self.doing = doing
        try:
            yield
        finally:
            self.doing = ""

    def _light(self, wanted: RequestedLight, hands: int) -> SceneLight:
        """The light of a request for so many hands; the very same one as long as it is asked for in the same words, so
        that what was drawn in it is known again."""
        words = json.dumps(wanted.record, sort_keys=True)
        if words not in self._lights:
            record, world = JsonObject(wanted.record, _wrong), None
            if wanted.radiance is not None:
                world = World(wanted.radiance, turn_of(record.needed("world")))
            while len(self._lights) >= LIGHTS_MAX:
                self._lights.popitem(last=False)
            self._lights[words] = light_of(lamps_of(record), world)
        self._lights.move_to_end(words)
        light = self._lights[words]
        beyond = [place for lamp in light.lamps for place in lamp.hands or () if place >= hands]
        if beyond:
            raise _wrong("hands of a lamp", f"numbers of hands of the image, below {hands}", beyond[0])
        return light

    def _on_hands(self, light: SceneLight, request: ImageRequest) -> SceneLight:
        """The light, less what the scene's things take of it, and with what was baked; the very same one for the same
        of all."""
        wanted = request.light
        if wanted is None or (wanted.left is None and wanted.baked is None):
            return light
        last, hands = self._last_on_hands, [(_Version.now(hand.avatar), hand.handedness) for hand in request.hands]
        at_points = wanted.left, wanted.left_at, wanted.baked, wanted.baked_at
        if (
            last is None
            or last.light is not light
            or last.hands != hands
            or not all(map(_is_same, last.at_points, at_points))
        ):
            both = light
            if wanted.left is not None and wanted.left_at is not None:
                nearest = [self._near(hand, wanted.left_at, _of_anchors)[0] for hand in request.hands]
                pairs = zip(wanted.left, nearest, strict=True)
                both = replace(both, shades=Shades(tuple(part[:, at] / np.float32(255) for part, at in pairs)))
            if wanted.baked is not None and wanted.baked_at is not None:
                found = [self._near(hand, wanted.baked_at, _of_gaussians) for hand in request.hands]
                pairs = zip(wanted.baked, found, strict=True)
                smooth = tuple(np.einsum("nk,nkij->nij", share, field[near]) for field, (near, share) in pairs)
                both = replace(both, baked=Baked(smooth))
            last = self._last_on_hands = _OnHands(light, hands, at_points, both)
        return last.both

    def _near(self, hand: RequestedHand, points_m: np.ndarray, search: _Search) -> tuple[np.ndarray, ...]:
        """Which of the points (P, 3) on the template are near an avatar's anchors or Gaussians, at rest."""
        key = _Version.now(hand.avatar), hand.forearm, hashlib.blake2b(points_m.tobytes()).digest(), search
        if key not in self._points:
            if len(self._points) >= SEARCHES_MAX:
                self._points.clear()
            with self._telling("Loading the avatar"):
                # the Gaussians that are drawn
                avatar = capped(ended(self._avatar(key[0], hand.handedness), forearm=hand.forearm))
                # where they are on the avatar's own hand: each goes with the vertex that is nearest
                template = load_template()
                skeleton = Skeleton(template.joints_m, handedness=Handedness.RIGHT)
                moved_m = posed_vertices(template, skeleton, avatar.canonical_joints_m) - template.vertices_m
                points_m = points_m + moved_m[_around(template.vertices_m, points_m, 1)[:, 0]]
                self._points[key] = search(avatar, points_m)
        return self._points[key]

    def _renderer(self, request: ImageRequest, light: SceneLight | None) -> SceneRenderer:
        wanted = request.settings
        size_px = _measured_size(request.width * request.height) if wanted.budget_ms is not None else None
        hands = tuple((_Version.now(hand.avatar), hand.handedness, hand.forearm) for hand in request.hands)
        key = _Key(hands, wanted, request.depth, size_px, light is not None)
        if key not in self._renderers:
            with self._telling("Loading the avatar"):
                shown = (ended(self._avatar(version, side), forearm=forearm) for version, side, forearm in hands)
                avatars = [capped(avatar) for avatar in shown]
                settings = _settings(wanted, avatars, size_px, self._backend)
                settings = replace(settings, depth=request.depth, backend=self._backend)
                while len(self._renderers) >= RENDERERS_MAX:
                    self._renderers.popitem(last=False)
                self._renderers[key] = SceneRenderer(avatars, settings, light)
                self._drop_idle()
        self._renderers.move_to_end(key)
        renderer = self._renderers[key]
        renderer.light = light
        return renderer

    def _avatar(self, version: _Version, handedness: str) -> HandAvatar:
        if handedness not in list(Handedness):
            raise InputError("handedness", wanted=" | ".join(Handedness), came=handedness[:80])
        loaded = self._avatars[version] if version in self._avatars else self._load(version)
        return loaded.for_hand(Handedness(handedness))

    def _load(self, version: _Version) -> HandAvatar:
        """Reads a file as it is now, in the place of all that was read from it before. AvatarError."""
        try:
            loaded = load_avatar_called(version.avatar)
        except InputError as error:
            refusal = AvatarError(error.thing, wanted=error.wanted, came=error.came)  # what to do, the client says
            if version.size < 0:
                refusal = AvatarError(f"{version.avatar} is not there")
                refusal.missing = True
            raise refusal from error
        for older in [each for each in self._avatars if each.avatar == version.avatar]:
            del self._avatars[older]
        for key in [key for key in self._renderers if any(each.avatar == version.avatar for each, _, _ in key.hands)]:
            del self._renderers[key]
        self._avatars[version] = loaded
        self._drop_idle()
        return loaded

    def _drop_idle(self) -> None:
        """Lets go of avatars that no renderer shows, but for the few that were read last."""
        shown = {version for key in self._renderers for version, _, _ in key.hands}
        idle = [version for version in self._avatars if version not in shown]
        for version in idle[:-IDLE_AVATARS_MAX]:
            del self._avatars[version]


def _is_same(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    return one is other or (one is not None and other is not None and np.array_equal(one, other))


def _of_anchors(avatar: HandAvatar, points_m: np.ndarray) -> tuple[np.ndarray]:
    """points_m: (P, 3) on the avatar's hand at rest -> (A,) the nearest of each anchor of the cast shadow."""
    cast = None if avatar.learned is None else avatar.learned.cast
    return (np.zeros(0, np.intp) if cast is None else _around(points_m, cast.anchors.position_m, 1)[:, 0],)


def _of_gaussians(avatar: HandAvatar, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """points_m: (P, 3) on the avatar's hand at rest -> (N, K) those around each Gaussian, and their weights, which sum
    to 1. None are near those of an avatar without anchors."""
    cast = None if avatar.learned is None else avatar.learned.cast
    if cast is None:
        return np.zeros((0, 1), np.intp), np.zeros((0, 1))
    of_gaussian = _around(points_m, cast.anchors.position_m, POINTS_AROUND)[cast.anchors.nearest[:, 0]]
    distance2 = np.square(points_m[of_gaussian] - avatar.position_m[:, None]).sum(-1)
    kept = np.argpartition(distance2, min(POINTS_NEAR, distance2.shape[1]) - 1, axis=1)[:, :POINTS_NEAR]
    distance2 = np.take_along_axis(distance2, kept, 1)
    share = np.exp((distance2.min(1, keepdims=True) - distance2) / (2 * SMOOTHED_M**2))
    return np.take_along_axis(of_gaussian, kept, 1), share / share.sum(1, keepdims=True)


def _around(points: np.ndarray, to: np.ndarray, count: int) -> np.ndarray:
    """(N, K) which of the points (P, 3) are around each of (N, 3), the nearest first."""
    around = np.empty((len(to), min(count, len(points))), np.intp)
    for row, place in enumerate(to):
        distance2 = np.square(points - place).sum(-1)
        near = np.argpartition(distance2, around.shape[1] - 1)[: around.shape[1]]
        around[row] = near[np.argsort(distance2[near], kind="stable")]
    return around


def _wrong(name: str, wanted: str, came: object) -> InputError:
    return InputError(f"light: {name}", wanted=wanted, came=repr(came)[:80])


def _settings(
    wanted: ImageSettings, avatars: list[HandAvatar], size_px: tuple[int, int] | None, backend: str
) -> RenderSettings:
    """The preset, or what the budget buys, each hand taking an equal part of it."""
    settings = preset(wanted.preset)
    if wanted.budget_ms is not None and size_px is not None:
        largest = max(avatars, key=len)
        settings = budget.best_for(wanted.budget_ms / len(avatars), largest, size_px, backend=backend).settings
    return settings


def _measured_size(pixels: int) -> tuple[int, int]:
    """The least size of a few that has so many pixels: each is measured for two seconds when it is first met, and a
    view's images change theirs all the time."""
    widths = BUDGET_WIDTHS_PX
    sizes = [(width, round(width / BUDGET_ASPECT)) for width in widths]
    return next((size for size in sizes if size[0] * size[1] >= pixels), sizes[-1])
