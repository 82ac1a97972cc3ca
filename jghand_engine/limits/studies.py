"""Limits of studies."""

from __future__ import annotations

# ---- studies --------------------------------------------------------------------------------------------------------
# accuracy of the paper's avatars (RENDERING 9.1): what an error beside it costs is said of a model as good as this, dB
MODEL_PSNR_DB = 33.4
# points on the skin of the transformation table: 1.4 mm apart, well below the distances that it tells apart
TRANSFORM_STUDY_POINTS = 20_000
