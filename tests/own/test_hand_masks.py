"""Which pixels are the hand."""

from dataclasses import replace

import cv2
import numpy as np
from films_of_bones import SIZE, SKIN, SLEEVE, WALL, drawn_hands, film_of, zoned
from tracking_samples import CAMERA, HEIGHT, WIDTH, right_joints_m

from jghand_engine.own import masks
from jghand_engine.own.masks import HOLE_PART, camera_moved, hand_masks, hand_size_px, wrist_side


def test_the_line_across_the_wrist_has_the_hand_on_one_side_and_the_forearm_on_the_other():
    joints = right_joints_m(4)
    joints_px = CAMERA.project(joints)
    side = wrist_side(joints_px, WIDTH, HEIGHT)
    wrist, knuckles = joints_px[:, 0], joints_px[:, 2:6].mean(1)
    for hand, forearm, z in zip((wrist + knuckles) / 2, wrist + (wrist - knuckles) / 4, side, strict=True):
        (x, y), (u, v) = hand.astype(int), forearm.astype(int)
        assert z[y, x]
        assert not z[v, u]
    assert np.allclose(hand_size_px(joints_px), 2 * np.linalg.norm(wrist - knuckles, axis=1))


def test_a_hand_of_one_color_on_a_wall_of_another_is_found_to_the_pixel_and_twice_the_same():
    joints_px, zones = zoned()
    film = film_of(joints_px, SKIN)
    wanted = drawn_hands(joints_px) & wrist_side(joints_px, *SIZE)
    found = hand_masks(film, zones)
    square = np.ones((3, 3), np.uint8)
    for mask, truth in zip(found, wanted.astype(np.uint8), strict=True):
        # small holes between fingers are filled
        assert (mask & (cv2.dilate(truth, square) == 0)).sum() < HOLE_PART * mask.size
        assert mask[cv2.erode(truth, square) > 0].all()
    assert np.array_equal(found, hand_masks(film, zones))


def test_a_large_mark_on_the_palm_is_skin_and_a_gap_between_fingers_is_not():
    joints_px, zones = zoned()
    film = film_of(joints_px, SKIN)
    rgb, (x, y) = film.rgb_u8.copy(), joints_px[0, :6].mean(0).astype(int)
    across = int(0.06 * hand_size_px(joints_px)[0])
    mark = np.s_[y - across : y + across, x - across : x + across]
    rgb[0][mark] = (20, 30, 160)
    assert 4 * across**2 > HOLE_PART * rgb[0, ..., 0].size
    found = hand_masks(replace(film, rgb_u8=rgb), zones)
    assert found[0][mark].all()
    # the same hole where the detector saw no skin
    ring = np.ones((40, 40), bool)
    ring[10:30, 10:30] = False
    assert not masks._cleaned(ring, np.zeros_like(ring))[20, 20]
    assert masks._cleaned(ring, ~ring)[20, 20]


def test_the_color_of_the_forearm_changes_no_pixel_of_the_masks():
    joints_px, zones = zoned()
    found = []
    for arm in (SKIN, SLEEVE, WALL):
        film = film_of(joints_px, arm)
        found.append(hand_masks(film, zones))
    assert found[0].any()
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[0], found[2])


def test_a_picture_without_the_hand_has_an_empty_mask():
    joints_px, zones = zoned()
    film = film_of(joints_px, SKIN)
    rgb = film.rgb_u8.copy()
    rgb[3] = WALL
    found = hand_masks(replace(film, rgb_u8=rgb), zones)
    assert found[3].sum() == 0
    assert found[4].any()


def test_where_the_camera_stands_still_a_wall_with_the_colors_of_skin_is_told_from_the_hand():
    """Where the hand is not, at least: there the colors of the whole film say nothing, and the pixel's own do."""
    joints_px, zones = zoned()
    x, y = np.meshgrid(*(np.arange(edge) for edge in SIZE))
    spots = (x % 24 < 6) & (y % 24 < 6)
    film = film_of(joints_px, WALL)
    rgb = np.where(spots[None, ..., None] & ~drawn_hands(joints_px)[..., None], np.array(SKIN, np.uint8), film.rgb_u8)
    film = replace(film, rgb_u8=rgb.astype(np.uint8))
    wanted = drawn_hands(joints_px) & wrist_side(joints_px, *SIZE)
    overlap = []
    for one in (replace(film, is_film=False), film):
        found = hand_masks(one, zones)
        overlap.append(np.mean([(m & t).sum() / (m | t).sum() for m, t in zip(found, wanted, strict=True)]))
    assert overlap[0] + 0.004 < overlap[1]


def test_a_picture_in_which_the_camera_moved_is_worked_out_from_colors_alone(monkeypatch):
    joints_px, zones = zoned()
    marble = np.random.default_rng(3).normal(0, 12, (*SIZE[::-1], 1))
    film = film_of(joints_px, WALL)
    rgb = np.where(drawn_hands(joints_px)[..., None], film.rgb_u8, np.clip(film.rgb_u8 + marble, 0, 255))
    rgb[3] = np.roll(rgb[3], 9, axis=1)
    film = replace(film, rgb_u8=rgb.astype(np.uint8))
    told, log_odds = [], masks._log_odds

    def watched(seen, colors, background):
        told.append(background is None)
        return log_odds(seen, colors, background)

    monkeypatch.setattr(masks, "_log_odds", watched)
    hand_masks(film, zones)
    assert told == [False, False, False, True, False, False]
    assert told == camera_moved(film, zones.away).tolist()
