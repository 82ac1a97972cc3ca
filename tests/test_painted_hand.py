"""Making an avatar without training, on a small scale: its order, its layers, its light and its skin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from painted_hand import (
    Layers,
    Recipe,
    bone_areas,
    curved_surface,
    make_untrained,
    place,
    shared_out,
    take_turns,
)
from painted_skin import Landmarks, MarkPainter, SkinLook, palm_share, reflectance
from studio_light import Occluder, Studio, bake_light, display, sphere_directions

from jghand_engine.avatar.avatar import UVD_RANGE_M
from jghand_engine.avatar.validation import check_avatar
from jghand_engine.captures.making.skin import SkinPoints
from jghand_engine.template.builtin import load_template

SMALL = Recipe("small", "none", layers=Layers(count=3000, backing_count=600, oversampling=1.2))
NO_NAILS = np.zeros((8, 8))


@pytest.fixture(scope="module")
def small():
    return make_untrained(load_template(), NO_NAILS, SMALL)


def test_a_made_avatar_can_be_rendered(small):
    check_avatar(small, "small")
    assert len(small) == 3000


def test_placing_the_gaussians_again_gives_the_same_bits():
    few = replace(SMALL.layers, count=800, backing_count=100)
    one, other = (place(load_template(), few, seed=0) for _ in range(2))
    for name in ("skin_m", "normal", "depth_m", "uv", "sigma_m", "turn"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


def test_every_prefix_has_the_same_share_of_the_backing_layer(small):
    depth_m = (0.5 - small.uvd[:, 2]) * 2 * UVD_RANGE_M
    backing = depth_m > SMALL.layers.outer_depth_m[1] + 1e-5
    assert int(backing.sum()) == 600
    for count in (750, 1500, 3000):
        assert abs(float(backing[:count].mean()) - 0.2) < 0.01


def test_the_backing_layer_does_not_grow_through_the_skin_in_a_prefix(small):
    half = small.prefix(750)
    depth_m = (0.5 - half.uvd[:, 2]) * 2 * UVD_RANGE_M
    backing = depth_m > 1e-3
    assert (half.sigma_m[backing] <= np.maximum(small.sigma_m[:750][backing], depth_m[backing] / 1.8)).all()
    outer = ~backing
    np.testing.assert_allclose(half.sigma_m[outer], np.minimum(2 * small.sigma_m[:750][outer], 4e-3), rtol=1e-6)


def test_a_darker_tone_reflects_less_in_every_channel(small):
    points = SkinPoints(
        small.position_m.astype(np.float64),
        np.tile([0.0, 0.0, 1.0], (len(small), 1)),
        small.bone_weights.astype(np.float64),
        np.zeros(len(small)),
    )
    landmarks = Landmarks.of(load_template().joints_m)
    marks = MarkPainter(points, landmarks).paint(points.position_m)
    fair, dark = (reflectance(points, marks, landmarks, SkinLook(tone=t)) for t in (SkinLook().tone, (0.45, 0.3, 0.23)))
    assert (dark < 0.5 * fair).all()


def test_shares_add_up():
    for count in (20, 999, 60_000):
        counts = shared_out(bone_areas(load_template()) ** 0.7, count)
        assert counts.sum() == count


def test_bone_areas_cover_the_whole_surface():
    template = load_template()
    whole = trimesh.triangles.area(template.vertices_m[template.faces]).sum()
    assert bone_areas(template).sum() == pytest.approx(whole, rel=1e-12)


def test_turns_keep_the_order_of_each_bone():
    bone = np.tile(np.arange(1, 21), 50)
    chosen, turn = take_turns(bone, np.arange(11, 31))
    assert (np.diff(turn) >= 0).all()
    for number in range(1, 21):
        own = chosen[bone[chosen] == number]
        assert len(own) == number + 10
        assert (np.diff(own) > 0).all()


def test_the_curved_surface_goes_through_the_vertices():
    template = load_template()
    face = np.arange(200)
    for corner in range(3):
        point_m, normal = curved_surface(template, face, np.tile(np.eye(3)[corner], (200, 1)), 0.75)
        np.testing.assert_allclose(point_m, template.vertices_m[template.faces[face, corner]], atol=1e-17)
        np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, rtol=1e-14)


def sphere(radius_m: float, center_m=(0, 0, 0)) -> tuple[np.ndarray, np.ndarray]:
    """A closed octahedron subdivided four times."""
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(4):
        corners = vertices[faces]
        middle = (corners + np.roll(corners, -1, 1)) / 2
        a, b, c = corners.transpose(1, 0, 2)
        ab, bc, ca = middle.transpose(1, 0, 2)
        triangles = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        vertices, index = np.unique(triangles.reshape(-1, 3).round(12), axis=0, return_inverse=True)
        faces = index.reshape(-1, 3)
    return radius_m * vertices / np.linalg.norm(vertices, axis=1, keepdims=True) + center_m, faces


def test_directions_are_spread_evenly():
    directions = sphere_directions(192)
    assert np.abs(directions.mean(0)).max() < 2e-3
    np.testing.assert_allclose(directions.T @ directions / 192, np.eye(3) / 3, atol=2e-3)


def test_a_lonely_ball_is_open_everywhere():
    vertices_m, faces = sphere(0.02)
    normal = sphere_directions(100)
    light = bake_light(0.02 * normal, normal, normal, Occluder(vertices_m, faces), Studio())
    assert light.openness.min() > 0.99


def test_a_white_ball_under_an_even_dome_is_white():
    vertices_m, faces = sphere(0.02)
    normal = sphere_directions(100)
    studio = Studio(ambient=(1.0, 1.0, 1.0), wrap=(0.0, 0.0, 0.0), translucency=(0, 0, 0), lights=())
    light = bake_light(0.02 * normal, normal, normal, Occluder(vertices_m, faces), studio)
    np.testing.assert_allclose(light.irradiance, 1, atol=0.03)


def test_a_ball_hides_light_from_its_neighbor_on_their_common_side():
    (left, faces), (right, _) = sphere(0.02, (-0.021, 0, 0)), sphere(0.02, (0.021, 0, 0))
    both = Occluder(np.concatenate([left, right]), np.concatenate([faces, faces + len(left)]))
    normal = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    light = bake_light(left.mean(0) + 0.02 * normal, normal, normal, both, Studio())
    assert light.openness[0] < 0.15
    assert light.openness[1] > 0.99


def test_palm_and_back_are_told_apart_on_every_finger():
    template = load_template()
    landmarks = Landmarks.of(template.joints_m)
    np.testing.assert_allclose((landmarks.axis * landmarks.palmar).sum(1), 0, atol=1e-15)
    # the fingers of a hand whose palm looks to +z flex to +z
    assert (landmarks.palmar[2:6, 2] > 0.9).all()
    assert palm_share(np.array([-1.0]))[0] == 0
    assert palm_share(np.array([1.0]))[0] == 1


def test_display_never_clips_hard():
    shown = display(np.linspace(0, 4, 400)[:, None])
    assert (np.diff(shown[:, 0]) > 0).all()
    assert shown.max() <= 1
