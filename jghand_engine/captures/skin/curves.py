"""Curves drawn on the palm or on the back of the template's hand, carried to a person's."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline, RBFInterpolator
from scipy.spatial import KDTree

from jghand_engine.captures.skin.canvas import MM, Canvas
from jghand_engine.template.builtin import load_template

# what carries a curve: wrist, thumb CMC, the four MCP, thumb MCP
CARRIERS = slice(0, 7)
# behind the wrist by this, mm, nothing carries it any more: there curves go on along the forearm, which lies so in the
# plane of the palm for each millimeter of the template's y
CARRIED_TO, FOREARM_WAY = -6.0, np.array([-0.18, 1.0])
# points that a curve is taken to, and how far from it its marks may reach, mm
STEPS, REACH_MM = 1000, 7.0
# how curves waver: with the canvas' own wobble, and by a finer one, mm
WAVER = np.array([0.55, -0.385], np.float32)
FINE_WAVER_MM, FINE_WAVER_CELL_MM = 0.22, 2.1


class PalmCurves:
    """The texels of one side of the hand and their places in the plane of the palm."""

    def __init__(self, canvas: Canvas, *, is_palm: bool) -> None:
        side = canvas.side > -0.05 if is_palm else canvas.side < 0.25
        # no curve goes past the fingers' roots
        self._on = np.nonzero(side & (canvas.fingers[:, 1:].sum(1) < 0.7))[0]
        template = load_template().joints_m[CARRIERS, :2] / MM
        self._spline = RBFInterpolator(template, canvas.joints[CARRIERS, :2], kernel="thin_plate_spline")
        self._size = canvas.size
        fine = [canvas.noise(f"waver{k}", FINE_WAVER_CELL_MM, self._on) for k in range(2)]
        self._xy = canvas.texels.point[self._on, :2] + canvas.wobble[self._on, None] * WAVER
        self._xy += FINE_WAVER_MM * np.stack(fine, 1)

    def near(self, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Texels near the smooth curve through `knots` (K, 2) mm on the template: their numbers, distance mm, and where
        along the curve they are, 0..1."""
        behind = np.minimum(knots[:, 1:] - CARRIED_TO, 0) * FOREARM_WAY * self._size
        carried = self._spline(np.maximum(knots, [-np.inf, CARRIED_TO])) + behind
        curve = CubicSpline(np.linspace(0, 1, len(knots)), carried)(np.linspace(0, 1, STEPS))
        low, high = curve.min(0) - REACH_MM, curve.max(0) + REACH_MM
        boxed = np.nonzero(((self._xy > low) & (self._xy < high)).all(1))[0]
        nearest = KDTree(curve).query(self._xy[boxed], distance_upper_bound=REACH_MM)
        distance, place = map(np.asarray, nearest)
        found = np.isfinite(distance)
        return self._on[boxed[found]], distance[found].astype(np.float32), place[found] / (STEPS - 1)
