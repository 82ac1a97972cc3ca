"""Makes the built-in avatar anew: a capture of a person whose skin is computed, a training on it.

    python scripts/train_builtin.py            # jghand_engine/assets/builtin_right.jghand

Two hours of Cycles on two quiet cores, an hour of training on all pictures, and some minutes of `jghand distill`; what
is there already is kept, so it goes on where it was stopped. Its detail is that of the person's maps, not the learned
one (scripts/other_person.py). It is judged on another capture (docs/FIGURES.md).
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import tyro
from build_family import TRAINED, kept_maps
from on_skin import on_skin
from other_person import somebody
from registration import with_maps

from jghand_engine.avatar.file import load_avatar, save_avatar
from jghand_engine.avatar.storage import Storage
from jghand_engine.captures.making.person_skin import MAP_PX

ASSETS = Path(__file__).resolve().parents[1] / "jghand_engine" / "assets"
CAPTURE = ["--identity", "adult_woman", "--cameras", "12", "--close-ups", "3", "--poses", "44", "--lights", "varied"]
LICENSE = (
    "CC0-1.0 AND Apache-2.0, see NOTICE: learned from path-traced pictures of MakeHuman's hand (CC0-1.0) on a rig with "
    "SOMA's joints (Apache-2.0), in the light of Blender's worlds (CC0-1.0)"
)


@dataclass(frozen=True)
class Options:
    """work: folder of the capture and the training · minutes: of training · out: the file"""

    work: Path = Path("builtin")
    minutes: float = 70.0
    out: Path = ASSETS / "builtin_right.jghand"


def main(options: Options) -> None:
    names = ("capture", "trained.jghand", "on_skin.jghand", "baked.jghand")
    capture, trained, moved, baked = (options.work / name for name in names)
    run("capture", "--out", capture, *CAPTURE)
    goes_on = ["--resume"] if trained.with_suffix(".training").exists() else []
    run("train", capture, "--out", trained, "--all-pictures", "--minutes", options.minutes, *goes_on)
    learned = load_avatar(trained)
    person = somebody(learned, *TRAINED, kept_maps(options.work, *TRAINED, MAP_PX))
    save_avatar(moved, on_skin(learned, person))
    run("distill", moved, capture, "--out", baked, "--overwrite")
    avatar = with_maps(load_avatar(baked), person)
    avatar = replace(avatar, info=replace(avatar.info, name="JGHand built-in", license=LICENSE))
    save_avatar(options.out, avatar, storage=Storage.COMPACT)
    print(f"{options.out}: {len(avatar)} Gaussians, {options.out.stat().st_size / 1e6:.2f} MB")


def run(*words: object) -> None:
    """A command of `jghand`; its failure ends this script with the same code."""
    code = subprocess.run([sys.executable, "-m", "jghand_engine", *map(str, words)]).returncode
    if code:
        raise SystemExit(code)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
