"""Builds the avatar that JGHand ships: the built-in template, sampled and painted with JGHand's own procedural skin.

    python scripts/build_avatar.py                              # jghand_engine/assets/painted_right.jghand
    python scripts/build_avatar.py --look.tone 0.55 0.38 0.29 --out my_hand.jghand

One to two minutes of processor time. The same options give the same file, byte for byte, with the same packages.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tyro
from painted_hand import Layers, Recipe, make_untrained
from painted_skin import SkinLook
from PIL import Image

from jghand_engine.avatar.file import save_avatar
from jghand_engine.avatar.storage import Storage
from jghand_engine.template.builtin import load_template

ASSETS = Path(__file__).resolve().parents[1] / "jghand_engine" / "assets"


@dataclass(frozen=True)
class Options:
    """out: the file to write; look, layers: every knob of the making."""

    out: Path = ASSETS / "painted_right.jghand"
    name: str = "JGHand painted"
    license: str = "MIT AND CC0-1.0 AND Apache-2.0, see NOTICE"
    storage: Storage = Storage.COMPACT
    layers: Layers = field(default_factory=Layers)
    look: SkinLook = field(default_factory=SkinLook)


def main(options: Options) -> None:
    started = time.perf_counter()
    nails = np.asarray(Image.open(ASSETS / "nails.png").convert("L"), dtype=float) / 255
    recipe = Recipe(options.name, options.license, layers=options.layers, look=options.look)
    avatar = make_untrained(load_template(), nails, recipe)
    save_avatar(options.out, avatar, storage=options.storage)
    megabytes = options.out.stat().st_size / 1e6
    print(f"{options.out}: {len(avatar)} Gaussians, {megabytes:.2f} MB, {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
