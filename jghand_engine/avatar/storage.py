"""How the arrays of an avatar are laid out in a file: exactly, or compactly at a small, known price.

| array        | exact        | compact               | price of compact, at most                                      |
| ------------ | ------------ | --------------------- | -------------------------------------------------------------- |
| position_m   | float32      | uint16 over their box | half a step: 1.5 µm for a box of 0.2 m                         |
| sigma_m      | float32      | float16               | 0.05 %                                                         |
| opacity, rgb | float32      | uint8                 | 1/510                                                          |
| ... linear   | float32      | uint16 of their root  | 1.6e-5, of dark colors less                                    |
| uvd          | float32      | uint16                | 1/131070                                                       |
| bone_weights | float32 x 21 | the 7 largest, uint16 | 1/65535 a weight, and what the eighth and smaller bones held   |

Compact is 39 bytes a Gaussian, exact 120. Unpacking what was packed from an unpacked avatar changes nothing more:
both ways agree bit for bit from the second time on. Weight columns are in standard joint order in a file. Colors of a
hand that was learned in known light are its albedo, scene-linear, and `albedo` in a compact file.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.orders import LEVEL_OF_STANDARD, STANDARD_OF_LEVEL

# weights per Gaussian in a compact file: on the built-in hand the rest holds at most 0.8 % of a row, 0.004 % on average
STORED_WEIGHTS = 7

UINT16_MAX = 65535
UINT8_MAX = 255


class Storage(StrEnum):
    """exact keeps every bit; compact is for avatars that are shipped or sent."""

    EXACT = "exact"
    COMPACT = "compact"


# the per-Gaussian arrays of an avatar: numpy float32, level order, shapes as in `HandAvatar`
ARRAY_NAMES = ("position_m", "sigma_m", "opacity", "rgb", "bone_weights", "uvd")
Arrays = dict[str, np.ndarray]


def expected_arrays(storage: Storage, *, linear: bool = False) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Name -> (safetensors dtype, shape without the leading N) of every per-Gaussian array in a file. linear: whether
    the colors are"""
    if storage is Storage.EXACT:
        return {
            "position_m": ("F32", (3,)),
            "sigma_m": ("F32", ()),
            "opacity": ("F32", ()),
            "rgb": ("F32", (3,)),
            "uvd": ("F32", (3,)),
            "bone_weights": ("F32", (JOINT_COUNT,)),
        }
    return {
        "position": ("U16", (3,)),
        "sigma_m": ("F16", ()),
        "opacity": ("U8", ()),
        **({"albedo": ("U16", (3,))} if linear else {"rgb": ("U8", (3,))}),
        "uvd": ("U16", (3,)),
        "weight": ("U16", (STORED_WEIGHTS,)),
        "weight_bone": ("U8", (STORED_WEIGHTS,)),
    }


def pack(arrays: Arrays, storage: Storage, *, linear: bool = False) -> tuple[dict[str, np.ndarray], list[list[float]]]:
    """Arrays as they stand in a file, and the box of the positions [[low], [high]] in meters (compact needs it).
    linear: whether the colors are"""
    position_m, weights = arrays["position_m"], arrays["bone_weights"][:, LEVEL_OF_STANDARD]
    box_m = [position_m.min(0).tolist(), position_m.max(0).tolist()]
    if storage is Storage.EXACT:
        return {name: np.ascontiguousarray(a) for name, a in (arrays | {"bone_weights": weights}).items()}, box_m
    bone, weight = largest_weights(weights)
    packed = {
        "position": on_grid(position_m, box_m),
        "sigma_m": arrays["sigma_m"].astype(np.float16),
        "opacity": np.rint(arrays["opacity"] * np.float64(UINT8_MAX)).astype(np.uint8),
        "uvd": np.rint(arrays["uvd"] * np.float64(UINT16_MAX)).astype(np.uint16),
        "weight": weight,
        "weight_bone": bone,
    }
    rgb = arrays["rgb"].astype(np.float64)
    if linear:
        packed["albedo"] = np.rint(UINT16_MAX * np.sqrt(rgb)).astype(np.uint16)
    else:
        packed["rgb"] = np.rint(UINT8_MAX * rgb).astype(np.uint8)
    return packed, box_m


def unpack(packed: dict[str, np.ndarray], storage: Storage, box_m: list[list[float]]) -> Arrays:
    """The inverse of `pack`. Bone indices must already be known to be below 21."""
    if storage is Storage.EXACT:
        return packed | {"bone_weights": np.ascontiguousarray(packed["bone_weights"][:, STANDARD_OF_LEVEL])}
    rgb = np.square(packed["albedo"] / UINT16_MAX) if "albedo" in packed else packed["rgb"] / UINT8_MAX
    return {
        "position_m": from_grid(packed["position"], box_m),
        "sigma_m": packed["sigma_m"].astype(np.float32),
        "opacity": (packed["opacity"] / UINT8_MAX).astype(np.float32),
        "rgb": rgb.astype(np.float32),
        "bone_weights": all_weights(packed["weight"], packed["weight_bone"]),
        "uvd": (packed["uvd"] / UINT16_MAX).astype(np.float32),
    }


def on_grid(position_m: np.ndarray, box_m: list[list[float]]) -> np.ndarray:
    """(N, 3) uint16: steps from the low corner of their box."""
    low, step = _steps(box_m)
    return np.rint((position_m - low) / np.where(step > 0, step, 1.0)).astype(np.uint16)


def from_grid(steps: np.ndarray, box_m: list[list[float]]) -> np.ndarray:
    """The inverse of `on_grid`, float32."""
    low, step = _steps(box_m)
    return (low + steps * step).astype(np.float32)


def _steps(box_m: list[list[float]]) -> tuple[np.ndarray, np.ndarray]:
    """Low corner and step of the position grid, meters, float64 (3,) each."""
    low, high = np.asarray(box_m, np.float64)
    return low, (high - low) / UINT16_MAX


def all_weights(weight: np.ndarray, bone: np.ndarray) -> np.ndarray:
    """(N, 21) float32 in level order: the inverse of `largest_weights`."""
    weights = np.zeros((len(weight), JOINT_COUNT))
    rows = np.arange(len(weights))[:, None]
    np.add.at(weights, (rows, LEVEL_OF_STANDARD[bone]), weight / UINT16_MAX)
    return weights.astype(np.float32)


def largest_weights(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest STORED_WEIGHTS columns, in standard order, of each row (uint8) and their shares in 1/65535 (uint16),
    adding up exactly.

    Rounded down first; what is missing goes to the largest remainders, so that a stored row packs to itself.
    """
    bone = np.argsort(-weights, axis=1, kind="stable")[:, :STORED_WEIGHTS]
    kept = np.take_along_axis(weights, bone, 1).astype(np.float64)
    share = kept / kept.sum(1, keepdims=True) * UINT16_MAX
    # a stored row comes back within rounding of whole numbers: floor must not take one away from those
    whole = np.floor(share + 1e-2)
    missing = (UINT16_MAX - whole.sum(1)).astype(int)
    rank = np.argsort(np.argsort(whole - share, axis=1, kind="stable"), axis=1, kind="stable")
    whole += rank < missing[:, None]
    return bone.astype(np.uint8), whole.astype(np.uint16)
