"""All maps of a person's skin on an identity, and the surface that they lie on.

What a height has that is coarser than COARSE_MM moves the surface itself, so that outlines and shadows see it; the
finer rest is for a bump map. Nothing is in both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from jghand_engine.captures.making.rig import Identity
from jghand_engine.captures.skin.canvas import Canvas
from jghand_engine.captures.skin.color import paint_color, paint_roughness
from jghand_engine.captures.skin.creases import paint_creases
from jghand_engine.captures.skin.curves import PalmCurves
from jghand_engine.captures.skin.flesh import paint_flesh
from jghand_engine.captures.skin.hair import Hair
from jghand_engine.captures.skin.nails import paint_nails
from jghand_engine.captures.skin.person import Person
from jghand_engine.captures.skin.relief import paint_relief

# spread of the filter that parts the heights: wider than an edge of the surface (0.6 mm after three subdivisions)
COARSE_MM = 0.6
# layers of the bump map; what a bent joint shows more is coarse
FINE_LAYERS = ("static", "straight", "fold")


@dataclass(frozen=True)
class SkinMaps:
    """Squares in the template's UV, row = 1 - v; around the island the nearest skin goes on.

    rgb:       (S, S, 3) float32 linear reflectance
    roughness: (S, S) float32
    plate:     (S, S) float32 0..1, how far it is nail
    coarse:    layer -> (S, S) float32 mm, of Canvas.HEIGHTS
    fine:      layer -> (S, S) float32 mm, of FINE_LAYERS
    """

    rgb: np.ndarray
    roughness: np.ndarray
    plate: np.ndarray
    coarse: dict[str, np.ndarray]
    fine: dict[str, np.ndarray]


def nearest_covered(covered: np.ndarray) -> np.ndarray:
    """(2, S, S) row and column of the nearest texel of skin: it goes on around its islands. covered: (S, S) bool"""
    return np.asarray(distance_transform_edt(~covered, return_distances=False, return_indices=True))


def paint_skin(identity: Identity, size: int, person: Person, hair: Hair | None = None) -> SkinMaps:
    """The maps with an edge of `size` texels: 2048 (0.16 mm on the skin) shows all but friction ridges, which want
    4096. The same to the bit for the same person. hair: painted on it, where no curves are drawn"""
    canvas = painted(identity, size, person)
    covered = canvas.texels.covered
    row, column = nearest_covered(covered)

    def spread(values: np.ndarray) -> np.ndarray:
        square = np.zeros((*covered.shape, *values.shape[1:]), np.float32)
        square[covered] = values
        return square[row, column]

    rgb = paint_color(canvas)
    if hair:
        rgb = hair.painted(canvas, rgb)
    heights = {name: spread(height) for name, height in canvas.heights.items()}
    sigma = COARSE_MM / canvas.texels.texel_mm
    coarse = {name: gaussian_filter(height, sigma) for name, height in heights.items()}
    return SkinMaps(
        rgb=spread(rgb),
        roughness=spread(paint_roughness(canvas)),
        plate=spread(canvas.amounts["plate"]),
        coarse=coarse,
        fine={name: heights[name] - coarse[name] for name in FINE_LAYERS},
    )


def painted(identity: Identity, size: int, person: Person) -> Canvas:
    """The canvas with all its heights and marks."""
    canvas = Canvas.of(identity, size, person)
    paint_nails(canvas)
    paint_flesh(canvas, PalmCurves(canvas, is_palm=False))
    paint_creases(canvas, PalmCurves(canvas, is_palm=True))
    paint_relief(canvas)
    return canvas
