"""Test films without rendering: whose hand it is, how it moves, what faults leave of the picture and of the truth."""

from dataclasses import replace

import cv2
import make_test_films as films
import numpy as np
import pytest

from jghand_engine.avatar.scene_light import World
from jghand_engine.captures.making.rig import RIG_JOINTS, RiggedHand, load_identity
from jghand_engine.export.light_file import ENV_FROM_WORLD
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.rotations import vector_rotation

FOCAL_PX, SIZE = 60.0, (48, 64)


@pytest.fixture(scope="module")
def identity():
    return load_identity("adult_man", forearm=True)


@pytest.fixture
def shown() -> films.Shown:
    """A white dot where the first joint is, on a black wall; the palm first, then the back."""
    width, height = SIZE
    joints = np.zeros((4, 21, 3))
    # wrist, index and pinky MCP: the thumb's side is on the right of a right palm
    joints[:, 2], joints[:, 5] = (0.03, -0.08, 0), (-0.03, -0.08, 0)
    joints[2:] *= (-1, 1, 1)
    joints = joints + np.array([0.02, 0.03, 0.4])
    rgba = np.zeros((4, height, width, 4), np.uint8)
    column, row = (FOCAL_PX * joints[0, 0, :2] / 0.4 + np.array(SIZE) / 2).astype(int)
    rgba[:, row - 1 : row + 2, column - 1 : column + 2] = 255
    wall = np.zeros((80, 60, 3))
    still = np.tile(np.eye(3), (4, 1, 1))
    return films.Shown(rgba, wall, joints, np.arange(4) / 7.5, still, np.full(4, 0.2), FOCAL_PX, joints[0])


def middle_px(alpha: np.ndarray) -> np.ndarray:
    row, column = np.nonzero(alpha > 0.5)
    return np.array([column.mean() + 0.5, row.mean() + 0.5])


def test_bones_become_as_long_as_told_and_the_skin_goes_with_them(identity):
    factors = np.ones(RIG_JOINTS)
    factors[13] = 1.2
    hand = films.with_bones(identity, factors)
    ratio = bone_lengths(hand.joints_m) / bone_lengths(identity.joints_m)
    assert sorted(ratio)[-1] == pytest.approx(1.2)
    assert sorted(ratio)[:-1] == pytest.approx(np.ones(19))
    tip = identity.weights25[:, 14] + identity.weights25[:, 13] > 0.999
    went = hand.joints25_m[14] - identity.joints25_m[14]
    assert np.allclose((hand.vertices_m - identity.vertices_m)[tip], went, atol=1e-5)
    others = identity.weights25[:, 11:15].sum(1) == 0
    assert np.allclose(hand.vertices_m[others], identity.vertices_m[others], rtol=0, atol=1e-12)


def test_the_film_shows_what_people_are_told_to_show(identity, monkeypatch):
    # takes seconds, and brings only skin to skin
    monkeypatch.setattr(films.Closing, "closed", lambda self, angles: angles)
    hand = RiggedHand(films.another(identity, 3))
    times, angles, turns = films.motion(hand, 3)
    assert np.abs(np.diff(times) - 1 / films.FPS).max() < 1e-9
    assert 12 <= times[-1] <= 20
    joints = films.placed(hand, angles, turns, np.tile([0.0, 0.0, -0.4], (len(times), 1))).joints_m
    palm = np.cross(joints[:, 2] - joints[:, 0], joints[:, 5] - joints[:, 0])
    towards_camera = palm[:, 2] / np.linalg.norm(palm, axis=1)
    for start, side in ((0.0, 1), (6.8, -1)):
        held = (times >= start) & (times <= start + 2)
        assert (side * towards_camera[held] > 0.9).all()
        assert np.abs(np.diff(angles[held], axis=0)).max() < 1e-9
    thumb = joints[:, 1, 2] - joints[:, 5, 2]
    turning = (times > 4.5) & (times < 6)
    assert (thumb[turning] > 0).all(), "it turns over the thumb's side"


def test_the_truth_stays_on_the_picture_while_the_camera_turns(shown):
    moving = films.moving_camera(shown)
    for turned in (moving, films.replace(shown, turn=vector_rotation(np.radians([[4.0, -6.0, 5.0]] * 4)))):
        joints = turned.joints_m @ np.swapaxes(turned.turn, -1, -2)
        there = films._pixels(joints, turned)[1, 0]
        assert middle_px(films.seen(turned, 1)[1]) == pytest.approx(there, abs=0.6)
    assert np.linalg.norm(there - films._pixels(shown.joints_m, shown)[1, 0]) > 5


def test_the_wall_lights_the_hand_from_where_the_camera_sees_it():
    around, middle_m = World(np.full((64, 128, 3), 9.0), ENV_FROM_WORLD), np.array([0.02, -0.05, -0.4])
    wall = np.random.default_rng(0).random((8, 6, 3)).repeat(10, 0).repeat(10, 1)
    seen = films.room(around, wall, FOCAL_PX, middle_m)
    direction, _ = around.samples
    for row, column in ((5, 5), (25, 45), (75, 15)):
        ray = np.array([(column - 30) / FOCAL_PX, (40 - row) / FOCAL_PX, -1])
        way = ray * (0.4 + films.WALL_BEHIND_M) - middle_m
        place = np.unravel_index((direction @ way).argmax(), direction.shape[:2])
        np.testing.assert_allclose(seen[place], wall[row, column])
    assert (seen[direction[..., 2] > -0.2] == 9).all()


def test_the_wall_stands_behind_the_hand_and_is_as_bright_as_it_looks_however_the_environment_is_turned(
    tmp_path, monkeypatch
):
    sky = np.full((16, 32, 3), 0.5, np.float32)
    np.save(tmp_path / "sky.npy", sky)
    monkeypatch.setattr(films, "shipped_environment", lambda name: tmp_path / "sky.npy")
    monkeypatch.setattr(films, "wall", lambda film, size: np.full((80, 60, 3), 0.25))
    light = replace(films.FILMS["man"].light, hdri_turn_deg=90.0, hdri_strength=0.125)
    file = films.lit_by(replace(films.FILMS["man"], light=light), FOCAL_PX, np.array([0.0, 0.0, -0.4]), SIZE)
    picture = cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_UNCHANGED)
    # what is behind the hand stands a quarter left of the middle; turned by a quarter, at both ends
    np.testing.assert_allclose(picture[8, [0, 31]], 0.25 / 0.125, rtol=0.01)
    np.testing.assert_allclose(picture[8, 8:24], 0.5, rtol=0.01)


def test_each_fault_is_what_it_is_called(shown):
    assert not films.seen(films.no_hand(shown), 0)[1].any()
    assert len(films.back_never_seen(shown).time_s) == 2
    plain = films.seen(shown, 0)[0].max()
    assert films.seen(films.burnt_out(shown), 0)[0].max() > 1.4 * plain
    assert np.ptp(films.exposure(shown).gain) > 0
    two = films.two_hands(shown)
    assert films.seen(two, 0)[1].sum() > 1.9 * films.seen(shown, 0)[1].sum()
    assert np.array_equal(films.sleeve(shown).rgba, shown.rgba), "what is before the wrist stays skin"
