"""The sample of the shell under the skin: where, how many, in which order."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from jghand_engine.avatar.avatar import UVD_RANGE_M
from jghand_engine.errors import InputError
from jghand_engine.template import sampling
from jghand_engine.template.builtin import load_template
from jghand_engine.template.closest import Surface
from jghand_engine.template.sampling import (
    SHELL_DEPTH_M,
    _draws,
    _shell_cells,
    bone_distances,
    farthest_point_order,
    sample_shell,
    uvd_coordinates,
)
from jghand_engine.template.surface import vertex_normals

PER_BONE = 150


@pytest.fixture(scope="module")
def template():
    return load_template()


@pytest.fixture(scope="module")
def sample(template):
    return sample_shell(template, per_bone=PER_BONE, seed=3)


def test_every_bone_gets_exactly_its_number(sample):
    assert len(sample) == 20 * PER_BONE
    assert np.array_equal(np.bincount(sample.bone), [0, *[PER_BONE] * 20])


def test_every_prefix_gives_all_bones_the_same_number(sample):
    for rank in (1, 10, PER_BONE):
        assert np.array_equal(np.bincount(sample.bone[: 20 * rank], minlength=21), [0, *[rank] * 20])


def test_points_lie_in_the_shell_and_nowhere_else(template, sample):
    signed = Surface(template.vertices_m, template.faces).closest(sample.position_m).signed_m
    assert signed.max() <= 0
    assert signed.min() >= -SHELL_DEPTH_M
    # uniform: about as many in the upper half of the shell as in the lower (a little more, the shell is curved)
    assert 0.48 < (signed > -SHELL_DEPTH_M / 2).mean() < 0.58


def test_points_belong_to_their_nearest_bone(template, sample):
    distance = bone_distances(sample.position_m, template.joints_m)
    own = distance[np.arange(len(sample)), sample.bone - 1]
    assert np.array_equal(own, distance.min(axis=1))


def test_the_stump_behind_the_wrist_is_shared_by_the_metacarpals(template):
    stump = sample_shell(template, per_bone=200, seed=0)
    behind = stump.bone[stump.position_m[:, 1] < -0.004]
    assert set(behind) == {1, 2, 3, 4, 5}


def test_texture_coordinates_are_those_of_the_closest_face(template, sample):
    uv = np.einsum("nk,nkc->nc", sample.barycentric, template.face_uv[sample.face])
    np.testing.assert_array_equal(sample.uvd[:, :2], uv)
    foot = np.einsum("nk,nkc->nc", sample.barycentric, template.vertices_m[template.faces[sample.face]])
    depth = np.linalg.norm(foot - sample.position_m, axis=1)
    np.testing.assert_allclose(sample.uvd[:, 2], 0.5 - depth / (2 * UVD_RANGE_M), atol=1e-12)


def test_depth_has_a_fixed_range(template):
    surface = Surface(template.vertices_m, template.faces)
    points = template.vertices_m[:1] + np.array([[0.0, 0, 0], [0, 0, 5.0], [0, 0, 0.004]])
    near = surface.closest(points)
    depth = uvd_coordinates(template, near)[:, 2]
    np.testing.assert_allclose(depth[:2], [0.5, 1], atol=1e-9)
    assert depth[2] == pytest.approx(0.5 + near.signed_m[2] / (2 * UVD_RANGE_M))


def test_depth_may_go_from_the_deepest_point_to_the_shallowest(template):
    sample = sample_shell(template, per_bone=5, depth_m=0.012, depth_of_points=True)
    signed_m = Surface(template.vertices_m, template.faces).closest(sample.position_m).signed_m
    assert signed_m.min() < -UVD_RANGE_M
    np.testing.assert_allclose(sample.uvd[:, 2], (signed_m - signed_m.min()) / np.ptp(signed_m), atol=1e-12)


def test_normals_point_out_of_the_skin(template, sample):
    np.testing.assert_allclose(np.linalg.norm(sample.normal, axis=1), 1, atol=1e-12)
    foot = np.einsum("nk,nkc->nc", sample.barycentric, template.vertices_m[template.faces[sample.face]])
    outwards = foot - sample.position_m
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    # at the wrist's rim and in creases the way to the closest point is not along the interpolated normal: worst
    # observed 58 degrees, 7 in the median
    cosine = np.einsum("nc,nc->n", outwards, sample.normal)
    assert cosine.min() > 0.5
    assert np.median(cosine) > 0.97


def test_farthest_point_order_takes_the_farthest_next():
    points = np.random.default_rng(0).normal(size=(2, 40, 3))
    points[1, 30:] = points[1, 3]  # each comes once, too
    order = farthest_point_order(points)
    for group, ranks in zip(points, order, strict=True):
        assert sorted(ranks) == list(range(40))
        assert ranks[0] == 0
        for rank in range(1, 40):
            gap = np.linalg.norm(group[:, None] - group[ranks[:rank]], axis=2).min(axis=1)
            assert gap[ranks[rank]] == pytest.approx(gap.max())


def test_a_prefix_covers_the_hand_better_than_chance(sample):
    """A level of detail: the gaps that a fifth of the points leaves, against those of a random fifth."""
    count = len(sample) // 5
    prefix = KDTree(sample.position_m[:count]).query(sample.position_m)[0]
    rng = np.random.default_rng(0)
    chance = KDTree(sample.position_m[rng.permutation(len(sample))[:count]]).query(sample.position_m)[0]
    # observed 0.72 (the palm's bones are larger than those of the fingers, which limits it)
    assert np.quantile(prefix, 0.99) < 0.8 * np.quantile(chance, 0.99)


# ---- how they are drawn ---------------------------------------------------------------------------------------------


def test_all_of_the_shell_lies_in_the_cells_that_points_are_drawn_from(template):
    surface = Surface(template.vertices_m, template.faces)
    cells_m, half_m = _shell_cells(template, surface, SHELL_DEPTH_M)
    inwards = np.random.default_rng(0).random((5, len(template.vertices_m), 1)) * SHELL_DEPTH_M
    points = (template.vertices_m - inwards * vertex_normals(template.vertices_m, template.faces)).reshape(-1, 3)
    signed = surface.closest(points).signed_m
    points = points[(signed <= 0) & (signed >= -SHELL_DEPTH_M)]
    assert KDTree(cells_m).query(points, p=np.inf)[0].max() <= half_m + 1e-12


def test_as_many_are_drawn_as_are_missing_at_the_rate_so_far_and_a_tenth_more():
    count, drawn = np.array([0, 40, 99, 0]), np.array([0, 80, 100, 500])
    np.testing.assert_array_equal(_draws(100, count, drawn), [440, 132, 16, 2016])


def test_a_bone_without_skin_is_named(template):
    joints = template.joints_m.copy()
    # the little finger's tip lies on its last joint and the whole bone outside the hand
    joints[[15, 20]] = [[-0.3, 0.5, 0.0], [-0.3, 0.6, 0.0]]
    with pytest.raises(InputError, match="pinky4"):
        sample_shell(replace(template, joints_m=joints), per_bone=5)


def test_a_bone_that_is_hardly_ever_met_is_given_up(template, monkeypatch):
    monkeypatch.setattr(sampling, "SHELL_DRAWS_MAX", 1)
    with pytest.raises(InputError, match="wanted skin around every bone"):
        sample_shell(template, per_bone=50)
