"""The grain of skin: network and loose folds of the back, follicles, friction ridges and cracks of the palm. In mm."""

from __future__ import annotations

import numpy as np

from jghand_engine.captures.skin.canvas import NARROWEST_TEXELS, Canvas
from jghand_engine.captures.skin.noise import fractal_noise, gauss, noise, smoothstep

# furrows between the pillows of the back: edge of a cell, half width, depth; and how high pillows are
NETWORK, FINE_NETWORK, PILLOW = (0.92, 0.092, 0.042), (0.52, 0.062, 0.028), 0.012
# cells are longer across a finger than along it, by this part; how points waver, and in what cells
STRETCH, WAVER, WAVER_CELL = 0.20, 0.16, 1.1
# part of the network on knuckles that is loose skin, gone when the joint bends; how much stronger it is there
LOOSE, ON_KNUCKLES = 0.65, 0.7
# wrinkles of dry skin between the joints: edge of a cell, half width, depth
DRY_LINES = (2.6, 0.117, 0.030)
# those of an old person are on the whole back, and so much deeper; so are the cracks of the palm
OLDER, OLDER_CRACKS = 1.5, 0.8
# soft folds of loose skin: cell, how much shorter they are along the bones than across, depth
CREPE, CREPE_SHORTER, CREPE_DEPTH = 3.4, 1.2, 0.13
# follicles: edge of a cell, part of the cells that have one, radius, depth
FOLLICLES = (2.3, 0.65, 0.13, 0.035)
# friction ridges: from one to the next, height from the groove; below this many texels a ridge they are not drawn
RIDGES_APART, RIDGE, RIDGE_TEXELS = 0.50, 0.052, 2.5
# where the pattern of a finger tip has its middle, as a part of the last bone; where it becomes transverse below it
TIP_PATTERN, TRANSVERSE = 0.52, (-5.5, -8.5)
# cracks: the zero lines of stretched noise of these cells; half width in its values, depth
CRACK_CELLS, CRACK_WIDTH, CRACK = (3.2, 2.6), 0.035, 0.06
# how late in life they come, see Canvas.present
CRACKS_RANK = 0.3
# grain: cell, height
GRAIN = ((0.34, 0.012), (0.80, 0.016))


def paint_relief(canvas: Canvas) -> None:
    person, size = canvas.person, canvas.texels.texel_mm
    skin, knuckle = canvas.skin, canvas.amounts["knuckle"]
    # the network reaches around to the flanks
    back = smoothstep(0.30, -0.15, canvas.side) * skin
    deep = canvas.deep * (0.8 + 0.5 * person.dryness)
    points = canvas.shifted("network", WAVER_CELL, WAVER)
    along = way_along(canvas, points)
    points = points + STRETCH * along

    border, _, number = canvas.cells("network", NETWORK[0], points)
    furrows = canvas.furrow(border, NETWORK[1])
    fine = canvas.furrow(canvas.cells("fine network", FINE_NETWORK[0], points)[0], FINE_NETWORK[1])
    pillows = smoothstep(0.046, 0.32, border) * (0.6 + 0.8 * number)
    strength = deep * back * (1 + ON_KNUCKLES * knuckle + 0.25 * canvas.noise("network strength", 9.0))
    network = strength * (PILLOW * pillows - NETWORK[2] * furrows - FINE_NETWORK[2] * fine)
    canvas.raise_by("straight", LOOSE * knuckle * network)
    relief = (1 - LOOSE * knuckle) * network
    canvas.mark("network", furrows * back)

    cell, width, depth = DRY_LINES
    lines = canvas.furrow(canvas.cells("dry lines", cell, points + 1.6 * along)[0], width)
    lines *= back * np.maximum(smoothstep(0.3, 0.7, canvas.fingers.sum(1)), canvas.aged)
    relief -= (1 + OLDER * canvas.aged) * depth * deep * lines
    canvas.mark("network", 0.7 * lines)
    folds = np.maximum(1 - np.abs(noise(points + CREPE_SHORTER * along, CREPE, canvas.seed("crepe"))), 0)
    canvas.raise_by("straight", -canvas.aged * CREPE_DEPTH * back * folds)

    cell, part, width, depth = FOLLICLES
    _, distance, number = canvas.cells("follicles", cell)
    wide = max(width, NARROWEST_TEXELS * size)
    pores = (width / wide) ** 2 * gauss(distance, wide) * (number < part) * back
    relief -= depth * pores
    canvas.mark("pore", pores)

    palm = smoothstep(0.05, 0.35, canvas.side) * skin
    if RIDGES_APART / size >= RIDGE_TEXELS:
        ridge = 0.5 + 0.5 * np.cos(2 * np.pi * _ridge_phase(canvas) / RIDGES_APART)
        canvas.mark("ridge", ridge * canvas.palm)
        worn = np.clip(0.85 + 0.35 * canvas.noise("worn ridges", 0.9), 0, 1.15)
        relief += RIDGE * (ridge**0.8 - 0.5) * worn * palm * (0.8 + 0.4 * canvas.amounts["pulp"])
    cracks = canvas.present(CRACKS_RANK) * _cracks(canvas) * palm
    relief -= CRACK * (1 + OLDER_CRACKS * canvas.aged) * cracks
    canvas.mark("crack", cracks)
    for number, (cell, height) in enumerate(GRAIN):
        relief += height * canvas.noise(f"grain{number}", cell) * skin
    canvas.raise_by("static", relief)


def way_along(canvas: Canvas, points: np.ndarray) -> np.ndarray:
    """(N, 3) mm: the way to each point that goes along the hand and then along the bones of its finger, so that what is
    stretched by it hangs together at the joints."""
    shares, up = canvas.texels.shares, np.array([0, 1, 0], np.float32)
    total = (1 - shares.sum((1, 2)))[:, None] * (points @ up)[:, None] * up
    for finger in range(5):
        joint = 1 + finger
        begins = canvas.joints[joint] @ up * up
        for share in shares[:, finger].T:
            axis = canvas.axis[joint + 5].astype(np.float32)
            part = (points - canvas.joints[joint].astype(np.float32)) @ axis
            total += share[:, None] * (begins.astype(np.float32) + part[:, None] * axis)
            joint += 5
            begins = begins + canvas.length[joint] * axis
    return total


def _ridge_phase(canvas: Canvas) -> np.ndarray:
    """(N,) mm across the ridges: circles about a point beyond the thenar on the palm, so that they follow the life
    line; loops or whorls on the finger tips, and across the finger below those."""
    points, joints = canvas.texels.point, canvas.joints
    flow = 1.5 * canvas.fractal_noise("ridges", 11.0, octaves=2) + 0.35 * canvas.noise("ridges", 3.0)
    x, y = (0.55 * joints[1] + 0.45 * joints[6] + [6, -4, 0])[:2]
    phase = np.hypot(points[:, 0] - x, 0.8 * (points[:, 1] - y)) + flow
    for finger, on in canvas.each_finger(0.5):
        along, across, _ = canvas.bone(16 + finger, TIP_PATTERN).of(points[on])
        kind = canvas.random(f"tip{finger}").integers(3)
        if kind:  # a whorl that leans to one side or the other
            tip = np.sqrt((along - 0.12 * (2 * kind - 3) * across) ** 2 + (1.25 * across) ** 2 + 0.4)
        else:
            tip = np.sqrt(np.maximum(along, 0) ** 2 + across**2 + 0.4) - 0.9 * np.minimum(along, 0) + 0.02 * across**2
        below = -along - 0.03 * across**2 - 0.4
        mix = smoothstep(*TRANSVERSE, along)
        phase[on] = (1 - mix) * tip + mix * below + 0.35 * flow[on]
    return phase


def _cracks(canvas: Canvas) -> np.ndarray:
    """(N,) 0..1: two sets of fine lines, along the hand and across it."""
    total = np.zeros_like(canvas.side)
    for stretched, cell in enumerate(CRACK_CELLS):
        points = canvas.texels.point * np.where(np.arange(3) == 1 - stretched, 0.55, 1.0).astype(np.float32)
        zero = np.abs(fractal_noise(points, cell, canvas.seed(f"cracks{stretched}"), 2))
        # values of noise change by about one in half a cell
        wide = max(CRACK_WIDTH, NARROWEST_TEXELS * canvas.texels.texel_mm / (cell / 2))
        lines = CRACK_WIDTH / wide * np.exp(-((zero / wide) ** 1.2))
        total = np.maximum(total, (0.8 if stretched else 1.0) * lines)
    return total * smoothstep(-0.1, 0.9, canvas.noise("cracked", 6.0))
