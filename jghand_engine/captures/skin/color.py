"""The color of a person's skin, from melanin, blood and carotene, and how rough it is. Linear Rec.709."""

from __future__ import annotations

import numpy as np

from jghand_engine.captures.skin.canvas import Canvas
from jghand_engine.captures.skin.flesh import HYPOTHENAR, MOUNT, THENAR, mounts
from jghand_engine.captures.skin.noise import gauss, noise, smoothstep
from jghand_engine.captures.skin.person import Person, reflectance

# tones between which skin becomes dark: from the usual person's
DARK = (Person.melanin, 0.9)
# how much less melanin the palm has, of pale and of dark skin
PALM_PALER, DARK_PALM_PALER = 0.60, 0.68
# where the palm's color begins and is whole, on the way from back to palm: that of dark skin changes over the whole
# flank, and ends a centimeter or two behind the wrist's crease
PALM_EDGE, DARK_PALM_EDGE, DARK_PALM_ENDS_MM = (-0.25, 0.40), (-0.60, 0.65), (-26.0, 4.0)
# what the horny layer of the palm, which is thick, sends back before melanin takes it: without it dark palms are orange
HORNY_PALM = 0.03
# melanin that knuckles, creases of dark palms and the network have more, as a part of the tone
ON_KNUCKLES, IN_CREASES, IN_NETWORK = 0.30, 0.30, 0.22
# tones from which marks, and creases, get no more melanin: light falls exponentially with it, so that in proportion to
# the tone marks of dark skin would be blotches, and creases inked
MARKS_DARKEST, CREASES_DARKEST = 0.30, 0.9
# freckles and spots of age: edge of a cell, mm, least radius, how much larger, the part of cells that have one, and
# that of the radius at which they begin to fade
FRECKLES, SPOTS = (3.4, 0.25, 0.75, 0.8, 0.50), (8.0, 0.6, 2.9, 1.3, 0.0)
# how far on a knuckle, whose wrinkles would make a blot of it, a spot begins to fade, and is gone
NO_SPOTS = (0.05, 0.40)
# how much darker than a freckle a spot of age is in its middle, as its edge fades over all of it
SPOTS_DARKER = 1.9
# age from which there are spots
SPOTS_FROM_AGE = 0.45
# blood as a part of the person's: everywhere, more on the palm, and at each mark
BLOOD, BLOOD_OF_PALM = 0.82, 0.34
BLOOD_AT = {"nail_fold": 0.80, "crease": 0.35, "wrinkle": 0.25}
BLOOD_ON_KNUCKLES, BLOOD_OF_PULP = 0.55, 0.65
BLOOD_OF_MOUNTS = {THENAR: 0.42, HYPOTHENAR: 0.42, MOUNT: 0.34}
# a vein takes this part of red, green and blue; more is a marker's line
VEIN_TAKES, VEIN, VEIN_OF_PALE = np.array([1.0, 0.50, 0.22]), 0.10, 0.16
# light that does not leave furrows; more looks inked: the shading does the rest. Red suffers less
DARK_FURROWS = {"crease": 0.17, "wrinkle": 0.15, "network": 0.10, "crack": 0.12}
FURROWS_RGB = np.array([0.75, 1.0, 1.0])
# what dry ridges send back more
DRY, DRY_RGB = 0.035, np.array([1.0, 0.96, 0.90])
# melanin of a nail's bed, of pale and of dark skin, as a part of the tone
BED_MELANIN, DARK_BED_MELANIN = 0.30, 0.36
# moons and free edges cover the bed in part, of dark skin less, or they would be white there
MOON_SHOWS, LESS_OF_MOON, FREE_EDGE_SHOWS, LESS_OF_FREE_EDGE = 0.55, 0.20, 0.85, 0.25
# how much stronger streaks of an old nail are, and how much yellower and rougher it is
OLD_STREAKS, OLD_YELLOW, OLD_ROUGH = 0.03, 0.20, 0.10
MOON_RGB, FREE_EDGE_RGB = np.array([0.74, 0.60, 0.54]), np.array([0.78, 0.73, 0.64])
# behind the wrist, where the color of a pale palm ends, and how far from that it does, here and there
PALE_FROM_TO_MM, PALE_UNEVEN_MM = (8.0, -62.0), 1.5
# no skin is darker or paler
RGB_LIMITS = (0.004, 0.95)
ROUGHNESS_LIMITS = (0.15, 0.90)


def paint_color(canvas: Canvas) -> np.ndarray:
    """(N, 3) reflectance."""
    person, of = canvas.person, canvas.amounts
    uneven_mm = PALE_UNEVEN_MM * canvas.fractal_noise("pale", 12.0)
    # broader than the palm of the relief: colors change slowly at the edge of the hand and behind the wrist
    palm = smoothstep(*PALM_EDGE, canvas.side_until(*PALE_FROM_TO_MM, uneven_mm))
    dark = smoothstep(*DARK, person.melanin)
    ends = smoothstep(*DARK_PALM_ENDS_MM, canvas.texels.point[:, 1] / canvas.size + uneven_mm)
    palm += dark * (ends * smoothstep(*DARK_PALM_EDGE, canvas.side_around) - palm)
    rgb = reflectance(_melanin(canvas, palm), _blood(canvas, palm), _carotene(canvas, palm)).astype(np.float32)
    rgb += HORNY_PALM * dark * palm[:, None]
    bluish = (VEIN + VEIN_OF_PALE * (1 - min(1.0, 2 * person.melanin))) * of["vein"]
    rgb *= 1 - bluish[:, None] * VEIN_TAKES
    dry = 0.6 * of["ridge"] * canvas.skin + 0.5 * palm * np.clip(canvas.fractal_noise("mottle", 5.0), 0, 1)
    rgb += DRY * person.dryness * dry[:, None] * DRY_RGB
    furrows = sum((part * np.clip(of[name], 0, 1) for name, part in DARK_FURROWS.items()), np.float32(0))
    rgb *= (1 - np.clip(furrows, 0, 0.6))[:, None] ** FURROWS_RGB
    rgb += of["plate"][:, None] * (_nails(canvas) - rgb)
    return rgb.clip(*RGB_LIMITS)


def paint_roughness(canvas: Canvas) -> np.ndarray:
    """(N,) roughness of the surface's gloss."""
    dryness, of = canvas.person.dryness, canvas.amounts
    rough = 0.50 + 0.10 * dryness - 0.05 * canvas.palm + 0.05 * canvas.noise("roughness", 2.0)
    rough += 0.10 * of["network"] - 0.06 * of["knuckle"]
    rough += of["plate"] * (0.24 + 0.08 * dryness + OLD_ROUGH * canvas.aged + 0.12 * of["free_edge"] - rough)
    return rough.clip(*ROUGHNESS_LIMITS)


def _melanin(canvas: Canvas, palm: np.ndarray) -> np.ndarray:
    tone, of = canvas.person.melanin, canvas.amounts
    marks, dark = min(tone, MARKS_DARKEST), smoothstep(*DARK, tone)
    share = 1 - palm * (PALM_PALER + dark * (DARK_PALM_PALER - PALM_PALER))
    uneven = 1 + 0.10 * canvas.fractal_noise("melanin", 14.0)
    uneven += 0.05 * canvas.noise("speckle", 1.7) + 0.05 * canvas.noise("fine speckle", 0.55)
    uneven *= 1 + ON_KNUCKLES * of["knuckle"] * (1 - palm) * smoothstep(0, 0.35, tone + 0.05)
    total = share * (tone + marks * (uneven - 1))
    total += min(tone, CREASES_DARKEST) * palm * IN_CREASES * of["crease"] * smoothstep(0.25, 0.6, tone)
    total += marks * IN_NETWORK * of["network"] * (1 - palm) + 0.05 * of["wrinkle"] + 0.04 * of["pore"]
    freckles = _spots(canvas, "freckles", FRECKLES, canvas.person.freckles)
    spots = _spots(canvas, "spots", SPOTS, max(0.0, canvas.person.age - SPOTS_FROM_AGE))
    spots *= 1 - smoothstep(*NO_SPOTS, of["knuckle"])
    total += canvas.back * canvas.skin * (0.09 + 0.10 * tone) * (freckles + SPOTS_DARKER * spots)
    return total.clip(0, 2)


def _spots(canvas: Canvas, name: str, kind: tuple[float, float, float, float, float], part: float) -> np.ndarray:
    """(N,) about 0..1.3, large ones stronger."""
    cell, least, more, most, core = kind
    points = canvas.shifted(name, cell / 4, cell / 12)
    _, distance, number = canvas.cells(name, cell, points)
    radius = least + more * number
    there = np.modf(91.7 * number)[0] < most * part
    return smoothstep(0.95, core, distance / radius) * there * (0.5 + 0.8 * number)


def _blood(canvas: Canvas, palm: np.ndarray) -> np.ndarray:
    of = canvas.amounts
    patches = smoothstep(-0.2, 1.0, canvas.fractal_noise("patches", 3.1, octaves=2)) - 0.4
    share = BLOOD + BLOOD_OF_PALM * palm + 0.08 * canvas.fractal_noise("mottle", 5.0)
    share += 0.10 * palm * patches + (0.05 + 0.12 * palm) * canvas.fractal_noise("fine mottle", 1.5, octaves=2)
    share += BLOOD_ON_KNUCKLES * of["knuckle"] * (1 - palm) + BLOOD_OF_PULP * of["pulp"] * palm
    share += sum((part * of[name] for name, part in BLOOD_AT.items()), np.float32(0))
    for center, (height, width) in mounts(canvas):
        kind = next((k for k in BLOOD_OF_MOUNTS if k[0] == height), None)
        if kind is not None:
            share += BLOOD_OF_MOUNTS[kind] * palm * gauss(canvas.distance_on_palm(center), 1.1 * width)
    # a vein's blood lies deep
    return (canvas.person.blood * share * (1 - 0.10 * of["vein"])).clip(0, 2)


def _carotene(canvas: Canvas, palm: np.ndarray) -> np.ndarray:
    hollow = palm * gauss(canvas.distance_on_palm(0.6 * canvas.joints[3]), 16.0)
    share = 0.35 + 0.8 * palm + 0.4 * hollow + 0.25 * canvas.noise("carotene", 16.0)
    return (canvas.person.warmth * share).clip(0, 2)


def _nails(canvas: Canvas) -> np.ndarray:
    """(N, 3): the bed seen through the plate, a redder band at its end, moon and free edge."""
    person, of, (x, y) = canvas.person, canvas.amounts, canvas.nail_xy.T
    dark = smoothstep(*DARK, person.melanin)
    melanin = person.melanin * (BED_MELANIN + dark * (DARK_BED_MELANIN - BED_MELANIN))
    bed = reflectance(*np.array([melanin, 0.30 + 0.55 * person.blood, 0.25 * person.warmth + OLD_YELLOW * canvas.aged]))
    flat = np.stack([6 * y, 0.7 * x, np.zeros_like(x)], 1)
    streaks = 1 + (0.04 + OLD_STREAKS * canvas.aged) * noise(flat, 0.8, canvas.seed("nail streaks"))
    rgb = bed * (streaks * (1 + 0.06 * smoothstep(0.2, 0.95, x)))[:, None]
    for name, color, part in (
        ("moon", MOON_RGB * (1 - 0.45 * min(1.0, person.melanin)), MOON_SHOWS - LESS_OF_MOON * dark),
        (
            "free_edge",
            FREE_EDGE_RGB * (1 - 0.25 * min(1.0, person.melanin)),
            FREE_EDGE_SHOWS - LESS_OF_FREE_EDGE * dark,
        ),
    ):
        rgb += part * of[name][:, None] * (color - rgb)
    band = gauss(x - 0.80 + 0.10 * y**2, 0.05) * (1 - of["free_edge"])
    return rgb * (1 - 0.12 * band[:, None] * np.array([0.3, 1.0, 1.0]))
