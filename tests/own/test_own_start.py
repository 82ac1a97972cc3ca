"""What the tracker says of the pictures of a film."""

import numpy as np
from films_of_bones import started
from tracking_samples import CANONICAL_M, right_joints_m

from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import hand_length
from jghand_engine.own.film import Window
from jghand_engine.own.start import Start

MIRROR = np.array([-1.0, 1.0, 1.0])


def test_the_start_lies_where_the_pictures_have_the_hand_and_is_as_long_as_wanted():
    start = started(right_joints_m(20))
    there, _ = start.camera.project(start.joints_m)
    assert np.median(np.linalg.norm(there - start.landmarks_px, axis=-1)) < 1.0
    assert (start.camera.width, start.camera.height) == (640, 480)
    assert np.isclose(hand_length(start.joints_m), hand_length(CANONICAL_M))
    assert start.seen.all()


def test_a_left_hand_starts_as_the_mirrored_right_one():
    joints = right_joints_m(12)
    right, left = started(joints), started(joints * MIRROR, Handedness.LEFT)
    assert left.handedness is Handedness.LEFT
    assert np.allclose(left.landmarks_px, right.landmarks_px, atol=1e-9)
    assert np.allclose(left.joints_m, right.joints_m, atol=1e-6)


def test_photographs_know_nothing_of_one_another():
    joints = right_joints_m(12)
    alone = started(joints[[0, 6, 11]], is_film=False)
    other = started(joints[[0, 3, 11]], is_film=False)
    film = started(joints[[0, 3, 11]]), started(joints[[0, 6, 11]])
    apart = [np.abs(one.joints_m[0] - two.joints_m[0]).max() for one, two in ((alone, other), film)]
    assert apart[0] < apart[1]


def test_a_start_is_kept_as_it_is_and_given_in_parts(tmp_path):
    start = started(right_joints_m(8))
    start.save(tmp_path / "start.npz")
    again = Start.load(tmp_path / "start.npz")
    assert np.array_equal(again.joints_m, start.joints_m)
    assert again.handedness is Handedness.RIGHT
    assert np.array_equal(again.part(np.array([2, 5])).joints_m, start.joints_m[[2, 5]])
    assert (again.camera.width, again.camera.fx, again.camera.cx) == (640, start.camera.fx, 320)


def test_a_start_in_a_part_of_the_pictures_sees_the_same_hand():
    start = started(right_joints_m(8))
    window = Window(100, 40, 400, 300, (200, 150))
    part = start.within(window)
    moved = (start.camera.project(start.joints_m)[0] - (100, 40)) / 2
    assert np.allclose(part.camera.project(part.joints_m)[0], moved)
    assert np.allclose(part.landmarks_px, (start.landmarks_px - (100, 40)) / 2)
    assert (part.camera.width, part.camera.height) == (200, 150)
