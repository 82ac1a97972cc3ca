"""Do the joints lie on the hand in the images? And when not: which common mistake would explain it?

The one test that sees units, axes, order and images together. It needs masks that do not come from the joints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage

from jghand_engine.captures.image_files import read_image
from jghand_engine.captures.sample import Sample, load_image
from jghand_engine.hand.joints import PARENTS
from jghand_engine.native import contract
from jghand_engine.render.camera import Camera

# a joint so near to the mask counts as on it, px: joints lie inside the finger, its silhouette may be cut close
CHECK_REACH_PX = 3
CHECK_ON_MASK_MIN = 0.85
# overlay images: enlargement, and how far outside of the image lines are still drawn, px
OVERLAY_ZOOM = 2
OVERLAY_REACH_PX = 20_000

# thumb to pinky, sRGB bytes: apart for most color-blind eyes, and none of them skin
_FINGER_COLORS = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (204, 121, 167))
_WRIST, _OUTLINE, _OFF, _GRAY = (255, 255, 255), (0, 255, 255), (255, 0, 0), 96


@dataclass(frozen=True)
class Seen:
    """An image that was looked at. The mask itself is not kept: a large set has gigabytes of them.

    mask_px: pixels of its mask · mask_part: part of the image, 0..1 · on_mask: part of its joints on the mask, 0..1 ·
    is_whole: whether all its joints are inside the image
    """

    sample: Sample
    mask_px: float
    mask_part: float
    on_mask: float
    is_whole: bool


def look_at(sample: Sample) -> Seen:
    """Reads an image and compares. InputError when it cannot be read."""
    mask, camera = load_image(sample).mask, sample.camera
    on_mask = part_on_mask(camera, sample.joints_m, mask)
    is_whole = bool(_inside(camera, joint_pixels(camera, sample.joints_m)).all())
    return Seen(sample, float(mask.sum()), float(mask.mean()), on_mask, is_whole)


def joint_pixels(camera: Camera, joints_m: np.ndarray) -> np.ndarray:
    """(21, 2) pixels; NaN for joints that are not before the camera."""
    pixels, depth_m = camera.project(joints_m)
    return np.where((depth_m > contract.Z_NEAR_M)[:, None], pixels, np.nan)


def joints_on_mask(camera: Camera, joints_m: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(21,) float: 1 for joints on the mask or within CHECK_REACH_PX of it, 0 for others, NaN for those that tell
    nothing: beyond a border of the image that the hand reaches."""
    hand = ndimage.binary_dilation(mask >= 0.5, iterations=CHECK_REACH_PX)
    pixels = joint_pixels(camera, joints_m)
    inside = _inside(camera, pixels)
    on = np.zeros(len(pixels))
    column, row = np.floor(pixels[inside]).astype(int).T
    on[inside] = hand[row, column]
    cut_off = bool(hand[[0, -1]].any() or hand[:, [0, -1]].any())
    on[~inside & cut_off] = np.nan
    return on


def _inside(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """(21,) which of the joints (21, 2) are inside the image."""
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0) & (pixels < [camera.width, camera.height])
    return inside[:, 0] & inside[:, 1]


def part_on_mask(camera: Camera, joints_m: np.ndarray, mask: np.ndarray) -> float:
    """The part of the telling joints that is on the mask, 0..1; 0 when none tells anything or there is no mask."""
    on = joints_on_mask(camera, joints_m, mask)
    return float(np.nanmean(on)) if np.isfinite(on).any() else 0.0


def likely_mistake(samples: Sequence[Sample]) -> str | None:
    """The common mistake whose repair puts the joints onto the masks, as a sentence; None when none of them does."""
    best, sentence = CHECK_ON_MASK_MIN, None
    masks = [load_image(sample).mask for sample in samples]
    for text, repair in _REPAIRS:
        parts = [part_on_mask(repair(one.camera), one.joints_m, mask) for one, mask in zip(samples, masks, strict=True)]
        if parts and float(np.median(parts)) > best:
            best, sentence = float(np.median(parts)), text
    return sentence


# ---- for people's eyes -----------------------------------------------------------------------------------------------


def overlay(sample: Sample) -> np.ndarray:
    """(h, w, 3) uint8: the image (on gray where it is transparent), the mask's outline in cyan, bones by finger,
    joints; a red ring around joints that miss the mask. Enlarged, so that lines are thin."""
    zoom = OVERLAY_ZOOM
    outlined: np.ndarray = load_image(sample).mask >= 0.5
    stored = read_image(sample.image)
    height, width = stored.shape[:2]
    image = Image.fromarray(_on_gray(stored)).resize((width * zoom, height * zoom), Image.Resampling.LANCZOS)
    pixels = np.array(image)
    hand = np.repeat(np.repeat(outlined, zoom, axis=0), zoom, axis=1)
    pixels[hand & np.logical_not(ndimage.binary_erosion(hand))] = _OUTLINE
    image = Image.fromarray(pixels)
    draw = ImageDraw.Draw(image)
    points = joint_pixels(sample.camera, sample.joints_m) * zoom - 0.5
    # NaN is not smaller either
    drawable = [bool((np.abs(point) < OVERLAY_REACH_PX).all()) for point in points]
    for joint in range(1, len(points)):
        if drawable[joint] and drawable[PARENTS[joint]]:
            draw.line([*points[PARENTS[joint]], *points[joint]], fill=_color(joint), width=2 * zoom)
    on = joints_on_mask(sample.camera, sample.joints_m, outlined)
    for joint in (joint for joint, wanted in enumerate(drawable) if wanted):
        draw.circle(tuple(points[joint]), 2.5 * zoom, fill=_color(joint), outline=(0, 0, 0))
        if on[joint] == 0:
            draw.circle(tuple(points[joint]), 5 * zoom, outline=_OFF, width=zoom)
    return np.asarray(image)


def _on_gray(stored: np.ndarray) -> np.ndarray:
    if stored.shape[2] == 3:
        return stored
    alpha = stored[..., 3:].astype(np.float32) / 255.0
    return (stored[..., :3] * alpha + _GRAY * (1 - alpha) + 0.5).astype(np.uint8)


def _color(joint: int) -> tuple[int, int, int]:
    return _FINGER_COLORS[(joint - 1) % 5] if joint else _WRIST


# ---- what people get wrong ------------------------------------------------------------------------------------------


def _fitted_to_size(camera: Camera) -> Camera:
    """As if K were that of a larger or smaller image of the same view: the principal point tells which."""
    x, y = camera.width / (2 * camera.cx), camera.height / (2 * camera.cy)
    if x <= 0 or y <= 0:
        return camera
    return replace(camera, fx=camera.fx * x, fy=camera.fy * y, cx=camera.cx * x, cy=camera.cy * y)


def _moved(change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Callable[[Camera], Camera]:
    """Gives a camera the rotation and translation (meters) that `change` makes of its own."""

    def repair(camera: Camera) -> Camera:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = change(camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3])
        return replace(camera, camera_from_world=matrix)

    return repair


_FLIP = np.array([1.0, -1.0, -1.0])
# a camera stands at -R' t
_REPAIRS: tuple[tuple[str, Callable[[Camera], Camera]], ...] = (
    ("Camera positions look like meters where millimeters are due.", _moved(lambda r, t: (r, 1000.0 * t))),
    ("Camera positions look like centimeters where millimeters are due.", _moved(lambda r, t: (r, 10.0 * t))),
    ("Camera positions look like millimeters where meters are due.", _moved(lambda r, t: (r, 0.001 * t))),
    (
        "Camera axes look like OpenGL's or Blender's (y up, z backwards) instead of OpenCV's.",
        _moved(lambda r, t: (_FLIP[:, None] * r, _FLIP * t)),
    ),
    (
        "Camera rotations look transposed (camera to world instead of world to camera).",
        _moved(lambda r, t: (r.T, r.T @ r.T @ t)),
    ),
    (
        "Camera matrices look inverted (camera to world instead of world to camera).",
        _moved(lambda r, t: (r.T, -r.T @ t)),
    ),
    ("The camera's position and its translation t look mistaken for each other.", _moved(lambda r, t: (r, -r.T @ t))),
    ("Focal length and principal point look like those of images of another size.", _fitted_to_size),
    (
        "x and y of focal length and principal point look exchanged, or the images turned.",
        lambda camera: replace(camera, fx=camera.fy, fy=camera.fx, cx=camera.cy, cy=camera.cx),
    ),
)
