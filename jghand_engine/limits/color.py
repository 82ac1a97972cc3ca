"""Limits of colors."""

from __future__ import annotations

# ---- color (IEC 61966-2-1) -----------------------------------------------------------------------------------------
# below this sRGB value the curve is a straight line of this slope
SRGB_TOE = 0.04045
SRGB_SLOPE = 12.92
SRGB_OFFSET = 0.055
SRGB_EXPONENT = 2.4
