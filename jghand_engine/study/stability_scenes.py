"""The hard pictures of the stability study: Gaussians and cameras at the ends of what can be drawn. RENDERING 3, 8."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.builtin import load_painted
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.shadow import darken
from jghand_engine.native import contract
from jghand_engine.native.library import load
from jghand_engine.render.camera import Camera
from jghand_engine.render.shadow import ShadowStyle
from jghand_engine.study.stability_hands import GRADIENT_MAX, hand_cases, template_size_m
from jghand_engine.study.stability_measures import GAUSSIANS, camera_before, posed_avatar
from jghand_engine.study.stability_pictures import (
    PictureRow,
    against_reference,
    converted,
    nudged_steps,
    picture_gradient,
    planes_of,
)

# what PICTURE_NUDGE_M may change a pixel by, in 8-bit steps: one contribution at the cut, and the movement itself
STEPS_MAX = 1.1

_CUT = contract.ALPHA_MIN


@dataclass(frozen=True)
class SceneCase:
    """make: the Gaussians and the camera · empty: nothing is to be seen · note: what to expect, in words"""

    name: str
    make: Callable[[], tuple[Gaussians, Camera]]
    empty: bool = False
    note: str = ""


@cache
def _hand() -> tuple[Gaussians, Camera]:
    """The built-in hand, relaxed, wrist at the origin, and a camera before it."""
    case = hand_cases()["ordinary: relaxed"]
    avatar = load_painted(handedness=Handedness.RIGHT).prefix(GAUSSIANS)
    with torch.no_grad():
        gaussians = posed_avatar(avatar, transform_of(avatar), (case.joints_m - case.joints_m[:1]).float())
    return converted(gaussians, torch.float32), camera_before(case)


def _with(**changes: Tensor | float) -> tuple[Gaussians, Camera]:
    """The hand with some tensors filled or replaced."""
    gaussians, camera = _hand()
    full = {
        name: value if isinstance(value, Tensor) else torch.full_like(getattr(gaussians, name), value)
        for name, value in changes.items()
    }
    return replace(gaussians, **full), camera


def _needles(aspect: float) -> tuple[Gaussians, Camera]:
    """The hand of ellipsoids: `aspect` times as long as their radius, and as much thinner across."""
    gaussians, camera = _hand()
    direction = torch.randn(len(gaussians), 3, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    d = direction / direction.norm(dim=1, keepdim=True)
    long, short = (gaussians.sigma_m.double() * aspect) ** 2, (gaussians.sigma_m.double() / aspect) ** 2
    matrix = short[:, None, None] * torch.eye(3, dtype=torch.float64) + (long - short)[:, None, None] * (
        d[:, :, None] * d[:, None, :]
    )
    six = matrix[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]].float()
    return replace(gaussians, covariance_m2=six), camera


def _camera_at(eye_m: list[float], target_m: list[float]) -> Camera:
    return Camera.looking_at(eye_m, target_m, (0.0, 1.0, 0.01), width=64, height=64, focal_px=0.9 * 64)


def _at_near_plane() -> tuple[Gaussians, Camera]:
    """Gaussians a millionth of a meter before, on and behind the near plane, across the picture and beyond."""
    camera = Camera(64, 64, 60.0, 60.0, 32.0, 32.0, np.eye(4))
    g = torch.Generator().manual_seed(5)
    position = 0.02 * (torch.rand(300, 3, generator=g) - 0.5)
    position[:, 2] = contract.Z_NEAR_M + torch.tensor([-1e-6, 0.0, 1e-6]).repeat(100)
    rgb = torch.rand(300, 3, generator=g)
    return Gaussians(position, torch.full((300,), 3e-4), torch.full((300,), 0.7), rgb), camera


def _empty() -> tuple[Gaussians, Camera]:
    return Gaussians(torch.zeros(0, 3), torch.zeros(0), torch.zeros(0), torch.zeros(0, 3)), _hand()[1]


def _poisoned() -> tuple[Gaussians, Camera]:
    gaussians, camera = _hand()
    tensors = {name: getattr(gaussians, name).clone() for name in ("position_m", "sigma_m", "opacity", "rgb")}
    for place, (tensor, value) in enumerate(
        zip(tensors.values(), (float("nan"), float("inf"), -1.0, 1e30), strict=True)
    ):
        tensor[place::40] = value
    return Gaussians(**tensors), camera


def _small(width: int, height: int) -> tuple[Gaussians, Camera]:
    gaussians, camera = _hand()
    return gaussians, replace(
        camera, width=width, height=height, fx=camera.fx * width / 64, fy=camera.fy * height / 64,
        cx=camera.cx * width / 64, cy=camera.cy * height / 64,
    )  # fmt: skip


def _far() -> tuple[Gaussians, Camera]:
    """So far away that the whole hand is one pixel."""
    gaussians, camera = _hand()
    matrix = camera.camera_from_world.copy()
    matrix[2, 3] += camera.fx * 2 * template_size_m() / 0.8
    return gaussians, replace(camera, camera_from_world=matrix)


SCENES = {
    case.name: case
    for case in (
        SceneCase("ordinary hand", _hand),
        SceneCase("radius 0", lambda: _with(sigma_m=0.0), empty=True, note="left out and counted"),
        SceneCase("radius 1e-12 m", lambda: _with(sigma_m=1e-12), note="drawn as fine as a pixel"),
        SceneCase("radius 10 m", lambda: _with(sigma_m=10.0), note="covers everything"),
        SceneCase("radius 1e10 m", lambda: _with(sigma_m=1e10), empty=True, note="left out and counted"),
        SceneCase("needles, 1000 times as long as thin", lambda: _needles(1000**0.5)),
        SceneCase("needles, 1e8 times as long as thin", lambda: _needles(1e4)),
        SceneCase("opacity 0", lambda: _with(opacity=0.0), empty=True),
        SceneCase("opacity 1/255 - 1e-6", lambda: _with(opacity=_CUT - 1e-6), empty=True),
        SceneCase("opacity 1/255", lambda: _with(opacity=_CUT), empty=True),
        SceneCase("opacity 1/255 + 1e-6", lambda: _with(opacity=_CUT + 1e-6)),
        SceneCase("opacity 1", lambda: _with(opacity=1.0)),
        SceneCase("camera inside the hand", lambda: (_hand()[0], _camera_at([0.0, 0.06, 0.0], [0.02, 0.16, 0.01]))),
        SceneCase("Gaussians at the near plane", _at_near_plane),
        SceneCase("picture of 1 x 1 pixels", lambda: _small(1, 1)),
        SceneCase("picture of 200 x 1 pixels", lambda: _small(200, 1)),
        SceneCase("empty scene", _empty, empty=True),
        SceneCase("hand behind the camera", lambda: (_hand()[0], _camera_at([0.0, 0, 1], [0.0, 0, 2])), empty=True),
        SceneCase("hand of one pixel", _far),
        SceneCase("NaN, infinity and nonsense in every 40th", _poisoned, note="left out and counted"),
    )
}


def scene_row(case: SceneCase) -> PictureRow:
    gaussians, camera = case.make()
    error = against_reference(gaussians, camera)
    finite, gradient = picture_gradient(gaussians, camera, template_size_m())
    nudged = nudged_steps(gaussians, camera)
    checks = (
        (error.good, "picture"),
        (finite, "gradient not finite"),
        (gradient <= GRADIENT_MAX, "gradient"),
        (depth_and_shadow_are_finite(case), "depth or shadow not finite"),
        (nudged <= STEPS_MAX, "a pixel jumps"),
        ((error.visible == 0) == case.empty, "something drawn" if case.empty else "nothing drawn"),
    )
    return PictureRow(case.name, error, gradient, finite, nudged, case.note, [w for good, w in checks if not good])


def depth_and_shadow_are_finite(case: SceneCase) -> bool:
    """Depth and self-shadow of the picture, with their gradients, also where there is no background."""
    gaussians, camera = case.make()
    leaves = converted(gaussians, torch.float32, grad=True)
    picture = rasterize(leaves, camera)
    planes = planes_of(picture).permute(2, 0, 1).contiguous()
    dark = [darken(planes, camera, ShadowStyle(samples=8), library=library) for library in (None, load("auto"))]
    values = [picture.depth_m, *dark]
    torch.stack([value.sum() for value in values]).sum().backward()
    each = (leaves.position_m, leaves.sigma_m, leaves.opacity, leaves.rgb, leaves.covariance_m2)
    gradients = [leaf.grad for leaf in each if leaf is not None and leaf.grad is not None]
    return all(bool(torch.isfinite(tensor).all()) for tensor in [*values, *gradients])
