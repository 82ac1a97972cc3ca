"""What is measured of a hard picture: finite pixels and gradients, precision, and agreement with the float64 reference.

The cases themselves stand in `stability_scenes`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.reference import Picture, rasterize_reference
from jghand_engine.learn.tensors import mapped
from jghand_engine.native import contract
from jghand_engine.render.camera import Camera
from jghand_engine.render.settings import RenderSettings

# promise 3 of RENDERING 13: a pixel differs by less from the reference, unless a contribution falls on the other side
# of the cut, which is worth one 8-bit step
PIXEL_MAX = 1.1e-4
FLIP_MAX = 1 / 255
# pixels of a small picture in which that may happen
FLIPPED_MAX = 2
# how far everything in a picture is moved to see whether a pixel jumps, meters
PICTURE_NUDGE_M = 1e-6


@dataclass(frozen=True)
class PictureError:
    """Against the float64 reference. worst: largest difference of a pixel, relative to the largest color and depth of
    the scene · flipped: pixels in which a contribution fell on the other side of the cut at 1/255 · finite: all of it
    · visible, invalid: Gaussians that were drawn, and left out as not drawable"""

    worst: float
    flipped: int
    finite: bool
    visible: int
    invalid: int

    @property
    def good(self) -> bool:
        """Promise 3 of RENDERING 13."""
        return self.finite and self.worst <= FLIP_MAX and self.flipped <= FLIPPED_MAX


@dataclass(frozen=True)
class PictureRow:
    """One row of the table of pictures. gradient: largest |gradient| times the natural size of what it is for (hand,
    radius, 1, 1) · nudged: largest change of a pixel, in 8-bit steps, when everything moves by a thousandth of a
    millimeter"""

    name: str
    error: PictureError
    gradient: float
    gradient_finite: bool
    nudged: float
    note: str = ""
    missed: list[str] = field(default_factory=list)


def planes_of(picture: Picture) -> Tensor:
    """(H, W, 5): color, alpha, sum of depths."""
    return torch.cat([picture.rgb, picture.alpha[..., None], picture.depth_sum[..., None]], -1)


def converted(gaussians: Gaussians, dtype: torch.dtype, *, grad: bool = False) -> Gaussians:
    """The same as leaves in another precision."""
    return mapped(gaussians, lambda tensor: tensor.detach().to(dtype).requires_grad_(grad))


def against_reference(gaussians: Gaussians, camera: Camera) -> PictureError:
    """float32 Gaussians as they are drawn (natively where there is a kernel) against the reference in float64."""
    with torch.no_grad():
        drawn = rasterize(gaussians, camera, RenderSettings(t_stop=contract.T_STOP))
        exact = rasterize_reference(converted(gaussians, torch.float64), camera)
    ours, theirs = planes_of(drawn).double(), planes_of(exact)
    # contributions scale with the largest color and depth of the scene
    scale = torch.ones(5, dtype=torch.float64)
    if exact.visible_gaussians:
        axis = torch.from_numpy(camera.camera_from_world[2])
        depth = gaussians.position_m.double() @ axis[:3] + axis[3]
        good = torch.isfinite(depth) & (depth.abs() <= contract.POSITION_MAX_M)
        scale[4] = max(float(depth[good].abs().max()), 1.0) if bool(good.any()) else 1.0
        color = gaussians.rgb[torch.isfinite(gaussians.rgb).all(1) & (gaussians.rgb.abs() <= contract.RGB_MAX).all(1)]
        scale[:3] = max(float(color.abs().max()), 1.0) if len(color) else 1.0
    error = ((ours - theirs).abs() / scale).amax(-1)
    return PictureError(
        worst=float(error.max()),
        flipped=int((error > PIXEL_MAX).sum()),
        finite=bool(torch.isfinite(ours).all()),
        visible=drawn.visible_gaussians,
        invalid=drawn.invalid_gaussians,
    )


def picture_gradient(gaussians: Gaussians, camera: Camera, size_m: float) -> tuple[bool, float]:
    """Whether the gradients of a sum of the mean pixel with random signs are finite, and the largest of them times the
    natural size of what it is for: the hand's, its own, or 1. A length beyond the hand's counts as the hand's: of a
    needle that leaves the picture at both ends nobody sees how long it is."""
    leaves = converted(gaussians, torch.float32, grad=True)
    planes = planes_of(rasterize(leaves, camera))
    signs = torch.sign(torch.randn(planes.shape, generator=torch.Generator().manual_seed(3)))
    (planes * signs).sum().backward()
    sizes = {"position_m": size_m, "sigma_m": None, "opacity": 1.0, "rgb": 1.0, "covariance_m2": None}
    finite, largest = True, 0.0
    for name, size in sizes.items():
        leaf = getattr(leaves, name)
        if leaf is None or leaf.grad is None:
            continue
        finite &= bool(torch.isfinite(leaf.grad).all())
        longest = size_m if name == "sigma_m" else size_m**2
        own = leaf.detach().nan_to_num(0, 0, 0).clamp(-longest, longest)
        natural = leaf.grad * (own if size is None else size)
        largest = max(largest, float(natural.abs().max()) if natural.numel() else 0.0)
    return finite, largest


def nudged_steps(gaussians: Gaussians, camera: Camera) -> float:
    """Largest change of a pixel's color or alpha, in 8-bit steps, when all Gaussians move by a micrometer sideways."""
    if not len(gaussians):
        return 0.0
    axis = torch.from_numpy(camera.camera_from_world[0, :3]).to(gaussians.position_m.dtype)
    sideways = axis * PICTURE_NUDGE_M
    moved = replace(gaussians, position_m=gaussians.position_m + sideways)
    with torch.no_grad():
        before, after = (planes_of(rasterize(g, camera))[..., :4] for g in (gaussians, moved))
    return 255 * float((after - before).abs().max())
