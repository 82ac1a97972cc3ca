"""From weights of joints to weights of bones.

A rig says "the skin follows joint j". Joint j turns the segment that *starts* at j, and our matrix B_i belongs to the
segment that *ends* at joint i. So the weight of joint j belongs to B_child(j): off by one here leaves every joint exact
and ruins the skin. The wrist's weight is shared by the metacarpals and, near the wrist, B_0 (METHOD 2.7).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from jghand_engine.avatar.validation import WEIGHT_SUM_TOLERANCE
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, PARENTS
from jghand_engine.hand.orders import JointOrder, to_level

if TYPE_CHECKING:
    import torch

# spread of the split of the wrist's weight over the metacarpals, meters (assumed; METHOD 2.7)
PALM_SPLIT_SIGMA_M = 0.012
# distance from the wrist over which the palm blends to the wrist matrix, meters (assumed)
WRIST_BLEND_M = 0.015
# weights below this are dropped and the rest renormalized: far joints would drag skin by fractions of a millimeter
WEIGHT_MIN = 1e-3

Array = TypeVar("Array", np.ndarray, "torch.Tensor")
TIPS = range(16, 21)
METACARPALS = range(1, 6)


def bone_weights(joint_weights: np.ndarray, vertices_m: np.ndarray, joints_m: np.ndarray) -> np.ndarray:
    """Weights of joints (V, 21), level order, to weights of bones (V, 21): column i belongs to the bone ending at i.

    vertices_m (V, 3) and joints_m (21, 3) are in the canonical frame. Tips must weigh nothing: no bone starts there.
    Raises InputError for rows that do not sum to 1, negative weights or weight on a tip.
    """
    check_weight_rows(joint_weights, "joint weights")
    if np.any(joint_weights[:, TIPS] > 0):
        raise InputError("joint weights", wanted="no weight on the tips", came="skin that follows a tip")
    result = np.zeros((len(joint_weights), JOINT_COUNT))
    for bone in range(6, JOINT_COUNT):
        result[:, bone] = joint_weights[:, PARENTS[bone]]
    result[:, :6] = joint_weights[:, :1] * palm_split(vertices_m, joints_m)
    return without_crumbs(result)


def columns_to_level(weights: np.ndarray, order: JointOrder) -> np.ndarray:
    """Sorts the columns of weights (V, 21), one per joint in `order`, into level order."""
    places = np.repeat(np.arange(JOINT_COUNT)[:, None], 3, axis=1)
    return weights[:, to_level(places, order)[:, 0]]


def palm_split(points_m: np.ndarray, joints_m: np.ndarray) -> np.ndarray:
    """(N, 6) shares, summing to 1, of B_0 and the bones 1..5 in what follows the wrist.

    Shares of the metacarpals fall off as exp(-d^2 / 2 sigma^2) with the distance d to each; B_0 takes over smoothly
    along +y (wrist to middle MCP) within WRIST_BLEND_M before the wrist, where the metacarpals meet and their distances
    say nothing any more. The blend goes by height, not by distance to the joint: skin is never near the wrist joint.
    """
    squared = np.stack([segment_distance(points_m, joints_m[0], joints_m[bone]) ** 2 for bone in METACARPALS], axis=1)
    # the smallest distance is taken out: far from all metacarpals every exponential would be 0
    share = np.exp((squared.min(axis=1, keepdims=True) - squared) / (2 * PALM_SPLIT_SIGMA_M**2))
    share /= share.sum(axis=1, keepdims=True)
    height = np.clip((points_m[:, 1] - joints_m[0, 1]) / WRIST_BLEND_M, 0, 1)
    wrist = 1 - height**2 * (3 - 2 * height)
    return np.concatenate([wrist[:, None], share * (1 - wrist[:, None])], axis=1)


def segment_distance(points_m: np.ndarray, start_m: np.ndarray, end_m: np.ndarray) -> np.ndarray:
    """(N,) distance of points (N, 3) to the segment between two points (3,)."""
    axis = end_m - start_m
    along = np.clip((points_m - start_m) @ axis / (axis @ axis), 0, 1)
    return np.linalg.norm(points_m - (start_m + along[:, None] * axis), axis=1)


def without_crumbs(weights: Array) -> Array:
    """Drops weights below WEIGHT_MIN and makes every row (N, 21) sum to 1 again. NumPy or torch."""
    kept = weights * (weights >= WEIGHT_MIN)
    return kept / kept.sum(1)[:, None]  # pyright: ignore[reportReturnType]


def check_weight_rows(weights: np.ndarray, name: str) -> None:
    """Raises InputError unless `weights` is (N, 21), finite, not negative, with rows that sum to 1."""
    if weights.ndim != 2 or weights.shape[1] != JOINT_COUNT:
        raise InputError(name, wanted=f"shape (N, {JOINT_COUNT})", came=f"{weights.shape}")
    if not np.isfinite(weights).all() or (weights < 0).any():
        raise InputError(name, wanted="finite numbers of at least 0", came="others")
    error = np.abs(weights.sum(axis=1) - 1).max(initial=0)
    if error > WEIGHT_SUM_TOLERANCE:
        raise InputError(name, wanted="rows that sum to 1", came=f"a row that is off by {error:.2g}")
