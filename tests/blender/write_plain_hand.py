"""Writes the built-in hand with one color all over and without gloss: run by the engine's Python.

    python write_plain_hand.py FILE.jghand RED GREEN BLUE

What it shows is the light that falls on it, as a matt mesh in its place shows it.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.file import save_avatar
from jghand_engine.avatar.relighting import relightable, thrown_back
from jghand_engine.hand.joints import Handedness


def main(file: Path, *rgb: str) -> None:
    hand = relightable(load_builtin(handedness=Handedness.RIGHT))
    assert hand.learned is not None
    assert hand.learned.response is not None
    none = np.zeros(len(hand), np.float32)
    colors = np.broadcast_to(np.array(rgb, np.float32), hand.rgb.shape)
    thrown = thrown_back(hand, colors)
    response = replace(hand.learned.response, reflectance=none, shade_gain=0.0, bounce=thrown)
    save_avatar(file, replace(hand, rgb=colors, learned=replace(hand.learned, response=response)))


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
