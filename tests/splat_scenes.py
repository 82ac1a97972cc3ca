"""Scenes for the rasterizer's tests, and how two pictures or two gradients are compared."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from jghand_engine.learn.gaussians import Gaussians, posed_covariance
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.reference import Picture, rasterize_reference
from jghand_engine.native.library import GPU, runnable_variants
from jghand_engine.render.camera import Camera
from jghand_engine.render.settings import RenderSettings

NATIVE = runnable_variants()
# what draws and has no gradients too
DRAWING = [*NATIVE, pytest.param(GPU, marks=pytest.mark.graphics_card)]
NAMES = ("position_m", "sigma_m", "opacity", "rgb")
ELLIPSOID_NAMES = ("position_m", "covariance_m2", "opacity", "rgb")  # of these, sigma_m is ignored

# Promise 3 of the contract: a pixel differs by more than rounding and the early stop only where a contribution falls on
# the other side of the cut, which is worth at most 1/255 of a color
PIXEL_TOLERANCE = 1.1e-4
FLIPPED_SHARE = 5e-5
FLIP_LIMIT = 1 / 255


def gaussians_from(position_m, sigma_m, opacity, rgb, dtype: torch.dtype = torch.float32) -> Gaussians:
    def tensor(array) -> torch.Tensor:
        return torch.as_tensor(np.asarray(array), dtype=torch.float32).to(dtype)

    return Gaussians(tensor(position_m), tensor(sigma_m), tensor(opacity), tensor(rgb))


def hand_gaussians(
    count: int,
    *,
    sigma_mm: tuple[float, float] = (0.5, 0.83),
    opacity: tuple[float, float] = (0.3, 0.95),
    seed: int = 0,
) -> Gaussians:
    """About a hand, 18 cm, filled: five fingers of capsules around the origin, fingers along x, palm facing -z."""
    random = np.random.default_rng(seed)
    finger = random.integers(0, 5, count)
    along = random.uniform(0, 1, count)
    angle = np.array([-0.75, -0.2, 0.0, 0.2, 0.4])[finger]
    length = np.array([0.10, 0.16, 0.17, 0.16, 0.14])[finger]
    radius = 0.015 - 0.008 * along
    disc, turn = np.sqrt(random.uniform(0, 1, count)), random.uniform(0, 2 * math.pi, count)
    side, depth = radius * disc * np.cos(turn), radius * disc * np.sin(turn)
    x = along * length * np.cos(angle) - side * np.sin(angle) - 0.08
    y = along * length * np.sin(angle) + side * np.cos(angle)
    z = depth + 0.1 * along * x
    rgb = np.clip(np.array([0.8, 0.6, 0.5]) + random.normal(0, 0.15, (count, 3)), 0.02, 1)
    sigma = random.uniform(*sigma_mm, count) * 1e-3
    return gaussians_from(np.stack([x, y, z], 1), sigma, random.uniform(*opacity, count), rgb)


def camera_for(width: int, height: int, *, distance_m: float = 0.6, eye_direction=(0.1, 0.2, -1.0)) -> Camera:
    """Looks at the origin so that a hand fills about half of the picture's width."""
    eye = torch.tensor(eye_direction, dtype=torch.float64)
    eye = eye / eye.norm() * distance_m
    focal = 0.95 * min(width, 1.5 * height) / 0.18 * distance_m
    up = torch.tensor([0.0, -1.0, 0.0])
    return Camera.looking_at(eye, torch.zeros(3), up, width=width, height=height, focal_px=focal)


def front_camera(width: int, height: int, focal_px: float) -> Camera:
    """The camera frame is the world: no rotation, no shift."""
    return Camera(width, height, focal_px, focal_px, width / 2, height / 2, np.eye(4))


def oblong_camera(width: int, height: int) -> Camera:
    """Wide, near, its middle beside the picture, pixels that are not square."""
    view = camera_for(width, height, distance_m=0.15, eye_direction=(0.7, 0.4, -0.5))
    return Camera(width, height, 40.0, 70.0, 10.0, height + 15.0, view.camera_from_world)


def stretched(gaussians: Gaussians, *, aspect: float = 4.0, seed: int = 5) -> Gaussians:
    """The same Gaussians as ellipsoids: axes of sigma times 1/aspect .. aspect, turned at random."""
    generator = torch.Generator().manual_seed(seed)
    stretch = math.log(aspect) * (2 * torch.rand(len(gaussians), 3, generator=generator) - 1)
    log_scale = torch.log(gaussians.sigma_m)[:, None] + stretch
    turn = torch.randn(len(gaussians), 4, generator=generator)
    covariance_m2 = posed_covariance(log_scale, turn, torch.eye(3).expand(len(gaussians), 3, 3))
    return replace(gaussians, covariance_m2=covariance_m2)


def as_ellipsoids(gaussians: Gaussians) -> Gaussians:
    """The same spheres, said by covariances."""
    return replace(gaussians, covariance_m2=gaussians.sigma_m[:, None] ** 2 * torch.tensor([1.0, 0, 0, 1, 0, 1]))


def names_of(gaussians: Gaussians) -> tuple[str, ...]:
    """The tensors that a picture of them depends on."""
    return NAMES if gaussians.covariance_m2 is None else ELLIPSOID_NAMES


def changed(gaussians: Gaussians, change: Callable[[str], torch.Tensor]) -> Gaussians:
    """Gaussians of what `change` says of the name of each tensor that is there."""
    names = NAMES if gaussians.covariance_m2 is None else (*NAMES, "covariance_m2")
    return replace(gaussians, **{name: change(name) for name in names})


def in_precision(gaussians: Gaussians, dtype: torch.dtype, *, grad: bool = False) -> Gaussians:
    """The same values as leaves of the other precision."""
    return changed(gaussians, lambda name: getattr(gaussians, name).detach().to(dtype).requires_grad_(grad))


def reordered(gaussians: Gaussians, index: torch.Tensor) -> Gaussians:
    return changed(gaussians, lambda name: getattr(gaussians, name)[index].contiguous())


def joined(*parts: Gaussians) -> Gaussians:
    return changed(parts[0], lambda name: torch.cat([getattr(part, name) for part in parts]))


def planes_of(picture: Picture) -> torch.Tensor:
    """(5, H, W)"""
    return torch.cat([picture.rgb.permute(2, 0, 1), picture.alpha[None], picture.depth_sum[None]])


def draw(gaussians: Gaussians, camera: Camera, backend: str, **settings) -> Picture:
    """backend: a variant of the kernels, a graphics card, or "torch" for the reference, which never stops early"""
    if backend == "torch":
        settings.pop("t_stop", None), settings.pop("threads", None)
        return rasterize_reference(gaussians, camera, **settings)
    return rasterize(gaussians, camera, RenderSettings(backend=backend, **settings))


def exact(gaussians: Gaussians, camera: Camera, **options) -> Picture:
    """The float64 reference of float32 Gaussians."""
    return rasterize_reference(in_precision(gaussians, torch.float64), camera, **options)


def assert_same_picture(
    got: Picture, want: Picture, *, depth_scale_m: float = 1.0, color_scale: float = 1.0, flips: int = 0
) -> None:
    """Promise 3. depth_scale_m, color_scale: the largest depth and color of the scene, for contributions scale with
    them. flips: pixels in which a contribution may fall on the other side of the cut, as observed."""
    scale = torch.tensor([color_scale] * 3 + [1.0, depth_scale_m], dtype=torch.float64)[:, None, None]
    error = ((planes_of(got).double() - planes_of(want).double()).abs() / scale).amax(0)
    assert bool(torch.isfinite(error).all())
    assert float(error.max()) <= FLIP_LIMIT, f"worst pixel {float(error.max()):.2e}"
    flipped = int((error > PIXEL_TOLERANCE).sum())
    assert flipped <= flips <= max(2, FLIPPED_SHARE * error.numel()), f"{flipped} of {error.numel()} pixels differ"


def assert_same_bits(got: Picture, want: Picture) -> None:
    assert torch.equal(planes_of(got), planes_of(want))


# ---- gradients ------------------------------------------------------------------------------------------------------


def gradients_of(gaussians: Gaussians, camera: Camera, *, dtype=torch.float32, seed: int = 0, **settings):
    """Gradients (position, sigma or covariance, opacity, rgb), float64, of a sum of the planes with random weights of
    both signs."""
    leaves = in_precision(gaussians, dtype, grad=True)
    backend = settings.pop("backend", "torch")
    planes = planes_of(draw(leaves, camera, backend, **settings))
    generator = torch.Generator().manual_seed(seed)
    weights = torch.randn(planes.shape, generator=generator, dtype=torch.float64).to(dtype)
    (planes * weights).sum().backward()
    names = names_of(leaves)
    grads = [getattr(leaves, name).grad for name in names]
    return [
        torch.zeros_like(getattr(leaves, name)).double() if g is None else g.double()
        for name, g in zip(names, grads, strict=True)
    ]


@dataclass(frozen=True)
class GradientBounds:
    """Tolerances of the four checks. `element` is relative to the largest gradient of the tensor."""

    element: float
    relative_l2: float
    cosine_gap: float
    signed_bias: float


def assert_same_gradients(
    got: list[torch.Tensor], want: list[torch.Tensor], bounds: GradientBounds, names: tuple[str, ...] = NAMES
) -> None:
    """The four checks: per element, as a vector, for sparsity, for signed bias."""
    for name, a, b in zip(names, got, want, strict=True):
        assert bool(torch.isfinite(a).all()), name
        size = float(b.norm())
        if size == 0:
            assert float(a.norm()) == 0, name
            continue
        error = a - b
        assert float(error.abs().max() / b.abs().max()) <= bounds.element, f"{name}: an element"
        assert float(error.norm()) / size <= bounds.relative_l2, f"{name}: relative L2 {float(error.norm()) / size:.2e}"
        cosine = float((a * b).sum() / (a.norm() * b.norm()))
        assert 1 - cosine <= bounds.cosine_gap, f"{name}: 1 - cosine {1 - cosine:.1e}"
        bias = float(error.sum().abs() / b.abs().sum())
        assert bias <= bounds.signed_bias, f"{name}: signed bias {bias:.1e}"
        assert_same_sparsity(name, a, b)


def assert_same_sparsity(name: str, got: torch.Tensor, want: torch.Tensor) -> None:
    """Nothing where nothing belongs, and at least a tenth of every gradient that is not negligible: a kernel that loses
    some gradients altogether hides inside absolute tolerances."""
    got, want = got.reshape(len(got), -1).norm(dim=1), want.reshape(len(want), -1).norm(dim=1)
    assert float(got[want == 0].sum()) == 0, f"{name}: a gradient where the reference has none"
    real = want > 1e-3 * want.max()
    ratio = float((got[real] / want[real]).min())
    assert ratio >= 0.1, f"{name}: a row has {ratio:.3f} of its gradient"
