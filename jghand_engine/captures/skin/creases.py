"""Lines of the skin: folds of the fingers' palm side, wrinkles on the back of their joints, the lines of the palm.

Lines that are straight, even or whole look drawn: each has its own tilt, bow, ends and gaps, and a fold has a lip on
each side. Lengths are millimeters on a hand of usual size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.captures.skin.canvas import Canvas
from jghand_engine.captures.skin.curves import PalmCurves
from jghand_engine.captures.skin.noise import gauss, smoothstep

# distance around a finger: its angle about the bone times its half thickness, palm side, back and root
AROUND_PALM, AROUND_BACK, AROUND_ROOT = 8.0, 7.5, 9.0
# a fold's lip: height as a part of the fold's depth, place beside it, width
LIP = (0.18, 1.25, 0.65)
WRINKLE_LIP = (0.25, 0.95, 0.50)
# a fold of this depth has the full color of a crease
FULL_DEPTH = 0.6
# hatching over each fold: lines, half width, depth, spread of tilts
HATCHING = (9, 0.13, 0.10, 0.22)
# short wrinkles that cross those of a knuckle: for each of its rows, half width, depth, spread of tilts
CROSSING = (2, 0.15, 0.13, 0.30)
# lines over a metacarpal's head: how many, half width, depth
KNUCKLE_LINES = (9, 0.26, 0.16)
# folds at the roots of fingers: part of the first bone, half width, depth; of middle and ring, and of index and pinky
ROOT_INNER = ((0.60, 0.32, 0.50), (0.69, 0.24, 0.22))
ROOT_OUTER = ((0.62, 0.32, 0.50), (0.71, 0.18, 0.12))


@dataclass(frozen=True)
class JointLines:
    """folds: (place along the bone, half width, depth) of the palm side's; of the back: rows of wrinkles, how far they
    reach along the bone, their depth."""

    folds: tuple[tuple[float, float, float], ...]
    rows: int
    reach: float
    depth: float


PIP = JointLines(
    ((-1.3, 0.34, 0.60), (1.5, 0.32, 0.50), (-3.3, 0.20, 0.16), (3.6, 0.20, 0.14), (0.2, 0.16, 0.14)), 8, 8.6, 0.34
)
DIP = JointLines(((-0.8, 0.33, 0.52), (1.2, 0.20, 0.18), (-2.6, 0.16, 0.10)), 5, 4.6, 0.22)
THUMB_MCP = JointLines(((-1.2, 0.32, 0.42), (1.8, 0.28, 0.30), (4.2, 0.20, 0.12)), 6, 7.0, 0.20)
THUMB_IP = JointLines(((-0.9, 0.34, 0.52), (1.7, 0.22, 0.24), (-3.4, 0.18, 0.12)), 6, 6.0, 0.28)

# lines of the palm on the template's: points (x, y), half width, depth
HEART = (((-46, 56), (-36, 62), (-24, 67), (-11, 70), (0, 76), (8, 85), (11, 91)), 0.50, 0.62)
HEAD = (((40, 80), (31, 77), (18, 71), (3, 63), (-12, 54), (-24, 45), (-31, 40)), 0.48, 0.56)
LIFE = (((40, 78.5), (31, 73), (21, 62), (14, 49), (10, 35), (10, 20), (14, 8), (18, 3)), 0.52, 0.66)
FATE = (((-3, 16), (-5, 32), (-4, 48), (-2, 63), (0, 72)), 0.34, 0.20)
BRACELETS = (
    (((-27, 1), (-12, -2), (5, -2), (22, 2)), 0.42, 0.42),
    (((-25, -5), (-9, -8), (8, -8), (21, -4)), 0.36, 0.30),
)
MINOR_LINES = (
    ((23, 66), (27, 54), (29, 42)), ((-30, 52), (-22, 40), (-18, 28)), ((-12, 80), (-16, 70), (-22, 62)),
    ((14, 84), (8, 76), (2, 70)), ((30, 30), (24, 36), (16, 38)), ((-38, 44), (-30, 42), (-20, 45)),
    ((-30, 74), (-24, 70), (-20, 63)), ((26, 60), (20, 50), (18, 38)), ((-10, 52), (-14, 40), (-24, 30)),
    ((6, 60), (2, 48), (0, 34)), ((34, 62), (28, 62), (20, 58)), ((-2, 86), (-5, 78), (-10, 72)),
)  # fmt: skip
MINOR_WIDTH, MINOR_DEPTH = 0.20, 0.16
# strands that leave each of the three main lines, and fine lines all over
STRANDS, FINE_LINES = 5, 110


def paint_creases(canvas: Canvas, curves: PalmCurves) -> None:
    for finger, on in canvas.each_finger(0.30):
        shared = _Finger(canvas, finger, on)
        for joint, lines in zip((6, 11), (PIP, DIP) if finger else (THUMB_MCP, THUMB_IP), strict=True):
            shared.folds(joint + finger, lines)
            shared.wrinkles(joint + finger, lines)
        if finger:
            shared.root()
            _knuckle_lines(canvas, finger)
    _palm_lines(canvas, curves)


class _Finger:
    """The lines of a finger, on its own texels."""

    def __init__(self, canvas: Canvas, finger: int, on: np.ndarray) -> None:
        self._canvas, self._finger, self._on = canvas, finger, on
        self._points = canvas.texels.point[on]
        self._size = canvas.finger_size(finger)
        self._random = canvas.random(f"finger{finger}")
        side, near = canvas.side[on], smoothstep(0.30, 0.60, canvas.fingers[on, finger])
        self._palm, self._back = near * smoothstep(-0.35, 0.25, side), near * smoothstep(0.25, 0.75, -side)
        self._wobble = canvas.wobble[on]
        self._fine = 0.16 * canvas.noise("fine wobble", 1.6, on) + 0.07 * canvas.noise("finest wobble", 0.7, on)
        self._gaps = 0.72 + 0.28 * canvas.noise("gaps", 2.2, on)

    def folds(self, joint: int, lines: JointLines) -> None:
        """The folds of the palm side, and the hatching of the skin around them."""
        rng, size = self._random, self._size
        along, across, palmar = self._canvas.hinge(joint).of(self._points)
        arc = np.arctan2(across, palmar) * AROUND_PALM * size
        deepest = max(depth for _, _, depth in lines.folds)
        for place, width, depth in lines.folds:
            middle = place * size + rng.normal(0, 0.25)
            x = along - middle - rng.normal(0, 0.03) * arc + rng.uniform(0.002, 0.007) * arc**2
            half = rng.uniform(0.75, 1.1) * size * (13.5 if depth > 0.4 else 8.0)
            present = self._canvas.present(1 - depth / deepest)
            self._fold(x, width, present * depth, smoothstep(1.0, 0.72, np.abs(arc) / half))
        count, width, depth, tilts = HATCHING
        for rank in np.linspace(0, 1, count):
            x = along - rng.normal(0, 3.2) * size - rng.normal(0, tilts) * arc + 0.5 * self._wobble + 1.5 * self._fine
            ends = smoothstep(1, 0.4, np.abs(arc - rng.uniform(-7, 7)) / rng.uniform(2.5, 6))
            line = self._canvas.present(rank) * self._canvas.furrow(x, width) * ends * self._palm
            self._canvas.raise_by("fold", -depth * self._canvas.deep * line, self._on)
            self._canvas.mark("crease", 0.30 * line, self._on)

    def root(self) -> None:
        """The folds where the finger leaves the palm, which lie well beyond its joint."""
        finger, rng = self._finger, self._random
        along, across, palmar = self._canvas.knuckle(finger).of(self._points)
        arc = np.arctan2(across, palmar) * AROUND_ROOT * self._size
        near = smoothstep(0.25, 0.6, self._canvas.fingers[self._on, finger])
        for rank, (part, width, depth) in enumerate(ROOT_INNER if finger in (2, 3) else ROOT_OUTER):
            middle = part * self._canvas.length[6 + finger] + rng.normal(0, 0.3)
            x = along - middle + 0.004 * arc**2 - rng.normal(0, 0.03) * arc
            ends = near * smoothstep(1, 0.7, np.abs(arc) / (14 * self._size))
            self._fold(x, width, self._canvas.present(rank) * depth, ends)

    def _fold(self, x: np.ndarray, width: float, depth: float, ends: np.ndarray) -> None:
        canvas, ends = self._canvas, ends * self._palm
        x = x + 0.55 * self._wobble + self._fine
        line = canvas.furrow(x, width) * ends
        part, beside, lip_width = LIP
        lip = part * depth * gauss(np.abs(x) - beside, lip_width) * ends
        canvas.raise_by("fold", lip - depth * canvas.deep * line, self._on)
        canvas.mark("crease", line * (depth / FULL_DEPTH) ** 0.6, self._on)

    def wrinkles(self, joint: int, lines: JointLines) -> None:
        """The loose skin over a straight joint: arcs around the knuckle and short lines that cross them."""
        canvas, rng, size, on = self._canvas, self._random, self._size, self._on
        along, across, palmar = canvas.hinge(joint).of(self._points)
        arc = np.arctan2(across, -palmar) * AROUND_BACK * size
        reach, strength = lines.reach * size, lines.depth / PIP.depth
        swell = 0.30 * strength * gauss(along, 0.62 * reach) * gauss(arc, 5.5 * size)
        canvas.raise_by("straight", swell * self._back, on)
        for row in np.linspace(-1, 1, lines.rows):
            strong = 1 - 0.75 * row**2
            place = row * reach + rng.normal(0, 0.32) * size
            bow = -0.018 * np.sign(place) * min(abs(place), 5) / 5
            tilt, middle = rng.normal(0, 0.05), rng.normal(0, 1.0)
            half = (7.5 * strong + 2.5) * size * rng.uniform(0.8, 1.1)
            x = along - place - bow * (arc - middle) ** 2 - tilt * arc + 0.8 * self._wobble + 1.7 * self._fine
            ends = smoothstep(1.0, 0.45, np.abs(arc - middle) / half) * self._back
            line = canvas.present(row**2) * canvas.furrow(x, 0.24 + 0.12 * strong) * ends * self._gaps
            part, beside, width = WRINKLE_LIP
            lip = part * gauss(np.abs(x) - beside, width) * ends
            canvas.raise_by("straight", lines.depth * strong * (lip - canvas.deep * line), on)
            canvas.mark("wrinkle", line * strong * strength**0.5, on)
        each, width, depth, tilts = CROSSING
        for rank in np.linspace(0, 1, each * lines.rows):
            place, tilt, middle = rng.normal(0, 0.55) * reach, rng.normal(0, tilts), rng.uniform(-6, 6) * size
            x = along - place - tilt * (arc - middle) + 0.8 * self._wobble + 2 * self._fine
            ends = smoothstep(1, 0.3, np.abs(arc - middle) / (rng.uniform(1.5, 4.0) * size))
            line = canvas.present(rank) * canvas.furrow(x, width) * ends * self._back
            canvas.raise_by("straight", -depth * canvas.deep * line, on)
            canvas.mark("wrinkle", 0.4 * line, on)
        canvas.mark("knuckle", gauss(along, 5.0 * size) * gauss(arc, 6.0 * size) * self._back, on)


def _knuckle_lines(canvas: Canvas, finger: int) -> None:
    """Many shallow lines that cross one another over the head of a metacarpal."""
    count, width, depth = KNUCKLE_LINES
    rng = canvas.random(f"knuckle{finger}")
    along, across, _ = canvas.knuckle(finger).of(canvas.texels.point)
    on = np.nonzero((np.hypot(along, across) < 14) & (canvas.back > 0.02))[0]
    along, across = along[on], across[on]
    fade = gauss(np.hypot(along, 0.8 * across), 6.5 * canvas.size) * canvas.back[on]
    wobble = canvas.wobble[on] + 0.2 * canvas.noise("knuckle", 1.4, on)
    for rank in np.linspace(0, 1, count):
        place, tilt = rng.normal(0, 5), rng.normal(0, 0.18)
        x = along - place - tilt * across + 0.012 * np.sign(place) * across**2 + wobble
        ends = smoothstep(1, 0.3, np.abs(across - rng.normal(0, 3)) / rng.uniform(3, 7))
        line = canvas.present(rank) * canvas.furrow(x, width) * ends * fade
        canvas.raise_by("straight", -depth * canvas.deep * line, on)
        canvas.mark("wrinkle", 0.5 * line, on)


@dataclass(frozen=True)
class _Curve:
    """knots (K, 2) mm, half width, depth; jitter: how far this person's knots depart from them; rank: see
    Canvas.present."""

    knots: np.ndarray
    width: float
    depth: float
    jitter: float
    rank: float = 0.0


def _curves(rng: np.random.Generator) -> list[_Curve]:
    """All lines of a palm, as far as they are the same in all: the rest is jitter."""
    main = (HEART, HEAD, LIFE)
    curves = [_Curve(np.array(knots, float), width, depth, 0.9) for knots, width, depth in (*main, FATE, *BRACELETS)]
    curves += [
        _Curve(np.array(knots, float), MINOR_WIDTH, MINOR_DEPTH, 1.6, rank)
        for rank, knots in zip(np.linspace(0, 1, len(MINOR_LINES)), MINOR_LINES, strict=True)
    ]
    for rank in np.linspace(0, 1, FINE_LINES):
        x, y = rng.uniform(-40, 34), rng.uniform(4, 88)
        # along the life line on the thenar, across below the fingers, oblique elsewhere
        angle = np.radians(rng.normal(115 if x > 8 and y < 62 else 20 if y > 60 else 70, 28))
        half = rng.uniform(2.5, 9) * np.array([np.cos(angle), np.sin(angle)])
        bow = rng.normal(0, 0.12) * np.array([-half[1], half[0]])
        middle = np.array([x, y])
        knots = np.stack([middle - half, middle + bow, middle + half])
        curves.append(_Curve(knots, rng.uniform(0.09, 0.15), rng.uniform(0.05, 0.13), 1.2, rank))
    for points, _, _ in main:
        knots = np.array(points, float)
        for rank, start in zip(np.linspace(0, 1, STRANDS), rng.integers(1, len(knots) - 1, STRANDS), strict=True):
            way = knots[start + 1] - knots[start]
            way /= np.linalg.norm(way)
            away = rng.choice((-1, 1)) * np.array([-way[1], way[0]])
            length = rng.uniform(5, 12)
            strand = np.array([-way, length * (0.5 * way + 0.12 * away), length * (way + 0.4 * away)])
            curves.append(_Curve(knots[start] + strand, 0.16, 0.15, 0.8, rank))
    return curves


def _palm_lines(canvas: Canvas, curves: PalmCurves) -> None:
    rng = canvas.random("palm")
    on_palm = smoothstep(0.0, 0.5, canvas.side) * smoothstep(0.65, 0.25, canvas.fingers[:, 1:].sum(1))
    on_palm *= 0.85 + 0.15 * canvas.noise("faint", 3.0)
    breadth, gaps = canvas.noise("breadth", 4.0), 0.8 + 0.2 * smoothstep(-1.2, 0.3, canvas.noise("palm gaps", 2.4))
    deep = 0.8 + 0.4 * canvas.person.age
    for curve in _curves(rng):
        on, distance, part = curves.near(curve.knots + rng.normal(0, curve.jitter, curve.knots.shape))
        taper = 0.30 + 0.70 * smoothstep(0, 0.10, part) * smoothstep(1, 0.72, part)
        seen = canvas.present(curve.rank) * on_palm[on] * taper * smoothstep(0, 0.02, part) * smoothstep(1, 0.97, part)
        width = curve.width * (0.55 + 0.45 * taper) * (1 + 0.28 * breadth[on])
        line = canvas.furrow(distance, np.maximum(width, 0.25 * curve.width)) * seen * gaps[on]
        height = -curve.depth * deep * line
        if curve.depth > 0.3:  # the flesh sinks towards a deep line
            height -= 0.22 * curve.depth * gauss(distance, 4 * curve.width) * seen
        if curve.depth > 0.15:
            height += LIP[0] * curve.depth * gauss(distance - 2.9 * curve.width, 1.3 * curve.width) * seen
        canvas.raise_by("fold", height, on)
        canvas.mark("crease", line * min(1.0, (curve.depth / FULL_DEPTH) ** 0.6), on)
