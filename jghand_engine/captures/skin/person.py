"""A person's skin: nine numbers from which all its maps follow, and the law of its color.

A file of a person is JSON with some of the numbers, {"melanin": 0.9, "age": 0.7, "seed": 4}; one that is left out has
its default.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.json_files import is_number, read_small_json

# what sends light back when nothing absorbs it, and what the horny layer does however dark the skin below is; linear
# Rec.709. Both, and the absorbances below, are fitted so that the law meets the Monk scale (`MONK_SRGB`)
DERMIS_RGB = np.array([0.905, 0.800, 0.690])
HORNY_LAYER_RGB = np.array([0.030, 0.021, 0.016])
# absorbance of an amount of 1, on the way in and out. Melanin's falls with the wavelength less than that of a thin
# layer would (wavelength^-3.3): with that the darkest swatches cannot be met
MELANIN_ABSORBS = np.array([2.05, 3.05, 4.30])
BLOOD_ABSORBS = np.array([0.115, 0.92, 0.78])
CAROTENE_ABSORBS = np.array([0.01, 0.06, 0.42])

# the ten tones of the Monk scale (Monk 2019), sRGB, and the melanin of backs of hands that look like them: living skin
# has blood, which the swatches have not
MONK_SRGB = ("f6ede4", "f3e7db", "f7ead0", "eadaba", "d7bd96", "a07e56", "825c43", "604134", "3a312a", "292420")
MONK_MELANIN = (0.05, 0.08, 0.12, 0.18, 0.28, 0.45, 0.65, 0.90, 1.30, 1.80)

# least and most of each number
RANGES = {
    "melanin": (0.0, 2.0),
    "blood": (0.0, 1.0),
    "warmth": (0.0, 1.0),
    "age": (0.0, 1.0),
    "freckles": (0.0, 1.0),
    "dryness": (0.0, 1.0),
    "nail_mm": (0.0, 3.0),
    "hair": (0.0, 1.0),
    "seed": (0.0, 2.0**31 - 1),
}
# ages of persons drawn by a seed: Beta(2, 3), most of them young or in the middle; hair: evenly between these, and who
# is below 0, every second person, has none; spreads of the other numbers
DRAWN_AGE, DRAWN_HAIR = (2.0, 3.0), (-1.0, 1.0)
DRAWN_SPREAD = {"blood": 0.06, "warmth": 0.08, "freckles": 0.20, "dryness": 0.15, "nail_mm": 0.5}


@dataclass(frozen=True)
class Person:
    """
    melanin:  0 palest to 2 darkest; see MONK_MELANIN
    blood:    0.2 pale to 0.8 flushed
    warmth:   carotene, the yellow of the horny layer, of the palm above all
    age:      0 child to 1 old: lines, veins, tendons, spots, flesh between bones, looseness, ridges of nails
    freckles: part of the back that has them
    dryness:  0 moist and glossy to 1 matt, whitish on the ridges
    nail_mm:  free edge of the nails beyond their beds, millimeters
    hair:     on the back of hand and first phalanges: none to all of the places that have a strand, see hair.py
    seed:     of every line, vein, freckle, ridge and strand
    """

    melanin: float = 0.14
    blood: float = 0.42
    warmth: float = 0.30
    age: float = 0.35
    freckles: float = 0.25
    dryness: float = 0.40
    nail_mm: float = 1.0
    hair: float = 0.0
    seed: int = 0

    def check(self, thing: str = "person") -> None:
        """InputError names a number that is out of its range."""
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not is_number(value, low, high):
                raise InputError(f"{thing}: {name}", wanted=f"{low:g} to {high:g}", came=str(value))
        if int(self.seed) != self.seed:
            raise InputError(f"{thing}: seed", wanted="a whole number", came=str(self.seed))

    @classmethod
    def of_file(cls, path: Path) -> Person:
        """InputError for a file that is none, has an unknown number, or one out of its range."""
        content = read_small_json(path)
        known = ", ".join(RANGES)
        if not isinstance(content, dict):
            raise InputError(f"{path}", wanted=f"an object with some of {known}", came=type(content).__name__)
        for name in content:
            if name not in RANGES:
                raise InputError(f"{path}: {name}", wanted=f"one of {known}", came=name)
        person = cls(**content)
        person.check(str(path))
        return dataclasses.replace(person, seed=int(person.seed))

    @classmethod
    def drawn(cls, seed: int) -> Person:
        """Anybody: a tone of the Monk scale, an age, hair or none, and the rest normal about the defaults."""
        rng = np.random.default_rng((seed, 9))
        numbers = {name: getattr(cls, name) + spread * rng.standard_normal() for name, spread in DRAWN_SPREAD.items()}
        numbers |= {"melanin": float(rng.choice(MONK_MELANIN)), "age": float(rng.beta(*DRAWN_AGE))}
        numbers["hair"] = float(rng.uniform(*DRAWN_HAIR))
        return cls(**{name: float(np.clip(value, *RANGES[name])) for name, value in numbers.items()}, seed=seed)


def reflectance(melanin: np.ndarray, blood: np.ndarray, carotene: np.ndarray) -> np.ndarray:
    """Amounts (...) -> (..., 3) diffuse reflectance, linear Rec.709: each pigment absorbs by Beer and Lambert's law."""
    absorbed = np.zeros((*np.shape(melanin), 3))
    for amount, absorbs in ((melanin, MELANIN_ABSORBS), (blood, BLOOD_ABSORBS), (carotene, CAROTENE_ABSORBS)):
        absorbed = absorbed + np.asarray(amount)[..., None] * absorbs
    return HORNY_LAYER_RGB + (DERMIS_RGB - HORNY_LAYER_RGB) * np.exp(-absorbed)
