"""Canonical points that were placed before, in the user's cache folder: placing takes some ten seconds of a processor.

A file is named by a digest of all that decides its points: the template, the numbers, and the code that places them.
What cannot be read or written is as if there were no cache.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import safetensors
import safetensors.torch
import scipy
import torch

from jghand_engine.errors import JGHandError
from jghand_engine.files import cache_folder, writing
from jghand_engine.template.mesh import HandTemplate

# placed points that the user's cache keeps, the newest: 5 MB each at 40,000 Gaussians
POINTS_CACHE_FILES = 8

PACKAGE = Path(__file__).resolve().parents[1]
# what placing is made of: a change of any of them makes other points, perhaps
_CODE = ("learn/canonical_points.py", "hand/joints.py", "avatar/avatar.py", "template/*.py")

Points = dict[str, torch.Tensor]


def points_file(template: HandTemplate, numbers: Mapping[str, float]) -> Path:
    """The file for the points of `template` under `numbers`, whether it is there or not."""
    libraries = [torch.__version__, np.__version__, scipy.__version__]
    about = [template.identifier, template.skin_face_count, dict(numbers), libraries]
    digest = hashlib.sha256(json.dumps(about).encode())
    for array in (template.vertices_m, template.faces, template.face_uv, template.bone_weights, template.joints_m):
        digest.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())
    for pattern in _CODE:
        for file in sorted(PACKAGE.glob(pattern)):
            digest.update(file.read_bytes())
    return cache_folder() / f"points_{digest.hexdigest()[:24]}.safetensors"


def read_points(file: Path) -> Points | None:
    """The tensors in a file of the cache, None where there is none that can be read."""
    try:
        return safetensors.torch.load(file.read_bytes())
    except (OSError, safetensors.SafetensorError):
        return None


def write_points(file: Path, points: Points) -> None:
    """Writes a file of the cache, whole or not at all, and removes the oldest beyond POINTS_CACHE_FILES."""
    with contextlib.suppress(JGHandError, OSError):
        with writing(file) as temporary:
            temporary.write_bytes(safetensors.torch.save(points))
        newest_first = sorted(file.parent.glob("points_*.safetensors"), key=lambda one: -one.stat().st_mtime)
        for old in newest_first[POINTS_CACHE_FILES:]:
            old.unlink(missing_ok=True)
