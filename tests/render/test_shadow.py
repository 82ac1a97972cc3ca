"""The self-shadow: the torch specification has the properties METHOD 5 asks for, and the kernel agrees with it."""

import ctypes
import math
import mmap
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from depth_scenes import camera, fingers, plane, planes_of, rays, sphere

from jghand_engine.errors import InputError
from jghand_engine.learn.shadow import darken, normalized_depth, printed_visibility, shade, surface_normals, visibility
from jghand_engine.native import contract
from jghand_engine.native.binding import Library
from jghand_engine.native.rasterizer import SURFACE_MARGIN_PX, SeenSurface
from jghand_engine.render import passes
from jghand_engine.render.shadow import NativeShade, ShadowStyle, vogel_disc

STYLE = ShadowStyle(samples=64)


def seen(depth_m: torch.Tensor, view, style: ShadowStyle = STYLE) -> torch.Tensor:
    valid = torch.isfinite(depth_m)
    return visibility(torch.where(valid, depth_m, 0.0), valid, view, style)


# ---- the specification ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.5, 0.0, -1.0), (-0.8, 0.6, -1.0), (0.0, 1.7, -1.0)])
def test_a_plane_is_not_darkened_at_any_tilt(normal: tuple[float, float, float]):
    view = camera(96, 80, 900.0)
    # the soft foot of the occlusion curve leaves 0.4 % on a flat surface (observed 0.9961 .. 0.9999)
    assert float(seen(plane(view, normal, 0.5), view).min()) > 0.996


def test_the_papers_own_form_is_the_mean_over_nearer_neighbors_and_knows_no_tangent_plane():
    """Beside a step of 30 mm half of the disc is nearer; a plane that faces the camera has the foot of the curve, a
    tilted one is dark all over, and the background, however it is stored, occludes nothing."""
    foot, half = 1 / (1 + math.exp(2)), 64
    step = torch.full((90, 120), 0.6)
    step[:, 60:] = 0.57
    v = printed_visibility(step, torch.ones_like(step), half)[45]
    assert float(v[30]) == pytest.approx(1 - foot, abs=1e-5)
    assert float(v[59]) == pytest.approx(1 - (1 + foot) / 2, abs=0.03)
    assert float(v[60]) == pytest.approx(1 - foot / 2, abs=0.03)
    view = camera(96, 80, 900.0)
    tilted = plane(view, (0.8, 0.0, -1.0), 0.5).float()
    assert float(printed_visibility(tilted, torch.ones_like(tilted), 64)[40, 48]) < 0.75
    alpha = torch.zeros_like(step)
    alpha[:, :60] = 0.5  # of half transparent skin the mean depth counts, not the sum
    alone = printed_visibility(step * alpha, alpha, half)
    assert float(alone[45, 30]) == pytest.approx(1 - foot, abs=1e-5)
    assert float(alone[45, 59]) == pytest.approx(1 - foot / 2, abs=0.03)
    assert float(alone[45, 90]) == 1


def test_the_gradient_of_the_papers_own_form_is_that_of_its_formula():
    g = torch.Generator().manual_seed(3)
    depth = (0.6 + 0.004 * torch.rand(12, 14, generator=g, dtype=torch.float64)).requires_grad_(True)
    alpha = torch.ones(12, 14, dtype=torch.float64)
    alpha[:2] = 0
    assert torch.autograd.gradcheck(lambda d: printed_visibility(d * alpha, alpha, 8), (depth,), atol=1e-6)


def test_a_crease_is_dark_and_its_flanks_are_light():
    view = camera(128, 64, 800.0)
    # two planes that meet in a vertical valley in the middle of the picture
    depth = torch.minimum(plane(view, (1.0, 0.0, -1.0), 0.5), plane(view, (-1.0, 0.0, -1.0), 0.5))
    v = seen(depth, view)[20:44].mean(0)
    assert float(v[62:66].max()) < 0.84  # observed 0.79 to 0.83
    assert float(v[8:16].min()) > 0.97
    assert float(v[62:66].max()) < float(v[40:48].mean()) < float(v[8:16].mean())


def test_the_shadow_keeps_its_world_size_when_the_camera_moves_away():
    means = []
    for distance_scale in (0.75, 1.0, 1.5):
        view = camera(160, 160, 500.0 * distance_scale)
        # a small sphere that floats 10 mm over a plane, both at a distance that keeps them equally large
        depth = torch.minimum(
            plane(view, (0.0, 0.0, -1.0), 0.6 * distance_scale),
            sphere(view, (0.0, 0.0, 0.6 * distance_scale - 0.01), 0.015),
        )
        means.append(float((1 - seen(depth, view)).sum()))
    assert max(means) / min(means) < 1.25  # observed 1.13; a fixed pixel radius would not see the scale at all


@pytest.mark.parametrize("orthographic", [False, True])
def test_the_normals_of_passes_are_those_of_the_specification(orthographic: bool):
    random = np.random.default_rng(5)
    view = replace(camera(61, 47, 300.0), orthographic=orthographic)
    depth = np.where(random.random((47, 61)) < 0.1, 0.0, 0.5 + 0.002 * random.random((47, 61)).cumsum(1)).astype(
        np.float32
    )
    depth[:, 30:] += depth[:, 30:] * 0.05
    wanted = surface_normals(torch.from_numpy(depth), view).numpy()
    assert (wanted != 0).any()
    np.testing.assert_allclose(passes.surface_normals(depth, view), wanted, atol=2e-5)


def test_sample_disc_is_even_and_inside_the_unit_circle():
    disc = vogel_disc(64)
    assert np.linalg.norm(disc, axis=-1).max() < 1
    assert np.abs(disc.mean(0)).max() < 0.05


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.6, 0.0, -1.0), (-0.3, 0.9, -1.0)])
def test_normals_of_a_plane_are_its_own_and_unit_to_its_edges(normal: tuple[float, float, float]):
    view = camera(40, 30, 300.0, fy=340.0, off_center=4.0)
    depth = plane(view, normal, 0.5)
    depth[10:20, 5:15] = 0  # a hole
    unit = torch.tensor(normal, dtype=torch.float64) / math.hypot(*normal)
    normals = surface_normals(depth, view)
    torch.testing.assert_close(normals[depth > 0], unit.expand(int((depth > 0).sum()), 3), rtol=0, atol=1e-9)
    assert float(normals[depth == 0].abs().max()) == 0


def test_normals_of_a_plane_in_parallel_rays_are_its_own():
    view = replace(camera(40, 30, 600.0, fy=680.0, off_center=4.0), orthographic=True)
    places = rays(view)
    depth = 0.5 + 0.6 * places[..., 0] - 0.2 * places[..., 1]
    unit = torch.tensor([0.6, -0.2, -1.0], dtype=torch.float64) / math.hypot(0.6, 0.2, 1.0)
    torch.testing.assert_close(surface_normals(depth, view), unit.expand(30, 40, 3), rtol=0, atol=1e-9)


def test_normals_of_a_sphere_point_away_from_its_middle():
    view = camera(80, 80, 900.0, off_center=2.0)
    depth = sphere(view, (0.0, 0.0, 0.6), 0.02)
    points = torch.where(torch.isfinite(depth), depth, 0.0)[..., None] * rays(view)
    outwards = (points - torch.tensor([0.0, 0.0, 0.6], dtype=torch.float64)) / 0.02
    normals = surface_normals(points[..., 2], view)
    # the smaller of two one-sided differences leans to the middle: worst observed 9.0 degrees
    front = torch.isfinite(depth) & (outwards[..., 2] < -0.5)
    assert int(front.sum()) > 2000
    assert float((normals * outwards).sum(-1)[front].min()) > math.cos(math.radians(9.5))


def test_a_pixel_without_neighbors_faces_the_camera():
    depth = torch.zeros(9, 7, dtype=torch.float64)
    depth[4, 3] = 0.5
    normals = surface_normals(depth, camera(7, 9, 100.0))
    assert normals[4, 3].tolist() == [0, 0, -1]
    assert float(normals.abs().sum()) == 1


def test_a_normal_never_spans_a_silhouette():
    """A slanted plane in front of a far wall: at its edge only the difference along the plane counts."""
    view = camera(60, 60, 600.0)
    slanted = (0.5, 0.2, -1.0)
    depth = plane(view, slanted, 0.5)
    depth[:, 30:] = 0.9
    depth[45:, :] = 0.9
    near = depth < 0.8
    unit = torch.tensor(slanted, dtype=torch.float64) / math.hypot(*slanted)
    normals = surface_normals(depth, view)
    torch.testing.assert_close(normals[near], unit.expand(int(near.sum()), 3), rtol=0, atol=1e-9)


def points_of(depth: torch.Tensor, view) -> torch.Tensor:
    """(H, W, 3) where each pixel's ray meets its depth."""
    spread = torch.ones_like(depth) if view.orthographic else depth
    return torch.cat([rays(view)[..., :2] * spread[..., None], depth[..., None]], -1)


def brute_visibility(depth: torch.Tensor, view, style: ShadowStyle) -> torch.Tensor:
    """METHOD 5.2 for the pixels of a depth map in plain loops; the normals are those of `surface_normals`."""
    height, width = depth.shape
    points = points_of(depth, view).tolist()
    normals, disc = surface_normals(depth, view).tolist(), vogel_disc(style.samples).tolist()
    result = torch.ones_like(depth)
    for row in range(height):
        for column in range(width):
            if depth[row, column] == 0:
                continue
            away = 1.0 if view.orthographic else float(depth[row, column])
            reach_x, reach_y = (min(max(focal * style.radius_m / away, 1.0), 96.0) for focal in (view.fx, view.fy))
            total = 0.0
            for x, y in disc:
                i, j = column + round(x * reach_x), row + round(y * reach_y)
                if not (0 <= i < width and 0 <= j < height) or depth[j, i] == 0:
                    continue
                v = [a - b for a, b in zip(points[j][i], points[row][column], strict=True)]
                length = math.sqrt(sum(c * c for c in v) + (1e-3 * style.radius_m) ** 2)
                height_m = sum(a * b for a, b in zip(v, normals[row][column], strict=True)) - 4e-4
                curve = style.softness * math.log1p(math.exp((height_m / length - style.bias) / style.softness))
                total += curve * max(1 - length / style.radius_m, 0) ** 2
            result[row, column] = math.exp(-style.gain * total / style.samples)
    return result


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize(("focal_px", "samples", "darkest"), [(12.0, 12, 1.0), (150.0, 12, 0.5), (5000.0, 100, 0.8)])
def test_visibility_is_that_of_the_method(focal_px: float, samples: int, darkest: float, orthographic: bool):
    """At the smallest reach on the picture, where a neighbor is too far to occlude; at an ordinary one; at the
    largest."""
    view = camera(24, 18, focal_px, fy=1.1 * focal_px, off_center=1.5)
    depth = torch.minimum(plane(view, (0.3, -0.2, -1.0), 0.5), sphere(view, (0.0, 0.0, 0.49), 0.01))
    depth[9:12, 10:15] -= 0.005
    depth[3:6, 2:9] = 0
    if orthographic:
        view = replace(view, fx=2 * view.fx, fy=2 * view.fy, orthographic=True)
    style = ShadowStyle(samples=samples, radius_m=0.03, bias=0.1, softness=0.06, gain=50.0)
    got = visibility(depth, depth > 0, view, style)
    torch.testing.assert_close(got, brute_visibility(depth, view, style), rtol=0, atol=1e-9)
    assert float(got.min()) <= darkest


@pytest.mark.parametrize("kind", ["empty", "single pixel", "alpha 1e-6", "one by one", "one row", "depth zero"])
def test_odd_pictures_give_finite_visibility_and_gradients(kind: str):
    shape = {"one by one": (1, 1), "one row": (1, 40)}.get(kind, (24, 24))
    view = camera(shape[1], shape[0], 100.0)
    planes = torch.zeros(5, *shape, dtype=torch.float64)
    if kind == "single pixel":
        planes[:, 5, 5] = torch.tensor([0.8, 0.6, 0.5, 1.0, 0.5], dtype=torch.float64)
    elif kind == "alpha 1e-6":
        planes[3:] = 1e-6
    elif kind == "depth zero":
        planes[:4] = 0.5
    elif kind != "empty":
        planes[:] = 0.5
    planes.requires_grad_()
    out = darken(planes, view, STYLE)
    (out * torch.linspace(0.5, 1.5, out.numel(), dtype=torch.float64).reshape(out.shape)).sum().backward()
    assert torch.isfinite(out).all()
    assert planes.grad is not None
    assert torch.isfinite(planes.grad).all()


def test_gradients_of_depth_match_finite_differences():
    # sample positions and normals are detached by design, so the difference quotient must not move them: a scene with
    # the reach clamped to one pixel count and steps far below a change of sides would still move normals. Hence the
    # directional derivative of one *sample* pixel, seen from pixels whose normals do not use it.
    view = camera(40, 32, 400.0)
    depth = torch.minimum(plane(view, (0.2, 0.1, -1.0), 0.5), sphere(view, (0.0, 0.0, 0.49), 0.01))
    valid = torch.ones_like(depth, dtype=torch.bool)
    row, column = 16, 20
    far = torch.ones_like(valid)
    far[row - 4 : row + 5, column - 4 : column + 5] = False

    def total(z: torch.Tensor) -> torch.Tensor:
        return visibility(z, valid, view, STYLE)[far].sum()

    z = depth.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(total(z), z)
    step = torch.zeros_like(depth)
    step[row, column] = 1e-7
    quotient = float(total(depth + step) - total(depth - step)) / 2e-7
    assert quotient != 0
    assert float(gradient[row, column]) == pytest.approx(quotient, rel=1e-4)


def test_only_the_color_is_darkened_and_by_the_tint():
    view = camera(96, 72, 260.0)
    planes = planes_of(fingers(view)).double()
    depth_m, valid = normalized_depth(planes[4], planes[3])
    darkness = 1 - visibility(depth_m, valid, view, STYLE)
    rgb = planes[:3].permute(1, 2, 0)
    half = shade(rgb, planes[3], planes[4], view, ShadowStyle(samples=64, strength=0.5, tint=(1.0, 0.5, 0.0)))
    assert torch.allclose(half[..., 0], rgb[..., 0] * (1 - 0.5 * darkness))
    assert torch.allclose(half[..., 1], rgb[..., 1] * (1 - 0.25 * darkness))
    assert torch.equal(half[..., 2], rgb[..., 2])


@pytest.mark.parametrize(
    "wrong",
    [
        {"samples": 0},
        {"samples": 257},
        {"radius_m": 0.0},
        {"radius_m": math.inf},
        {"bias": math.nan},
        {"softness": 0.0},
        {"softness": math.inf},
        {"softness": 1e-3},
        {"softness": math.nextafter(1.15 / 80, 0)},
        {"gain": -1e-9},
        {"gain": math.inf},
        {"tint": (0.5, 0.5, 1.5)},
        {"tint": (-1e-9, 0.5, 0.5)},
        {"tint": (0.5, 0.5)},
        {"strength": float("nan")},
        {"strength": -1e-9},
        {"strength": 1 + 1e-9},
    ],
)
def test_impossible_styles_are_refused(wrong: dict):
    with pytest.raises(InputError, match=f"shadow {next(iter(wrong))}"):
        ShadowStyle(**wrong)


# ---- the kernel -----------------------------------------------------------------------------------------------------

SCENES = [
    pytest.param((200, 150, 400.0, 440.0, 5.0, 64), id="off-center, unequal focal lengths"),
    pytest.param((333, 77, 700.0, None, 0.0, 64), id="tail of a row"),
    pytest.param((96, 96, 2500.0, None, 0.0, 33), id="reach at its largest"),
    pytest.param((128, 64, 3000.0, 700.0, 0.0, 33), id="reach at its largest along one axis"),
    pytest.param((60, 40, 20.0, None, 0.0, 16), id="reach at its smallest"),
    pytest.param((7, 3, 30.0, None, 0.0, 256), id="smaller than a vector"),
    pytest.param((1, 1, 30.0, None, 0.0, 1), id="one pixel"),
]


def both(library: Library, scene: tuple, *, noise_m: float = 0.0, threads: int = 2) -> tuple[torch.Tensor, ...]:
    """Darkened color and gradient of the planes, kernel and float64 reference."""
    width, height, fx, fy, off_center, samples = scene
    view = camera(width, height, fx, fy=fy, off_center=off_center)
    planes = planes_of(fingers(view, noise_m=noise_m)).requires_grad_()
    exact = planes.detach().double().requires_grad_()
    style = ShadowStyle(samples=samples)
    out, reference = darken(planes, view, style, library=library, threads=threads), darken(exact, view, style)
    weight = torch.randn(out.shape, generator=torch.Generator().manual_seed(5))
    out.backward(weight)
    reference.backward(weight.double())
    assert planes.grad is not None
    assert exact.grad is not None
    return out.detach(), reference.detach(), planes.grad, exact.grad


@pytest.mark.parametrize("scene", SCENES)
def test_kernel_agrees_with_the_float64_reference(library: Library, scene: tuple):
    out, reference, _, _ = both(library, scene)
    error = (out - reference).abs().amax(0)
    # the promise is 5e-5 but for flips; observed 1.8e-6 (AVX2: 1.5e-6), and in one scene one normal of 9216 pixels from
    # the other side, 1.1e-5
    assert int((error > 2e-6).sum()) <= (1 if scene[2] == 2500.0 else 0)
    assert float(error.max()) < 5e-5


@pytest.mark.parametrize("scene", SCENES[:5])
def test_kernel_gradients_agree_with_the_float64_reference(library: Library, scene: tuple):
    _, _, gradient, exact = both(library, scene)
    for plane_index in range(5):
        got, want = gradient[plane_index].double().flatten(), exact[plane_index].flatten()
        size = float(want.norm())
        if size == 0:
            assert float(got.norm()) == 0
            continue
        # size, direction, sparsity and signed bias of the error
        # (observed 5e-6, or 5e-4 with the flipped normal; 1e-7; none; 3e-8)
        assert float((got - want).norm()) / size < (1e-3 if scene[2] == 2500.0 else 1e-5)
        assert float(1 - got @ want / (got.norm() * want.norm())) < 1e-6
        assert not bool(((got == 0) & (want.abs() > 1e-6 * float(want.abs().max()))).any())
        assert abs(float((got - want).sum())) / float(want.abs().sum()) < 1e-4


def test_kernel_gives_the_same_bits_from_one_two_and_three_threads(library: Library):
    results = [both(library, (200, 150, 400.0, None, 0.0, 64), noise_m=1e-4, threads=n) for n in (1, 2, 3, 2)]
    for other in results[1:]:
        assert torch.equal(results[0][0], other[0])
        assert torch.equal(results[0][2], other[2])


@pytest.mark.skipif(sys.platform == "win32", reason="guard pages are made with mprotect")
@pytest.mark.parametrize("side", ["before", "after"])
@pytest.mark.parametrize("scene", [(37, 21), (16, 16), (1, 1), (50, 3)])
def test_kernel_stays_inside_its_buffers(library: Library, scene: tuple[int, int], side: str, monkeypatch):
    """Every buffer touches a page that may not be read: one byte beyond it would end the process."""
    width, height = scene
    view = camera(width, height, 3000.0)  # the largest reach: taps go beyond every side

    def guarded_zeros(shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
        return guarded(np.zeros(shape, dtype), side)

    monkeypatch.setattr("jghand_engine.render.shadow.aligned_zeros", guarded_zeros)
    planes = planes_of(fingers(view))
    planes[3:] = planes[3:].clamp_min(0.5)
    native = NativeShade(library, width, height)
    v, depth_m, rgba = guarded_zeros((height, width)), guarded_zeros((height, width)), guarded_zeros((height, width, 4))
    native.prepare(guarded(planes.numpy(), side), view, STYLE, near_m=0.6, visibility=v, rgba=rgba, depth_m=depth_m)
    native.run()
    darkened, out = guarded(np.ones((3, height, width), np.float32), side), guarded_zeros((5, height, width))
    native.run_backward(native.prepare_backward(v, darkened, out))
    assert all(np.isfinite(array).all() for array in (v, rgba, depth_m, out))


def guarded(array: np.ndarray, side: str) -> np.ndarray:
    """A copy that begins or ends at a page without access."""
    size = -(-array.nbytes // mmap.PAGESIZE) * mmap.PAGESIZE
    memory = mmap.mmap(-1, size + 2 * mmap.PAGESIZE)
    KEPT.append(memory)
    base = np.frombuffer(memory, np.uint8)
    for guard in (0, mmap.PAGESIZE + size):
        assert ctypes.CDLL(None).mprotect(ctypes.c_void_p(base.ctypes.data + guard), mmap.PAGESIZE, 0) == 0
    start = mmap.PAGESIZE + (size - array.nbytes if side == "after" else 0)
    copy = base[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


KEPT: list[mmap.mmap] = []


def test_shadow_off_only_composes(library: Library):
    view = camera(45, 33, 200.0)
    planes = planes_of(fingers(view)).numpy()
    native = NativeShade(library, 45, 33)
    rgba, depth_m = np.empty((33, 45, 4), np.float32), np.empty((33, 45), np.float32)
    native.prepare(planes, view, None, near_m=0.5, rgba=rgba, depth_m=depth_m)
    native.run()
    assert np.array_equal(rgba, np.moveaxis(planes[:4], 0, -1))
    exact, valid = normalized_depth(torch.from_numpy(planes[4]), torch.from_numpy(planes[3]))
    assert np.array_equal(depth_m > 0, valid.numpy())
    assert np.abs(depth_m - exact.numpy()).max() < 1e-7


@pytest.mark.parametrize(("orthographic", "focal_px"), [(False, 1000.0), (True, 2500.0), (False, 500.0)])
def test_edges_of_skin_before_other_skin_are_smoothed_and_nothing_else(
    library: Library, orthographic: bool, focal_px: float
):
    height, width, step_m = 20, 37, contract.EDGE_STEP_M
    planes = np.random.default_rng(0).uniform(0.2, 1, (5, height, width)).astype(np.float32)
    row, column = np.mgrid[:height, :width]
    # two skins with a slanted edge, and a step that is no edge; nothing above, and at a corner beside the edge
    depth_m = np.where(2 * column + row > 50, 0.4 + 1.5 * step_m, 0.4) + 0.8 * step_m * (column > 4)
    is_there = (row > 2) & ((row < 15) | (column > 12))
    near = np.where(is_there, -depth_m if orthographic else 1 / depth_m, contract.NOT_NEAR).astype(np.float32)
    surface = SeenSurface(np.pad(near, SURFACE_MARGIN_PX, constant_values=contract.NOT_NEAR), 1.0, 0.7)
    native, rgba = NativeShade(library, width, height), np.empty((height, width, 4), np.float32)
    native.prepare(
        planes, replace(camera(width, height, focal_px), orthographic=orthographic), None, near_m=0.5, rgba=rgba
    )
    native.set_surface(surface)
    native.run()
    wanted, smoothed = planes[:4].copy(), np.zeros((height, width), bool)
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            beside = [(y, x - 1), (y, x + 1), (y - 1, x), (y + 1, x)]
            if is_there[y, x] and all(is_there[at] for at in beside):
                pixel_m = (1 if orthographic else depth_m[y, x]) / focal_px
                least_m = max(step_m, contract.EDGE_STEEPNESS * pixel_m)
                smoothed[y, x] = any(abs(depth_m[at] - depth_m[y, x]) > least_m for at in beside)
            if smoothed[y, x]:
                weight = np.outer([1, 2, 1], [1, 2, 1])
                sums = (weight * planes[:4, y - 1 : y + 2, x - 1 : x + 2]).sum((1, 2))
                wanted[:3, y, x] += 0.7 * (sums[:3] / sums[3] * planes[3, y, x] - planes[:3, y, x])
    # steps of three widths of a pixel are none
    assert smoothed.sum() == 0 if focal_px == 500 else 20 < smoothed.sum() < 60
    np.testing.assert_allclose(rgba, np.moveaxis(wanted, 0, -1), rtol=1e-5)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38, -1.0, 0.0, 1e-45])
@pytest.mark.parametrize("slot", [3, 4])
def test_poisoned_depth_reads_nothing_it_must_not(library: Library, value: float, slot: int):
    view = camera(64, 48, 500.0)
    planes = planes_of(fingers(view)).numpy()
    planes[slot, ::3, ::5] = value
    native = NativeShade(library, 64, 48)
    v = np.empty((48, 64), np.float32)
    native.prepare(planes, view, STYLE, near_m=0.6, visibility=v)
    native.run()  # the taps of a poisoned pixel stay within the padding; its own value may be anything from 0 to 1
    clean = np.isfinite(v)
    assert clean.mean() > 0.5
    assert ((v[clean] >= 0) & (v[clean] <= 1)).all()


@pytest.mark.parametrize("near_m", [math.nan, math.inf, -math.inf])
def test_an_origin_of_depth_that_is_no_number_ends_in_a_picture_without_a_shadow(library: Library, near_m: float):
    view = camera(64, 48, 500.0)
    native, v = NativeShade(library, 64, 48), np.empty((48, 64), np.float32)
    native.prepare(planes_of(fingers(view)).numpy(), view, STYLE, near_m=near_m, visibility=v)
    native.run()
    assert (v == 1).all()
