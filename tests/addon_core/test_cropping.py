"""A view is asked for no more than can show a hand, and that part is the same picture as in the whole."""

from dataclasses import replace

import numpy as np
import pytest

from blender_addon.core import posing, stand_in
from blender_addon.core import view as cropping
from blender_addon.core.view import HandInSpace, Part, Pinhole


def hand_at(*place_m: float) -> HandInSpace:
    world_from_hand = np.eye(4)
    world_from_hand[:3, 3] = place_m
    return HandInSpace("right", posing.rest_joints_m("right"), world_from_hand)


def view_of(**more) -> Pinhole:
    return Pinhole(1048, 693, 900.0, 900.0, 520.0, 350.0, np.eye(4), **more)


def test_the_part_holds_every_joint_and_its_skin_and_not_the_whole_view():
    view, hand = view_of(), hand_at(0.0, 0.0, 0.9)
    part = cropping.part_with(view, [hand])
    assert part is not None
    assert part.pixels < 0.5 * view.width * view.height
    pixels = view.project(hand.joints_world_m)[:, :2]
    reach_px = 900 * cropping.REACH_M / 1.2
    assert (pixels - reach_px >= (part.left, part.top)).all() or part.top == 0 or part.left == 0
    assert (pixels + reach_px <= (part.right, part.bottom)).all()


@pytest.mark.parametrize("handedness", ["right", "left"])
@pytest.mark.parametrize("turn", range(8))
def test_the_part_holds_the_whole_forearm_of_a_hand_that_shows_one(handedness, turn):
    hand = replace(hand_at(0.0, 0.0, 0.9), handedness=handedness, joints_m=1.2 * posing.rest_joints_m(handedness))
    angle = turn * np.pi / 4
    hand.world_from_hand[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    part = cropping.part_with(view_of(), [hand])
    skin = stand_in.surface_at(hand.joints_world_m, handedness, forearm=True).vertices
    pixels = view_of().project(skin)[:, :2]
    assert part is not None
    room_px = 20  # for the blur of splats
    assert (pixels.min(0) - room_px >= (part.left, part.top)).all()
    assert (pixels.max(0) + room_px <= (part.right, part.bottom)).all()
    without = cropping.part_with(view_of(), [replace(hand, forearm=False)])
    assert without is not None
    assert without.pixels < part.pixels


def test_two_hands_share_one_part():
    view = view_of()
    alone = cropping.part_with(view, [hand_at(-0.2, 0.0, 1.0)])
    both = cropping.part_with(view, [hand_at(-0.2, 0.0, 1.0), hand_at(0.2, 0.0, 1.0)])
    assert alone is not None
    assert both is not None
    assert both.left == alone.left
    assert both.right > alone.right


@pytest.mark.parametrize("place_m", [(0.0, 0.0, -1.0), (5.0, 0.0, 1.0), (0.0, -1e9, 1e-1)])
def test_a_hand_outside_the_view_has_no_part(place_m):
    assert cropping.part_with(view_of(), [hand_at(*place_m)]) is None


def test_a_hand_beside_the_camera_can_be_anywhere():
    assert cropping.part_with(view_of(), [hand_at(0.0, 0.0, 0.0)]) == Part(0, 0, 1048, 693)


def test_no_hand_has_no_part():
    assert cropping.part_with(view_of(), []) is None


def test_an_orthographic_view_shows_what_is_behind_its_camera_too():
    view = view_of(orthographic=True)
    assert cropping.part_with(view, [hand_at(0.0, 0.0, -1.0)]) == cropping.part_with(view, [hand_at(0.0, 0.0, 1.0)])


@pytest.mark.parametrize("pixels_max", [10**7, 50_000])
@pytest.mark.parametrize("orthographic", [False, True])
def test_a_point_lies_at_the_same_place_of_the_part_as_of_the_whole(pixels_max, orthographic):
    view, part = view_of(orthographic=orthographic), Part(96, 32, 800, 640)
    small = cropping.picture_of(view, part, pixels_max)
    assert small.width * small.height <= 1.01 * pixels_max
    points_m = np.random.default_rng(0).uniform(-0.3, 0.3, (50, 3)) + np.array([0.0, 0.0, 1.0])
    whole, cut = view.project(points_m), small.project(points_m)
    assert np.allclose((whole[:, 0] - part.left) / part.width, cut[:, 0] / small.width)
    assert np.allclose((whole[:, 1] - part.top) / part.height, cut[:, 1] / small.height)
    if pixels_max > part.pixels:
        assert (small.width, small.height, small.fx) == (part.width, part.height, view.fx)
