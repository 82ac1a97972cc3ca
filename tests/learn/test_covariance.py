"""Covariances on a moving hand: the formula, what it does at the edges, and gradients that stay finite."""

import pytest
import torch

from jghand_engine.avatar.skin_task import QUATERNION_MIN
from jghand_engine.learn.gaussians import posed_covariance
from jghand_engine.native import contract

ENTRIES = [0, 1, 2, 4, 5, 8]
FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]


def some(count: int, dtype: torch.dtype = torch.float64, seed: int = 0) -> tuple[torch.Tensor, ...]:
    """log_scale, quaternion of any length, linear with shear and mirror."""
    generator = torch.Generator().manual_seed(seed)
    log_scale = -7 + torch.randn(count, 3, generator=generator, dtype=torch.float64)
    quaternion = torch.randn(count, 4, generator=generator, dtype=torch.float64)
    linear = torch.eye(3) + 0.5 * torch.randn(count, 3, 3, generator=generator, dtype=torch.float64)
    return log_scale.to(dtype), quaternion.to(dtype), linear.to(dtype)


def matrices(covariance: torch.Tensor) -> torch.Tensor:
    return covariance[:, FULL].reshape(-1, 3, 3)


def rotation(quaternion: torch.Tensor) -> torch.Tensor:
    """(N, 3, 3) by turning the three axes: v + 2 w (q x v) + 2 q x (q x v)."""
    unit = quaternion / quaternion.norm(dim=1, keepdim=True)
    w, q = unit[:, :1], unit[:, 1:]
    turned = []
    for axis in torch.eye(3, dtype=unit.dtype):
        v = axis.expand_as(q)
        once = torch.linalg.cross(q, v)
        turned.append(v + 2 * w * once + 2 * torch.linalg.cross(q, once))
    return torch.stack(turned, 2)


def test_the_covariance_is_the_textbooks():
    log_scale, quaternion, linear = some(200)
    R = rotation(quaternion)
    want = linear @ R @ torch.diag_embed(torch.exp(2 * log_scale)) @ R.mT @ linear.mT
    got = posed_covariance(log_scale, quaternion, linear)
    torch.testing.assert_close(got, want.reshape(-1, 9)[:, ENTRIES], rtol=1e-12, atol=1e-18)


def test_a_mirror_image_has_the_mirrored_covariance():
    log_scale, quaternion, linear = some(50)
    mirror = torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)
    right = posed_covariance(log_scale, quaternion, linear)
    left = posed_covariance(log_scale, quaternion, mirror[:, None] * linear)
    assert torch.equal(matrices(left), mirror[:, None] * matrices(right) * mirror)


def test_the_length_and_the_sign_of_a_quaternion_mean_nothing():
    log_scale, quaternion, linear = some(50)
    once = posed_covariance(log_scale, quaternion, linear)
    for factor in (-1.0, 1e-4, 1e4):
        torch.testing.assert_close(posed_covariance(log_scale, factor * quaternion, linear), once, rtol=1e-12, atol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("length", [0.0, 1e-30, QUATERNION_MIN, 1e-5])
def test_a_quaternion_without_length_is_no_rotation_and_has_a_finite_gradient(length, dtype):
    log_scale, quaternion, linear = some(20, dtype)
    quaternion = (length * quaternion / quaternion.norm(dim=1, keepdim=True)).requires_grad_()
    got = posed_covariance(log_scale, quaternion, linear)
    got.sum().backward()
    assert bool(torch.isfinite(got).all())
    assert quaternion.grad is not None
    assert bool(torch.isfinite(quaternion.grad).all())
    if length < QUATERNION_MIN:
        want = linear @ torch.diag_embed(torch.exp(2 * log_scale)) @ linear.mT
        # float32: 1e-7 of the largest entry
        close = {"rtol": 1e-5, "atol": 1e-12} if dtype == torch.float32 else {"rtol": 1e-12, "atol": 0.0}
        torch.testing.assert_close(got.detach(), want.reshape(-1, 9)[:, ENTRIES], **close)
        assert float(quaternion.grad.abs().max()) == 0


@pytest.mark.parametrize("linear", ["collapsed", "zero", "mirrored"])
def test_any_linear_map_gives_semi_definite_covariances_and_finite_gradients(linear):
    log_scale, quaternion, maps = some(2000, torch.float32)
    maps = {"collapsed": maps * torch.tensor([1.0, 1.0, 0.0]), "zero": torch.zeros_like(maps), "mirrored": -maps}[
        linear
    ]
    leaves = [tensor.clone().requires_grad_() for tensor in (log_scale, quaternion, maps)]
    covariance = posed_covariance(*leaves)
    covariance.sum().backward()
    assert all(leaf.grad is not None and bool(torch.isfinite(leaf.grad).all()) for leaf in leaves)
    values = torch.linalg.eigvalsh(matrices(covariance.detach().double()))
    # within what the rasterizer takes for rounding; worst seen -3.4e-8
    assert bool((values[:, 0] >= -0.1 * contract.COVARIANCE_SLACK * values.sum(1)).all())
