"""The skin of the painted hand: creases, knuckle wrinkles, palm lines, veins, tendons and nails, and a reflectance from
melanin, blood and these marks.

Each mark gives a height (meters, for the relief that the light sees) and an amount 0..1 (for the color). Positions
are those of the built-in template's canonical hand; along fingers they are relative to its joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from jghand_engine.captures.making.skin import SkinPoints, noise
from jghand_engine.captures.skin.noise import gauss, smoothstep
from jghand_engine.color import srgb_to_linear
from jghand_engine.hand.joints import JOINT_COUNT, PARENTS
from jghand_engine.hand.rotations import unit

MM = 1e-3
FINGER_JOINTS = {"mcp": (2, 3, 4, 5), "pip": (7, 8, 9, 10), "dip": (12, 13, 14, 15)}
TIPS = (16, 17, 18, 19, 20)

# palm lines as points (x, y) in millimeters, width and depth in millimeters; +x is the index side
PALM_LINES = (
    (((-44, 55), (-33, 62), (-20, 67), (-8, 72), (3, 80), (11, 91)), 0.62, 0.60),  # heart
    (((36, 80), (24, 76), (10, 69), (-6, 59), (-20, 47), (-30, 38)), 0.60, 0.55),  # head
    (((36, 79), (25, 71), (15, 58), (9, 43), (7, 27), (10, 12), (14, 4)), 0.68, 0.65),  # life
    (((-3, 14), (-4, 34), (-3, 54), (-1, 70)), 0.45, 0.22),  # fate
    (((-26, 3), (-10, 1), (8, 2), (24, 6)), 0.60, 0.45),  # bracelet
    (((-24, -3), (-9, -5), (9, -4), (22, 0)), 0.50, 0.30),
    (((23, 66), (27, 54), (29, 42)), 0.40, 0.18),  # small lines of the thenar
    (((-30, 52), (-22, 40), (-18, 28)), 0.40, 0.16),
    (((-12, 80), (-16, 70), (-22, 62)), 0.40, 0.16),
    (((14, 84), (8, 76), (2, 70)), 0.38, 0.15),
    (((30, 30), (24, 36), (16, 38)), 0.38, 0.14),
    (((-38, 44), (-30, 42), (-20, 45)), 0.38, 0.14),
)
# veins of the back: points (x, y), width and height in millimeters
VEINS = (
    (((11, 86), (11, 72), (7, 57), (2, 42), (5, 24), (11, 8), (14, -4)), 1.1, 0.42),
    (((-10, 82), (-7, 68), (-4, 55), (2, 42)), 0.95, 0.36),
    (((-28, 73), (-25, 58), (-18, 42), (-15, 22), (-17, 4), (-17, -6)), 1.1, 0.42),
    (((-7, 68), (-15, 62), (-25, 58)), 0.85, 0.30),
    (((-18, 42), (-9, 34), (4, 28)), 0.8, 0.24),
    (((36, 52), (28, 38), (24, 22), (22, 6)), 1.0, 0.34),
)
# extensor tendons from knuckle to wrist: (first joint of the finger, height in millimeters)
TENDONS = ((2, 0.45), (3, 0.50), (4, 0.40), (5, 0.30))
# how strongly pigments darken linear red, green, blue (relative, chosen by eye)
BLOOD = np.array([0.10, 0.62, 0.52])
MELANIN = np.array([0.34, 0.54, 0.72])
VENOUS = np.array([0.60, 0.30, 0.16])
# opposite to the normal of the built-in template's thumb nail: where the thumb's pad is, canonical frame
THUMB_PALMAR = np.array([-0.93, 0.26, 0.27])
OUT_OF_PALM = np.array([0.0, 0.0, 1.0])
THUMB_METACARPAL, THUMB_PROXIMAL, THUMB_DISTAL, THUMB_TIP = 1, 6, 11, 16
# the two bones at a PIP and at a DIP joint of a usual index finger, meters; the first DIP joint
USUAL_BONES_M = (0.049, 0.045)
FIRST_DIP = 11
# n . palmar over which the skin of the palm turns into that of the back
SIDE_BLEND = 0.45


@dataclass(frozen=True)
class Landmarks:
    """Directions of a canonical hand.

    joints_m: (21, 3) meters; axis: (21, 3) unit direction of bone i, from parent(i) to joint i, row 0 that of bone 3;
    palmar: (21, 3) unit directions, perpendicular to the bone, to which it flexes; lateral: axis x palmar, (21, 3).
    """

    joints_m: np.ndarray
    axis: np.ndarray
    palmar: np.ndarray
    lateral: np.ndarray

    @classmethod
    def of(cls, joints_m: np.ndarray) -> Landmarks:
        """joints_m (21, 3) meters, level order, canonical frame, right hand."""
        bones = np.array([joints_m[3], *(joints_m[i] - joints_m[PARENTS[i]] for i in range(1, JOINT_COUNT))])
        axis = unit(bones)
        palmar = np.tile(OUT_OF_PALM, (JOINT_COUNT, 1))
        palmar[[THUMB_PROXIMAL, THUMB_DISTAL, THUMB_TIP]] = THUMB_PALMAR
        palmar[THUMB_METACARPAL] = OUT_OF_PALM + 0.5 * THUMB_PALMAR
        palmar = unit(palmar - (palmar * axis).sum(1, keepdims=True) * axis)
        return cls(joints_m, axis, palmar, np.cross(axis, palmar))

    def palm_side(self, points: SkinPoints) -> np.ndarray:
        """(N,) -1 where the skin faces away from the flexion side of its bone (back), +1 towards it (palm)."""
        palmar = unit(points.bone_weights @ self.palmar)
        return (points.normal * palmar).sum(1)

    def joint_scale(self, joint: int) -> float:
        """Size of a finger at one of its joints 6..15, relative to an index finger: from the lengths of its bones."""
        length_m = np.linalg.norm(self.joints_m[joint + 5] - self.joints_m[joint])
        length_m += np.linalg.norm(self.joints_m[joint] - self.joints_m[joint - 5])
        usual_m = USUAL_BONES_M[joint >= FIRST_DIP]
        return float(np.clip(length_m / usual_m, 0.6, 1.1))

    def hinge_axis(self, joint: int) -> np.ndarray:
        """(3,) the direction of the finger at `joint`: between its two bones."""
        child = joint + 5
        return self.axis[joint] if child >= JOINT_COUNT else unit(self.axis[joint] + self.axis[child])


def palm_share(side: np.ndarray) -> np.ndarray:
    """(N,) 0 on the back, 1 on the palm, smooth at the edge of the hand."""
    return smoothstep(-SIDE_BLEND, SIDE_BLEND, side)


@dataclass(frozen=True)
class SkinMarks:
    """Amounts 0..1 (N,) of each mark, and the height of the relief in meters (N,)."""

    height_m: np.ndarray
    crease: np.ndarray
    wrinkle: np.ndarray
    vein: np.ndarray
    nail: np.ndarray
    nail_fold: np.ndarray
    lunula: np.ndarray
    free_edge: np.ndarray


@dataclass(frozen=True)
class NailShape:
    """The outline of one nail in the plane of its bone's axis and lateral direction, meters from the tip joint."""

    tip: int
    center_axial_m: float
    center_lateral_m: float
    half_length_m: float
    half_width_m: float


def fit_nails(points: SkinPoints, marks: Landmarks) -> tuple[NailShape, ...]:
    """The outlines of the nails from the points that lie on one; fingers without such points get none."""
    shapes = []
    for tip in TIPS:
        on = (points.nail > 0.5) & (points.bone_weights[:, tip] > 0.3)
        if on.sum() < 20:
            continue
        relative = points.position_m[on] - marks.joints_m[tip]
        low_a, high_a = np.percentile(relative @ marks.axis[tip], (2, 98))
        low_l, high_l = np.percentile(relative @ marks.lateral[tip], (2, 98))
        shapes.append(
            NailShape(tip, (low_a + high_a) / 2, (low_l + high_l) / 2, (high_a - low_a) / 2, (high_l - low_l) / 2)
        )
    return tuple(shapes)


class MarkPainter:
    """Evaluates the marks at any position near the skin, the side of the hand held: so that relief has a slope."""

    def __init__(self, points: SkinPoints, marks: Landmarks) -> None:
        self._marks = marks
        self._side = marks.palm_side(points)
        self._palm = palm_share(self._side)
        self._weights = points.bone_weights
        self._nails = fit_nails(points, marks)

    def paint(self, position_m: np.ndarray) -> SkinMarks:
        """The marks at `position_m` (N, 3), which lie near the points given to the constructor."""
        line, line_depth_m = self._palm_lines(position_m)
        fold = self._finger_creases(position_m)
        crease = line + fold
        wrinkle = self._knuckles(position_m)
        vein, vein_height = self._curves(position_m, VEINS)
        on_back = smoothstep(0.1, 0.6, -self._side) * (1 - smoothstep(92 * MM, 98 * MM, position_m[:, 1]))
        nails = self._nail_parts(position_m)
        skin = 1 - nails["nail"]
        height = (
            -0.50 * MM * np.clip(fold, 0, 1.3)
            - line_depth_m
            - 0.48 * MM * wrinkle * skin
            + MM * vein_height * on_back
            + self._tendons(position_m) * on_back
            + self._texture(position_m) * skin
            + self._cushions(position_m)
            + nails.pop("height")
        )
        return SkinMarks(height, np.clip(crease, 0, 1), wrinkle * skin, vein * on_back, **nails)

    def _curves(self, position_m: np.ndarray, curves: tuple) -> tuple[np.ndarray, np.ndarray]:
        """Amount 0..1 and height in millimeters of soft curves drawn in the plane of the palm."""
        wobble = np.stack([noise(position_m, 13 * MM, 71), noise(position_m, 13 * MM, 72)], 1) * 1.0 * MM
        xy = position_m[:, :2] + wobble
        deepest = max(depth for _, _, depth in curves)
        amount, height = np.zeros(len(xy)), np.zeros(len(xy))
        for knots, width, depth in curves:
            distance_m, along = _distance_to_curve(xy, np.array(knots, float) * MM)
            taper = smoothstep(0, 0.12, along) * (1 - smoothstep(0.80, 1, along))
            width_m = width * MM * (0.55 + 0.45 * taper)
            line = gauss(distance_m, width_m) * (0.25 + 0.75 * taper)
            # the skin dips gently towards a line, not only in it
            dip = 0.35 * gauss(distance_m, 3.2 * width_m) * taper
            amount = np.maximum(amount, line * depth / deepest)
            height = np.maximum(height, (line + dip) * depth)
        return amount, height

    def _palm_lines(self, position_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Amount 0..1 and depth in meters."""
        amount, height_mm = self._curves(position_m, PALM_LINES)
        towards_palm = smoothstep(0.0, 0.55, self._side)
        return amount * towards_palm, MM * height_mm * towards_palm

    def _along(self, position_m: np.ndarray, joint: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Axial and lateral distance from a joint, and a mask of its surroundings on the same finger."""
        axis = self._marks.hinge_axis(joint)
        relative = position_m - self._marks.joints_m[joint]
        child = joint + 5
        own = self._weights[:, joint] + (self._weights[:, child] if child < 21 else 0)
        return relative @ axis, relative @ self._marks.lateral[joint], smoothstep(0.35, 0.75, own)

    def _finger_creases(self, position_m: np.ndarray) -> np.ndarray:
        """Flexion creases: at the base of each finger, double at the middle joints, single at the last ones."""
        flexion = smoothstep(-0.25, 0.35, self._side)
        total = np.zeros(len(position_m))
        wave = noise(position_m, 5 * MM, 21) * 0.35 * MM
        patchy = 0.75 + 0.25 * noise(position_m, 3 * MM, 22)
        lines = [(j, ((-1.4, 0.42, 0.80), (1.5, 0.40, 0.70), (3.4, 0.3, 0.22))) for j in FINGER_JOINTS["pip"]]
        lines += [(j, ((-0.4, 0.40, 0.75), (1.4, 0.30, 0.25))) for j in FINGER_JOINTS["dip"]]
        lines += [(11, ((-1.0, 0.42, 0.75), (1.6, 0.36, 0.45))), (6, ((-1.0, 0.42, 0.55), (2.4, 0.36, 0.35)))]
        for joint, offsets in lines:
            axial, lateral, near = self._along(position_m, joint)
            bow = 0.10 * lateral**2 / (8 * MM)
            for offset, width, depth in offsets:
                total += near * depth * gauss(axial - offset * MM + bow + wave, width * MM)
        for joint in FINGER_JOINTS["mcp"]:
            axis, length_m = self._marks.axis[joint + 5], self._bone_length_m(joint + 5)
            relative = position_m - self._marks.joints_m[joint]
            lateral = relative @ self._marks.lateral[joint + 5]
            near = smoothstep(0.35, 0.75, self._weights[:, joint + 5]) * (np.abs(lateral) < 14 * MM)
            for part, depth in ((0.60, 0.75), (0.68, 0.30)):
                total += near * depth * gauss(relative @ axis - part * length_m + wave, 0.45 * MM)
        return total * flexion * np.clip(patchy, 0, 1.1)

    def _bone_length_m(self, bone: int) -> float:
        return float(np.linalg.norm(self._marks.joints_m[bone] - self._marks.joints_m[bone - 5]))

    def _knuckles(self, position_m: np.ndarray) -> np.ndarray:
        """Fine transverse wrinkles on the back of the joints, bowed around the knuckle."""
        total = np.zeros(len(position_m))
        wave = noise(position_m, 3.5 * MM, 31) * 0.30 * MM
        patchy = np.clip(0.75 + 0.35 * noise(position_m, 2.2 * MM, 32), 0.1, 1.2)
        for joints, spread, spacing, depth in (
            ((7, 8, 9, 10), 5.0, 2.1, 1.0),
            ((12, 13, 14, 15), 3.0, 1.7, 0.8),
            ((11,), 3.6, 2.0, 0.5),
        ):
            for joint in joints:
                axial, lateral, near = self._along(position_m, joint)
                size = self._marks.joint_scale(joint)
                centered, across = axial / size + 0.5 * MM, lateral / size
                # rows bow away from the knuckle's middle, like the rim of an eye
                bowed = centered * (1 + 0.9 * (across / (7 * MM)) ** 2) + wave
                row = 0.5 + 0.5 * np.cos(2 * np.pi * bowed / (spacing * MM))
                total += size * depth * near * row**3 * gauss(centered, spread * MM) * gauss(across, 5.5 * MM)
        for joint in (*FINGER_JOINTS["mcp"], 6):
            relative = position_m - self._marks.joints_m[joint]
            axial = relative @ self._marks.axis[joint] + wave
            distance = np.linalg.norm(relative[:, :2], axis=1)
            row = 0.5 + 0.5 * np.cos(2 * np.pi * axial / (2.1 * MM) + 1.5 * noise(position_m, 6 * MM, 33))
            total += 0.18 * row**3 * gauss(distance, 7 * MM)
        return total * patchy * smoothstep(0.25, 0.75, -self._side)

    def _tendons(self, position_m: np.ndarray) -> np.ndarray:
        """Height in meters of the extensor tendons, which fan out from the wrist to the knuckles."""
        height = np.zeros(len(position_m))
        for joint, rise in TENDONS:
            knuckle = self._marks.joints_m[joint][:2]
            wrist = np.array([0.30 * knuckle[0], 0.06 * knuckle[1]])
            along = (knuckle - wrist) / np.linalg.norm(knuckle - wrist)
            relative = position_m[:, :2] - wrist
            t = relative @ along / np.linalg.norm(knuckle - wrist)
            across = relative @ np.array([-along[1], along[0]])
            fade = smoothstep(0.15, 0.45, t) * (1 - smoothstep(0.85, 1.0, t))
            height = np.maximum(height, rise * MM * fade * gauss(across, 1.9 * MM))
        return height

    def _cushions(self, position_m: np.ndarray) -> np.ndarray:
        """Height in meters of the soft pads of the palm, of each phalanx and of the finger tips."""
        joints, palmar = self._marks.joints_m, self._marks.palmar
        pads = [
            (0.45 * joints[1] + 0.55 * joints[6], 14.0, 2.2),
            (0.62 * joints[5], 13.0, 1.7),
            *((joints[joint] + 9 * MM * palmar[joint], 6.5, 0.8) for joint in FINGER_JOINTS["mcp"]),
            *((0.5 * (joints[b] + joints[b - 5]) + 7 * MM * palmar[b], 4.8, 0.55) for b in range(7, 21)),
        ]
        height_mm = np.zeros(len(position_m))
        for center, width, height in pads:
            height_mm += height * gauss(np.linalg.norm(position_m - center, axis=1), width * MM)
        return MM * height_mm * self._palm

    def _texture(self, position_m: np.ndarray) -> np.ndarray:
        """Height in meters of pores and fine furrows, coarser and stronger on the back."""
        fine = noise(position_m, 1.3 * MM, 41) + 0.6 * noise(position_m, 2.4 * MM, 42)
        return MM * (0.020 + 0.015 * (1 - self._palm)) * fine

    def _nail_parts(self, position_m: np.ndarray) -> dict[str, np.ndarray]:
        parts = {name: np.zeros(len(position_m)) for name in ("nail", "nail_fold", "lunula", "free_edge", "height")}
        dorsal = smoothstep(0.0, 0.3, -self._side)
        for shape in self._nails:
            relative = position_m - self._marks.joints_m[shape.tip]
            a = (relative @ self._marks.axis[shape.tip] - shape.center_axial_m) / shape.half_length_m
            b = (relative @ self._marks.lateral[shape.tip] - shape.center_lateral_m) / shape.half_width_m
            near = dorsal * (self._weights[:, shape.tip] > 0.3)
            radius = (np.abs(a) ** 2.6 + np.abs(b) ** 2.6) ** (1 / 2.6)
            # signed distance to the outline, meters, positive inside
            depth_m = (1 - radius) * min(shape.half_width_m, shape.half_length_m)
            plate = near * smoothstep(-0.25 * MM, 0.25 * MM, depth_m)
            towards_tip = smoothstep(0.1, 0.7, a)
            fold = near * gauss(depth_m + 0.40 * MM, 0.60 * MM) * (1 - 0.75 * towards_tip)
            edge_m = (0.84 - 0.12 * b**2 - a) * shape.half_length_m
            moon = smoothstep(0, 0.12, -0.62 - a + 0.30 * (1 - b**2))
            parts["nail"] = np.maximum(parts["nail"], plate)
            parts["nail_fold"] = np.maximum(parts["nail_fold"], fold)
            parts["free_edge"] = np.maximum(parts["free_edge"], plate * smoothstep(0.15 * MM, -0.15 * MM, edge_m))
            parts["lunula"] = np.maximum(parts["lunula"], plate * moon)
            parts["height"] += -fold * 0.40 * MM + near * 0.15 * MM * gauss(depth_m + 1.2 * MM, 0.7 * MM)
        return parts


def _distance_to_curve(xy: np.ndarray, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (N,) of points (N, 2) to the smooth curve through `knots` (K, 2), and where along it, 0..1."""
    t = np.linspace(0, 1, len(knots))
    dense = np.linspace(0, 1, 600)
    distance, index = KDTree(CubicSpline(t, knots)(dense)).query(xy)
    return distance, dense[index]


# ---- reflectance -----------------------------------------------------------------------------------------------------


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

    def near(at: np.ndarray, width: float) -> np.ndarray:
        return gauss(np.linalg.norm(p - at, axis=1), width * MM)

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
