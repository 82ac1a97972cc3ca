"""What pictures show of each Gaussian, on films whose colors are known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from drawn_film import WALL_RGB, film_of, plain_hand
from scipy.ndimage import binary_erosion

from jghand_engine.avatar.learned import no_light
from jghand_engine.own.gather import observe, trusted
from jghand_engine.own.masks import wrist_side


@pytest.fixture(scope="module")
def flat():
    """A hand that shines with its own smooth colors, and its film."""
    hand = plain_hand()
    assert hand.learned is not None
    learned = replace(hand.learned, response=None, light=no_light(), cast=None, correctives=None)
    way = hand.position_m @ np.array([[6.0, 0, 3], [2, 3, 0], [0, 8, 5]], np.float32)
    hand = replace(hand, rgb=(0.5 + 0.2 * np.sin(0.5 * way)).astype(np.float32), learned=learned, detail=None)
    return hand, film_of(hand, None)


def seen_by(hand, film, masks=None):
    return observe(hand, film.joints_m, film.camera, film.pictures, film.masks if masks is None else masks)


def test_colors_of_a_hand_come_back_where_it_was_seen(flat):
    hand, film = flat
    found = seen_by(hand, film)
    many = found.seen.sum(0)
    color = (found.color * found.seen[..., None]).sum(0) / many[:, None]
    shown = np.where(color.numpy() <= 0.0031308, 12.92 * color, 1.055 * color.numpy() ** (1 / 2.4) - 0.055)
    # at the wrist's line pictures show what lies behind it, too
    error = np.abs(shown - hand.rgb)[(many > 0.5).numpy() & (hand.position_m[:, 1] > 0.01)]
    assert (many > 0.5).float().mean() > 0.4
    # a few lie deep, and are seen through gaps between others: observed 1.4 and 2.2
    assert np.percentile(error, 95) < 1.6 / 255
    assert np.percentile(error, 99) < 2.5 / 255


def test_skin_that_no_picture_shows_is_not_seen(flat):
    hand, film = flat
    palm = film.part(np.array([0, 1]))
    seen = seen_by(hand, palm).seen.sum(0).numpy()
    back = (hand.learned.normal[:, 2] < -0.5) & (hand.position_m[:, 1] > 0.02) & (hand.position_m[:, 1] < 0.06)
    front = (hand.learned.normal[:, 2] > 0.8) & (hand.position_m[:, 1] > 0.02) & (hand.position_m[:, 1] < 0.06)
    assert seen[back].max() == 0
    assert np.median(seen[front]) > 0.3


def test_a_forearm_of_any_color_changes_no_number(flat):
    hand, film = flat
    behind = ~wrist_side(film.camera.project(film.joints_m)[0], film.camera.width, film.camera.height)
    with_forearm = film.masks | behind
    painted = film.pictures.copy()
    painted[behind] = (255, 0, 200)
    found, other = seen_by(hand, film, with_forearm), seen_by(hand, replace(film, pictures=painted), with_forearm)
    assert (found.color == other.color).all()
    assert (found.seen == other.seen).all()
    assert (found.behind == other.behind).all()


def test_what_is_behind_the_hand_is_the_wall_though_the_mask_is_a_little_too_small(flat):
    hand, film = flat
    small = binary_erosion(film.masks, iterations=2, structure=np.ones((1, 3, 3)))
    np.testing.assert_allclose(seen_by(hand, film, small).behind, WALL_RGB, rtol=0.02)


def test_where_the_hand_hides_all_nothing_is_behind_it(flat):
    hand, film = flat
    assert seen_by(hand, film, np.ones_like(film.masks)).behind is None


def test_a_bent_finger_counts_less_than_a_straight_one(flat):
    hand, film = flat
    # the third picture points: the index finger is straight, the others are bent
    trust = trusted(film.joints_m)[3]
    assert trust[7] > 0.9
    assert trust[[8, 13, 18, 9, 10]].max() < 0.2
    assert trust[[0, 1, 2]].max() < 0.5
    assert trusted(film.joints_m)[0].min() > 0.9
    found = seen_by(hand, film).trust[3]
    index, middle = (torch.from_numpy(hand.bone_weights[:, bone] > 0.99) for bone in (12, 13))
    assert found[index].min() > 0.8 > 0.2 > found[middle].max()
