"""What lies below the skin and shapes it: pads, bones at the joints, knuckles, tendons and what is sunk between them,
veins, the mounts of the palm.

Heights and widths are millimeters on a hand of usual size.
"""

from __future__ import annotations

import numpy as np

from jghand_engine.captures.skin.canvas import Canvas, Frame
from jghand_engine.captures.skin.curves import PalmCurves
from jghand_engine.captures.skin.noise import gauss, smoothstep

# pads of the phalanges' palm side, from the first: height, where along the bone, half length; and their half breadth
PADS = ((0.75, 0.62, 5.5), (0.60, 0.50, 4.2), (0.95, 0.50, 5.2))
PAD_BREADTH, WAIST_OF_BACK, PAD_END = 6.0, 0.28, 0.55
# of an old person: how much lower pads are, how far the shafts of phalanges sink all around, from the first, and how
# much thicker the bones at their ends are
FLATTER, SUNK, THICKER = 0.6, (1.0, 0.8, 0.3), 0.5
# bones at the middle and last joints: height on the back, on the flanks, half length
BONES = ((0.55, 0.50, 4.2), (0.30, 0.32, 3.2))
# a bent joint shows the two heads of its bone, this far to each side, and the flat between them
CONDYLES, CONDYLES_APART, BENT_JOINT = 0.55, 3.0, 0.35
# heads of the metacarpals: straight, and how much more when the finger bends; dips between them
KNUCKLE, KNUCKLE_BENT, KNUCKLE_WIDTH = 0.85, 1.9, 5.0
DIP, DIP_WIDTH = 0.95, 3.6
# of an old person: how far the back sinks between two metacarpals, and between those of thumb and index; widths
HOLLOWS, WEB_HOLLOW = (1.6, 3.8), (2.2, 9.0)
# how far aside on the wrist, as a part of how far on the knuckles, what fans out to them begins
ASIDE = 0.30
# extensor tendons of index to pinky
TENDONS, TENDON_WIDTH = (0.50, 0.60, 0.52, 0.36), 1.7
# how far tendons and veins stand out of the flesh of a child, which hides them, of the usual person, and of an old one
TENDONS_STAND_OUT, VEINS_STAND_OUT = (0.35, 1.165, 2.85), (0.30, 0.965, 2.87)
# thenar, hypothenar, hollow of the palm, and pads below the fingers: height, width
THENAR, HYPOTHENAR, HOLLOW, MOUNT = (3.2, 13.0), (1.7, 13.0), (-2.0, 13.0), (0.7, 5.0)
# veins of the back, on the template's hand: points (x, y), half width, height. An end that is a point of another vein
# flows into it. Three run on along the forearm, and out of it
_MEDIAN = ((13, -6), (6, -30), (2, -56), (5, -80), (0, -104), (4, -130), (2, -150))
_ULNAR = ((-17, -10), (-13, -36), (-16, -60), (-13, -88), (-16, -118), (-14, -150))
_CEPHALIC = ((22, -16), (19, -42), (20, -72), (17, -108), (19, -150))
VEINS = (
    (((13, 84), (11, 72), (7, 57), (2, 42), (5, 24), (11, 8), *_MEDIAN), 1.25, 0.50),
    (((-9, 82), (-7, 68), (-4, 55), (2, 42)), 1.05, 0.42),
    (((-29, 74), (-25, 58), (-18, 42), (-15, 22), (-17, 4), *_ULNAR), 1.25, 0.50),
    (((-7, 68), (-15, 62), (-25, 58)), 0.90, 0.34),
    (((-18, 42), (-9, 34), (5, 24)), 0.90, 0.28),
    (((36, 52), (28, 38), (24, 22), (22, 6), *_CEPHALIC), 1.10, 0.42),
    (((11, 72), (20, 62), (28, 38)), 0.85, 0.26),
    (((-25, 58), (-33, 48), (-36, 34)), 0.80, 0.22),
    (((2, -56), (-6, -74), (-13, -88)), 0.95, 0.30),
    (((19, -42), (13, -62), (5, -80)), 0.85, 0.26),
)
# how far a person's veins depart from these; over what length one that ends dives, and over what its color goes, which
# depth hides before the swell; the height of those that have all the color
VEIN_JITTER, VEIN_DIVES, VEIN_PALES, VEIN_FULL = 1.6, 12.0, 20.0, 0.50
# swells of fat, all over
UNEVEN, UNEVEN_CELL = 0.10, 7.0


def paint_flesh(canvas: Canvas, curves: PalmCurves) -> None:
    for finger, on in canvas.each_finger(0.2):
        _finger(canvas, finger, on)
    _knuckles(canvas)
    _tendons(canvas)
    _hollows(canvas)
    for center, (height, width) in mounts(canvas):
        canvas.raise_by("static", canvas.palm * height * gauss(canvas.distance_on_palm(center), width))
    canvas.raise_by("static", UNEVEN * canvas.fractal_noise("uneven", UNEVEN_CELL, octaves=2) * canvas.skin)
    _veins(canvas, curves)


def mounts(canvas: Canvas) -> list[tuple[np.ndarray, tuple[float, float]]]:
    """Centers of the palm's mounts and of its hollow, with height and width on this hand."""
    joints, size = canvas.joints, canvas.size
    places = [
        (0.45 * joints[1] + 0.55 * joints[6], THENAR),
        (0.30 * joints[0] + 0.62 * joints[5] + [-4, 0, 0], HYPOTHENAR),
        (joints[2:5].mean(0) * [1, 0.62, 1], HOLLOW),
        *(((joints[1 + f] + joints[2 + f]) / 2 + 4 * canvas.axis[6 + f], MOUNT) for f in (1, 2, 3)),
    ]
    return [(center, (height, width * size)) for center, (height, width) in places]


def _finger(canvas: Canvas, finger: int, on: np.ndarray) -> None:
    size = canvas.finger_size(finger)
    near = smoothstep(0.2, 0.7, canvas.fingers[on, finger])
    points, back, palm = canvas.texels.point[on], near * canvas.back[on], near * canvas.palm[on]
    flank = np.clip(near - back - palm, 0, 1)
    for joint, (on_back, on_flank, reach) in zip((6 + finger, 11 + finger), BONES, strict=True):
        along, across, _ = canvas.hinge(joint).of(points)
        ring = (1 + THICKER * canvas.aged) * gauss(along, reach * size)
        canvas.raise_by("static", ring * (0.7 * on_back * back + 0.8 * on_flank * flank), on)
        canvas.raise_by("static", -PAD_END * size * palm * gauss(along, 2.3 * size), on)
        heads = CONDYLES * gauss(np.abs(across) - CONDYLES_APART * size, 2.2 * size)
        canvas.raise_by("bent", back * gauss(along + 1.2, 4.0 * size) * (heads + BENT_JOINT), on)
    for bone, (height, part, reach), sunk in zip((6, 11, 16), PADS, SUNK, strict=True):
        if finger == 0 and bone == 6:  # that is the thenar
            continue
        along, across, _ = canvas.bone(bone + finger, part).of(points)
        pad = gauss(along, reach * size) * gauss(across, PAD_BREADTH * size)
        height *= 1 - FLATTER * canvas.aged
        canvas.raise_by("static", size * height * palm * pad - WAIST_OF_BACK * back * gauss(along, 0.8 * reach), on)
        canvas.raise_by("static", -size * sunk * canvas.aged * near * gauss(along, reach * size), on)
    along, _, _ = canvas.bone(16 + finger, 0.58).of(points)
    canvas.mark("pulp", palm * gauss(along, 6 * size), on)


def _knuckles(canvas: Canvas) -> None:
    size, points = canvas.size, canvas.texels.point
    for finger in range(1, 5):
        along, across, _ = canvas.knuckle(finger).of(points)
        distance = np.hypot(along + 1.0, across)
        head = canvas.back * gauss(distance, KNUCKLE_WIDTH * size)
        canvas.raise_by("static", KNUCKLE * size * head)
        canvas.raise_by("bent", KNUCKLE_BENT * size * head)
        canvas.mark("knuckle", canvas.back * gauss(distance, 6.0 * size))
        if finger < 4:
            beside = (canvas.joints[2 + finger] - canvas.joints[1 + finger]) / 2
            between = Frame(canvas.joints[1 + finger] + beside, canvas.axis[6 + finger], canvas.palmar[6 + finger])
            along, across, _ = between.of(points)
            dip = np.hypot(0.5 * along, across)
            canvas.raise_by("static", -DIP * size * canvas.back * gauss(dip, DIP_WIDTH * size))


def _tendons(canvas: Canvas) -> None:
    """They fan out from the wrist to the knuckles, with a hollow at each side."""
    size, stands_out = canvas.size, canvas.by_age(*TENDONS_STAND_OUT)
    for finger, height in enumerate(TENDONS, 1):
        part, across = _along_back(canvas, canvas.joints[1 + finger, :2], ASIDE if finger < 4 else 0.25)
        ridge = gauss(across, TENDON_WIDTH * size) - 0.35 * gauss(np.abs(across) - 4.2 * size, 2.0 * size)
        seen = smoothstep(0.05, 0.4, part) * smoothstep(1.02, 0.90, part)
        canvas.raise_by("straight", canvas.back * stands_out * height * size * ridge * seen)


def _hollows(canvas: Canvas) -> None:
    """Where flesh has gone between the metacarpals."""
    size, joints = canvas.size, canvas.joints
    depth, width = HOLLOWS
    for finger in range(1, 4):
        part, across = _along_back(canvas, joints[[1 + finger, 2 + finger], :2].mean(0), ASIDE)
        seen = smoothstep(0.20, 0.6, part) * smoothstep(1.10, 0.80, part)
        # as shallow as they are narrow, or they would be slits at the wrist
        broad = size * (ASIDE + (1 - ASIDE) * part.clip(0))
        sunk = broad * canvas.back * gauss(across, width * broad) * seen
        canvas.raise_by("static", -canvas.aged * depth * sunk)
    depth, width = WEB_HOLLOW
    web = canvas.distance_on_palm(0.45 * joints[2] + 0.3 * joints[6] + 0.25 * joints[1])
    canvas.raise_by("static", -canvas.aged * depth * size * canvas.back * gauss(web, width * size))


def _along_back(canvas: Canvas, end: np.ndarray, aside: float) -> tuple[np.ndarray, np.ndarray]:
    """In the plane of the palm, of the line to `end` (2,) from the wrist, beside its middle by this part of the end's
    x: (N,) the part of it at each texel, and the distance across, mm."""
    wrist = canvas.joints[0, :2] + [aside * end[0], 2]
    length = np.linalg.norm(end - wrist)
    x, y = ((end - wrist) / length).astype(np.float32)
    relative = canvas.texels.point[:, :2] - wrist.astype(np.float32)
    return relative @ np.array([x, y]) / length, relative @ np.array([-y, x]) + 0.5 * canvas.wobble


def _veins(canvas: Canvas, curves: PalmCurves) -> None:
    rng, stands_out = canvas.random("veins"), canvas.by_age(*VEINS_STAND_OUT)
    # the forearm's side says nothing of where its own back is
    outwards = np.minimum(-canvas.side, -canvas.texels.normal[:, 2])
    on_back = smoothstep(0.15, 0.7, outwards) * smoothstep(0.6, 0.2, canvas.fingers.sum(1))
    broken = 0.75 + 0.25 * canvas.noise("veins", 9.0)
    points = [knot for knots, _, _ in VEINS for knot in knots]
    moved = {knot: np.array(knot) + rng.normal(0, VEIN_JITTER, 2) for knot in dict.fromkeys(points)}
    swell = np.zeros_like(canvas.side)
    for knots, width, height in VEINS:
        on, distance, part = curves.near(np.array([moved[knot] for knot in knots]))
        length = np.linalg.norm(np.diff(knots, axis=0), axis=1).sum()
        first = length * part if points.count(knots[0]) == 1 else np.inf
        last = length * (1 - part) if points.count(knots[-1]) == 1 else np.inf
        shallow, colored = (
            smoothstep(0, reach, first) * smoothstep(0, reach, last) for reach in (VEIN_DIVES, VEIN_PALES)
        )
        seen = on_back[on] * broken[on]
        # where two meet they are one
        swell[on] = np.maximum(swell[on], height * gauss(distance, width) * seen * shallow)
        canvas.mark("vein", height / VEIN_FULL * gauss(distance, 1.5 * width) * seen * colored, on)
    canvas.raise_by("static", stands_out * swell)
