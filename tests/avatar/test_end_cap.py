"""The cap of a hand: who looks at it from behind sees skin, and from the side nobody sees it."""

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
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset

# as much from everywhere: what is dark then is no skin
EVEN = SceneLight(World(np.ones((16, 32, 3))))


@cache
def hands(name: str, forearm: bool, side: Handedness) -> tuple[HandAvatar, HandAvatar]:
    """One that is shown, open and with its cap."""
    shown = ended(load_avatar_called(name), forearm=forearm).for_hand(side)
    return shown, capped(shown)


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


def drawn(avatar: HandAvatar, seen: Camera, light: SceneLight | None = None, gaussians: int = 0) -> np.ndarray:
    """(H, W, 4) premultiplied, linear in a light."""
    settings = replace(preset("final"), gaussians=gaussians, threads=2)
    return HandRenderer(avatar, settings, light).render(pose(avatar), seen).rgba


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
def test_who_looks_into_the_end_of_a_hand_sees_skin(name, side, forearm, aside_deg):
    bare, closed = hands(name, forearm, side)
    seen = camera(closed, aside_deg)
    pixels = cap_px(closed, seen)
    assert missing(drawn(bare, seen, EVEN), pixels) > 0.3
    picture = drawn(closed, seen, EVEN)
    assert missing(picture, pixels) == 0
    assert black_pixels(picture) == 0


def test_few_gaussians_have_a_cap_and_so_has_a_hand_in_its_own_light():
    bare, closed = hands("builtin", True, Handedness.RIGHT)
    seen = camera(closed, 0)
    pixels = cap_px(closed, seen)
    for gaussians in (1500, 4000, 0):
        assert missing(drawn(bare, seen, gaussians=gaussians), pixels) > 0.3
        assert missing(drawn(closed, seen, gaussians=gaussians), pixels) == 0


@pytest.mark.parametrize("forearm", [True, False])
@pytest.mark.parametrize("orthographic", [True, False])
def test_from_the_side_no_pixel_is_another_one(forearm, orthographic):
    bare, closed = hands("builtin", forearm, Handedness.RIGHT)
    for aside_deg in (60, 90, 150):
        seen = camera(closed, aside_deg, orthographic=orthographic)
        change = np.abs(drawn(closed, seen, EVEN) - drawn(bare, seen, EVEN))
        # observed: 2e-3 at most, as other rows make other blocks; of Gaussians at one depth another may come first
        assert np.quantile(change, 0.997) < 2e-3
        assert change.max() < 0.1


def test_a_cap_comes_into_sight_from_its_edge_as_the_eye_gets_behind_it():
    _, closed = hands("builtin", True, Handedness.RIGHT)
    assert closed.cap is not None
    assert closed.detail is not None
    height = -1 - closed.detail.shown[closed.detail.shown < 0]
    bones, shown = closed.skeleton().bones(pose(closed)), []
    for part in (0, 0.25, 0.5, 0.75, 1):
        # of parallel rays the angle is the same at all places
        aside_deg = np.degrees(np.arccos((1 - part) * SEEN_FROM + part * SEEN_WHOLLY))
        seen = camera(closed, aside_deg, orthographic=True)
        shown.append(closed.cap.seen(bones.linear_offset, bones.root_m, seen.eye_m))
        # native/detail.cpp
        wanted = np.clip((1.2 * shown[-1] + 0.2 - height[height > 0.7]) / 0.2, 0, 1)
        column, row = cap_px(closed, seen).T
        assert np.median(np.abs(drawn(closed, seen, EVEN)[row, column, 3] - wanted)) < 0.05
    # smoothly between
    assert shown == pytest.approx([0, 5 / 32, 0.5, 27 / 32, 1], abs=0.02)


@pytest.mark.parametrize("forearm", [True, False])
def test_nothing_leaps_where_a_cap_begins_to_be_seen(forearm):
    bare, closed = hands("builtin", forearm, Handedness.RIGHT)
    begins_deg = np.degrees(np.arccos(SEEN_FROM))
    before, after = (camera(closed, begins_deg + by, orthographic=True) for by in (0.05, -0.05))
    change, of_bare = (
        np.abs(drawn(avatar, after, EVEN)[..., 3] - drawn(avatar, before, EVEN)[..., 3]) for avatar in (closed, bare)
    )
    assert (change > of_bare + 0.2).sum() < 5


@pytest.mark.parametrize("towards", [(1, 0, 0.2), (0.2, 0.3, 1), (-1, 0, 0.1), (0, -1, 0.3)])
def test_no_edge_of_skin_that_fades_throws_a_shadow_onto_it(towards):
    _, closed = hands("builtin", True, Handedness.RIGHT)
    sun, seen = SceneLight(lamps=(Lamp(LampKind.SUN, (3.0, 3.0, 3.0), towards),)), camera(closed, 20)
    column, row = cap_px(closed, seen).T
    settings = replace(preset("final"), threads=2)
    sharp, soft = (
        HandRenderer(closed, replace(settings, sharp_shadows=is_sharp), sun)
        .render(pose(closed), seen)
        .rgba[row, column]
        for is_sharp in (True, False)
    )
    lit = soft[:, 1] > 0.3 * soft[:, 1].max()
    assert (sharp[lit, 1] < 0.5 * soft[lit, 1]).mean() < 0.02


def test_a_cap_takes_nothing_from_the_rest():
    bare, closed = hands("builtin", True, Handedness.RIGHT)
    assert closed.detail is not None
    assert bare.detail is not None
    assert closed.detail.density_per_m == pytest.approx(bare.detail.density_per_m, rel=1e-6)
    seen = camera(closed, 90)
    for gaussians in (1500, 4000):
        change = np.abs(drawn(closed, seen, EVEN, gaussians) - drawn(bare, seen, EVEN, gaussians))
        assert np.quantile(change, 0.997) < 5e-3


def test_a_hand_of_fewer_gaussians_than_anchors_has_one():
    few = capped(ended(load_avatar_called("builtin").prefix(300)))
    seen = camera(few, 0)
    assert missing(drawn(few, seen, EVEN), cap_px(few, seen)) == 0


def test_hands_that_no_surface_ends_have_none():
    for avatar in (load_avatar_called("painted"), load_avatar_called("builtin")):
        assert capped(avatar) is avatar
