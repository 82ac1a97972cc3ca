"""ST-LPIPS where its weights are installed, LPIPS with made-up weights, and how both are refused."""

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from torch.nn import functional

from jghand_engine.cli.learning import train_options
from jghand_engine.errors import InputError
from jghand_engine.learn import perceptual

ALEX = {0: (64, 3, 11), 3: (192, 64, 5), 6: (384, 192, 3), 8: (256, 384, 3), 10: (256, 256, 3)}
CHANNELS = (64, 192, 384, 256, 256)


@pytest.fixture(scope="module")
def st_lpips():
    metric = perceptual.st_lpips()
    if metric is None:
        pytest.skip(perceptual.ST_LPIPS_MISSING)
    return metric


@pytest.fixture(scope="module")
def alex():
    random = torch.Generator().manual_seed(0)
    trunk = {}
    for number, (out, channels, size) in ALEX.items():
        shape = (out, channels, size, size)
        trunk[f"features.{number}.weight"] = torch.randn(shape, generator=random) / (channels * size * size) ** 0.5
        trunk[f"features.{number}.bias"] = torch.zeros(out)
    heads = {f"lin{i}.model.1.weight": torch.rand(1, c, 1, 1, generator=random) for i, c in enumerate(CHANNELS)}
    return trunk, heads


def picture(size=64, seed=0):
    rough = np.random.default_rng(seed).random((size, size, 3))
    return torch.from_numpy(gaussian_filter(rough, (2, 2, 0)).astype(np.float32) * 4 - 1.5).clamp(0, 1)


def blurred(rgb, sigma):
    return torch.from_numpy(gaussian_filter(rgb.numpy(), (sigma, sigma, 0)))


def test_st_lpips_of_equal_pictures_is_zero(st_lpips):
    assert float(st_lpips.distance(picture(), picture())) == 0


@pytest.mark.parametrize(("sigma", "published"), [(1, 0.0498722), (4, 0.6487374)])
def test_st_lpips_is_that_of_its_package(st_lpips, sigma, published):
    """The values that the package itself gives for these pictures."""
    assert float(st_lpips.distance(blurred(picture(), sigma), picture())) == pytest.approx(published, rel=1e-4)


def test_st_lpips_has_a_finite_gradient_on_black_too(st_lpips):
    ours = (0.9 * picture()).requires_grad_(True)
    st_lpips.distance(ours, picture()).backward()
    assert torch.isfinite(ours.grad).all()
    assert float(ours.grad.abs().sum()) > 0
    black = torch.zeros(40, 40, 3, requires_grad=True)
    st_lpips.distance(black, torch.zeros(40, 40, 3)).backward()
    assert torch.isfinite(black.grad).all()


def test_a_training_takes_the_users_trunk_instead_of_the_stand_in(alex, tmp_path, monkeypatch):
    trunk, heads = alex
    for name, tensors in (("alexnet.pth", trunk), ("heads.pth", heads)):
        torch.save(dict(tensors), tmp_path / name)
    monkeypatch.setattr(perceptual, "_installed_file", lambda *_: tmp_path / "heads.pth")
    options, metric = train_options("paper-faithful", 0, lpips_trunk=tmp_path / "alexnet.pth")
    assert (metric.name, metric.note, options.loss.perceptual) == ("LPIPS", "version 0.1, alex", 0.2)
    a, b = picture(), blurred(picture(), 1)
    assert float(metric.distance(a, b)) == float(perceptual.lpips_of(trunk, heads, "alex").distance(a, b))
    with pytest.raises(InputError, match="--lpips-trunk: wanted a preset that learns by LPIPS"):
        train_options("default", 0, lpips_trunk=tmp_path / "alexnet.pth")


def test_lpips_is_the_published_formula(alex):
    """Written out once more for the first two of the five maps, the others with heads of 0."""
    trunk, heads = alex
    few = {name: (head if name[3] in "01" else torch.zeros_like(head)) for name, head in heads.items()}
    a, b = picture(), blurred(picture(), 1)

    def maps(rgb):
        x = (2 * rgb.permute(2, 0, 1)[None] - 1 - torch.tensor([-0.030, -0.088, -0.188]).view(1, 3, 1, 1)) / (
            torch.tensor([0.458, 0.448, 0.450]).view(1, 3, 1, 1)
        )
        one = functional.relu(functional.conv2d(x, trunk["features.0.weight"], stride=4, padding=2))
        two = functional.conv2d(functional.max_pool2d(one, 3, 2), trunk["features.3.weight"], padding=2)
        return one, functional.relu(two)

    wanted = 0.0
    for i, (p, q) in enumerate(zip(maps(a), maps(b), strict=True)):
        unlike = (functional.normalize(p, dim=1, eps=1e-10) - functional.normalize(q, dim=1, eps=1e-10)) ** 2
        wanted += float((unlike * heads[f"lin{i}.model.1.weight"]).sum(1).mean())
    assert float(perceptual.lpips_of(trunk, few, "alex").distance(a, b)) == pytest.approx(wanted, rel=1e-4)


def test_lpips_names_what_a_trunk_lacks(alex):
    trunk, heads = alex
    with pytest.raises(InputError, match=r"features\.2\.weight"):
        perceptual.lpips_of(trunk, heads, "vgg")


def test_pictures_that_no_network_can_halve_are_refused(alex):
    with pytest.raises(InputError, match="at least 32"):
        perceptual.lpips_of(*alex, "alex").distance(picture(31), picture(31))


def test_a_file_of_something_else_than_tensors_is_refused(tmp_path):
    torch.save([torch.zeros(2)], tmp_path / "list.pth")
    with pytest.raises(InputError, match="named tensors"):
        perceptual._load_tensors(tmp_path / "list.pth")
