"""Lets independent programs judge and read JGHand's USD stages, and compares what they find with what the engine has.

    python scripts/check_usd_files.py --install         puts the programs into .envs/usd_clients, then compares
    python scripts/check_usd_files.py                   compares with those that are there
    python scripts/check_usd_files.py --page docs/FORMATS.md      and writes the tables into the page

To be run with the engine's Python. The programs are pinned in scripts/usd_clients/: NVIDIA's validator with its rule
for Gaussian splats, lightusd (a parser that shares nothing with Pixar's) and fourdgs. Blender's importer is asked by
tests/blender/test_usd_import.py.

The built-in hand, learned, with 2,000 Gaussians, is written in every way there is. Exit code 1 when a validator finds
an issue, or a reader something else than the engine has, beyond the precision of what was written.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from other_programs import install_python, pins, put_into_page, python_of, run, table

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.color import srgb_to_linear
from jghand_engine.export.motion import HandMotion
from jghand_engine.export.usd.check import NO_SPLATS, check_usd
from jghand_engine.export.usd.package import (
    UsdOptions,
    UsdReport,
    export_usd,
)
from jghand_engine.export.usd.stage import Variant
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.hand.sequence import PoseSequence

TOOLS = ROOT / "scripts" / "usd_clients"
# JGHAND_USD_CLIENTS names another environment
CLIENTS = Path(os.environ.get("JGHAND_USD_CLIENTS") or ROOT / ".envs" / "usd_clients")
GAUSSIANS, FRAMES = 2000, 20


@dataclass(frozen=True)
class Way:
    """A way to write a stage. words: of the command line · options · frames · reads: the file that readers of single
    layers get, the same as the stage where it is one file"""

    words: str
    options: UsdOptions = field(default_factory=UsdOptions)
    frames: int = FRAMES
    reads: str = "hand.splats.usdc"

    @property
    def has_splats(self) -> bool:
        """Whether there are splats in the file, which rules for them are about."""
        return self.options.package != "usdc" or self.options.default_variant == Variant.SPLATS


WAYS = (
    Way(""),
    Way("--radiance linear", UsdOptions(radiance="linear")),
    Way("--package usdz", UsdOptions(package="usdz"), reads="hand.usdz"),
    *(
        Way(f"--package usdc --default-variant {variant}", UsdOptions(package="usdc", default_variant=variant),
            reads="hand.usdc")
        for variant in Variant
    ),
)  # fmt: skip
# what is written is float32 (position at up to 0.5 m, meters; radius as a part; color of 0..1, whose harmonics are
# divided by 0.28)
PRECISION = (1e-7, 1e-6, 5e-7)


@dataclass(frozen=True)
class Verdict:
    """What validators say of a way. issues: of Pixar's and our own, of all files and variants · nvidia: failures and
    warnings of the usual rules, None where it is not there · splats: issues of its rule for splats"""

    way: Way
    issues: list[str]
    nvidia: tuple[int, int] | None = None
    splats: int | None = None

    @property
    def as_meant(self) -> list[str]:
        """Those that say what was asked for: another variant than splats alone."""
        return [sentence for sentence in self.issues if not self.way.has_splats and sentence == NO_SPLATS]

    @property
    def good(self) -> bool:
        wrong = len(self.issues) - len(self.as_meant)
        return not wrong and not self.splats and (self.nvidia is None or self.nvidia[0] == 0)


@dataclass(frozen=True)
class Reading:
    """What a reader finds of a way. position_mm, sigma, rgb, opacity: largest differences; sigma as a part"""

    way: Way
    client: str
    frames: int
    position_mm: float
    sigma: float
    rgb: float
    opacity: float

    @property
    def good(self) -> bool:
        position_m, sigma, rgb = PRECISION
        within = self.position_mm <= 1e3 * position_m and self.sigma <= sigma
        return within and self.rgb <= rgb and self.opacity <= rgb


def subject(frames: int) -> HandMotion:
    """The built-in hand in motion, half a meter from the origin, of another size in every frame."""
    avatar = load_builtin(handedness=Handedness.RIGHT).prefix(GAUSSIANS)
    canonical = avatar.canonical_joints_m
    poses = pose_sequence_of_names(("open", "fist", "pinch", "open"), canonical, handedness=Handedness.RIGHT)
    which = np.linspace(0, len(poses) - 1, frames).astype(int)
    # no two frames alike: it grows and walks
    step = np.linspace(0, 1, frames)[:, None, None]
    joints_m = (0.85 + 0.3 * step) * poses.joints_m[which] + np.array([0.3, -0.2, 0.35]) + 1e-3 * step
    return HandMotion(avatar, PoseSequence(joints_m, 30.0, Handedness.RIGHT))


def write(way: Way, folder: Path) -> UsdReport:
    motion = subject(way.frames)
    return export_usd(folder, motion.avatar, motion.sequence, options=way.options)


def judge(way: Way, report: UsdReport) -> Verdict:
    """By Pixar's validators, our own rules and NVIDIA's."""
    files = [path for path in (report.stage, report.shot) if path is not None]
    issues = [str(finding) for path in files for finding in check_usd(path)]
    if not python_of(CLIENTS).exists():
        return Verdict(way, issues)
    answers = json.loads(run(python_of(CLIENTS), TOOLS / "validate_with_nvidia.py", *files)).values()
    failures = sum(len(answer["all"].get(kind, ())) for answer in answers for kind in ("ERROR", "FAILURE"))
    warnings = sum(len(answer["all"].get("WARNING", ())) for answer in answers)
    return Verdict(way, issues, (failures, warnings), sum(len(v) for a in answers for v in a["splats"].values()))


def read(client: str, way: Way, report: UsdReport) -> Reading:
    """By a program of its own."""
    motion = subject(way.frames)
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "table.npz"
        run(python_of(CLIENTS), TOOLS / "read_usd.py", client, report.stage.parent / way.reads, table, str(way.frames))
        found = dict(np.load(table))
    count = len(found["positions_m"])
    rest_m, still_sigma_m, opacity, still_rgb = motion.rest_arrays()
    frames = [motion.frame(index) for index in range(count)]
    # a reader of the Default time alone gets the rest pose, in the colors of the first frame
    centers_m = np.stack([rest_m] if count == 1 else [frame.position_m for frame in frames])
    rgb = np.stack([still_rgb if frame.rgb is None else frame.rgb for frame in frames])
    if way.options.radiance == "linear":
        rgb = srgb_to_linear(rgb)
    # radii are in every frame where the hand changes its size by more than nobody sees
    each = count > 1 and report.sigma_error == 0
    sigma_m = np.stack([frame.sigma_m if each else still_sigma_m for frame in frames])
    # balls are not turned: what is, has an order of its own for quaternions
    turned = np.abs(found["turns_wxyz"] - [1.0, 0.0, 0.0, 0.0]).max()
    return Reading(
        way,
        client,
        count,
        1e3 * float(np.abs(found["positions_m"] - centers_m).max()),
        float(max(np.abs(found["scales_m"] / sigma_m[..., None] - 1).max(), turned)),
        float(np.abs(found["rgb"] - rgb).max()),
        float(np.abs(found["opacity"] - opacity).max()),
    )


def readings(way: Way, report: UsdReport) -> Iterator[Reading]:
    """By every program that can read this way and is there: without splats there is nothing to read."""
    if not python_of(CLIENTS).exists() or not way.reads or not way.has_splats:
        return
    # it reads the times of a payload in a variant at 24 frames a second, whatever the stage says (EXPORT 10)
    if way.options.package != "usdz":
        yield read("lightusd", way, report)
    yield read("fourdgs", way, report)


def markdown(verdicts: list[Verdict], found: list[Reading]) -> str:
    """The tables of docs/FORMATS.md."""
    versions = pins(TOOLS / "requirements.txt")
    judged = []
    for one in verdicts:
        nvidia = "not asked" if one.nvidia is None else f"{one.nvidia[0]} failures, {one.nvidia[1]} warnings"
        ours = f"{len(one.issues) - len(one.as_meant)} issues"
        splats = "not asked" if one.splats is None else f"{one.splats} issues"
        judged.append([_words(one.way), ours, nvidia, splats if one.way.has_splats else "no splats in it"])
    header = [
        "`jghand export`", f"UsdValidation {versions['usd-core']} and check-usd, all variants",
        f"usd-validation-nvidia {versions['usd-validation-nvidia']}, all variants", "its rule VG.035",
    ]  # fmt: skip
    figures = [
        [
            _words(one.way), f"{one.client} {versions[one.client]}", str(one.frames), f"{one.position_mm:.1g}",
            f"{100 * one.sigma:.1g} %", f"{one.rgb:.1g}", f"{one.opacity:.1g}",
        ]
        for one in found
    ]  # fmt: skip
    compared = table(["`jghand export`", "read by", "frames", "position mm", "size", "color", "opacity"], figures, 2)
    return f"{table(header, judged, words=4)}\n\n{compared}"


def _words(way: Way) -> str:
    return f"`{way.words}`" if way.words.startswith("--") else way.words or "as it is"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--install", action="store_true", help="put the programs into .envs/usd_clients first")
    parser.add_argument("--page", type=Path, help="write the tables into this page, between its marks")
    options = parser.parse_args()
    if options.install:
        install_python(CLIENTS, TOOLS / "requirements.txt")
    if not python_of(CLIENTS).exists():
        print("The other readers are not here: python scripts/check_usd_files.py --install", file=sys.stderr)
    verdicts: list[Verdict] = []
    found: list[Reading] = []
    for way in WAYS:
        with tempfile.TemporaryDirectory() as folder:
            report = write(way, Path(folder))
            verdicts.append(judge(way, report))
            found += readings(way, report)
        print(f"{'good' if verdicts[-1].good else 'BAD '}  {way.words or 'as it is'}")
        for sentence in verdicts[-1].issues:
            print(f"      {sentence}")
    for one in found:
        print(f"{'good' if one.good else 'BAD '}  {one.way.words or 'as it is'}, read by {one.client}")
    print(markdown(verdicts, found))
    if options.page:
        put_into_page(options.page, "check_usd_files.py", markdown(verdicts, found))
    return 0 if all(one.good for one in (*verdicts, *found)) else 1


if __name__ == "__main__":
    raise SystemExit(main())
