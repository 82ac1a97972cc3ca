"""The cap of a hand: who looks at it from behind sees skin, and from the side nobody sees it."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import ndimage

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_avatar_called
from jghand_engine.avatar.end_cap import SEEN_FROM, SEEN_WHOLLY
from jghand_engine.avatar.forearm import capped, ended
from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import DetailedHand
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.settings import preset

# as much from everywhere: what is dark then is no skin
EVEN = SceneLight(World(np.ones((16, 32, 3))))


class Shown:
    """A hand, and its renderers: each takes a second to be made."""

    def __init__(self, avatar: HandAvatar) -> None:
        self.avatar, self._renderer = avatar, cache(self._made)

    def _made(self, in_light: bool, **changes: object) -> SceneRenderer:
        return SceneRenderer([self.avatar], replace(preset("final"), threads=2, **changes), EVEN if in_light else None)

    def drawn(self, seen: Camera, light: SceneLight | None = EVEN, **changes: object) -> np.ndarray:
        """(H, W, 4) premultiplied, linear in a light. changes: of the settings"""
        renderer = self._renderer(light is not None, **changes)
        renderer.light = light
        return renderer.render([pose(self.avatar)], seen).rgba


Hands = Callable[..., tuple[Shown, Shown]]


@pytest.fixture(scope="module")
def hands() -> Hands:
    """Gives one that is shown, open and with its cap."""

    @cache
    def made(name: str, forearm: bool, side: Handedness) -> tuple[Shown, Shown]:
        shown = ended(load_avatar_called(name), forearm=forearm).for_hand(side)
        return Shown(shown), Shown(capped(shown))

    return made


def pose(avatar: HandAvatar) -> np.ndarray:
    return named_pose("relaxed", avatar.rest_joints_m, handedness=avatar.handedness)


def camera(closed: HandAvatar, aside_deg: float, *, orthographic: bool = False) -> Camera:
    """Towards the wrist, so many degrees from the way out of the end, to the palm's side."""
    assert closed.cap is not None
    way = closed.cap.way * (np.array([-1, 1, 1]) if closed.handedness is Handedness.LEFT else 1)
    palm, angle = np.array([0, 0, 1.0]) - way[2] * way, np.radians(aside_deg)
    to_eye = np.cos(angle) * way + np.sin(angle) * palm / np.linalg.norm(palm)
    wrist_m = pose(closed)[0]
    seen = Camera.looking_at(wrist_m + 0.9 * to_eye, wrist_m, (0.3, 0, 1), width=240, height=240, focal_px=800.0)
    return replace(seen, fx=900.0, fy=900.0, orthographic=True) if orthographic else seen


def cap_px(closed: HandAvatar, seen: Camera) -> np.ndarray:
    """(N, 2) int columns and rows of the cap, well within its outline."""
    posed_m = DetailedHand.of(closed, 1.0).posed_m(closed.skeleton().bones(pose(closed)))
    assert closed.detail is not None
    cap = np.flatnonzero(closed.detail.shown < 0)
    return seen.project(posed_m[cap[closed.detail.shown[cap] < -1.7]])[0].astype(int)


def missing(rgba: np.ndarray, pixels: np.ndarray) -> float:
    """The part of pixels that show no skin, but what is behind it or next to no light."""
    shown = rgba[pixels[:, 1], pixels[:, 0]]
    bright = np.median(rgba[..., 1][rgba[..., 3] > 0.99])
    return float(((shown[:, 3] < 0.98) | (shown[:, 1] < 0.2 * bright)).mean())


def black_pixels(rgba: np.ndarray) -> int:
    """Of what is wholly shown."""
    green = rgba[..., 1][np.asarray(ndimage.binary_erosion(rgba[..., 3] > 0.99), bool)]
    return int((green < 0.05 * np.median(green)).sum())


@pytest.mark.parametrize("aside_deg", [0, 20])
@pytest.mark.parametrize("forearm", [True, False])
@pytest.mark.parametrize(("name", "side"), [("builtin", Handedness.RIGHT), ("strong", Handedness.LEFT)])
def test_who_looks_into_the_end_of_a_hand_sees_skin(hands, name, side, forearm, aside_deg):
    bare, closed = hands(name, forearm, side)
    seen = camera(closed.avatar, aside_deg)
    pixels = cap_px(closed.avatar, seen)
    assert missing(bare.drawn(seen), pixels) > 0.3
    picture = closed.drawn(seen)
    assert missing(picture, pixels) == 0
    assert black_pixels(picture) == 0


def test_few_gaussians_have_a_cap_and_so_has_a_hand_in_its_own_light(hands):
    bare, closed = hands("builtin", True, Handedness.RIGHT)
    seen = camera(closed.avatar, 0)
    pixels = cap_px(closed.avatar, seen)
    for gaussians in (1500, 4000, 0):
        assert missing(bare.drawn(seen, None, gaussians=gaussians), pixels) > 0.3
        assert missing(closed.drawn(seen, None, gaussians=gaussians), pixels) == 0


@pytest.mark.parametrize("forearm", [True, False])
@pytest.mark.parametrize("orthographic", [True, False])
def test_from_the_side_no_pixel_is_another_one(hands, forearm, orthographic):
    bare, closed = hands("builtin", forearm, Handedness.RIGHT)
    for aside_deg in (60, 90, 150):
        seen = camera(closed.avatar, aside_deg, orthographic=orthographic)
        change = np.abs(closed.drawn(seen) - bare.drawn(seen))
        # observed: 2e-3 at most, as other rows make other blocks; of Gaussians at one depth another may come first
        assert np.quantile(change, 0.997) < 2e-3
        assert change.max() < 0.1


def test_a_cap_comes_into_sight_from_its_edge_as_the_eye_gets_behind_it(hands):
    _, closed = hands("builtin", True, Handedness.RIGHT)
    avatar = closed.avatar
    assert avatar.cap is not None
    assert avatar.detail is not None
    height = -1 - avatar.detail.shown[avatar.detail.shown < 0]
    bones, shown = avatar.skeleton().bones(pose(avatar)), []
    for part in (0, 0.25, 0.5, 0.75, 1):
        # of parallel rays the angle is the same at all places
        aside_deg = np.degrees(np.arccos((1 - part) * SEEN_FROM + part * SEEN_WHOLLY))
        seen = camera(avatar, aside_deg, orthographic=True)
        shown.append(avatar.cap.seen(bones.linear_offset, bones.root_m, seen.eye_m))
        # native/detail.cpp
        wanted = np.clip((1.2 * shown[-1] + 0.2 - height[height > 0.7]) / 0.2, 0, 1)
        column, row = cap_px(avatar, seen).T
        assert np.median(np.abs(closed.drawn(seen)[row, column, 3] - wanted)) < 0.05
    # smoothly between
    assert shown == pytest.approx([0, 5 / 32, 0.5, 27 / 32, 1], abs=0.02)


@pytest.mark.parametrize("forearm", [True, False])
def test_nothing_leaps_where_a_cap_begins_to_be_seen(hands, forearm):
    bare, closed = hands("builtin", forearm, Handedness.RIGHT)
    begins_deg = np.degrees(np.arccos(SEEN_FROM))
    before, after = (camera(closed.avatar, begins_deg + by, orthographic=True) for by in (0.05, -0.05))
    change, of_bare = (np.abs(hand.drawn(after)[..., 3] - hand.drawn(before)[..., 3]) for hand in (closed, bare))
    assert (change > of_bare + 0.2).sum() < 5


@pytest.mark.parametrize("towards", [(1, 0, 0.2), (0.2, 0.3, 1), (-1, 0, 0.1), (0, -1, 0.3)])
def test_no_edge_of_skin_that_fades_throws_a_shadow_onto_it(hands, towards):
    _, closed = hands("builtin", True, Handedness.RIGHT)
    sun, seen = SceneLight(lamps=(Lamp(LampKind.SUN, (3.0, 3.0, 3.0), towards),)), camera(closed.avatar, 20)
    column, row = cap_px(closed.avatar, seen).T
    sharp, soft = (closed.drawn(seen, sun, sharp_shadows=is_sharp)[row, column] for is_sharp in (True, False))
    lit = soft[:, 1] > 0.3 * soft[:, 1].max()
    assert (sharp[lit, 1] < 0.5 * soft[lit, 1]).mean() < 0.02


def test_a_cap_takes_nothing_from_the_rest(hands):
    bare, closed = hands("builtin", True, Handedness.RIGHT)
    density, of_bare = (hand.avatar.detail.density_per_m for hand in (closed, bare))
    assert density == pytest.approx(of_bare, rel=1e-6)
    seen = camera(closed.avatar, 90)
    for gaussians in (1500, 4000):
        change = np.abs(closed.drawn(seen, gaussians=gaussians) - bare.drawn(seen, gaussians=gaussians))
        assert np.quantile(change, 0.997) < 5e-3


def test_a_hand_of_fewer_gaussians_than_anchors_has_one():
    few = Shown(capped(ended(load_avatar_called("builtin").prefix(300))))
    seen = camera(few.avatar, 0)
    assert missing(few.drawn(seen), cap_px(few.avatar, seen)) == 0


def test_hands_that_no_surface_ends_have_none():
    for avatar in (load_avatar_called("painted"), load_avatar_called("builtin")):
        assert capped(avatar) is avatar
