"""What a backend does for a frame: pose Gaussians and paint a picture of them. `frame.py` decides, painters obey.

`NativePainter` is in painter_native.py; `TorchPainter`, here, is the chain of reference functions, slow and exact.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch

from jghand_engine import limits
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.gaussians import Gaussians
from jghand_engine.avatar.pose_features import Angles
from jghand_engine.avatar.torch_posing import TorchPosing, reflects
from jghand_engine.errors import InputError
from jghand_engine.hand.fast_transform import FastBones
from jghand_engine.render.camera import Camera
from jghand_engine.render.picture import Picture
from jghand_engine.render.rasterize import rasterize
from jghand_engine.render.report import FrameReport
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.shadow import ShadowStyle
from jghand_engine.render.shadow_native import darken

# names of the stages that painters run
SKIN, GLOSS, RASTER, SHADOW, COMPOSE = "skin", "gloss", "raster", "shadow + compose", "compose"
# why the raster was skipped
SAME_PICTURE = "same pose, camera and settings"


@dataclass(frozen=True)
class Pose:
    """One hand of a picture: its bone transforms, and its root relative to the picture's origin (3,), meters.
    keeps_correctives: whether those of the last pose are used again"""

    bones: FastBones
    shift_m: np.ndarray
    keeps_correctives: bool = False

    @property
    def angles(self) -> Angles:
        """Its joint angles, for correctives."""
        return Angles.of(torch.from_numpy(self.bones.angles_rad))


@dataclass(frozen=True)
class Canvas:
    """What to paint. camera: of the picture's origin, that is camera_from_world @ translation(origin) · near_m: depth
    of the origin, meters · style: of the shadow, None for none · alpha_min: cut-off of the blend · depth: whether
    somebody wants it."""

    camera: Camera
    near_m: float
    style: ShadowStyle | None
    alpha_min: float
    depth: bool = False

    @property
    def eye_m(self) -> np.ndarray:
        """(3,) where the camera stands, relative to the picture's origin, meters."""
        return self.camera.eye_m

    def same_view(self, other: Canvas | None) -> bool:
        """Whether the two see the same Gaussians in the same way, shadow aside."""
        if other is None or self.alpha_min != other.alpha_min:
            return False
        mine, theirs = self.camera, other.camera
        numbers = ("width", "height", "fx", "fy", "cx", "cy")
        if any(getattr(mine, name) != getattr(theirs, name) for name in (*numbers, "orthographic")):
            return False
        return bool(np.array_equal(mine.camera_from_world, theirs.camera_from_world))


class Painter(Protocol):
    """Paints hands, whose avatars it knows, again and again. keeps_correctives: whether it can (`Pose`)."""

    backend: str
    threads: int
    keeps_correctives: bool

    def paint(
        self, poses: Sequence[Pose] | None, canvas: Canvas, report: FrameReport, *, keeps_picture: bool = False
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """-> rgba (H, W, 4) float32 premultiplied, depth (H, W) float32 meters or None. Both belong to the caller.

        poses: one per avatar; None keeps the Gaussians of the last call · keeps_picture: also what was drawn of them,
        in the same view
        """
        ...

    def hand_weights(self, canvas: Canvas) -> np.ndarray:
        """(H, W, hands) how much of a pixel each hand covers, of the Gaussians of the last call."""
        ...

    def part_map(self, canvas: Canvas, parts: Sequence[np.ndarray]) -> np.ndarray:
        """(H, W) uint8 number of the part that covers most of the pixel, 0 where hardly anything does, of the Gaussians
        of the last call. parts: per hand the number, from 1, of the part that each of its Gaussians belongs to."""
        ...


class TorchPainter:
    """Paints with the reference functions: no compiled code, seconds per picture."""

    backend, threads, keeps_correctives = "torch", 1, False

    def __init__(self, avatars: Sequence[HandAvatar], settings: RenderSettings) -> None:
        self._avatars = avatars
        self._settings = replace(settings, backend="torch")
        self._hands = [TorchPosing(avatar) for avatar in avatars]
        self._gaussians: Gaussians | None = None
        self._drawn: Picture | None = None

    def paint(
        self, poses: Sequence[Pose] | None, canvas: Canvas, report: FrameReport, *, keeps_picture: bool = False
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """See Painter."""
        with torch.no_grad():
            if poses is not None:
                started = time.perf_counter()
                self._gaussians = self._posed(poses)
                report.ran(SKIN, 1e3 * (time.perf_counter() - started))
            if not keeps_picture:
                self._drawn = None
            picture = self._picture(canvas, report)
            report.visible_gaussians, report.invalid_gaussians = picture.visible_gaussians, picture.invalid_gaussians
            started = time.perf_counter()
            planes = torch.cat([picture.rgb.permute(2, 0, 1), picture.alpha[None], picture.depth_sum[None]])
            if canvas.style is not None:
                planes = torch.cat([darken(planes, canvas.camera, canvas.style), planes[3:]])
            rgba = np.ascontiguousarray(planes[:4].permute(1, 2, 0).numpy())
            depth_m = np.ascontiguousarray(picture.depth_m.numpy()) if canvas.depth else None
            report.ran(COMPOSE if canvas.style is None else SHADOW, 1e3 * (time.perf_counter() - started))
        return rgba, depth_m

    def _picture(self, canvas: Canvas, report: FrameReport) -> Picture:
        if self._drawn is not None:
            report.skipped(RASTER, SAME_PICTURE, "0")
            return self._drawn
        if self._gaussians is None:
            raise InputError("picture", wanted="a pose", came="none")
        colored = self._colored(self._gaussians, canvas, report)
        started = time.perf_counter()
        picture = rasterize(colored, canvas.camera, replace(self._settings, alpha_min=canvas.alpha_min))
        self._drawn = picture
        report.ran(RASTER, 1e3 * (time.perf_counter() - started))
        return picture

    def hand_weights(self, canvas: Canvas) -> np.ndarray:
        """See Painter."""
        numbers = owners([len(avatar) for avatar in self._avatars])
        return hand_weights(len(self._avatars), lambda first: self._coverage(canvas, numbers, first))

    def part_map(self, canvas: Canvas, parts: Sequence[np.ndarray]) -> np.ndarray:
        """See Painter."""
        numbers = np.concatenate(parts)
        return heaviest_part(int(numbers.max()), lambda first: self._coverage(canvas, numbers, first))

    def _coverage(self, canvas: Canvas, numbers: np.ndarray, first: int) -> np.ndarray:
        """(H, W, 3) how much of a pixel the Gaussians of these numbers cover: `first` and the next two."""
        if self._gaussians is None:
            raise InputError("picture", wanted="a pose", came="none")
        settings = replace(self._settings, alpha_min=canvas.alpha_min)
        with torch.no_grad():
            rgb = torch.from_numpy(part_colors(numbers, first)).to(self._gaussians.rgb)
            return rasterize(replace(self._gaussians, rgb=rgb), canvas.camera, settings).rgb.numpy()

    def _posed(self, poses: Sequence[Pose]) -> Gaussians:
        """All hands' Gaussians relative to the picture's origin."""
        parts = [
            hand.pose(RootRelative.of(avatar, pose.bones, pose.shift_m), pose.angles).matt
            for hand, avatar, pose in zip(self._hands, self._avatars, poses, strict=True)
        ]
        fields = ("position_m", "sigma_m", "opacity", "rgb")
        covariance_m2 = None
        if any(part.covariance_m2 is not None for part in parts):
            covariance_m2 = torch.cat([covariance_of(part) for part in parts])
        return Gaussians(
            *(torch.cat([getattr(part, name) for part in parts]) for name in fields), covariance_m2=covariance_m2
        )

    def _colored(self, gaussians: Gaussians, canvas: Canvas, report: FrameReport) -> Gaussians:
        """The same as they look from the camera; kept for the next picture from there."""
        started, first, changed = time.perf_counter(), 0, False
        for hand, avatar in zip(self._hands, self._avatars, strict=True):
            rgb = hand.rgb(canvas.eye_m)
            if rgb is not None:
                gaussians.rgb[first : first + len(avatar)] = rgb
                changed |= reflects(avatar)
            first += len(avatar)
        if changed:
            report.ran(GLOSS, 1e3 * (time.perf_counter() - started))
        return gaussians


def owners(counts: Sequence[int]) -> np.ndarray:
    """(N,) which hand each row is of, for hands of so many rows."""
    return np.repeat(np.arange(len(counts)), counts)


def part_colors(numbers: np.ndarray, first: int) -> np.ndarray:
    """(N, 3) float32 colors: 1 in the channel of the row's number, among three numbers from `first` on."""
    return (numbers[:, None] == np.arange(first, first + 3)).astype(np.float32)


def hand_weights(hands: int, coverage: Callable[[int], np.ndarray]) -> np.ndarray:
    """(H, W, hands) float32 from `coverage(first)` (H, W, 3) of the hands `first` and the next two."""
    planes = [coverage(first) for first in range(0, hands, 3)]
    return np.concatenate(planes, -1)[..., :hands].astype(np.float32)


def heaviest_part(parts: int, coverage: Callable[[int], np.ndarray]) -> np.ndarray:
    """(H, W) uint8, see Painter.part_map, from `coverage(first)` (H, W, 3) of the parts `first` and the next two."""
    heaviest, total, numbers = np.float32(0), np.float32(0), np.uint8(0)
    for first in range(1, parts + 1, 3):
        covered = coverage(first)
        total = total + covered.sum(-1)
        here = covered.argmax(-1)
        most = np.take_along_axis(covered, here[..., None], -1)[..., 0]
        numbers = np.where(most > heaviest, (first + here).astype(np.uint8), numbers)
        heaviest = np.maximum(heaviest, most)
    return np.where(total > limits.DEPTH_ALPHA_MIN, numbers, 0).astype(np.uint8)


def covariance_of(gaussians: Gaussians) -> torch.Tensor:
    """(N, 6) as in `Gaussians`, of spheres too."""
    if gaussians.covariance_m2 is not None:
        return gaussians.covariance_m2
    sphere = gaussians.sigma_m.new_tensor([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])
    return gaussians.sigma_m[:, None] ** 2 * sphere


@dataclass(frozen=True)
class RootRelative:
    """FastBones as torch tensors (avatar.skinning.PoseTransforms), around the picture's origin, not the world's."""

    linear: torch.Tensor
    offset_m: torch.Tensor
    root_m: torch.Tensor
    canonical_root_m: torch.Tensor
    scale: torch.Tensor

    @classmethod
    def of(cls, avatar: HandAvatar, bones: FastBones, shift_m: np.ndarray) -> RootRelative:
        """shift_m: (3,) the hand's root relative to the picture's origin."""
        matrices = torch.from_numpy(np.asarray(bones.linear_offset, np.float32))
        return cls(
            linear=matrices[:, :, :3],
            offset_m=matrices[:, :, 3],
            root_m=torch.from_numpy(shift_m.astype(np.float32)),
            canonical_root_m=avatar.canonical_joints_m[0],
            scale=torch.tensor(bones.scale, dtype=torch.float32),
        )
