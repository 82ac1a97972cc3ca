"""What a fit weighs: where landmarks lie, where bones point, what hands do, and how steadily. All but pictures.

Weights were chosen on one rendered film of a man's hand. Angles are finger by finger: flexion and abduction of the
first joint, flexion of the second and third.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from jghand_engine.hand.joints import PARENTS
from jghand_engine.hand.shapes import named_angles
from jghand_engine.own.masks import hand_size_px
from jghand_engine.own.start import Start
from jghand_engine.track.costs import REST_RAD
from jghand_engine.track.poses import LIMITS_RAD

# error of a landmark, part of the hand's length in the picture; of a bone's direction by the detector
LANDMARK_SIGMA, DIRECTION_SIGMA = 0.03, 0.5
# the detector's wrist lies a tenth of the hand off ours, and the thumb's first joint too
WRIST_TRUST, THUMB_TRUST = 0.1, 0.2
# errors beyond this many standard deviations count less and less (Cauchy's loss)
ROBUST_SIGMAS = 2.0
LIMIT_WEIGHT, REST_WEIGHT, ABDUCTION_WEIGHT = 200.0, 0.02, 0.05
# tendons bend a finger's last joint with the one before; without it the fit bends the last one to shorten a finger
COUPLING_WEIGHT, COUPLING, COUPLING_REST_RAD, COUPLING_SIGMA_RAD = 0.05, 0.6, 0.03, 0.2
# neighboring fingers bend alike
ALIKE_WEIGHT, ALIKE_SIGMA_RAD = 0.01, 0.4
# second differences at that rate: of angles, of the wrist's place in meters, of the palm's turn. A tracker's strength,
# fifteen times as much, would hide what pictures say
SMOOTH_WEIGHT, SMOOTH_ANGLE, SMOOTH_PLACE, SMOOTH_TURN, SMOOTH_FPS = 0.02, 6.0, 1500.0, 6.0, 7.5
# lengths of bones as logarithms, shifts of the palm's first joints, shapes in standard deviations
LENGTH_WEIGHT, LENGTH_SIGMA = 0.02, 0.07
SHIFT_WEIGHT, SHIFT_SIGMA_M = 0.02, 0.003
# the skin of two hands is nearest to the true one with this; more makes hands thin, less makes one of them thick
SHAPE_WEIGHT = 0.0015
# pictures of the flat hand square to the camera, which are the ruler: angles and the palm's slope there
GUIDE_WEIGHT, GUIDE_ANGLE_SIGMA_RAD, GUIDE_SLOPE_SIGMA = 0.1, math.radians(8.0), 0.2
# the detector's mean flexion and the palm's tilt there are below these, and at most so many count of each side
GUIDE_FLEXION_DEG, GUIDE_TILT_DEG, GUIDES_MAX = 25.0, 25.0, 6

_FINGER_PARENTS = list(PARENTS[1:])
_OPEN_RAD = np.radians(named_angles("open")).reshape(-1)


@dataclass(frozen=True)
class Evidence:
    """What the detector says of F pictures.

    landmarks_px: (F, 21, 2), 0 where it saw no hand · size_px: (F,) about the hand's length, 1 there
    directions: (F, 20, 3) unit · seen: (F,) 0 or 1
    guides: (F,) bool, pictures of the flat hand, see `guides` · time_s: (F,); None of photographs
    """

    landmarks_px: Tensor
    size_px: Tensor
    directions: Tensor
    seen: Tensor
    guides: Tensor
    time_s: Tensor | None

    @classmethod
    def of(cls, start: Start, time_s: np.ndarray | None, dtype: torch.dtype) -> Evidence:
        """time_s: of a film's pictures; None of photographs, which have nothing to do with one another"""
        landmarks = np.nan_to_num(start.landmarks_px)
        return cls(
            torch.from_numpy(landmarks).to(dtype),
            torch.from_numpy(hand_size_px(landmarks)).to(dtype).clamp_min(1),
            torch.from_numpy(np.nan_to_num(start.detector_directions)).to(dtype),
            torch.from_numpy(start.seen).to(dtype),
            torch.from_numpy(guides(start.detector_directions)),
            None if time_s is None else torch.from_numpy(time_s).to(dtype),
        )


def flat_hands(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(F,) degrees by which fingers are bent, those by which the palm is tilted from the camera, and which of its sides
    is seen, -1 or 1; by the detector's directions (F, 20, 3)."""
    levels = directions.reshape(len(directions), 4, 5, 3)[:, :, 1:]
    cosine = (levels[:, 1:] * levels[:, :-1]).sum(-1).clip(-1, 1)
    flexion = np.degrees(np.arccos(cosine)).mean((1, 2))
    palm = np.cross(levels[:, 0, :-1], levels[:, 0, 1:]).sum(1)
    facing = palm[:, 2] / np.maximum(np.linalg.norm(palm, axis=1), 1e-9)
    return flexion, np.degrees(np.arccos(np.abs(facing).clip(0, 1))), np.sign(facing)


def guides(directions: np.ndarray) -> np.ndarray:
    """(F,) bool: the pictures of the flat palm, and of the flat back, by the detector's directions (F, 20, 3)."""
    flexion, tilt, shown = flat_hands(directions)
    flat = (flexion < GUIDE_FLEXION_DEG) & (tilt < GUIDE_TILT_DEG)
    chosen = np.zeros(len(directions), bool)
    for side in (-1, 1):
        of_side = np.flatnonzero(flat & (shown == side))
        chosen[of_side[np.argsort(flexion[of_side] + tilt[of_side])[:GUIDES_MAX]]] = True
    return chosen


def robust(squared: Tensor) -> Tensor:
    """Cauchy's loss of squared errors in standard deviations."""
    return ROBUST_SIGMAS**2 * torch.log1p(squared / ROBUST_SIGMAS**2)


def landmark_term(evidence: Evidence, pictures: Tensor, joints_px: Tensor) -> Tensor:
    """joints_px: (B, 21, 2) of those pictures"""
    trust = torch.ones(joints_px.shape[1]).to(joints_px)
    trust[0], trust[1] = WRIST_TRUST, THUMB_TRUST
    sigma_px = LANDMARK_SIGMA * evidence.size_px[pictures, None]
    away = ((joints_px - evidence.landmarks_px[pictures]) ** 2).sum(-1) / sigma_px**2
    return ((trust * robust(away)).mean(-1) * evidence.seen[pictures]).mean()


def direction_term(evidence: Evidence, pictures: Tensor, directions: Tensor) -> Tensor:
    """directions: (B, 20, 3) unit, of the bones in those pictures"""
    away = ((directions - evidence.directions[pictures]) ** 2).sum(-1) / DIRECTION_SIGMA**2
    return (robust(away).mean(-1) * evidence.seen[pictures]).mean()


def anatomy_terms(angle_rad: Tensor) -> Tensor:
    """What hands do and do not, of angles (B, 20)."""
    limits = torch.from_numpy(LIMITS_RAD).to(angle_rad)
    over = angle_rad - angle_rad.clamp(limits[:, 0], limits[:, 1])
    rest = angle_rad - torch.from_numpy(REST_RAD).to(angle_rad)
    fingers = angle_rad.unflatten(-1, (5, 4))[:, 1:]
    first, second, third = fingers[..., 0], fingers[..., 2], fingers[..., 3]
    coupled = (third - COUPLING * second - COUPLING_REST_RAD) / COUPLING_SIGMA_RAD
    unlike = sum(((bend.diff(dim=-1) / ALIKE_SIGMA_RAD) ** 2).mean() for bend in (first, second))
    return (
        LIMIT_WEIGHT * (over**2).sum(-1).mean()
        + REST_WEIGHT * (rest**2).mean()
        + ABDUCTION_WEIGHT * (angle_rad[:, 1::4] ** 2).mean()
        + COUPLING_WEIGHT * (coupled**2).mean()
        + ALIKE_WEIGHT * unlike
    )


def guide_term(evidence: Evidence, pictures: Tensor, angle_rad: Tensor, directions: Tensor) -> Tensor:
    """Flat hands are flat: angles (B, 20) and directions (B, 20, 3) of those pictures."""
    bent = ((angle_rad - torch.from_numpy(_OPEN_RAD).to(angle_rad)) / GUIDE_ANGLE_SIGMA_RAD) ** 2
    slope = (directions[:, 1:5, 2] / GUIDE_SLOPE_SIGMA) ** 2
    off = bent.mean(-1) + slope.mean(-1)
    return GUIDE_WEIGHT * (off * evidence.guides[pictures].to(off)).mean()


def smooth_term(time_s: Tensor | None, angle_rad: Tensor, place_m: Tensor, turn: Tensor) -> Tensor:
    """Of all pictures: angles (F, 20), places (F, 3), turns (F, 3, 3). Accelerations are white noise, so that a second
    difference counts by the cube of the rate."""
    if time_s is None or len(time_s) < 3:
        return angle_rad.new_zeros(())
    step = time_s.diff()
    span = (step[1:] + step[:-1]) / 2 * SMOOTH_FPS

    def uneven(values: Tensor) -> Tensor:
        speed = values.diff(dim=0) / (step * SMOOTH_FPS)[:, None]
        return ((speed.diff(dim=0) / span[:, None]) ** 2).sum(-1)

    both = SMOOTH_ANGLE * uneven(angle_rad) + SMOOTH_PLACE * uneven(place_m) + SMOOTH_TURN * uneven(turn.flatten(1))
    return SMOOTH_WEIGHT * (span * both).mean()


def hand_term(log_length: Tensor, palm_shift_m: Tensor, shape: Tensor) -> Tensor:
    """How likely a hand is: bones (20,), first joints (5, 3), shape (K,). The whole hand's size is no bone's length."""
    length = log_length - log_length.mean()
    return (
        LENGTH_WEIGHT * ((length / LENGTH_SIGMA) ** 2).mean()
        + SHIFT_WEIGHT * ((palm_shift_m / SHIFT_SIGMA_M) ** 2).mean()
        + SHAPE_WEIGHT * (shape**2).sum()
    )


def directions_of(joints_m: Tensor) -> Tensor:
    """(..., 20, 3) unit, of bones 1..20."""
    bones = joints_m[..., 1:, :] - joints_m[..., _FINGER_PARENTS, :]
    return bones / bones.norm(dim=-1, keepdim=True)
