"""Lets independent programs read JGHand's splat files and compares what they find with what the engine has.

    python scripts/check_splat_files.py --install           puts the programs into .envs/splat_clients, then compares
    python scripts/check_splat_files.py                     compares with those that are there
    python scripts/check_splat_files.py --page docs/FORMATS.md      and writes the table into the page

To be run with the engine's Python. The programs are pinned in scripts/splat_clients/: loaders of three.js, PlayCanvas
and its splat-transform (need Node), gsply, gaussforge and fourdgs (Python, in an environment of their own).

Two hands' worth of Gaussians are compared: the built-in hand in a pose, and ellipsoids in all directions. Exit code 1
when a difference is above what the format's own precision allows.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from build_web_viewer import install_packages
from other_programs import install_python, pins, put_into_page, python_of, run

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.errors import JGHandError
from jghand_engine.export.splats.cloud import AXES_FROM_RUB, SplatCloud
from jghand_engine.export.splats.files import FORMATS, SplatMotion
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.sequence import PoseSequence

TOOLS = ROOT / "scripts" / "splat_clients"
# JGHAND_SPLAT_CLIENTS names another folder that holds node_modules and an environment `python`
CLIENTS = Path(os.environ.get("JGHAND_SPLAT_CLIENTS") or ROOT / ".envs" / "splat_clients")
NODE, PYTHON = CLIENTS / "node_modules", CLIENTS / "python"
# so many meters is white from black where a Gaussian is found again by all that it has: some lie nearer than SOG steps
COLOR_M = 0.01


@dataclass(frozen=True)
class Found:
    """What a program found. positions_m (N, 3) · covariance_m2 (N, 3, 3) · rgb (N, 3) and opacity (N,) 0..1"""

    positions_m: np.ndarray
    covariance_m2: np.ndarray
    rgb: np.ndarray
    opacity: np.ndarray

    @classmethod
    def of_ellipsoids(cls, rows: np.ndarray) -> Found:
        """From rows of center (3), sigma (3), quaternion w, x, y, z (4), color (3), opacity (1)."""
        turns = Rotation.from_quat(rows[:, 6:10], scalar_first=True).as_matrix()
        covariance = np.einsum("nab,nb,ncb->nac", turns, rows[:, 3:6] ** 2, turns)
        return cls(rows[:, :3], covariance, rows[:, 10:13], rows[:, 13])

    @classmethod
    def of_covariances(cls, rows: np.ndarray) -> Found:
        """From rows of center (3), covariance xx, xy, xz, yy, yz, zz (6), color (3), opacity (1)."""
        whole = rows[:, [3, 4, 5, 4, 6, 7, 5, 7, 8]].reshape(-1, 3, 3)
        return cls(rows[:, :3], whole, rows[:, 9:12], rows[:, 12])

    @classmethod
    def of_cloud(cls, cloud: SplatCloud) -> Found:
        """What the engine has."""
        parts = cloud.positions_m, cloud.scales_m, cloud.rotations_wxyz, cloud.rgb, cloud.opacity[:, None]
        return cls.of_ellipsoids(np.concatenate(parts, 1).astype(np.float64))

    def in_order_of(self, other: Found) -> Found:
        """The same Gaussians, each beside the one of `other` that it is likest: SOG sorts them. As they are where that
        is not one to one: some are lacking, or there twice."""
        own, others = (
            np.column_stack([
                each.positions_m, np.sqrt(np.einsum("nii->ni", each.covariance_m2)), COLOR_M * each.rgb,
                COLOR_M * each.opacity,
            ])
            for each in (self, other)
        )  # fmt: skip
        nearest = np.atleast_1d(KDTree(own).query(others)[1])
        if len(np.unique(nearest)) != len(self.positions_m) or len(nearest) != len(self.positions_m):
            return self
        return Found(*(getattr(self, name)[nearest] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Difference:
    """Largest differences. position_mm · sigma: of the mean size, as a part of it · shape: of the covariance (norm), as
    a part of it · rgb, opacity: 0..1"""

    position_mm: float
    sigma: float
    shape: float
    rgb: float
    opacity: float

    @classmethod
    def between(cls, found: Found, wanted: Found) -> Difference:
        if len(found.positions_m) != len(wanted.positions_m):
            return cls(*(np.inf for _ in cls.__dataclass_fields__))
        sizes = (np.sqrt(np.trace(one.covariance_m2, axis1=1, axis2=2)) for one in (found, wanted))
        here, there = sizes
        norm = np.linalg.norm(wanted.covariance_m2, axis=(1, 2))
        return cls(
            1e3 * float(np.abs(found.positions_m - wanted.positions_m).max()),
            float(np.abs(here / there - 1).max()),
            float((np.linalg.norm(found.covariance_m2 - wanted.covariance_m2, axis=(1, 2)) / norm).max()),
            float(np.abs(found.rgb - wanted.rgb).max()),
            float(np.abs(found.opacity - wanted.opacity).max()),
        )

    def within(self, limit: Difference) -> bool:
        return all(getattr(self, name) <= getattr(limit, name) for name in self.__dataclass_fields__)


NOTHING = Difference(0, 0, 0, 0, 0)
_HALF_BYTE = 0.5 / 255 + 1e-6
# what a format's own precision allows, for balls and ellipsoids together.
# ply, glb: float32, and the logarithm and the logit of ply.
# splat: colors in bytes; a quaternion's components in steps of 1/128, seen 0.016.
# spz: 2^-19 m; sizes in steps of 1/16 of a natural logarithm; colors in bytes of the harmonics times 0.15.
# sog: what was seen, and a little; positions are cut to 16 bits along the box, of a hand with its forearm 0.31 m: seen
# 0.0051 mm; sizes and colors come from tables of 256 values, opacity is cut to bytes
PRECISION = {
    "ply": Difference(1e-5, 2e-6, 3e-6, 2e-7, 2e-6),
    "glb": Difference(1e-5, 2e-6, 3e-6, 2e-7, 2e-7),
    "splat": Difference(1e-5, 2e-6, 0.018, _HALF_BYTE, _HALF_BYTE),
    "spz": Difference(1e3 * 2**-19 + 1e-5, 0.0318, 0.066, 0.0037, _HALF_BYTE),
    "sog": Difference(0.006, 0.011, 0.022, 0.0028, 1 / 255 + 1e-6),
}
BYTES_OF_THREE = Difference(0, 0, 0, _HALF_BYTE, _HALF_BYTE)
# reads a .splat's bytes of quaternions as 0..255 for -1..1, where 128 is not 0; of gaussforge's opacity, logits are cut
TRANSFORM_ADDS, GAUSSFORGE_ADDS = Difference(0, 0, 0.015, 0, 0), Difference(0, 0, 0, 0, 5e-5)


@dataclass(frozen=True)
class Client:
    """name and version of a program · formats: that it reads · read: the found Gaussians of a file · there: whether it
    is installed · adds: what the program's own precision adds to the format's · sorts: whether it has an order of its
    own"""

    name: str
    version: str
    formats: tuple[str, ...]
    read: Callable[[Path], Found]
    there: Callable[[], bool]
    adds: Difference = NOTHING
    sorts: bool = False

    def find(self, path: Path, wanted: Found) -> Found:
        """What it reads from a file, in the order of `wanted` where that is not kept."""
        found = self.read(path)
        return found.in_order_of(wanted) if self.sorts or path.suffix == ".sog" else found

    def limit(self, format: str) -> Difference:
        pairs = (
            (getattr(PRECISION[format], name), getattr(self.adds, name)) for name in self.adds.__dataclass_fields__
        )
        return Difference(*(one + two for one, two in pairs))


def clients() -> list[Client]:
    """Every program that is asked, installed or not."""
    packages = json.loads((TOOLS / "package.json").read_text())["dependencies"]
    versions = pins(TOOLS / "requirements.txt")
    transform = "@playcanvas/splat-transform"
    on_python = (
        ("gsply", ("ply", "spz", "sog"), NOTHING),
        ("gaussforge", ("ply", "splat", "spz", "sog"), GAUSSFORGE_ADDS),
        ("fourdgs", ("glb",), NOTHING),
    )
    formats = {"three": ("ply", "splat", "glb", "spz"), transform: ("ply", "splat", "spz", "sog")}
    return [
        Client("three", packages["three"], formats["three"], _by_three, node_has("three"), BYTES_OF_THREE),
        Client(
            "splat-transform", packages[transform], formats[transform], _by_transform, node_has(transform),
            TRANSFORM_ADDS,
        ),
        Client(
            "playcanvas", packages["playcanvas"], ("glb",), _by_playcanvas, node_has("playcanvas"), sorts=True
        ),
        *(
            Client(name, versions[name], kinds, lambda path, name=name: _by_python(name, path), has_python, adds)
            for name, kinds, adds in on_python
        ),
    ]  # fmt: skip


def node_has(package: str) -> Callable[[], bool]:
    return lambda: shutil.which("node") is not None and (NODE / package).is_dir()


def has_python() -> bool:
    return python_of(PYTHON).exists()


def node(script: str, *words: str | Path) -> str:
    """Runs a script of scripts/splat_clients/ with the packages of the clients."""
    if not NODE.is_dir():
        raise SystemExit("The programs are not here: python scripts/check_splat_files.py --install")
    # modules are looked up from where a script lies
    copy = CLIENTS / script
    shutil.copyfile(TOOLS / script, copy)
    return run("node", copy, *words)


def _table(path: Path, width: int) -> np.ndarray:
    return np.fromfile(path, "<f4").reshape(-1, width).astype(np.float64)


def _by_three(path: Path) -> Found:
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "table"
        node("read_with_three.mjs", path, table)
        return Found.of_covariances(_table(table, 13))


def _by_playcanvas(path: Path) -> Found:
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "table"
        node("read_with_playcanvas.mjs", path, table)
        return Found.of_ellipsoids(_table(table, 14))


def _by_python(client: str, path: Path) -> Found:
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "table"
        run(python_of(PYTHON), TOOLS / "read_with_python.py", client, path, table)
        return Found.of_ellipsoids(_table(table, 14))


def _by_transform(path: Path) -> Found:
    with tempfile.TemporaryDirectory() as folder:
        csv = Path(folder) / "rows.csv"
        transform(path, csv)
        rows = np.genfromtxt(csv, delimiter=",", names=True)
    names = ("x", "y", "z", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
             "f_dc_0", "f_dc_1", "f_dc_2", "opacity")  # fmt: skip
    table = np.stack([rows[name] for name in names], 1)
    table[:, 3:6] = np.exp(table[:, 3:6])
    table[:, 10:13] = table[:, 10:13] * 0.28209479177387814 + 0.5
    table[:, 13] = 1 / (1 + np.exp(-table[:, 13]))
    return Found.of_ellipsoids(table)


def transform(source: Path, target: Path) -> None:
    """Converts a file with splat-transform, which turns axes where it knows those of a format."""
    words = ("-g", "cpu") if target.suffix == ".sog" else ()
    run("node", NODE / "@playcanvas/splat-transform/bin/cli.mjs", "-w", "-q", *words, source, target)


# ---- what is compared ------------------------------------------------------------------------------------------------


def hand_cloud(axes: str) -> SplatCloud:
    """The built-in hand, pointing, as an export writes it."""
    avatar = load_builtin(handedness=Handedness.RIGHT)
    joints_m = named_pose("point", avatar.canonical_joints_m, handedness=avatar.handedness)
    return SplatMotion(avatar, PoseSequence(joints_m[None], 30.0, Handedness.RIGHT), axes=axes).cloud(0)


def ellipsoid_cloud(axes: str, count: int = 3000) -> SplatCloud:
    """Long and flat Gaussians in all directions, colors and opacities."""
    rng = np.random.default_rng(7)
    turn = Rotation.from_matrix(AXES_FROM_RUB[axes])
    turns = turn * Rotation.from_quat(rng.normal(size=(count, 4)))
    return SplatCloud(
        rng.uniform(-0.1, 0.1, (count, 3)) @ AXES_FROM_RUB[axes].T,
        rng.uniform(0.0003, 0.002, (count, 3)),
        turns.as_quat(scalar_first=True),
        rng.uniform(0.02, 0.98, count),
        rng.uniform(0, 1, (count, 3)),
        axes,
    )


SUBJECTS = {"hand": hand_cloud, "ellipsoids": ellipsoid_cloud}


@dataclass(frozen=True)
class Row:
    """One comparison. size: bytes of the file"""

    format: str
    client: Client
    subject: str
    size: int
    difference: Difference

    @property
    def good(self) -> bool:
        return self.difference.within(self.client.limit(self.format))


def compare(folder: Path) -> Iterator[Row]:
    """Every format by every program that is there."""
    for format, kind in FORMATS.items():
        try:
            kind.check()
        except JGHandError as error:
            print(f"{format}: {error}", file=sys.stderr)
            continue
        for subject, make in SUBJECTS.items():
            cloud = make(kind.axes[0])
            path = folder / f"{subject}.{format}"
            path.write_bytes(kind.encode(cloud))
            wanted = Found.of_cloud(cloud)
            for client in clients():
                if format in client.formats and client.there():
                    found = client.find(path, wanted)
                    yield Row(format, client, subject, path.stat().st_size, Difference.between(found, wanted))


def markdown(rows: list[Row]) -> str:
    """The table of docs/FORMATS.md: the larger of the differences of hand and ellipsoids."""
    lines = [
        "| format | read by | position mm | size | shape | color | opacity |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for format in FORMATS:
        for client in clients():
            mine = [row.difference for row in rows if row.format == format and row.client.name == client.name]
            if mine:
                worst = Difference(*(max(getattr(one, n) for one in mine) for n in Difference.__dataclass_fields__))
                cells = (
                    f"{worst.position_mm:.1g}", f"{100 * worst.sigma:.1g} %", f"{100 * worst.shape:.1g} %",
                    f"{worst.rgb:.1g}", f"{worst.opacity:.1g}",
                )  # fmt: skip
                lines.append(f"| {format} | {client.name} {client.version} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def install() -> None:
    """Puts the programs into CLIENTS. Nothing else of the project is touched."""
    CLIENTS.mkdir(parents=True, exist_ok=True)
    if shutil.which("npm"):
        install_packages(TOOLS, CLIENTS)
    else:
        print("npm is not here: the programs that need Node are left out", file=sys.stderr)
    install_python(PYTHON, TOOLS / "requirements.txt")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--install", action="store_true", help="put the programs into .envs/splat_clients first")
    parser.add_argument("--page", type=Path, help="write the table into this page, between its marks")
    options = parser.parse_args()
    if options.install:
        install()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = list(compare(folder))
        for row in rows:
            verdict = "" if row.good else "   ABOVE THE FORMAT'S PRECISION"
            print(f"{row.format:6} {row.subject:10} {row.client.name:16} {row.size:9} bytes  {row.difference}{verdict}")
    if not rows:
        print("None of the programs is here: python scripts/check_splat_files.py --install", file=sys.stderr)
        return 1
    if options.page:
        put_into_page(options.page, "check_splat_files.py", markdown(rows))
    return 0 if all(row.good for row in rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
