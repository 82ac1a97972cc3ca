"""Poses whose skin touches: fingers on the palm and side by side, the thumb on the fingers or at their tips.

What nearly touches is brought to touch, and what is inside other skin comes out: by the distances of the skin, because
bones say too little of how thick fingers are. What touches is pressed a little, as skin gives way. SKIN 8.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from jghand_engine.captures.making.rig import RiggedHand
from jghand_engine.captures.making.skin_gaps import FINGERS, NEIGHBORS, HandSkin, SkinGaps
from jghand_engine.hand.kinematics import RANGES_DEG

# skin that is nearer than this part of the hand's length (wrist to middle tip) is meant to touch: 5 mm
REACH_PART = 0.027
# the thumb lies across two fingers, and meets the second at an angle: 7 mm
THUMB_REACH_PART = 0.04
# how deep skin is in other skin where it touches, mm: tips press the palm, fingers lie side by side
TIP_MM, SIDE_MM, THUMB_MM = -1.2, -0.4, -0.5
# a finger's three flexions are multiplied by one factor from here to there, in so many steps
FACTORS, FACTOR_STEPS = (0.8, 1.2), 11
# fingers turn towards their neighbors by so much in a fist, degrees, and in so many steps
TURNS_DEG, TURN_STEPS = (-12.0, 24.0), 13
# halvings of the step in which skin begins to touch: to 1/4 of a degree
HALVINGS = 4
# a finger that is turned presses the palm elsewhere, and one that is bent is beside its neighbor elsewhere
ROUNDS = 2
# the thumb's search: millimeters that a degree away from its start weighs, the step of differences (less is within the
# noise of distances between vertices), and how often it steps
THUMB_PULL_MM, THUMB_STEP_DEG, THUMB_STEPS = 0.06, 1.0, 8
# it starts where the thumb is not in a finger: on its way to the thumb at rest by one of these parts. From inside, it
# would come out on the wrong side
LIFTS, LIFTED_MM = (0.0, 0.15, 0.3, 0.45, 0.6), -2.0
# the search must start within the ranges, not on them
ROUND_OFF_DEG = 1e-6


class Closing:
    """Closes poses of one hand by its skin."""

    def __init__(self, hand: RiggedHand) -> None:
        self.hand, self._skin = hand, HandSkin(hand.identity)
        length_mm = 1e3 * hand.finger_length_m
        self._reach_mm, self._thumb_reach_mm = REACH_PART * length_mm, THUMB_REACH_PART * length_mm

    def gaps(self, angles_deg: np.ndarray) -> SkinGaps:
        """Of a pose (5, 4)."""
        return self._skin.gaps(self.hand.skin(self.hand.pose(angles_deg[None]))[0])

    def closed(self, angles_deg: np.ndarray) -> np.ndarray:
        """(5, 4) angles, degrees -> the angles beside them at which skin that nearly touches does touch."""
        angles = np.clip(angles_deg, RANGES_DEG[..., 0], RANGES_DEG[..., 1])
        palm = self.gaps(angles).palm()
        on_palm = [finger for finger in FINGERS if palm[finger - 1] < self._reach_mm]
        pairs = [k for k, pair in enumerate(NEIGHBORS) if set(pair) <= set(on_palm)]
        for _ in range(ROUNDS if on_palm else 0):
            angles = self._pressed(angles, on_palm)
            # the last of them goes to a finger that goes itself
            angles = self._turned(self._turned(angles, [k for k in pairs if k < 2]), [k for k in pairs if k == 2])
        return self._thumb_on(self._pressed(angles, on_palm) if on_palm else angles)

    def _pressed(self, angles: np.ndarray, fingers: list[int]) -> np.ndarray:
        """The fingers bent until they press the palm."""
        rows = np.array(fingers)

        def bent(factors: np.ndarray) -> np.ndarray:
            trial = angles.copy()
            trial[np.ix_(rows, (0, 2, 3))] *= factors[:, None]
            return np.clip(trial, RANGES_DEG[..., 0], RANGES_DEG[..., 1])

        grid = np.linspace(*FACTORS, FACTOR_STEPS)
        return bent(_first_within(grid, len(rows), lambda f: self.gaps(bent(f)).palm()[rows - 1], TIP_MM))

    def _turned(self, angles: np.ndarray, pairs: list[int]) -> np.ndarray:
        """The first fingers of these NEIGHBORS turned until they are beside the others."""
        rows = [NEIGHBORS[pair][0] for pair in pairs]

        def turned(turns_deg: np.ndarray) -> np.ndarray:
            trial = angles.copy()
            trial[rows, 1] = turns_deg
            return trial

        grid = np.linspace(*TURNS_DEG, TURN_STEPS)
        if not pairs:
            return angles
        return turned(_first_within(grid, len(rows), lambda t: self.gaps(turned(t)).neighbors()[pairs], SIDE_MM))

    def _thumb_on(self, angles: np.ndarray) -> np.ndarray:
        """The thumb on the fingers that it nearly touches."""
        near = self.gaps(angles).thumb() < self._thumb_reach_mm
        if not near.any():
            return angles

        def placed(thumb: np.ndarray) -> np.ndarray:
            return np.concatenate([thumb[None], angles[1:]])

        def residuals(thumb: np.ndarray) -> np.ndarray:
            gaps = self.gaps(placed(thumb)).thumb() - THUMB_MM
            # the others must not be entered
            return np.append(np.where(near, gaps, np.minimum(gaps, 0)), THUMB_PULL_MM * (thumb - start))

        def jacobian(thumb: np.ndarray) -> np.ndarray:
            beside = np.where(thumb < (low + high) / 2, THUMB_STEP_DEG, -THUMB_STEP_DEG)
            here, columns = residuals(thumb), [residuals(thumb + step) for step in np.diag(beside)]
            return (np.stack(columns) - here).T / beside

        low, high = RANGES_DEG[0].T
        lifts = [(1 - part) * angles[0] for part in LIFTS]
        lifted = next((thumb for thumb in lifts if self.gaps(placed(thumb)).thumb().min() > LIFTED_MM), lifts[-1])
        start = np.clip(lifted, low + ROUND_OFF_DEG, high - ROUND_OFF_DEG)
        return placed(least_squares(residuals, start, jacobian, (low, high), max_nfev=THUMB_STEPS).x)


def _first_within(grid: np.ndarray, count: int, gaps: Callable[[np.ndarray], np.ndarray], wanted: float) -> np.ndarray:
    """(count,) values of the grid's range: of each the first at which its gap falls to `wanted`, else of its least.

    gaps: (count,) values -> (count,) gaps, each of its value. Deep inside they need not fall with it: hence a grid.
    """
    seen = np.stack([gaps(np.full(count, value)) for value in grid])
    within = seen <= wanted
    first = np.where(within.any(0), within.argmax(0), seen.argmin(0))
    high = grid[first]
    low = np.where(within.any(0), grid[np.maximum(first - 1, 0)], high)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        is_within = gaps(middle) <= wanted
        low, high = np.where(is_within, low, middle), np.where(is_within, middle, high)
    return high
