"""Limits of the kernels."""

from __future__ import annotations

# ---- native: threads ------------------------------------------------------------------------------------------------
# threads taken without being asked, at most; beyond this many nothing was measured
AUTOMATIC_THREADS = 8
