"""How a forearm bends and twists behind the wrist: slices along it, each of which turns about the wrist by its part.

The forearm's turn is split about the forearm's axis: it bends (flexion, deviation) within BEND_M, and its twist
(pronation) grows evenly from the wrist to where the forearm ends, as of real forearms, whose two bones cross. What the
palm carries in skin weights is carried by B_0 as ever; slices add how much they differ from B_0 to it: without a turn
they add zeros, and every point is where it was to the bit.
"""

from __future__ import annotations

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.rotations import quaternion_rotation, unit

# slices behind the wrist, meters. A centimeter apart where the wrist bends by up to 90 degrees: neighbors that differ
# by 30 degrees make the skin between them 3 % thinner. What is before the first one follows the palm
SLICES_M = np.array([-0.015, -0.005, 0.005, 0.015, 0.025, 0.035, 0.05, 0.065, 0.08, 0.095, 0.11, 0.125])
# the slices that move: the first one never does
SLICE_COUNT = len(SLICES_M) - 1
# from where to where the wrist bends, and the forearm twists. Shorter, the skin of a wrist bent by 90 degrees folds
BEND_M, TWIST_M = (-0.015, 0.035), (0.0, 0.125)
# what counts as 0 in a quaternion: round-off must not tell in which sense a half turn goes
ZERO = 1e-9

NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])


def unit_turns(turns: np.ndarray) -> np.ndarray:
    """(..., 4) quaternions w, x, y, z of any length as unit ones, each of the two of a rotation as the same one, that
    of at most a half turn. InputError for what is none."""
    try:
        numbers = np.asarray(turns, np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    length = np.linalg.norm(numbers, axis=-1, keepdims=True) if numbers.shape[-1:] == (4,) else np.nan
    if not np.all(np.isfinite(length) & (length > ZERO)):
        raise InputError("turn of a forearm", wanted="a quaternion w, x, y, z", came=str(turns)[:80])
    turns = numbers / length
    largest = np.take_along_axis(turns[..., 1:], np.abs(turns[..., 1:]).argmax(-1)[..., None], -1)
    leading = np.where(np.abs(turns[..., :1]) > ZERO, turns[..., :1], largest)
    return np.where(leading < 0, -turns, turns)


def slice_shares(behind_m: np.ndarray) -> np.ndarray:
    """(N, SLICE_COUNT) how much of the slices that move is at places (N,) behind the wrist, meters: at most two, which
    share linearly; all of the last one beyond it."""
    return np.stack([np.interp(behind_m, SLICES_M, row) for row in np.eye(len(SLICES_M))[1:]], 1)


class Wrist:
    """The wrist of one canonical right hand.

    palm: (3, 3) its palm's frame · way: (3,) from the wrist along the forearm
    """

    def __init__(self, palm: np.ndarray, way: np.ndarray) -> None:
        self._palm, self._axis = palm, palm.T @ unit(way)
        bend = ((SLICES_M[1:] - BEND_M[0]) / np.ptp(BEND_M)).clip(0, 1)
        self._bent = bend * bend * (3 - 2 * bend)
        self._twisted = ((SLICES_M[1:] - TWIST_M[0]) / np.ptp(TWIST_M)).clip(0, 1)

    def changes(self, palm_map: np.ndarray, turn: np.ndarray | None) -> np.ndarray:
        """(SLICE_COUNT, 3, 4) by how much the maps of the slices differ from B_0.

        palm_map: (3, 4) B_0, root-relative · turn: (4,) of the forearm in the axes of the palm, see `HandPose`
        """
        result = np.zeros((SLICE_COUNT, 3, 4))
        if turn is not None:
            turned = self._palm @ (self.slice_rotations(turn) - np.eye(3)) @ self._palm.T
            result[:, :, :3] = palm_map[:, :3] @ turned
        return result

    def slice_rotations(self, turn: np.ndarray) -> np.ndarray:
        """(SLICE_COUNT, 3, 3) of the slices in the palm's axes."""
        turn = unit_turns(turn)
        twist = np.array([turn[0], *(turn[1:] @ self._axis * self._axis)])
        # a forearm that is folded back by a half turn has no twist of its own
        twist = unit_turns(twist) if np.linalg.norm(twist) > ZERO else NO_TURN
        bend = unit_turns(_product(turn, twist * (1, -1, -1, -1)))
        return quaternion_rotation(_part(bend, self._bent)) @ quaternion_rotation(_part(twist, self._twisted))


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def _part(turn: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(N, 4) rotations about the axis of one (4,) by a part (N,) of its angle."""
    sine = np.linalg.norm(turn[1:])
    half = part * np.arctan2(sine, turn[0])
    axis = turn[1:] / sine if sine > 0 else turn[1:]
    return np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * axis], 1)
