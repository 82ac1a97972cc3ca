"""The weight field: true at the skin, smooth between fingers, never zero outside, and with its axes in order."""

import numpy as np
import pytest
import torch

from jghand_engine.template.builtin import load_template
from jghand_engine.template.weight_field import WeightField, _harmonic
from jghand_engine.template.weights import WEIGHT_MIN


@pytest.fixture(scope="module")
def field():
    return WeightField.build(load_template())


@pytest.fixture(scope="module")
def skin():
    """Points on the skin, uniform by area, and the weights that the mesh gives them."""
    template, rng = load_template(), np.random.default_rng(0)
    corners = template.vertices_m[template.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    face = rng.choice(len(area), 20_000, p=area / area.sum())
    bary = rng.dirichlet([1, 1, 1], len(face))
    weights = np.einsum("nk,nkj->nj", bary, template.bone_weights[template.faces[face]])
    return np.einsum("nk,nkc->nc", bary, corners[face]), weights


def of_fingers(weights):
    """(N, 5) weight on the phalanges of each finger."""
    return np.stack([weights[:, [6 + f, 11 + f, 16 + f]].sum(axis=1) for f in range(5)], axis=1)


def test_at_the_skin_it_gives_the_mesh_s_weights(field, skin):
    points, weights = skin
    error = np.abs(field.query(points).numpy() - weights).sum(axis=1) / 2
    # METHOD 3.4 asks for 1.5 %; observed 0.6 %
    assert error.mean() <= 0.0075


def test_skin_of_one_finger_does_not_leak_into_another(field, skin):
    points, weights = skin
    own, found = of_fingers(weights), of_fingers(field.query(points).numpy())
    finger = own.argmax(axis=1)
    # the webs follow two fingers by intent: they are left out
    alone = (own.max(axis=1) > 0.5) & (np.sort(own, axis=1)[:, -2] == 0)
    leak = found.sum(axis=1) - found[np.arange(len(found)), finger]
    assert np.quantile(leak[alone], 0.99) <= 0.006  # METHOD 3.4; observed 0.5 %


def test_between_two_fingers_it_has_no_jump(field):
    """The nearest vertex would jump by 1 half-way. Steps of 0.1 mm from the index to the middle finger."""
    joints = load_template().joints_m
    start, end = (joints[7] + joints[12]) / 2, (joints[8] + joints[13]) / 2
    line = np.linspace(start, end, int(np.linalg.norm(end - start) / 1e-4))
    weights = field.query(line).numpy()
    assert weights[0, [7, 12]].sum() > 0.9
    assert weights[-1, [8, 13]].sum() > 0.9
    # worst observed 0.0125
    assert np.abs(np.diff(weights, axis=0)).sum(axis=1).max() / 2 < 0.015


def test_rows_sum_to_one_everywhere(field):
    points = np.random.default_rng(0).uniform(-0.2, 0.3, (5000, 3))
    weights = field.query(points)
    assert weights.shape == (5000, 21)
    assert (weights.sum(dim=1) - 1).abs().max() < 1e-6
    assert ((weights == 0) | (weights >= WEIGHT_MIN)).all()


def test_outside_the_grid_the_border_goes_on(field):
    low, high = field.low_m.numpy(), field.high_m.numpy()
    for axis in range(3):
        for side, step in ((low, -1), (high, 1)):
            border = (low + high) / 2
            border[axis] = side[axis]
            outside = border.copy()
            outside[axis] += step
            np.testing.assert_allclose(field.query(outside[None]), field.query(border[None]), atol=1e-6)


def test_voxels_are_met_at_their_centers_and_axes_are_in_order():
    """A field that knows where it is: channel a holds coordinate a."""
    counts, low, high = (4, 6, 5), torch.tensor([-1.0, 2.0, 0.5]), torch.tensor([0.5, 4.5, 2.5])
    axes = [torch.linspace(float(low[k]), float(high[k]), counts[k]) for k in range(3)]
    place = torch.stack(torch.meshgrid(*axes, indexing="ij"))
    grid = torch.zeros(1, 21, *counts)
    grid[0, :3] = 0.2 + 0.1 * (place - low.view(3, 1, 1, 1)) / (high - low).view(3, 1, 1, 1)
    grid[0, 3] = 1 - grid[0, :3].sum(dim=0)
    field = WeightField(grid, low.double(), high.double())
    points = low + (high - low) * torch.rand(100, 3, generator=torch.Generator().manual_seed(0))
    corner = torch.stack([low, high, torch.stack([low[0], high[1], low[2]])])
    for asked in (points, corner):
        expected = 0.2 + 0.1 * (asked - low) / (high - low)
        np.testing.assert_allclose(field.query(asked)[:, :3], expected, atol=1e-6)


def test_its_grid_surrounds_the_hand_with_a_margin(field):
    template = load_template()
    low_m, high_m = template.vertices_m.min(axis=0) - 0.0119, template.vertices_m.max(axis=0) + 0.0119
    # of voxels of which 16 do not do
    coarse_m = (high_m - low_m)[0] / 15.3
    for grid, voxel_m in ((field, 0.003), (WeightField.build(template, voxel_m=coarse_m), coarse_m)):
        assert (grid.low_m.numpy() <= low_m).all()
        assert (grid.high_m.numpy() >= high_m).all()
        spacing = (grid.high_m - grid.low_m) / (torch.tensor(grid.grid.shape[2:]) - 1)
        np.testing.assert_allclose(spacing, voxel_m, atol=1e-12)


def test_the_filling_is_harmonic():
    """Between two fixed planes Laplace's equation has a straight line as its solution."""
    values, fixed = torch.zeros(1, 1, 16, 8, 8), torch.zeros(1, 1, 16, 8, 8, dtype=torch.bool)
    fixed[:, :, [0, 15]] = True
    values[:, :, 15] = 1
    filled = _harmonic(values, fixed, levels=4)
    line = torch.linspace(0, 1, 16).view(1, 1, 16, 1, 1).expand_as(filled)
    # coarse levels and a fixed number of sweeps leave a rest: worst observed 0.0095
    assert (filled - line).abs().max() < 0.012
    assert torch.equal(filled[:, :, [0, 15]], values[:, :, [0, 15]])


def test_gradients_reach_the_points(field):
    points = torch.tensor([[0.0, 0.1, 0.0], [0.02, 0.12, 0.01]], dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(field.query(points)[:, 3].sum(), points)
    assert torch.isfinite(gradient).all()
    assert gradient.abs().max() > 0
