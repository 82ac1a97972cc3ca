"""JGHand's own procedural skin: reflectance from melanin and blood, and from marks (creases, veins, nails)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.captures.making.skin_marks import MM, TIPS, SkinMarks
from jghand_engine.captures.making.skin_points import Landmarks, SkinPoints, bump, noise, palm_share
from jghand_engine.color import srgb_to_linear

# how strongly pigments darken linear red, green, blue (relative, chosen by eye)
BLOOD = np.array([0.10, 0.62, 0.52])
MELANIN = np.array([0.34, 0.54, 0.72])
VENOUS = np.array([0.60, 0.30, 0.16])


@dataclass(frozen=True)
class SkinLook:
    """tone: sRGB of the palm in full light; warmth of the back, strength of marks and light are relative to 1."""

    tone: tuple[float, float, float] = (0.875, 0.685, 0.600)
    tan_of_back: float = 0.46
    blood: float = 1.0
    relief: float = 1.0
    gloss: float = 1.0
    exposure: float = 1.10
    seed: int = 0


def reflectance(points: SkinPoints, marks: SkinMarks, landmarks: Landmarks, look: SkinLook) -> np.ndarray:
    """Linear RGB reflectance (N, 3): the palm's tone, darkened by melanin (back), blood (pads, knuckles), veins."""
    p = points.position_m
    side = landmarks.palm_side(points)
    palm = palm_share(side)
    mottle = 0.5 * noise(p, 9 * MM, look.seed + 1) + 0.35 * noise(p, 4 * MM, look.seed + 2)
    speckle = noise(p, 1.1 * MM, look.seed + 3)
    blood = look.blood * (_warm_places(p, palm, side, landmarks) + 0.14 * mottle + 0.05 * speckle * palm)
    blood = blood + 0.55 * marks.crease + 0.30 * marks.wrinkle + 0.65 * marks.nail_fold
    tan = look.tan_of_back * (1 - palm) * (1 + 0.10 * noise(p, 3 * MM, look.seed + 4) + 0.06 * speckle)
    tan = tan + 0.30 * marks.wrinkle + 0.06 * noise(p, 25 * MM, look.seed + 5)
    pigment = blood[:, None] * BLOOD + tan[:, None] * MELANIN + 0.27 * marks.vein[:, None] * VENOUS
    skin = srgb_to_linear(np.array(look.tone)) * np.exp(-pigment)
    return _with_nails(skin, marks, look)


def _warm_places(p: np.ndarray, palm: np.ndarray, side: np.ndarray, landmarks: Landmarks) -> np.ndarray:
    """Amount of blood (N,): finger tips, knuckles, the cushions of the palm, the sides of fingers; 0 is the mean."""
    joints = landmarks.joints_m
    near = lambda at, width: bump(np.linalg.norm(p - at, axis=1), width * MM)  # noqa: E731
    warm = -0.06 + 0.10 * palm
    for tip in TIPS:
        warm = warm + 0.42 * near(joints[tip], 8.5) * (0.45 + 0.55 * palm)
        warm = warm + 0.12 * near(0.5 * (joints[tip] + joints[tip - 5]), 8)
    for joint, amount in (*((j, 0.38) for j in (7, 8, 9, 10)), *((j, 0.24) for j in (12, 13, 14, 15, 11, 6))):
        size = landmarks.joint_scale(joint)
        warm = warm + amount * size * near(joints[joint] - 4 * MM * landmarks.palmar[joint], 6.5 * size) * (1 - palm)
    for joint in (2, 3, 4, 5):
        warm = warm + 0.34 * near(joints[joint] - 8 * MM * landmarks.palmar[joint], 9) * (1 - palm)
        warm = warm + 0.16 * near(joints[joint] + 9 * MM * landmarks.palmar[joint], 9) * palm
    thenar, hypothenar = 0.45 * joints[1] + 0.55 * joints[6], 0.62 * joints[5]
    warm = warm + 0.22 * near(thenar, 17) * palm + 0.20 * near(hypothenar, 16) * palm
    return warm - 0.10 * near(np.array([0, 0.055, 0.01]), 18) * palm


def _with_nails(skin: np.ndarray, marks: SkinMarks, look: SkinLook) -> np.ndarray:
    tone = np.array(look.tone)
    bed = srgb_to_linear(np.clip(tone * [0.99, 0.95, 0.97] + [0.02, 0.0, 0.01], 0, 1))
    pale = srgb_to_linear(np.clip(0.62 * tone + 0.36, 0, 1))
    edge = srgb_to_linear(np.clip(0.45 * tone + [0.52, 0.50, 0.46], 0, 1))
    nail = bed + (pale - bed) * 0.5 * marks.lunula[:, None]
    nail = nail + (edge - nail) * 0.85 * marks.free_edge[:, None]
    return skin + (nail - skin) * marks.nail[:, None]
