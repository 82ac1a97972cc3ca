"""The texture of an own hand's skin, of films that the engine draws of a hand with a known one."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_film import explained_of, film_of, plain_hand, window_world
from scipy.ndimage import gaussian_filter

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.detail import NO_RATIO, Detail, log_ratios, ratio_bytes
from jghand_engine.avatar.relief import Relief
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import NO_FIST
from jghand_engine.learn.fist import with_fist
from jghand_engine.own import detail
from jghand_engine.own.detail import Laid, filled, flows_between, seen_detail
from jghand_engine.own.gather import observe
from jghand_engine.own.light_and_skin import OwnHand
from jghand_engine.own.make import hand_of
from jghand_engine.own.report import FilmView

# a pixel is 0.8 mm; marks are some millimeters wide
SIZE, MARK_TEXELS, TEXELS = (240, 400), 2.0, 512


def surface() -> Detail:
    """The built-in hand's, without anything on it."""
    found = load_builtin(handedness=Handedness.RIGHT).detail
    assert found is not None
    return replace(found, texture=np.full((4, 4, 3), NO_RATIO, np.uint8), relief=None)


def marks() -> np.ndarray:
    """(S, S, 3) log ratios of a skin full of marks."""
    noise = gaussian_filter(np.random.default_rng(3).standard_normal((TEXELS, TEXELS)), MARK_TEXELS)
    return np.repeat((0.25 * noise / noise.std())[..., None], 3, -1).clip(-0.6, 0.6)


@pytest.fixture(autouse=True)
def few_texels(monkeypatch):
    monkeypatch.setattr(detail, "TEXELS", TEXELS)
    monkeypatch.setattr(detail, "FLOW_TEXELS", TEXELS // 2)


@pytest.fixture(scope="module")
def film() -> FilmView:
    marked = replace(plain_hand(), detail=replace(surface(), texture=ratio_bytes(marks())))
    return film_of(marked, window_world(), SIZE)


def texture_of(film: FilmView) -> np.ndarray:
    """(S, S, 3) uint8"""
    hand = plain_hand()
    observed = observe(hand, film.joints_m, film.camera, film.pictures, film.masks)
    own = OwnHand(hand, np.ones(len(hand)), window_world())
    return seen_detail(own, surface(), observed.shown, film.joints_m).texture


def likeness(texture: np.ndarray) -> float:
    """Correlation with the marks, where there is a texture."""
    there = (texture != NO_RATIO).any(-1)
    return float(np.corrcoef(log_ratios(texture)[there].mean(-1), marks()[there].mean(-1))[0, 1])


def test_marks_of_the_skin_are_found_where_they_are(film):
    found = texture_of(film)
    there = (found != NO_RATIO).any(-1)
    # observed 0.91, of a quarter of the square; skin covers 36 % of it
    assert likeness(found) > 0.85
    assert there.mean() > 0.2
    # observed 0.75: a mean of pictures that lie apart is weaker
    assert log_ratios(found)[there].std() > 0.7 * marks()[there].std()


def test_pictures_that_lie_apart_are_laid_onto_one_another():
    wide = 64
    marked = gaussian_filter(np.random.default_rng(2).standard_normal((TEXELS + 2 * wide,) * 2), 6.0)
    marked = (0.2 * marked / marked.std()).astype(np.float32)
    row, column = np.mgrid[:TEXELS, :TEXELS].astype(np.float32)
    shifts = np.array([(0, 0), (7, -3), (-5, 6), (2, 8)])
    weights = [weight * np.ones((TEXELS, TEXELS), np.float32) for weight in (1.0, 0.9, 0.8, 0.7)]
    pictures = [
        np.repeat(np.roll(marked, shift[::-1], (0, 1))[wide:-wide, wide:-wide, None], 3, -1) for shift in shifts
    ]
    flows = flows_between([Laid(column, row, *each) for each in zip(weights, pictures, pictures, strict=True)])
    inside = np.s_[wide:-wide, wide:-wide]
    # the first one stays. Texels; observed 0.07
    apart = [
        np.median(np.linalg.norm(flow[inside] - shift, axis=-1)) for flow, shift in zip(flows, shifts, strict=True)
    ]
    assert max(apart) < 0.2


def test_a_side_that_is_never_seen_has_no_detail(film):
    palm, back = (texture_of(film.part(part)) for part in (np.arange(3), np.arange(5, 8)))
    both = (palm != NO_RATIO).any(-1) & (back != NO_RATIO).any(-1)
    assert both.mean() < 0.2 * (palm != NO_RATIO).any(-1).mean()


def test_skin_that_is_hardly_seen_has_the_fine_skin_of_the_prior():
    size, prior = TEXELS, 0.2
    strength = np.tile(np.linspace(0, 1, size, dtype=np.float32), (size, 1))
    heights = np.full((4, 4, 2), 40, np.int8)
    given = replace(surface(), texture=ratio_bytes(np.full((4, 4, 3), prior)), relief=Relief(heights))
    found = filled(given, strength, np.full((size, size, 3), -0.3, np.float32))
    assert found.relief is not None
    wanted = prior + (-0.3 - prior) * strength
    # half a byte of either
    assert np.abs(log_ratios(found.texture) - wanted[..., None]).max() < 0.006
    assert np.abs(found.relief.height - 40 * (1 - strength[..., None])).max() < 0.51


def test_what_gaussians_show_is_no_detail():
    texture = texture_of(film_of(plain_hand(), window_world(), SIZE))
    # observed 0.0014, and 0.0064 of a texture that has what they show
    assert np.abs(log_ratios(texture)).mean() < 0.002


def test_the_avatar_of_a_film_has_the_marks_of_its_skin(film, tmp_path):
    prior = replace(plain_hand(), detail=surface())
    avatar, _ = hand_of(explained_of(film, np.zeros(len(film.joints_m))), prior, tmp_path, lambda *_: None)
    assert avatar.detail is not None
    # observed 0.76: of seven pictures, in a light that was found; and the Gaussians' own colors have some of the marks,
    # more of them in front, which alone are seen (RENDERING 3)
    assert likeness(avatar.detail.texture) > 0.7
    assert avatar.fist == with_fist(avatar).fist != NO_FIST
