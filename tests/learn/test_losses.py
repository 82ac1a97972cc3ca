"""The terms of the training loss: values against plain formulas, gradients against finite differences."""

import pytest
import torch
from torch.nn import functional

from jghand_engine.errors import InputError
from jghand_engine.learn import losses
from jghand_engine.learn.ssim import ssim, ssim_parts
from jghand_engine.native.library import load
from jghand_engine.native.ssim import NativeSsim


def picture(height=23, width=19, seed=0, dtype=torch.float64):
    return torch.rand(height, width, 3, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def plain_factors(a, b):
    """Luminance and contrast-structure of SSIM (3, H - 10, W - 10) as they are written, with one two-dimensional
    convolution per map."""
    x = torch.arange(-5, 6, dtype=a.dtype)
    weights = torch.exp(-(x**2) / (2 * 1.5**2))
    kernel = torch.outer(weights, weights)[None, None] / weights.sum() ** 2

    def mean(maps):
        return functional.conv2d(maps.permute(2, 0, 1).unsqueeze(1), kernel)[:, 0]

    ma, mb = mean(a), mean(b)
    saa, sbb, sab = mean(a * a) - ma * ma, mean(b * b) - mb * mb, mean(a * b) - ma * mb
    return (2 * ma * mb + 1e-4) / (ma * ma + mb * mb + 1e-4), (2 * sab + 9e-4) / (saa + sbb + 9e-4)


def plain_ssim(a, b):
    luminance, contrast = plain_factors(a, b)
    return (luminance * contrast).mean()


def test_ssim_is_the_formula():
    a, b = picture(), picture(seed=1)
    assert float(ssim(a, b)) == pytest.approx(float(plain_ssim(a, b)), abs=1e-14)


def test_ssim_has_the_gradient_of_the_formula():
    a, b = picture().requires_grad_(True), picture(seed=1)
    (ours,) = torch.autograd.grad(ssim(a, b), a)
    (wanted,) = torch.autograd.grad(plain_ssim(a, b), a)
    # worst observed 2e-18
    torch.testing.assert_close(ours, wanted, rtol=0, atol=1e-16)


def test_ssim_in_single_precision_keeps_its_gradient():
    a, b = picture(60, 50), picture(60, 50, seed=1)
    (exact,) = torch.autograd.grad(ssim(x := a.requires_grad_(True), b), x)
    single = a.detach().float().requires_grad_(True)
    (ours,) = torch.autograd.grad(ssim(single, b.float()), single)
    error = (ours - exact).norm() / exact.norm()
    assert float(error) < 1e-5  # worst observed 9e-7


@pytest.mark.parametrize("size", [(11, 11), (23, 17), (64, 48), (61, 250)])
def test_the_native_ssim_is_that_of_torch(size):
    a, b = (picture(*size, seed=seed, dtype=torch.float32) for seed in (0, 1))
    values, gradients = [], []
    for mean in (ssim, lambda x, b: ssim_parts(x, b)[0].mean()):
        x = a.clone().requires_grad_(True)
        value = mean(x, b)
        value.backward()
        values.append(float(value.detach()))
        gradients.append(x.grad)
    assert values[0] == pytest.approx(values[1], abs=1e-6)  # worst observed 4e-8
    largest = float(gradients[1].abs().max())
    torch.testing.assert_close(gradients[0], gradients[1], rtol=0, atol=1e-5 * largest)  # worst observed 2e-6


def test_the_native_ssim_does_not_depend_on_threads_or_on_what_was_there_before():
    library = load()
    pairs = [[picture(*size, seed=s, dtype=torch.float32).numpy() for s in (0, 1)] for size in ((40, 60), (90, 20))]
    alone, together = NativeSsim(library, 1), NativeSsim(library, 3)
    first = [alone.mean_and_gradient(*pair) for pair in pairs]
    for kernel in (alone, together):
        for pair, (value, gradient) in zip(pairs, first, strict=True):
            again, same = kernel.mean_and_gradient(*pair)
            assert again == kernel.mean(*pair) == value
            assert (same == gradient).all()


def test_a_black_picture_has_finite_gradients():
    black = torch.zeros(20, 20, 3, requires_grad=True)
    losses.ssim_loss(black, torch.zeros(20, 20, 3)).backward()
    assert torch.isfinite(black.grad).all()


def test_ssim_refuses_a_picture_smaller_than_its_window():
    with pytest.raises(InputError, match="at least 11 pixels"):
        ssim(picture(10, 30), picture(10, 30))


def test_l1_is_the_mean_difference():
    assert float(losses.l1_loss(torch.zeros(4, 5, 3), torch.full((4, 5, 3), 0.25))) == 0.25


def test_mask_loss_is_the_mean_square():
    assert float(losses.mask_loss(torch.full((4, 5), 0.5), torch.ones(4, 5))) == 0.25


def test_truth_gets_no_gradient():
    a, b = picture().requires_grad_(True), picture(seed=1).requires_grad_(True)
    alpha, mask = picture()[..., 0].requires_grad_(True), picture(seed=1)[..., 0].requires_grad_(True)
    (losses.l1_loss(a, b) + losses.ssim_loss(a, b) + losses.mask_loss(alpha, mask)).backward()
    assert b.grad is None
    assert mask.grad is None
    assert bool((a.grad != 0).all())
    assert bool((alpha.grad != 0).all())


@pytest.mark.parametrize("loss", [losses.l1_loss, losses.ssim_loss])
def test_picture_losses_agree_with_finite_differences(loss):
    b = picture(13, 12, seed=1)
    assert torch.autograd.gradcheck(lambda a: loss(a, b), picture(13, 12).requires_grad_(True), atol=1e-8)


def test_offsets_of_zero_cost_nothing_and_have_a_gradient():
    offset = torch.zeros(7, 3, requires_grad=True)
    loss = losses.offset_loss(offset, offset, hand_size_m=0.18)
    loss.backward()
    assert float(loss.detach()) == 0
    assert bool((offset.grad == 0).all())


def test_offset_loss_is_length_over_hand_size():
    offset = torch.tensor([[3e-3, 4e-3, 0.0], [0.0, 0.0, 0.0]], dtype=torch.float64)
    # 5 mm and 0 mm, mean 2.5 mm, once for identity and twice as much for the pose; short of it by eps at most
    assert float(losses.offset_loss(offset, 2 * offset, hand_size_m=0.1)) == pytest.approx(0.075, abs=2e-4)


def test_offset_loss_agrees_with_finite_differences():
    offset = (1e-3 * picture()[0]).requires_grad_(True)
    assert torch.autograd.gradcheck(lambda x: losses.offset_loss(x, hand_size_m=0.18), offset, eps=1e-9, atol=1e-5)


def test_tone_is_what_all_skin_is_colored_by_alike():
    shade = torch.tensor([[0.3, 0.0, -0.1], [0.1, 0.2, 0.1]], dtype=torch.float64, requires_grad=True)
    assert float(losses.tone_loss(shade).detach()) == pytest.approx(0.2**2 + 0.1**2)
    assert torch.autograd.gradcheck(losses.tone_loss, shade)
