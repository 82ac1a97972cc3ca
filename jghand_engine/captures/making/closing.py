"""Poses whose skin touches: fingers on the palm and side by side, the thumb on the fingers or at their tips.

What nearly touches is brought to touch, and what is inside other skin comes out: by the distances of the skin, because
bones say too little of how thick fingers are. What touches is pressed a little, as skin gives way (SKIN, Poses closed
by skin).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from jghand_engine.captures.making.rig import RiggedHand
from jghand_engine.captures.making.skin_gaps import FINGERS, IdentitySkin, SkinGaps
from jghand_engine.hand.kinematics import NEIGHBORS, RANGES_DEG

# skin that is nearer than this part of the hand's length (wrist to middle tip) is meant to touch: 5 mm
REACH_PART = 0.027
# the thumb lies across two fingers, and meets the second at an angle: 7 mm; others within so many times it are watched
THUMB_REACH_PART, THUMB_WATCH = 0.04, 3.0
# how deep skin is in other skin where it touches, mm: tips press the palm, fingers lie side by side
TIP_MM, SIDE_MM, THUMB_MM = -1.2, -0.4, -0.5
# a finger's three flexions are multiplied by one of these factors, and neighbors turn to one another by one of these
# angles; then again near what was found, because a turned finger meets the palm elsewhere, and a bent one its neighbor
FACTORS, TURNS_DEG = np.linspace(0.8, 1.2, 11), np.linspace(-12.0, 24.0, 13)
NEAR_FACTORS, NEAR_TURNS_DEG = np.linspace(0.94, 1.06, 5), np.linspace(-4.0, 4.0, 5)
# halvings of the step in which skin begins to touch: to 1/4 of a degree
HALVINGS = 4
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
        self.hand, self._skin = hand, IdentitySkin(hand.identity)
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
        pairs = [pair for pair in NEIGHBORS if set(pair) <= set(on_palm)]
        if not on_palm:
            return self._thumb_on(angles)
        for factors, turns_deg in ((FACTORS, TURNS_DEG), (NEAR_FACTORS, NEAR_TURNS_DEG)):
            angles = self._pressed(angles, on_palm, factors)
            # the pinky goes to a finger that goes itself
            for part in (slice(0, -1), slice(-1, None)):
                angles = self._turned(angles, pairs[part], turns_deg)
            angles = self._thumb_on(angles)
        # the ball of the thumb is a part of the palm
        return self._pressed(angles, on_palm, NEAR_FACTORS)

    def _pressed(self, angles: np.ndarray, fingers: list[int], factors: np.ndarray) -> np.ndarray:
        """The fingers bent until they press the palm."""

        def bent(chosen: np.ndarray) -> np.ndarray:
            trial = angles.copy()
            trial[np.ix_(fingers, (0, 2, 3))] *= chosen[:, None]
            return np.clip(trial, RANGES_DEG[..., 0], RANGES_DEG[..., 1])

        return bent(_first_within(factors, len(fingers), lambda f: self.gaps(bent(f)).palm(fingers), TIP_MM))

    def _turned(self, angles: np.ndarray, pairs: list[tuple[int, int]], turns_deg: np.ndarray) -> np.ndarray:
        """The first fingers of the pairs turned until they are beside the others."""
        fingers = [finger for finger, _ in pairs]

        def turned(chosen: np.ndarray) -> np.ndarray:
            trial = angles.copy()
            trial[fingers, 1] += chosen
            return np.clip(trial, RANGES_DEG[..., 0], RANGES_DEG[..., 1])

        if not pairs:
            return angles
        return turned(_first_within(turns_deg, len(pairs), lambda t: self.gaps(turned(t)).neighbors(pairs), SIDE_MM))

    def _thumb_on(self, angles: np.ndarray) -> np.ndarray:
        """The thumb on the fingers that it nearly touches."""
        before = self.gaps(angles).thumb()
        near = before < self._thumb_reach_mm
        if not near.any():
            return angles
        # the others must not be entered
        watched = [finger for finger in FINGERS if before[finger - 1] < THUMB_WATCH * self._thumb_reach_mm]
        near = near[np.array(watched) - 1]

        def placed(thumb: np.ndarray) -> np.ndarray:
            return np.concatenate([thumb[None], angles[1:]])

        def residuals(thumb: np.ndarray) -> np.ndarray:
            gaps = self.gaps(placed(thumb)).thumb(watched) - THUMB_MM
            return np.append(np.where(near, gaps, np.minimum(gaps, 0)), THUMB_PULL_MM * (thumb - start))

        def jacobian(thumb: np.ndarray) -> np.ndarray:
            beside = np.where(thumb < (low + high) / 2, THUMB_STEP_DEG, -THUMB_STEP_DEG)
            here, columns = residuals(thumb), [residuals(thumb + step) for step in np.diag(beside)]
            return (np.stack(columns) - here).T / beside

        low, high = RANGES_DEG[0].T
        lifts = [(1 - part) * angles[0] for part in LIFTS]
        lifted = next(
            (thumb for thumb in lifts if self.gaps(placed(thumb)).thumb(watched).min() > LIFTED_MM), lifts[-1]
        )
        start = np.clip(lifted, low + ROUND_OFF_DEG, high - ROUND_OFF_DEG)
        # the stubs know of named schemes alone
        found = least_squares(residuals, start, jacobian, (low, high), max_nfev=THUMB_STEPS)  # pyright: ignore[reportArgumentType]
        return placed(found.x)


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
