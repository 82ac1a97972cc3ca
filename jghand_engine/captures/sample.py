"""One image of a hand that something can be learned from: the record that every loader of a data set gives."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from jghand_engine.captures.image_files import read_image, read_mask
from jghand_engine.captures.known_light import KnownLight
from jghand_engine.captures.masks import lit_part, template_mask
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.sequence import HandPose
from jghand_engine.render.camera import Camera
from jghand_engine.template.mesh import HandTemplate

# of the images of a set, those whose pixels are finer than `pixel_at_hand_m`: close-ups, a quarter of a capture, see
# little of the hand, and what most images see sets the widths of Gaussians
FINER_PART = 0.4


class MaskSource(StrEnum):
    """Where the mask of an image comes from: a file of its own, the image's alpha, the projected template, or that
    without what is black or glaring in the image, as the avatar papers do."""

    FILE = "file"
    ALPHA = "alpha"
    TEMPLATE = "template"
    TEMPLATE_LIT = "template, lit pixels"

    @property
    def is_projected(self) -> bool:
        """Whether it is a silhouette of a template, and so no evidence of where the person's hand is."""
        return self in (MaskSource.TEMPLATE, MaskSource.TEMPLATE_LIT)


@dataclass(frozen=True, eq=False)
class Sample:
    """An image on disk and what is known of it; nothing is read until `load_image`. Equal only to itself.

    image:     path of the image, sRGB
    camera:      OpenCV camera, world -> camera, meters; its size is the image's
    joints_m:    (21, 3) float64, level order, world, meters; of a left hand not mirrored
    handedness:  which hand
    capture, sequence, frame, camera_name: where it comes from; (sequence, frame) names a pose
    mask_source, mask: how to get the mask; `mask` is the file for MaskSource.FILE
    template:    whose silhouette stands in for a mask; None: the built-in hand's
    light:       what lights it; None: unknown
    forearm:     (4,) how its forearm is turned, see `HandPose`; None: unknown
    """

    image: Path
    camera: Camera
    joints_m: np.ndarray
    handedness: Handedness
    capture: str
    sequence: str
    frame: int
    camera_name: str
    mask_source: MaskSource = MaskSource.ALPHA
    mask: Path | None = None
    template: HandTemplate | None = None
    light: KnownLight | None = None
    forearm: np.ndarray | None = None

    @property
    def pose(self) -> tuple[str, int]:
        """What names the pose: images of several cameras share it."""
        return self.sequence, self.frame

    @property
    def hand(self) -> HandPose:
        """What renderers draw to compare it with the image."""
        return HandPose(self.joints_m, self.forearm)


@dataclass(frozen=True)
class TrainingImage:
    """rgb: (H, W, 3) float32, display-referred sRGB over black, 0..1 · mask: (H, W) float32, 0..1"""

    rgb: np.ndarray
    mask: np.ndarray


def load_image(sample: Sample) -> TrainingImage:
    """Reads the image and its mask, and puts the hand on black: colors are multiplied by the mask (of 8-bit straight
    alpha: premultiplied), so that what is not hand is exactly 0.

    InputError names the file when it is missing, broken, of another size than the camera, or has no alpha where the
    mask is its alpha.
    """
    stored = read_image(sample.image)
    _check_size(sample, sample.image, stored)
    rgb, mask = stored[..., :3].astype(np.float32) / 255.0, _mask(sample, stored)
    return TrainingImage(rgb * mask[..., None], mask)


def _mask(sample: Sample, stored: np.ndarray) -> np.ndarray:
    if sample.mask_source.is_projected:
        mask = template_mask(sample.camera, sample.joints_m, sample.handedness, sample.template)
        return lit_part(mask, stored) if sample.mask_source is MaskSource.TEMPLATE_LIT else mask
    if sample.mask_source is MaskSource.FILE:
        if sample.mask is None:
            raise InputError(f"mask of {sample.image}", wanted="a mask file", came="none named")
        mask = read_mask(sample.mask)
        _check_size(sample, sample.mask, mask)
        return mask
    if stored.shape[2] != 4:
        raise InputError(
            f"image {sample.image}",
            wanted="an alpha channel, which is its mask",
            came="none",
            remedy="Save it as PNG with alpha, or give masks as files.",
        )
    return stored[..., 3].astype(np.float32) / 255.0


def _check_size(sample: Sample, path: Path, pixels: np.ndarray) -> None:
    height, width = pixels.shape[:2]
    if (width, height) != (sample.camera.width, sample.camera.height):
        raise InputError(
            f"size of {path}",
            wanted=f"{sample.camera.width} x {sample.camera.height} pixels, for which its camera is given",
            came=f"{width} x {height}",
            remedy="Images that were resized need their cameras scaled with them: take the originals.",
        )


def pixel_at_hand_m(samples: Sequence[Sample], canonical_joints_m: np.ndarray) -> float:
    """Size of a pixel where the hand is, meters of a hand of the canonical size: two fifths of the images have finer
    ones. canonical_joints_m: (21, 3)"""
    joints_m = np.stack([one.joints_m for one in samples])
    eyes_m, focal = np.stack([one.camera.eye_m for one in samples]), np.array([one.camera.fx for one in samples])
    scale = bone_lengths(joints_m).sum(-1) / bone_lengths(canonical_joints_m).sum()
    return float(np.quantile(np.linalg.norm(eyes_m - joints_m.mean(1), axis=1) / (focal * scale), FINER_PART))


# ---- what tells two sets apart, wherever their folders lie -----------------------------------------------------------


def image_names(samples: Sequence[Sample]) -> list[str]:
    """A line for each image, in their order."""
    return [f"{one.capture} {one.sequence} {one.frame} {one.camera_name}" for one in samples]


def image_digest(samples: Sequence[Sample]) -> str:
    """16 hexadecimal digits that stand for these images, in whatever order: of their names and joints.

    The joints, because our own captures name their images alike.
    """
    lines = [
        f"{name} {np.rint(1e4 * one.joints_m.ravel()).astype(int).tolist()}"
        for name, one in zip(image_names(samples), samples, strict=True)
    ]
    return hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()[:16]
