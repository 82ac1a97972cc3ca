"""Builds what is known of skin where no picture shows any: the mean of procedural persons and how they differ.

    python scripts/build_skin_prior.py   # writes jghand_engine/assets/skin_prior.npz; some minutes

Persons have every tone of the Monk scale in turn, the other numbers by chance, on the hands of the captures. Colors are
logarithms of linear reflectance in the template's UV; their principal components are scaled so that a person's are
normal with a spread of 1.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from jghand_engine.captures.making.rig import identity_names, load_identity
from jghand_engine.captures.skin.color import paint_color
from jghand_engine.captures.skin.maps import nearest_covered, painted
from jghand_engine.captures.skin.person import MONK_MELANIN, Person
from jghand_engine.files import writing
from jghand_engine.template.builtin import ASSETS

# texels of 2.7 mm: a sixth of a nail. Finer marks are a person's own and lie elsewhere on another
SIZE = 128
PERSONS, COMPONENTS = 30, 6
LEAST_REFLECTANCE = 0.005


def skin_of(number: int) -> np.ndarray:
    """(SIZE, SIZE, 3) logarithm of a person's linear reflectance; around the islands the nearest skin goes on."""
    names = identity_names()
    person = replace(Person.drawn(number), melanin=MONK_MELANIN[number % len(MONK_MELANIN)])
    canvas = painted(load_identity(names[number % len(names)], forearm=True), SIZE, person)
    covered = canvas.texels.covered
    square = np.zeros((SIZE, SIZE, 3))
    square[covered] = np.log(np.maximum(paint_color(canvas), LEAST_REFLECTANCE))
    row, column = nearest_covered(covered)
    return square[row, column]


def build(persons: int) -> dict[str, np.ndarray]:
    """mean (SIZE, SIZE, 3) float16 · component (COMPONENTS, SIZE, SIZE, 3) int8 · step (COMPONENTS,) of its numbers."""
    skins = []
    for number in range(persons):
        skins.append(skin_of(number))
        print(f"person {number + 1} of {persons}", flush=True)
    mean = np.mean(skins, 0)
    _, spread, rows = np.linalg.svd((np.array(skins) - mean).reshape(persons, -1), full_matrices=False)
    component = rows[:COMPONENTS] * spread[:COMPONENTS, None] / np.sqrt(persons - 1)
    print("share of the variance:", np.round(np.cumsum(spread**2)[:COMPONENTS] / (spread**2).sum(), 3))
    step = np.abs(component).max(1) / 127
    whole = np.rint(component / step[:, None]).astype(np.int8).reshape(-1, SIZE, SIZE, 3)
    return {"mean": mean.astype(np.float16), "component": whole, "step": step.astype(np.float32)}


def main() -> None:
    """Writes the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ASSETS / "skin_prior.npz")
    parser.add_argument("--persons", type=int, default=PERSONS)
    args = parser.parse_args()
    arrays = build(args.persons)
    with writing(args.out) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # pyright: ignore[reportArgumentType]
    print(f"{args.out}: {args.out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
