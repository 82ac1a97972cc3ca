"""What half precision costs: measured on what is written, not promised."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass
class HalfPrice:
    """What half precision lost so far. position_m, sigma, rgb, opacity, turn_deg: largest error of a center (meters),
    of a radius (as part of it), of a color and an opacity (0..1), of the axes of an ellipsoid (degrees) · squares_m2,
    coordinates: of the mean error of a coordinate."""

    position_m: float = 0.0
    sigma: float = 0.0
    rgb: float = 0.0
    opacity: float = 0.0
    turn_deg: float = 0.0
    squares_m2: float = 0.0
    coordinates: int = 0

    @property
    def rms_m(self) -> float:
        """Root of the mean square error of a coordinate, meters."""
        return math.sqrt(self.squares_m2 / max(self.coordinates, 1))

    def add_positions(self, values_m: np.ndarray) -> None:
        """(N, 3) coordinates that were rounded."""
        error_m = values_m - values_m.astype(np.float16).astype(np.float32)
        squares_m2 = (error_m * error_m).sum(axis=1)
        self.position_m = max(self.position_m, math.sqrt(float(squares_m2.max(initial=0.0))))
        self.squares_m2 += float(squares_m2.sum(dtype=np.float64))
        self.coordinates += values_m.size

    def add_sizes(self, scales_m: np.ndarray) -> None:
        """(N, 3) sizes that were rounded."""
        self.sigma = max(self.sigma, float(np.abs(_rounded(scales_m) / scales_m - 1).max(initial=0.0)))

    def add_colors(self, rgb: np.ndarray, harmonics: np.ndarray, factor: float) -> None:
        """(N, 3) colors whose harmonics were rounded: color = 0.5 + factor * harmonics."""
        self.rgb = max(self.rgb, float(np.abs(0.5 + factor * _rounded(harmonics) - rgb).max(initial=0.0)))

    def add_opacities(self, opacity: np.ndarray) -> None:
        """(N,) that were rounded."""
        self.opacity = max(self.opacity, float(np.abs(_rounded(opacity) - opacity).max(initial=0.0)))

    def add_turns(self, turns_xyzw: np.ndarray) -> None:
        """(N, 4) quaternions that were rounded; readers make them units again."""
        rounded, turns = _rounded(turns_xyzw).astype(np.float64), turns_xyzw.astype(np.float64)
        # a chord between unit quaternions; an angle of space is twice theirs
        chord = np.linalg.norm(_unit(rounded) - _unit(turns), axis=1).max(initial=0.0)
        self.turn_deg = max(self.turn_deg, math.degrees(4 * math.asin(float(chord) / 2)))

    def sentences(self) -> list[str]:
        """For who asked for it."""
        turned = f", and turned axes by up to {self.turn_deg:.2f} degrees" if self.turn_deg else ""
        return [
            f"Half precision moved centers by up to {1e3 * self.position_m:.3f} mm ({1e3 * self.rms_m:.3f} mm in the "
            f"mean of a coordinate), changed radii by up to {100 * self.sigma:.2f} %, colors by up to "
            f"{255 * self.rgb:.2f} and opacities by up to {255 * self.opacity:.2f} of 255{turned}.",
            "There is no variant points, nothing to fall back on for a USD without splats, and NVIDIA's rule VG.035, "
            "which wants floats, refuses the splats.",
        ]


def _rounded(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float16).astype(np.float32)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
