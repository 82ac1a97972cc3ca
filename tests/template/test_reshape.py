"""An avatar in another shape."""

from dataclasses import fields, replace

import numpy as np
import pytest

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.captures.making.rig import load_identity
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import Skeleton
from jghand_engine.template.builtin import load_template
from jghand_engine.template.closest import Surface
from jghand_engine.template.mesh import posed_vertices
from jghand_engine.template.reshape import places_after, pulled_back, reshaped
from jghand_engine.template.surface import vertex_normals
from tests.detail_samples import detail_of, noise

TEMPLATE = load_template()


@pytest.fixture(scope="module")
def avatar():
    """Of the built-in hand one Gaussian in a hundred."""
    return load_builtin(handedness=Handedness.RIGHT).prefix(400)


def grown(by_m: float) -> np.ndarray:
    return TEMPLATE.vertices_m + by_m * vertex_normals(TEMPLATE.vertices_m, TEMPLATE.faces)


def test_a_surface_that_stays_changes_no_bit(avatar):
    same = reshaped(avatar, TEMPLATE.faces, TEMPLATE.vertices_m, TEMPLATE.vertices_m)
    for name in ("position_m", "sigma_m", "opacity", "rgb", "uvd"):
        assert np.array_equal(getattr(same, name), getattr(avatar, name)), name
    assert np.array_equal(same.learned.normal, avatar.learned.normal)
    before, after = avatar.learned.cast, same.learned.cast
    assert all(
        np.array_equal(getattr(before.anchors, f.name), getattr(after.anchors, f.name)) for f in fields(before.anchors)
    )
    assert np.array_equal(before.own, after.own)


def test_what_lies_under_the_skin_goes_with_it_as_deep_as_it_is_wide(avatar):
    after_m = grown(1.5e-3)
    thicker = reshaped(avatar, TEMPLATE.faces, TEMPLATE.vertices_m, after_m)
    before = Surface(TEMPLATE.vertices_m, TEMPLATE.faces).closest(avatar.position_m.astype(float)).signed_m
    now = Surface(after_m, TEMPLATE.faces).closest(thicker.position_m.astype(float)).signed_m
    # this template ends at the wrist
    error_m = np.abs(now - thicker.sigma_m / avatar.sigma_m * before)[avatar.position_m[:, 1] > 0.02]
    assert np.median(error_m) < 5e-5
    assert np.percentile(error_m, 95) < 6e-4
    # where only the places are wanted, of several changes
    surfaces_m = np.stack([TEMPLATE.vertices_m, after_m])
    places_m = places_after(avatar.position_m, TEMPLATE.faces, TEMPLATE.vertices_m, surfaces_m)
    np.testing.assert_array_equal(places_m, [avatar.position_m, thicker.position_m])


def test_a_hand_that_is_turned_and_smaller_has_smaller_gaussians_and_turned_normals(avatar):
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    smaller = reshaped(avatar, TEMPLATE.faces, TEMPLATE.vertices_m, 0.8 * TEMPLATE.vertices_m @ turn.T)
    np.testing.assert_allclose(smaller.position_m, 0.8 * avatar.position_m @ turn.T, atol=1e-6)
    np.testing.assert_allclose(smaller.sigma_m, 0.8 * avatar.sigma_m, rtol=1e-4)
    np.testing.assert_allclose(smaller.learned.normal, avatar.learned.normal @ turn.T, atol=1e-5)
    np.testing.assert_allclose(
        smaller.learned.cast.anchors.normal, avatar.learned.cast.anchors.normal @ turn.T, atol=1e-5
    )


def test_the_surface_of_the_detail_goes_with_the_skin(avatar):
    avatar = replace(avatar, detail=detail_of(noise(16)))
    moved = reshaped(avatar, TEMPLATE.faces, TEMPLATE.vertices_m, TEMPLATE.vertices_m + np.array([0, 0, 2e-3]))
    np.testing.assert_allclose(moved.detail.position_m, avatar.detail.position_m + np.float32([0, 0, 2e-3]), atol=1e-7)
    assert moved.detail.texture is avatar.detail.texture


@pytest.mark.parametrize("name", ["child", "big_man", "long_fingers"])
def test_a_persons_own_joints_carry_its_pulled_back_surface_to_where_it_was(name):
    hand = load_identity(name)
    skeleton = Skeleton(TEMPLATE.joints_m, handedness=Handedness.RIGHT)
    bones = skeleton.bones(hand.joints_m, np.float64)
    back_m = pulled_back(skeleton, hand.vertices_m, hand.bone_weights, bones)
    own = replace(TEMPLATE, vertices_m=back_m, bone_weights=hand.bone_weights)
    np.testing.assert_allclose(posed_vertices(own, skeleton, hand.joints_m), hand.vertices_m, atol=1e-9)
    # lengths of bones and the size of the hand are in the joints: what is left is thickness
    assert np.linalg.norm(back_m - TEMPLATE.vertices_m, axis=1)[: len(hand.vertices_m) - 1].max() < 5e-3
