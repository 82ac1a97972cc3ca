"""Tries the kernels of other systems on this one: Windows under Wine, Linux on arm64 under QEMU.

    python scripts/check_kernels.py                 what can be tried here, and what cannot

The libraries' own self-test (jghand_engine/native/selftest.py) runs in Python, which those systems would have to have.
So it runs here, with this machine's library, and every call that it makes is recorded: the memory that goes in and
what comes out. A small program (check_kernels.cpp, built by zig for the other system) makes the same calls there and
compares all numbers. Wanted: `apt-get install wine64 qemu-user libc6-arm64-cross`. The libraries of macOS are built
and nowhere tried: nothing here runs them.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bundled_engine
from bundled_engine import PLATFORMS

from jghand_engine.native import binding, build, library, selftest
from jghand_engine.native.learned_tasks import LearnedTask
from jghand_engine.native.mean import MeanTask
from jghand_engine.native.rasterizer import _Job as RasterJob
from jghand_engine.native.tasks import ShadeTask, SkinTask

PROGRAM = Path(__file__).with_suffix(".cpp")
FLOAT, DOUBLE = 1, 2
TEAM_BYTES = binding.new_team().nbytes
# where Debian has the C library of another processor
ARM64_SYSTEM = Path("/usr/aarch64-linux-gnu")


# ---- sizes: pointer -> bytes, by the comments of the structures in native/*.h --------------------------------------


def raster_sizes(job: RasterJob) -> dict[str, int]:
    n, pixels, tiles = job.count, job.width * job.height, job.tiles_x * job.tiles_y
    sizes = {"position": 12 * n, "sigma": 4 * n, "covariance": 24 * n, "opacity": 4 * n, "rgb": 12 * n}
    sizes |= {f"{name}_gradient": size for name, size in sizes.items()}
    sizes |= {"records": 64 * n, "rects": 8 * n}
    sizes |= {"sort_a": 8 * n, "sort_b": 8 * n, "order": 4 * n, "summaries": 16 * job.parts}
    sizes |= {"part_cursors": 4 * job.parts * (job.tiles_x + 1) * (job.tiles_y + 1), "tile_start": 4 * (tiles + 1)}
    sizes |= {"tile_list": 4 * job.list_capacity, "tile_work": 4 * tiles, "record_gradients": 4 * 64 * n}
    return sizes | {"planes": 20 * pixels, "plane_gradients": 20 * pixels, "team": TEAM_BYTES}


def skin_sizes(task: SkinTask) -> dict[str, int]:
    pairs = ctypes.cast(task.block_start, ctypes.POINTER(ctypes.c_int32))[task.blocks]
    sizes = {"rest": 256 * task.blocks, "block_start": 4 * (task.blocks + 1), "bone": 4 * pairs, "weight": 64 * pairs}
    return sizes | {"linear_offset": 21 * 48, "position": 192 * task.blocks, "sigma": 64 * task.blocks}


def learned_sizes(task: LearnedTask) -> dict[str, int]:
    blocks, hidden = task.skin.blocks, task.hidden
    sizes = {f"skin.{name}": size for name, size in skin_sizes(task.skin).items()}
    sizes |= {"look": 448 * blocks, "places": 64 * hidden * blocks, "features": 84 * hidden}
    sizes |= {"middle": 4 * hidden * hidden, "middle_bias": 4 * hidden, "out": 24 * hidden}
    return sizes | {"irradiance": 192, "lobe": 28 * task.lobes, "matt": 384 * blocks, "rgb": 192 * blocks}


def shade_sizes(task: ShadeTask) -> dict[str, int]:
    pixels, disc = task.width * task.height, -(-task.samples // 16) * 64
    sizes = {"disc_x": disc, "disc_y": disc, "picture": 20 * pixels, "row_valid": 4 * task.height}
    padded = 4 * (task.height + 2 * task.pad_rows) * task.stride
    return sizes | {"depth": padded, "visibility": 4 * pixels, "rgba": 16 * pixels, "depth_out": 4 * pixels}


def mean_sizes(task: MeanTask) -> dict[str, int]:
    image, sums = task.width * task.height, (task.height - 1) * task.stride + task.width
    sizes = {"rgba": 16 * image, "depth": 4 * image}
    return sizes | {"sum": 16 * sums, "depth_sum": 4 * sums, "depth_weight": 4 * sums}


def depth_start(task: ShadeTask) -> int:
    """Bytes from the beginning of the padded plane to where the task points."""
    columns = (task.stride - -(-task.width // 16) * 16) // 2
    return 4 * (task.pad_rows * task.stride + columns)


@dataclass(frozen=True)
class Structure:
    """A structure that a call takes. results: what is compared, with its kind · starts: pointers into a block."""

    kind: type[ctypes.Structure]
    sizes: Callable[[Any], dict[str, int]]
    results: dict[str, int]
    starts: dict[str, Callable[[Any], int]] = field(default_factory=dict)


_GRADIENTS = {f"{name}_gradient": FLOAT for name in ("position", "sigma", "covariance", "opacity", "rgb")}
_RASTER = Structure(RasterJob, raster_sizes, {"planes": FLOAT})
_POSED = {"skin.position": FLOAT, "skin.sigma": FLOAT, "matt": FLOAT}
_MEAN = Structure(MeanTask, mean_sizes, {"rgba": FLOAT, "depth": FLOAT})
_LEARNED = Structure(LearnedTask, learned_sizes, _POSED)
# arguments of each call: bytes and what they are, or a structure
CALLS: dict[str, tuple[tuple[int, int] | Structure, ...]] = {
    "jg_raster_forward": (_RASTER,),
    "jg_raster_backward": (replace(_RASTER, results=_GRADIENTS),),
    "jg_shade": ((TEAM_BYTES, 0), Structure(ShadeTask, shade_sizes, {"rgba": FLOAT}, {"depth": depth_start})),
    "jg_skin": ((TEAM_BYTES, 0), Structure(SkinTask, skin_sizes, {"position": FLOAT, "sigma": FLOAT})),
    "jg_learned_pose": ((TEAM_BYTES, 0), _LEARNED),
    "jg_learned_gloss": ((TEAM_BYTES, 0), replace(_LEARNED, results={"rgb": FLOAT})),
    "jg_mean_add": (
        (TEAM_BYTES, 0),
        replace(_MEAN, results=dict.fromkeys(("sum", "depth_sum", "depth_weight"), FLOAT)),
    ),
    "jg_mean_finish": ((TEAM_BYTES, 0), _MEAN),
}
# matrices, scale and angles of the bones; the skeleton's size is the library's
_BONES = ((0, 0), (8 * 63, 0), (8 * 252, DOUBLE), (8, DOUBLE), (8 * 37, DOUBLE))


# ---- recording -------------------------------------------------------------------------------------------------------


@dataclass
class _Block:
    address: int
    size: int
    kind: int
    before: bytes


class Recorder:
    """Stands in place of a library's functions, and keeps what every call was given and what came of it."""

    def __init__(self, call: ctypes.CDLL) -> None:
        self._call, self.calls = call, []

    def __getattr__(self, name: str) -> Callable[..., Any]:
        function = getattr(self._call, name)
        arguments = CALLS.get(name)
        if name == "jg_bone_transforms":
            arguments = ((self._call.jg_skeleton_bytes(), 0), *_BONES[1:])
        if arguments is None:
            return function

        def recorded(*addresses: int) -> Any:
            blocks, pointers = _before(addresses, arguments)
            result = function(*addresses)
            self.calls.append(_packed(name, len(addresses), blocks, pointers))
            return result

        return recorded

    def write(self, path: Path) -> None:
        path.write_bytes(struct.pack("<Q", len(self.calls)) + b"".join(self.calls))


def _before(
    addresses: tuple[int, ...], arguments: tuple[tuple[int, int] | Structure, ...]
) -> tuple[list[_Block], list[tuple[int, int, int, int]]]:
    """The blocks of memory of a call, its arguments first, and the pointers between them: block, offset, target and
    start."""
    blocks, pointers = [], []
    for address, argument in zip(addresses, arguments, strict=True):
        size, kind = (ctypes.sizeof(argument.kind), 0) if isinstance(argument, Structure) else argument
        blocks.append(_Block(address, size, kind, ctypes.string_at(address, size)))
    for number, argument in enumerate(arguments):
        if not isinstance(argument, Structure):
            continue
        task = argument.kind.from_address(addresses[number])
        sizes = argument.sizes(task)
        for name, offset, pointer in _pointers(task):
            if not pointer:
                continue
            start = argument.starts[name](task) if name in argument.starts else 0
            kind = argument.results.get(name, 0)
            blocks.append(_Block(pointer - start, sizes[name], kind, ctypes.string_at(pointer - start, sizes[name])))
            pointers.append((number, offset, len(blocks) - 1, start))
    return blocks, pointers


def _pointers(task: ctypes.Structure, prefix: str = "", base: int = 0) -> Iterator[tuple[str, int, int | None]]:
    """Name, offset and value of every pointer of a structure, those of structures in it included."""
    for name, kind in (entry[:2] for entry in task._fields_):
        offset = base + getattr(type(task), name).offset
        if kind is ctypes.c_void_p:
            yield prefix + name, offset, getattr(task, name)
        elif isinstance(kind, type) and issubclass(kind, ctypes.Structure):
            yield from _pointers(getattr(task, name), f"{name}.", offset)


def _packed(name: str, arguments: int, blocks: list[_Block], pointers: list[tuple[int, int, int, int]]) -> bytes:
    parts = [struct.pack("<Q", len(name)), name.encode(), struct.pack("<QQ", arguments, len(blocks))]
    for block in blocks:
        after = ctypes.string_at(block.address, block.size) if block.kind else b""
        parts += [struct.pack("<QQ", block.size, block.kind), block.before, after]
    parts.append(struct.pack("<Q", len(pointers)))
    return b"".join([*parts, *(struct.pack("<4Q", *pointer) for pointer in pointers)])


# ---- trying ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Imitation:
    """How a program of another system is run here. wanted: what must be there for it."""

    platform: str
    zig: str
    suffix: str
    command: tuple[str, ...]
    wanted: tuple[str | Path, ...]


IMITATIONS = (
    Imitation("windows-x64", "x86_64-windows-gnu", ".exe", ("wine",), ("wine",)),
    Imitation(
        "linux-arm64",
        "aarch64-linux-gnu.2.28",
        "",
        ("qemu-aarch64", "-L", str(ARM64_SYSTEM)),
        ("qemu-aarch64", ARM64_SYSTEM / "lib" / "libc.so.6"),
    ),
)


def is_there(wanted: str | Path) -> bool:
    return wanted.exists() if isinstance(wanted, Path) else shutil.which(wanted) is not None


def variants_here() -> set[str]:
    """What this processor can run of x86-64: Wine runs it as it is."""
    chosen = library.load()
    return {"v3", "v4"} if chosen is not None and chosen.variant == "v4" else {"v3"}


def check(imitation: Imitation, recording: Path, folder: Path) -> bool:
    """Whether every library of a platform computes what is recorded. Prints what it tried."""
    compiler = build.find_compiler()
    program = folder / f"check_kernels{imitation.suffix}"
    flags = ("-O1", "-std=c++17", "-fno-exceptions", "-fno-rtti", "-nostdlib++", "-target", imitation.zig)
    command = [*compiler.command, *flags, str(PROGRAM), "-o", str(program)]
    subprocess.run(command, check=True)
    good = True
    for path in bundled_engine.built_kernels([PLATFORMS[imitation.platform]]):
        variant = path.stem.rsplit("_", 1)[1]
        if variant == "detector" or (variant.startswith("v") and variant not in variants_here()):
            print(f"{path.name}: not tried" + ("" if variant == "detector" else ", this processor cannot run it"))
            continue
        done = subprocess.run(
            [*imitation.command, str(program), str(path), str(recording)],
            capture_output=True, text=True, check=False, env={**os.environ, "WINEDEBUG": "-all"},
        )  # fmt: skip
        print(f"{path.name}: {done.stdout.strip() or done.stderr.strip()[-400:]}")
        good = good and done.returncode == 0
    return good


def main() -> int:
    found = library.load()
    if found is None:
        sys.exit("this machine's own kernels are not built, and they are what others are compared with")
    recorder = Recorder(found.call)
    selftest.check(replace(found, call=recorder))  # type: ignore[arg-type]  # answers as the library does
    good = True
    with tempfile.TemporaryDirectory(prefix="jghand_kernels_") as name:
        folder = Path(name)
        recorder.write(folder / "calls.bin")
        for imitation in IMITATIONS:
            lacking = [str(wanted) for wanted in imitation.wanted if not is_there(wanted)]
            if lacking:
                print(f"{imitation.platform}: not tried, {' and '.join(lacking)} not found")
            else:
                good = check(imitation, folder / "calls.bin", folder) and good
    print("macos-arm64, macos-x64: built, not tried: nothing here runs them")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
