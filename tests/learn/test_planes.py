"""Feature planes at fixed points: as exact as sampling a picture, forward and backward."""

import torch
from torch.nn import functional

from jghand_engine.learn.planes import FixedLookup, IdentityPlanes

ROWS, COLUMNS, CHANNELS = 5, 9, 3


def spots(count: int = 400, seed: int = 0) -> torch.Tensor:
    """(N, 2) random ones; corners, edges, texel centers and some outside of the plane among them."""
    some = torch.rand(count, 2, generator=torch.Generator().manual_seed(seed))
    ends = torch.tensor([[0.0, 0.0], [1.0, 1.0], [0.0, 1.0], [1.0, 0.0], [0.5, 1.0], [1.0, 0.3], [0.25, 0.75]])
    outside = torch.tensor([[-0.2, 0.4], [1.3, 0.4], [0.4, -5.0], [0.4, 1.0001]])
    return torch.cat([some, ends, outside])


def plane_at(
    points: torch.Tensor, *, rows: int = ROWS, columns: int = COLUMNS, channels: int = CHANNELS
) -> FixedLookup:
    plane = FixedLookup(points, rows, columns, channels)
    torch.nn.init.normal_(plane.texels, generator=torch.Generator().manual_seed(1))
    return plane


def sampled(texels: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """(N, channels) by grid_sample, for which -1 and 1 are the centers of the outer texels."""
    picture = texels.reshape(ROWS, COLUMNS, CHANNELS).permute(2, 0, 1)[None]
    grid = (2 * points - 1)[None, :, None, :].to(texels.dtype)
    values = functional.grid_sample(picture, grid, mode="bilinear", padding_mode="border", align_corners=True)
    return values[0, :, :, 0].T


def test_a_lookup_is_what_grid_sample_gives():
    points = spots()
    plane = plane_at(points)
    # no difference seen; a vectorized build may add the four up in another order
    torch.testing.assert_close(plane(len(points)), sampled(plane.texels, points), atol=3e-7, rtol=0)


def test_a_lookup_has_the_gradient_of_grid_sample():
    points = spots()
    plane = plane_at(points)
    pull = torch.randn(len(points), CHANNELS, generator=torch.Generator().manual_seed(2))
    (ours,) = torch.autograd.grad((plane(len(points)) * pull).sum(), plane.texels)
    (wanted,) = torch.autograd.grad((sampled(plane.texels, points) * pull).sum(), plane.texels)
    # sums of some 40 terms; worst seen 1e-6
    torch.testing.assert_close(ours, wanted, atol=2e-6, rtol=0)


def test_a_prefix_of_the_points_has_the_same_features_and_pulls_at_nothing_else():
    points = spots()
    plane = plane_at(points)
    assert torch.equal(plane(17), plane(len(points))[:17])
    plane(17).sum().backward()
    alone = plane_at(points[:17])
    alone(17).sum().backward()
    assert torch.equal(plane.texels.grad, alone.texels.grad)


def test_roughness_is_the_mean_squared_step_between_neighbors():
    plane = plane_at(spots())
    picture = plane.texels.detach().reshape(ROWS, COLUMNS, CHANNELS)
    down, right = picture[1:] - picture[:-1], picture[:, 1:] - picture[:, :-1]
    wanted = (down**2).mean() + (right**2).mean()
    torch.testing.assert_close(plane.roughness().detach(), wanted)
    # a plane without a slope has none
    torch.nn.init.constant_(plane.texels, 0.7)
    assert float(plane.roughness().detach()) == 0


# ---- the identity planes ---------------------------------------------------------------------------------------------


def identity_planes() -> tuple[IdentityPlanes, torch.Tensor]:
    uvd = torch.rand(50, 3, generator=torch.Generator().manual_seed(3))
    return IdentityPlanes(uvd, texels=8, depth_texels=4), uvd


def test_the_three_planes_span_uv_ud_and_vd():
    """Texels that hold their own coordinate give it back: 32 features of (u, v), 16 of (u, d), 16 of (v, d)."""
    planes, uvd = identity_planes()
    assert planes.width == 64
    for plane, x, y in ((planes.uv, 0, 1), (planes.ud, 0, 2), (planes.vd, 1, 2)):
        rows, columns, channels = plane.shape
        at = torch.stack(
            torch.meshgrid(torch.linspace(0, 1, rows), torch.linspace(0, 1, columns), indexing="ij")[::-1], -1
        )
        texels = torch.zeros(rows, columns, channels)
        texels[..., :2] = at
        plane.texels.data = texels.reshape(-1, channels)
        torch.testing.assert_close(plane(50)[:, :2].detach(), uvd[:, [x, y]], atol=1e-6, rtol=0)
    features = planes(50).detach()
    wanted = uvd[:, [0, 1, 0, 2, 1, 2]]
    torch.testing.assert_close(features[:, [0, 1, 32, 33, 48, 49]], wanted, atol=1e-6, rtol=0)
