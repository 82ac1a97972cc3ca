"""Where the Gaussians of a hand that is going to be learned start: in a thin shell under the template's skin.

Placing takes some ten seconds of a processor, so points are kept in the user's cache folder: in files named by a digest
of all that decides them. What cannot be read or written there is as if there were no cache.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.torch
import scipy
import torch
from scipy.spatial import KDTree

from jghand_engine.errors import JGHandError
from jghand_engine.files import cache_folder, write_file
from jghand_engine.hand.joints import BONE_COUNT, JOINT_COUNT
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.sampling import FOREARM, bone_distances, sample_shell
from jghand_engine.template.weight_field import WeightField

# placed points that the cache keeps, the newest: 5 MB each at 40,000 Gaussians
POINTS_CACHE_FILES = 8
# Gaussians of the forearm for the same area, as a part of the hand's: nobody looks at its pores
FOREARM_DENSITY = 0.125
# how much wider its Gaussians start: many pictures end before it, and what none shows must have no holes
FOREARM_SPREAD = 1.5
PACKAGE = Path(__file__).resolve().parents[1]
# what placing is made of: a change of any of them makes other points, perhaps
_CODE = ("learn/canonical_points.py", "hand/joints.py", "avatar/avatar.py", "template/*.py")

Points = dict[str, torch.Tensor]


@dataclass(frozen=True)
class CanonicalPoints:
    """N points whose every prefix covers the hand; float32 but for the joints.

    position_m: (N, 3) · normal: (N, 3) unit, of the skin above · uvd: (N, 3) 0..1 · bone_weights: (N, 21)
    sigma_m: (N,) half the mean distance to the three nearest (METHOD 4.2), of the forearm more
    joints_m: (21, 3) float64, canonical
    template: its identifier
    """

    position_m: torch.Tensor
    normal: torch.Tensor
    uvd: torch.Tensor
    bone_weights: torch.Tensor
    sigma_m: torch.Tensor
    joints_m: torch.Tensor
    template: str

    def __len__(self) -> int:
        return self.position_m.shape[0]


def place_points(
    template: HandTemplate,
    count: int,
    *,
    depth_m: float,
    area_power: float,
    seed: int,
    depth_of_points: bool = False,
) -> CanonicalPoints:
    """`count` points in the shell of `depth_m` under the skin; the same arguments give the same points.

    area_power: bones share the points as their area to this power: 0 equally, as the paper does, 1 evenly over the
    skin; a forearm has FOREARM_DENSITY. depth_of_points: as of `sample_shell`.
    Points that were placed before come from the user's cache.
    """
    numbers = {"depth_m": depth_m, "area_power": area_power, "seed": seed, "depth_of_points": depth_of_points}
    file = points_file(template, {"count": count, **numbers})
    found = read_points(file)
    if found is None or not _is_of(found, count):
        placed = _placed(template, count, **numbers)
        write_points(file, {name: value.contiguous() for name, value in vars(placed).items() if name != "template"})
        return placed
    return CanonicalPoints(**found, template=template.identifier)


def _is_of(found: Points, count: int) -> bool:
    """Whether a file of the cache has the arrays of `count` points, in their shapes and types."""
    shapes = {"position_m": (count, 3), "normal": (count, 3), "uvd": (count, 3), "bone_weights": (count, JOINT_COUNT)}
    wanted = {name: (shape, torch.float32) for name, shape in {**shapes, "sigma_m": (count,)}.items()}
    wanted["joints_m"] = ((JOINT_COUNT, 3), torch.float64)
    return {name: (tuple(array.shape), array.dtype) for name, array in found.items()} == wanted


def _placed(template: HandTemplate, count: int, *, area_power: float, **numbers: Any) -> CanonicalPoints:
    counts = shared_out(bone_shares(template, area_power), count)
    sample = sample_shell(template, per_bone=int(counts.max()), **numbers)
    chosen = take_turns(sample.bone, counts)
    position_m = sample.position_m[chosen]
    nearest = np.asarray(KDTree(position_m).query(position_m, k=4)[0])[:, 1:]
    spread = np.where(sample.bone[chosen] == FOREARM, FOREARM_SPREAD, 1.0)
    return CanonicalPoints(
        position_m=torch.from_numpy(position_m).float(),
        normal=torch.from_numpy(sample.normal[chosen]).float(),
        uvd=torch.from_numpy(sample.uvd[chosen]).float(),
        bone_weights=WeightField.build(template).query(position_m).float(),
        sigma_m=torch.from_numpy(0.5 * spread * nearest.mean(1)).float(),
        joints_m=torch.from_numpy(template.joints_m.copy()),
        template=template.identifier,
    )


def bone_shares(template: HandTemplate, area_power: float) -> np.ndarray:
    """(20,) how many of the points are each bone's, in proportion; (21,) with those of a forearm."""
    areas = bone_areas(template)
    hand, forearm = areas[:BONE_COUNT], areas[BONE_COUNT:]
    shares = hand**area_power
    return np.concatenate([shares, FOREARM_DENSITY * forearm / hand.sum() * shares.sum()])


def bone_areas(template: HandTemplate) -> np.ndarray:
    """(20,) area of the closed surface that is nearest to each of the bones 1..20, square meters; (21,) with that of a
    forearm's skin."""
    corners = template.vertices_m[template.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    nearest = bone_distances(corners.mean(1), template.joints_m).argmin(1)
    nearest[template.is_forearm] = BONE_COUNT
    return np.bincount(nearest, area * template.has_points, minlength=BONE_COUNT)


def shared_out(share: np.ndarray, count: int) -> np.ndarray:
    """(B,) whole numbers in proportion to `share` (B,) that add up to `count`."""
    counts = np.floor(share / share.sum() * count).astype(int)
    counts[np.argsort(-share, kind="stable")[: count - counts.sum()]] += 1
    return counts


def take_turns(bone: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Indices (sum of counts,) into a sample.

    bone (M,) names the bone from 1 of each point, in farthest-point order within each bone. Bone b gives its first
    counts[b - 1] points, at even steps of the whole list, so that every prefix has the same shares.
    """
    picked = [np.flatnonzero(bone == number)[:count] for number, count in enumerate(counts, start=1)]
    turn = np.concatenate([(np.arange(count) + 0.5) / count for count in counts])
    order = np.argsort(turn, kind="stable")
    return np.concatenate(picked)[order]


# ---- the cache -------------------------------------------------------------------------------------------------------


def points_file(template: HandTemplate, numbers: Mapping[str, float]) -> Path:
    """The cache's file for the points of `template` under `numbers`, whether it is there or not."""
    libraries = [torch.__version__, np.__version__, scipy.__version__]
    about = [template.identifier, template.skin_face_count, template.forearm_face_count, dict(numbers), libraries]
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
        write_file(file, safetensors.torch.save(points))
        newest_first = sorted(file.parent.glob("points_*.safetensors"), key=lambda one: -one.stat().st_mtime)
        for old in newest_first[POINTS_CACHE_FILES:]:
            old.unlink(missing_ok=True)
