"""The most exact picture the engine knows, in double precision from the joints on, and how far others are from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.avatar.relighting import in_studio
from jghand_engine.color import decibels
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.reference import rasterize_reference
from jghand_engine.learn.shadow import shade
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.learn.tensors import mapped
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import PRESETS
from jghand_engine.render.shadow import ShadowStyle
from jghand_engine.render.subject import Subject

# contribution below which a Gaussian does not touch a pixel of the exact picture
ALPHA_MIN = 1e-6
# poses of such pictures, which take seconds each, and how many pixels they have all together at most
POSES = 6
PIXELS = 1_200_000


@dataclass(frozen=True)
class Error:
    """Of whole pictures, premultiplied color."""

    # of all pictures together
    psnr_db: float
    # largest difference of a channel, 0..1
    worst: float


class ExactPictures64:
    """The pictures of some poses (P, 21, 3), all Gaussians, nothing cut off, nothing stopped, in float64. What detail
    changes, and that a hand ends with its skin, is added as the kernels draw it, by preset `reference`."""

    def __init__(self, subject: Subject, poses_m: np.ndarray) -> None:
        # as the renderer shows it where no scene lights it
        self._subject, self.poses_m = replace(subject, avatar=in_studio(subject.avatar)), poses_m
        # whether there is a shadow, and how strong, is decided by the renderer
        settings = replace(PRESETS["reference"], antialias=False)
        self._renderer = HandRenderer(subject.avatar, settings)
        self._plain = HandRenderer(replace(subject.avatar, detail=None), settings)
        self.pictures = [self._exact(pose_m) for pose_m in poses_m]

    def error(self, draw: Callable[[np.ndarray], np.ndarray]) -> Error:
        """Of what `draw` makes of joints (21, 3): (H, W, 3 or 4) premultiplied."""
        return error_from(self.pictures, self.poses_m, draw)

    def _posed(self, pose_m: np.ndarray) -> Gaussians:
        avatar = self._subject.avatar
        bones = transform_of(avatar).bones(torch.from_numpy(pose_m))
        eye_m = torch.from_numpy(self._subject.camera.eye_m)
        gaussians = pose_gaussians(avatar, bones, frames=bones.frames, eye_m=eye_m)
        return replace(gaussians, pixel_m=avatar.pixel_m * float(bones.scale))

    def _exact(self, pose_m: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            gaussians, camera = self._posed(pose_m), self._subject.camera
            picture = rasterize_reference(mapped(gaussians, Tensor.double), camera, alpha_min=ALPHA_MIN)
            plain, detailed = (one.render(pose_m, camera) for one in (self._plain, self._renderer))
            by_detail = (detailed.rgba - plain.rgba)[..., :3].astype(np.float64)
            rgb, plan, learned = picture.rgb, detailed.report.plan, self._subject.avatar.learned
            look = ShadowLook() if learned is None else learned.shadow
            if plan is not None and plan.strength > 0 and look is not None:
                samples = PRESETS["reference"].shadow_samples
                style = ShadowStyle(samples, plan.strength, gain=look.gain, tint=look.tint)
                rgb = shade(rgb, picture.alpha, picture.depth_sum, camera, style)
            return rgb.numpy() + by_detail


def error_from(pictures: Sequence[np.ndarray], poses_m: np.ndarray, draw: Callable[[np.ndarray], np.ndarray]) -> Error:
    """As `ExactPictures64.error`, from pictures (H, W, 3) of poses (P, 21, 3)."""
    pairs = zip(poses_m, pictures, strict=True)
    differences = [draw(pose_m)[..., :3].astype(np.float64) - picture for pose_m, picture in pairs]
    mean_square = float(np.mean([np.square(each).mean() for each in differences]))
    return Error(decibels(mean_square), max(float(np.abs(each).max()) for each in differences))


def spread_poses(subject: Subject, count: int) -> np.ndarray:
    """(count, 21, 3) of the subject's poses, evenly over its motion."""
    return subject.poses[np.linspace(0, len(subject.poses) - 1, count).round().astype(int)]


def pose_count(size_px: Sequence[int]) -> int:
    """How many poses of pictures of this size are drawn in double precision, which takes seconds each."""
    pixels = size_px[0] * size_px[1]
    return max(2, min(POSES, round(PIXELS / pixels)))
