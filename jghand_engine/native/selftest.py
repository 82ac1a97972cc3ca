"""Does the library compute what it should on this very machine? A tiny image with known sums, one
of ellipsoids, two posed blocks of Gaussians, one hand and the mean of two images, in two milliseconds.

It guards against what no test of ours can see: a processor that misreports its abilities, a damaged file, another
compiler's mistake.
"""

from __future__ import annotations

import ctypes
from dataclasses import replace
from functools import partial

import numpy as np

from jghand_engine.color import linear_to_srgb, srgb_to_linear
from jghand_engine.errors import RetryError
from jghand_engine.native import contract
from jghand_engine.native.binding import Library, aligned_zeros, new_team
from jghand_engine.native.detail_task import DetailHand, DetailTask
from jghand_engine.native.learned_tasks import NETWORK_TILE, CorrectiveKind, LearnedTask
from jghand_engine.native.mean import MeanTask, NativeMean
from jghand_engine.native.rasterizer import GaussianArrays, NativeRasterizer, View, job_bytes
from jghand_engine.native.scene_light_task import LampDepth, SceneLightTask
from jghand_engine.native.tasks import LANES, ShadeTask, SkinTask, SsimTask, new_shade_task, padded_depth

_COUNT, _SIZE, _SHADOW_SAMPLES, _TOLERANCE = 200, 32, 16, 1e-4
# means of the planes R G B A D, and of the gradients with respect to position, sigma, opacity and color when every
# pixel of every plane has gradient 1 / pixels; from the float64 reference (tests/native recomputes them)
EXPECTED_PLANES = (0.29586, 0.37901, 0.284323, 0.596285, 0.319804)
EXPECTED_GRADIENTS = (0.117767, 1.950287, 0.009067, 0.002981)
# the same with covariances instead of radii; planes, then gradients
EXPECTED_PLANES_OF_ELLIPSOIDS = (0.189774, 0.217715, 0.182388, 0.381848, 0.20729)
EXPECTED_GRADIENTS_OF_ELLIPSOIDS = (0.115688, 102.045218, 0.007946, 0.001909)
# means of the image with the shadow, R G B A
EXPECTED_RGBA = (0.278745, 0.359152, 0.268071, 0.596285)


def sample_gaussians() -> GaussianArrays:
    """200 Gaussians without a random generator, half a meter in front of the camera; number 7 is NaN."""
    i = np.arange(_COUNT, dtype=np.float64)
    spread = partial(_spread, i)

    position = np.stack([spread(0.618034) * 0.1 - 0.05, spread(0.754878) * 0.1 - 0.05, 0.5 + spread(0.569840) * 0.1], 1)
    rgb = np.stack([spread(0.245122), spread(0.430160), spread(0.850651)], 1)
    position[7] = np.nan
    parts = (position, 0.002 + 0.004 * spread(0.381966), 0.2 + 0.7 * spread(0.324718), rgb)
    position_m, sigma_m, opacity, rgb = (np.ascontiguousarray(part, np.float32) for part in parts)
    return GaussianArrays(position_m, sigma_m, opacity, rgb)


def sample_ellipsoids() -> GaussianArrays:
    """The same Gaussians stretched and turned, each in another way; number 9 has a negative variance."""
    spheres, entry = sample_gaussians(), np.arange(9.0)[:, None]
    root = (
        0.5 * np.eye(3)[..., None] + _spread(_spread(np.arange(_COUNT), 0.381966) + entry, 0.7).reshape(3, 3, -1) - 0.5
    )
    root *= spheres.sigma_m
    covariance = np.einsum("ikn,jkn->ijn", root, root)[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]].T
    covariance[9, 3] *= -1
    return replace(spheres, covariance_m2=np.ascontiguousarray(covariance, np.float32))


def sample_view() -> View:
    return View(_SIZE, _SIZE, 150.0, 150.0, _SIZE / 2, _SIZE / 2, np.eye(3, 4))


def check(library: Library) -> None:
    """RetryError when the library's structures or results are not what this Python expects."""
    call = library.call
    tasks = (
        (call.jg_skin_task_bytes, SkinTask),
        (call.jg_learned_task_bytes, LearnedTask),
        (call.jg_scene_light_task_bytes, SceneLightTask),
        (call.jg_lamp_depth_bytes, LampDepth),
        (call.jg_shade_task_bytes, ShadeTask),
        (call.jg_detail_hand_bytes, DetailHand),
        (call.jg_detail_task_bytes, DetailTask),
        (call.jg_ssim_task_bytes, SsimTask),
        (call.jg_mean_task_bytes, MeanTask),
    )
    sizes = (call.jg_raster_job_bytes(), call.jg_team_bytes(), *(size() for size, _ in tasks))
    expected = (job_bytes(), new_team().nbytes, *(ctypes.sizeof(task) for _, task in tasks))
    if sizes != expected:
        raise _failure(library, f"structures of {expected} bytes", str(sizes))
    _check_raster_and_shadow(library)
    _check_ellipsoids(library)
    _check_skin(library)
    _check_trained_skin(library)
    _check_bones(library)
    _check_mean(library)


def _check_raster_and_shadow(library: Library) -> None:
    planes, gradients = _drawn(library, sample_gaussians(), invalid=1)
    _compare(library, "sums of an image", planes.mean((1, 2)), EXPECTED_PLANES)
    _compare(library, "sums of gradients", gradients, EXPECTED_GRADIENTS)
    _compare(library, "sums of a shaded image", _shaded(library, planes).mean((0, 1)), EXPECTED_RGBA)


def _check_ellipsoids(library: Library) -> None:
    planes, gradients = _drawn(library, sample_ellipsoids(), invalid=2)
    _compare(library, "sums of an image of ellipsoids", planes.mean((1, 2)), EXPECTED_PLANES_OF_ELLIPSOIDS)
    _compare(library, "sums of gradients of ellipsoids", gradients, EXPECTED_GRADIENTS_OF_ELLIPSOIDS)


def _drawn(library: Library, gaussians: GaussianArrays, *, invalid: int) -> tuple[np.ndarray, list[float]]:
    """The planes, and the mean gradients of position, sigma or covariance, opacity and color."""
    rasterizer = NativeRasterizer(library, threads=1)
    planes = rasterizer.forward(gaussians, sample_view())
    if rasterizer.invalid != invalid:
        raise _failure(library, f"{invalid} invalid Gaussians left out", str(rasterizer.invalid))
    gradients = rasterizer.backward(np.full_like(planes, 1.0 / _SIZE**2))
    shape = gradients.sigma_m if gradients.covariance_m2 is None else gradients.covariance_m2
    parts = (gradients.position_m, shape, gradients.opacity, gradients.rgb)
    return planes, [float(np.abs(part).mean()) for part in parts if part is not None]


def _shaded(library: Library, planes: np.ndarray) -> np.ndarray:
    """(H, W, 4) the image with its shadow at full strength in every channel."""
    view, task = sample_view(), new_shade_task(_SIZE, _SIZE)
    index = np.arange(_SHADOW_SAMPLES) + 0.5
    radius, angle = np.sqrt(index / _SHADOW_SAMPLES), index * contract.GOLDEN_ANGLE_RAD
    disc = aligned_zeros((2, _SHADOW_SAMPLES))
    disc[:] = radius * np.cos(angle), radius * np.sin(angle)
    depth, row_valid, team = padded_depth(task), np.zeros(_SIZE, np.int32), new_team()
    rgba = np.zeros((_SIZE, _SIZE, 4), np.float32)
    task.samples, task.darkness = _SHADOW_SAMPLES, (1.0, 1.0, 1.0)
    task.fx, task.fy, task.cx, task.cy, task.origin = view.fx, view.fy, view.cx, view.cy, 0.5
    task.radius, task.bias = contract.SHADOW_RADIUS_M, contract.SHADOW_BIAS
    task.softness, task.gain = contract.SHADOW_SOFTNESS, contract.SHADOW_GAIN
    task.disc_x, task.disc_y = disc[0].ctypes.data, disc[1].ctypes.data
    task.picture, task.row_valid, task.rgba = planes.ctypes.data, row_valid.ctypes.data, rgba.ctypes.data
    library.call.jg_shade(team.ctypes.data, ctypes.addressof(task))
    del depth  # until here the task pointed to it
    return rgba


def _check_skin(library: Library) -> None:
    """Sixteen Gaussians between two bones, blended here in double precision."""
    i = np.arange(LANES)
    rest = np.stack([_spread(i, 0.62), _spread(i, 0.75), _spread(i, 0.57), 0.001 + 0.001 * _spread(i, 0.25)])
    share = _spread(i, 0.43)
    weight = np.stack([share, 1 - share])
    matrices = np.eye(3, 4) + 0.1 * _spread(np.arange(21 * 12), 0.31).reshape(21, 3, 4)
    bone, shift = np.array([3, 17], np.int32), (0.1, -0.2, 0.3)
    arrays = [np.ascontiguousarray(array, np.float32) for array in (rest[None], weight, matrices)]
    position, sigma = aligned_zeros((LANES, 3)), aligned_zeros((LANES,))
    block_start, team = np.array([0, 2], np.int32), new_team()
    task = SkinTask(
        scale=1.0,
        inverse_scale=1.0,
        stretch_min=0.5,
        stretch_max=2.0,
        blocks=1,
    )
    aligned = [aligned_zeros(array.shape) for array in arrays]
    for to, array in zip(aligned, arrays, strict=True):
        to[:] = array
    task.rest, task.weight, task.linear_offset = (array.ctypes.data for array in aligned)
    task.block_start, task.bone, task.shift = block_start.ctypes.data, bone.ctypes.data, shift
    task.position, task.sigma = position.ctypes.data, sigma.ctypes.data
    library.call.jg_skin(team.ctypes.data, ctypes.addressof(task))
    blended = np.einsum("en,eij->nij", weight, matrices[bone])
    wanted = np.einsum("nij,jn->ni", blended[:, :, :3], rest[:3]) + blended[:, :, 3] + np.array(shift)
    stretch = np.cbrt(np.linalg.det(blended[:, :, :3]))
    _compare(library, "posed positions", position.ravel(), wanted.ravel())
    _compare(library, "posed radii, mm", 1e3 * sigma, 1e3 * rest[3] * stretch)


def _check_trained_skin(library: Library) -> None:
    """Sixteen Gaussians of one bone that stands still: what a network, light and gloss make of them, here in double
    precision."""
    numbers = iter(np.split(_spread(np.arange(2000), 0.7548) - 0.5, 250))
    shapes = {"look": (7, 16), "places": (8, 16), "features": (21, 8), "middle": (8, 8), "middle_bias": (8,)}
    shapes |= {"out": (8, 6), "irradiance": (16, 3), "lobe": (1, 7)}

    def some(shape: tuple[int, ...]) -> np.ndarray:
        out = aligned_zeros(shape)
        out.ravel()[:] = np.concatenate([next(numbers) for _ in range(-(-out.size // 8))])[: out.size]
        return out

    arrays = {name: some(shape) for name, shape in shapes.items()}
    rest, weight = some((4, LANES)), np.ones((1, LANES), np.float32)
    matrices = np.tile(np.eye(3, 4, dtype=np.float32), (21, 1, 1))
    block_start, bone = np.array([0, 1], np.int32), np.array([2], np.int32)
    results = {"position": (LANES, 3), "sigma": (LANES,)}, {"matt": (6, LANES), "rgb": (LANES, 3)}
    posed, seen = ({name: aligned_zeros(shape) for name, shape in each.items()} for each in results)
    task = LearnedTask(rim=0.5, exponent_max=3.0, length2_min=1e-12, hidden=NETWORK_TILE, lobes=1)
    task.correctives, task.reach, task.eye = CorrectiveKind.NETWORK, (0.1, 0.5), (0.1, 0.2, 2.0)
    task.skin = SkinTask(scale=1.0, inverse_scale=1.0, stretch_min=0.5, stretch_max=2.0, blocks=1)
    given = {"rest": rest, "weight": weight, "block_start": block_start, "bone": bone, "linear_offset": matrices}
    for into, named in ((task.skin, given | posed), (task, arrays | seen)):
        for name, array in named.items():
            setattr(into, name, array.ctypes.data)
    for function in (library.call.jg_learned_pose, library.call.jg_learned_gloss):
        team = new_team()
        function(team.ctypes.data, ctypes.addressof(task))
    _compare(library, "skin of a network", np.hstack([posed["position"], seen["rgb"]]).ravel(), _trained(arrays, rest))


def _trained(arrays: dict[str, np.ndarray], rest: np.ndarray) -> np.ndarray:
    """(16 * 6,) position and color of the Gaussians above, written out."""
    a = {name: array.astype(np.float64) for name, array in arrays.items()}
    first = np.maximum(a["places"].T + a["features"][2], 0)
    second = np.maximum(first @ a["middle"] + a["middle_bias"], 0)
    correction = np.tanh(second @ a["out"]) * np.repeat([0.1, 0.5], 3)
    position, normal = rest[:3].T + correction[:, :3], a["look"][:3].T
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    (x, y, z), one = normal.T, np.ones(LANES)
    xx, yy, zz = x * x, y * y, z * z
    waves = [one, x, y, z, x * y, y * z, z * x, xx - yy, 3 * zz - 1, y * (3 * xx - yy), x * y * z, y * (5 * zz - 1)]
    waves += [z * (5 * zz - 3), x * (5 * zz - 1), z * (xx - yy), x * (xx - 3 * yy)]
    matt = a["look"][3:6].T * np.exp(np.clip(np.stack(waves, 1) @ a["irradiance"] + correction[:, 3:], -3, 3))
    eye = np.array([0.1, 0.2, 2.0]) - position
    eye = eye / np.linalg.norm(eye, axis=1, keepdims=True)
    facing, lobe = (normal * eye).sum(1), a["lobe"][0]
    mirrored = 2 * facing[:, None] * normal - eye
    strength = a["look"][6] * np.exp2((mirrored @ lobe[:3] - 1) * lobe[3]) * (1 + 0.5 * (1 - facing.clip(0, 1)) ** 5)
    return np.hstack([position, matt + strength[:, None] * lobe[4:]]).ravel()


def _check_bones(library: Library) -> None:
    """Both ends of every bone map exactly, whatever the frames are; so an identity is frame enough."""
    parents = np.array([0, 0, 0, 0, 0, *range(1, 16)])
    i = np.arange(63.0)
    canonical = (
        np.array([0.05, 0.0, 0.0]) + 0.1 * np.stack([_spread(i, 0.62), _spread(i, 0.75), _spread(i, 0.57)], 1)[:21]
    )
    joints = np.roll(canonical, 1, axis=1)[::-1] + 0.3
    canonical = canonical - canonical[0]
    bone = canonical[1:] - canonical[parents]
    length = np.linalg.norm(bone, axis=1)
    half_turn, along, across = np.diag([-1.0, 1.0, -1.0]), [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]
    options = [1e-14, 0.02, 0.2, 1e-3, -0.34, 0.25, 0.62, -0.78, 0.9, -2.4, 1e-3, 1e-4, 1e-2, 1e-77, 0.0, 0.0, 1.0]
    parts = [options, canonical, length, bone / length[:, None], np.tile(np.eye(3), (21, 1)), np.tile(along, (15, 1))]
    parts += [np.tile(np.eye(3), (15, 1)), np.tile(across, (4, 1)), np.tile(half_turn, (6, 1))]
    skeleton = np.concatenate([np.ravel(part) for part in parts])
    if library.call.jg_skeleton_bytes() != skeleton.nbytes:
        raise _failure(library, f"a Skeleton of {skeleton.nbytes} bytes", str(library.call.jg_skeleton_bytes()))
    matrices, scale, angles = np.full((21, 3, 4), np.nan), np.empty(1), np.empty(37)
    joints = np.ascontiguousarray(joints)
    outputs = (array.ctypes.data for array in (matrices, scale, angles))
    library.call.jg_bone_transforms(skeleton.ctypes.data, joints.ctypes.data, *outputs)
    bones = matrices[1:]
    for ends, wanted in ((canonical[parents], joints[parents]), (canonical[1:], joints[1:])):
        came = (bones[:, :, :3] @ ends[:, :, None])[..., 0] + bones[:, :, 3]
        _compare(library, "ends of bones", came.ravel(), (wanted - joints[0]).ravel())


def _check_mean(library: Library) -> None:
    """Two images with a row of odd length, one of them a part of the other, and colors beyond 1."""
    index, weights = np.arange(2 * 3 * 7 * 4).reshape(2, 3, 7, 4), (0.25, 0.75)
    straight, alpha = 1.5 * _spread(index, 0.62)[..., :3], 0.1 + 0.9 * _spread(index, 0.43)[..., 3:]
    alpha[:, 1, 2], alpha[1, 0], alpha[1, :, :2] = 0, 0, 0
    images = np.concatenate([straight * alpha, alpha], -1).astype(np.float32)
    depth_m = np.where(alpha[..., 0] > 0, 0.5 + 0.1 * _spread(index[..., 0], 0.7), 0).astype(np.float32)
    mean = NativeMean(library, 1, 7, 3)
    mean.add(images[0], depth_m[0], 0, 0, weights[0])
    mean.add(np.ascontiguousarray(images[1, 1:, 2:]), np.ascontiguousarray(depth_m[1, 1:, 2:]), 2, 1, weights[1])
    rgba, seen_m = mean.finish()
    shares = alpha * np.reshape(weights, (2, 1, 1, 1))
    covered = shares.sum(0)
    safe = np.maximum(covered, 1e-9)
    color = linear_to_srgb((srgb_to_linear(straight) * shares).sum(0) / safe) * covered
    _compare(library, "a mean in linear light", rgba, np.concatenate([color, covered], -1))
    wanted_m = np.where(covered > contract.DEPTH_ALPHA_MIN, (depth_m[..., None] * shares).sum(0) / safe, 0)
    _compare(library, "a mean depth", seen_m, wanted_m[..., 0])


def _spread(i: np.ndarray, step: float) -> np.ndarray:
    """Numbers in 0..1 without a random generator."""
    return (i * step) % 1.0


def _compare(library: Library, what: str, came, wanted) -> None:
    came, wanted = np.asarray(came, np.float64), np.asarray(wanted, np.float64)
    if not (np.abs(came - wanted) <= _TOLERANCE * np.maximum(1.0, np.abs(wanted))).all():
        raise _failure(library, f"{what} {wanted.round(5).tolist()}", str(came.round(5).tolist()))


def _failure(library: Library, wanted: str, came: str) -> RetryError:
    remedy = "Build it anew with `python -m jghand_engine.native.build`."
    return RetryError(f"self-test of {library.path.name}", wanted=wanted, came=came, remedy=remedy)
