"""Nails: a plate in a groove, the fold of skin around it, the moon and the free edge.

A nail's own coordinates are x from -1 at its root to 1 at its far end, y from -1 to 1 across, and the depth inside its
outline, mm. The outline follows the template's nail mask.
"""

from __future__ import annotations

import numpy as np

from jghand_engine.captures.skin.canvas import Canvas
from jghand_engine.captures.skin.noise import gauss, noise, smoothstep

# percentiles of the mask's texels that are the ends of a nail: the mask is soft
ENDS = (2, 98)
# the root's outline is a superellipse of this exponent; the far end is an arch, higher in the middle
ROOT_EXPONENT, ARCH = 2.6, 0.16
# height mm and width mm: the groove at the outline, the fold around it, the cuticle over the root
GROOVE_MM, FOLD_MM, CUTICLE_MM = (0.26, 0.16), (0.40, 0.60), (0.07, 0.14)
# the plate: at its edge, more in its middle, its free edge, and the step down to the finger tip beyond it
PLATE_MM, VAULT_MM, FREE_EDGE_MM, STEP_MM = 0.10, 0.10, 0.10, 0.28
# half of the way from skin to plate; no less than a texel, or the edge of a pale nail in dark skin is a saw
EDGE_MM = 0.10
# ridges along the plate, mm high and apart: at 0.01 mm it looks corrugated already
RIDGE_MM, RIDGES_APART_MM = 0.0035, 0.55
# of an old person: how much higher they are, and cell of coarser ones, mm
HIGHER, OLD_RIDGES_MM = 2.0, 0.8
# how far the moon reaches from the root: whole on thumb and index, half on the middle finger, little on the others
MOONS = (1.0, 1.0, 0.55, 0.2, 0.2)
# most of the half length that a free edge takes on the plate itself
FREE_EDGE_MOST = 0.55


def paint_nails(canvas: Canvas) -> None:
    texels = canvas.texels
    edge = max(EDGE_MM, texels.texel_mm)
    for finger in range(5):
        on = np.nonzero((texels.shares[:, finger, 2] > 0.25) & (canvas.side < 0.35))[0]
        a, lateral, _ = canvas.bone(16 + finger).of(texels.point[on])
        masked = texels.nail[on] > 0.5
        (a0, a1), (l0, l1) = np.percentile(a[masked], ENDS), np.percentile(lateral[masked], ENDS)
        half, half_width = float(a1 - a0) / 2, float(l1 - l0) / 2
        x, y = (a - (a0 + a1) / 2) / half, (lateral - (l0 + l1) / 2) / half_width
        canvas.nail_xy[on] = np.stack([x, y], 1)
        small = min(half, half_width)
        root = 1 - (np.clip(-x, 0, 2) ** ROOT_EXPONENT + np.abs(y) ** ROOT_EXPONENT) ** (1 / ROOT_EXPONENT)
        far = np.minimum(1 - np.abs(y), 1.02 - ARCH * y**2 - x)
        depth = small * np.where(x < 0, root, far)
        depth = depth + (0.06 * canvas.noise(f"nail{finger}", 1.6, on) + 0.04) * smoothstep(0.9, 0.5, x)
        plate = smoothstep(-edge, edge, depth)
        in_skin = smoothstep(0.85, 0.45, x)
        fold = gauss(depth + 0.85, FOLD_MM[1]) * in_skin
        cuticle = gauss(depth + 0.16, CUTICLE_MM[1]) * smoothstep(0.1, -0.5, x)
        edge_at = 1.0 - min(FREE_EDGE_MOST, canvas.person.nail_mm / half) - 0.10 * y**2
        free_edge = plate * smoothstep(-0.08, 0.08, x - edge_at)
        moon = plate * smoothstep(-0.06, 0.08, -x - 0.60 + 0.42 * (1 - y**2) * MOONS[finger])
        step = gauss((x - 1.05) * half - 0.25, 0.30) * smoothstep(1.05, 0.8, np.abs(y))
        height = (
            FOLD_MM[0] * fold + CUTICLE_MM[0] * cuticle - GROOVE_MM[0] * gauss(depth + 0.02, GROOVE_MM[1]) * in_skin
        )
        height += plate * (PLATE_MM + VAULT_MM * smoothstep(0, 0.8, depth)) + FREE_EDGE_MM * free_edge - STEP_MM * step
        canvas.raise_by("static", height + plate * _ridges(canvas, finger, a, lateral), on)
        amounts = {"plate": plate, "free_edge": free_edge, "moon": moon, "nail_fold": np.maximum(fold, cuticle)}
        for name, amount in amounts.items():
            canvas.mark(name, amount, on)


def _ridges(canvas: Canvas, finger: int, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """(N,) mm: fine ridges from root to end, and unevenness that is drawn out along them."""

    def drawn_out(name: str, cell_mm: float, part: float) -> np.ndarray:
        flat = np.stack([across, part * along, np.zeros_like(along)], 1)
        return noise(flat, cell_mm, canvas.seed(f"{name}{finger}"))

    phase = (across + 0.25 * drawn_out("ridge phase", 0.9, 0.08)) / RIDGES_APART_MM
    uneven = drawn_out("ridge", 0.45, 0.10) + drawn_out("plate", 2.0, 0.25)
    old = canvas.aged * drawn_out("old ridge", OLD_RIDGES_MM, 0.04)
    return RIDGE_MM * (1 + HIGHER * canvas.aged) * (np.sin(2 * np.pi * phase) + 1.1 * uneven + 1.5 * old)
