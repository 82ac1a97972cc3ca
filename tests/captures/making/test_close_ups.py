"""Close-ups are aimed anew in every pose: what they show, and how large."""

import numpy as np
import pytest

from jghand_engine.captures.making import close_ups
from jghand_engine.captures.making.cameras import PlannedCamera
from jghand_engine.captures.making.close_ups import CLOSE_FIELD_M, CLOSE_PX, plan_close_ups
from jghand_engine.captures.making.rig import RiggedHand, load_identity
from jghand_engine.captures.masks import silhouette
from jghand_engine.hand.rotations import unit
from jghand_engine.template.surface import vertex_normals

POSES = ("open", "fist", "point", "grasp", "spread", "ok")


@pytest.fixture(scope="module")
def hand() -> RiggedHand:
    return RiggedHand(load_identity("adult_woman"))


@pytest.fixture(scope="module")
def vertices_m(hand) -> np.ndarray:
    return hand.skin(hand.pose(np.stack([hand.angles_of(name) for name in POSES])))


@pytest.fixture(scope="module")
def planned(hand, vertices_m) -> list[PlannedCamera]:
    return plan_close_ups(hand.identity, vertices_m, 4, 0, 6)


def test_every_pose_has_close_ups_of_its_own_with_pixels_of_a_hand_that_fills_1080_lines(planned, vertices_m):
    assert [one.pose for one in planned] == [pose for pose in range(6) for _ in range(4)]
    for one in planned:
        assert one.pose is not None
        assert (one.camera.width, one.camera.height) == (CLOSE_PX, CLOSE_PX)
        depth_m = one.camera.project(vertices_m[one.pose])[1]
        # the middle of the field is on the hand, somewhere between its nearest and its farthest vertex
        assert depth_m.min() < one.camera.fx * CLOSE_FIELD_M / CLOSE_PX < depth_m.max()


def test_the_middle_of_a_close_up_shows_its_part_of_the_hand_and_nothing_before_it(hand, planned, vertices_m):
    """Palm, knuckles, tips and nails take turns; also in a fist, whose tips are in the palm."""
    parts = close_ups._parts(hand.identity)
    for number, one in enumerate(planned):
        assert one.pose is not None
        vertices, part = vertices_m[one.pose], parts[number % 4]
        normals = vertex_normals(vertices, hand.identity.faces)
        px, _ = one.camera.project(vertices[part])
        # 20 mm about the middle
        shown = part[(np.abs(px - CLOSE_PX / 2) < CLOSE_PX * 20 / 70).all(1)]
        towards = unit(one.camera.eye_m - vertices[shown])
        facing = shown[(normals[shown] * towards).sum(1) > 0.5]
        above = vertices[facing] + close_ups.OFF_SKIN_M * normals[facing]
        clear = close_ups._sees(one.camera.eye_m, above, vertices[hand.identity.faces])
        assert clear.sum() >= 3, f"{POSES[one.pose]}, close-up {number % 4}"


def test_close_ups_are_mostly_hand(hand, planned, vertices_m):
    """Palms and knuckles more than half, but for a knuckle at the border; a stretched finger is a quarter as wide."""
    share = [silhouette(one.camera.scaled(0.125), vertices_m[one.pose], hand.identity.faces).mean() for one in planned]
    palm, knuckles, tips, nails = np.array(share).reshape(-1, 4).T
    assert palm.min() > 0.5
    assert np.median(knuckles) > 0.5
    assert min(tips.min(), nails.min()) > 0.15


def test_a_triangle_before_a_point_hides_it_and_one_behind_or_beside_it_does_not():
    triangle = np.array([[[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [0.0, 2.0, 1.0]]])
    points = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 0.5], [3.0, 0.0, 2.0], [0.0, 0.0, -2.0], [0.0, 3.9, 2.0]])
    for faces in (triangle, triangle[:, ::-1]):
        np.testing.assert_array_equal(close_ups._sees(np.zeros(3), points, faces), [False, True, True, True, False])


def test_a_close_up_depends_on_its_pose_and_the_seed_and_has_rays_enough(hand, planned, vertices_m):
    fewer = plan_close_ups(hand.identity, vertices_m[:2], 4, 0, 6)
    assert [one.camera.camera_from_world.tolist() for one in fewer] == [
        one.camera.camera_from_world.tolist() for one in planned[:8]
    ]
    assert {one.samples for one in fewer} == {32}
    assert plan_close_ups(hand.identity, vertices_m[:1], 1, 0, 64)[0].samples == 128
    other = plan_close_ups(hand.identity, vertices_m[:1], 4, 1, 6)
    assert other[0].camera.camera_from_world.tolist() != planned[0].camera.camera_from_world.tolist()
    assert plan_close_ups(hand.identity, vertices_m, 0, 0, 6) == []
