"""The mask of a hand where no file has one: the template, posed by the joints and projected.

It is the silhouette of the template's hand in that pose, not of the person's: a few millimeters off where their hand is
thicker or thinner. Figures got with it say so.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage

from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import Skeleton
from jghand_engine.native import contract
from jghand_engine.render.camera import Camera
from jghand_engine.template.builtin import load_template
from jghand_engine.template.mesh import HandTemplate, posed_vertices

# samples per pixel edge when a template is projected: steps of 1/16 in the coverage of a pixel
MASK_SUPERSAMPLING = 4
# gray values between which the avatar papers take a pixel of a projected mask for skin (PAPER 2)
PAPER_MASK_GRAY = (10, 200)


def template_mask(
    camera: Camera, joints_m: np.ndarray, handedness: Handedness, template: HandTemplate | None = None
) -> np.ndarray:
    """(H, W) float32 coverage 0..1 of a template posed by joints_m (21, 3), level order, world, meters.

    template: None is the built-in one. Faces that reach behind the near plane are left out.
    """
    template = template or load_template()
    skeleton = Skeleton(template.joints_m, handedness=handedness)
    return silhouette(camera, posed_vertices(template, skeleton, joints_m), template.faces)


def lit_part(mask: np.ndarray, rgb8: np.ndarray) -> np.ndarray:
    """What the avatar papers keep of a projected mask: pixels neither black nor glaring, of those the largest piece.

    mask: (H, W) coverage · rgb8: (H, W, 3) the image -> (H, W) float32, 0 or 1. Source: PAPER 2. It removes what
    of the projected hand lies on the black background, and its price is holes in dark and in shining skin.
    """
    gray = rgb8[..., :3].mean(axis=-1)
    low, high = PAPER_MASK_GRAY
    labeled: Any = ndimage.label((mask >= 0.5) & (gray > low) & (gray < high), structure=np.ones((3, 3)))
    pieces, count = labeled
    if not count:
        return np.zeros(mask.shape, np.float32)
    largest = 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
    return (pieces == largest).astype(np.float32)


def template_note(count: int, total: int) -> tuple[str, ...]:
    """What must be said beside figures when `count` of `total` masks are the projected template."""
    if not count:
        return ()
    return (
        f"{count} of {total} images have no mask: the template, posed and projected, stands in for it, so figures "
        "are not those of the papers' protocol.",
    )


def silhouette(camera: Camera, vertices_m: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(H, W) float32: which part of each pixel the projected triangles cover, in steps of MASK_SUPERSAMPLING^-2.

    The drawing library fills every sample that an outline touches: the silhouette is wider by half a sample, an eighth
    of a pixel, on all sides.
    """
    pixels, depth_m = camera.project(vertices_m)
    fine = MASK_SUPERSAMPLING
    corners = pixels[faces] * fine
    visible = (depth_m[faces] > contract.Z_NEAR_M).all(axis=1)
    canvas = Image.new("L", (camera.width * fine, camera.height * fine))
    draw = ImageDraw.Draw(canvas)
    # those whose box does not overlap the canvas need not be drawn
    near = ((corners.max(axis=1) >= 0) & (corners.min(axis=1) <= np.array(canvas.size))).all(axis=1)
    for triangle in corners[visible & near].reshape(-1, 6).tolist():
        draw.polygon(triangle, fill=1)
    covered = np.asarray(canvas).reshape(camera.height, fine, camera.width, fine)
    return covered.mean(axis=(1, 3), dtype=np.float32)
