"""Builds the native library from every *.cpp of this folder, for this machine or for every release target.

    python -m jghand_engine.native.build                 the libraries of this machine
    python -m jghand_engine.native.build linux_aarch64 … named targets (cross-compiled; `all` for every one)

The compiler is clang inside the `ziglang` wheel, so that no compiler needs to be installed; the environment variable
JGHAND_CXX names another one. gcc is not recommended for the AVX2 variant: it splits 64-byte vectors badly.

The sources use C headers only (<math.h>, <stdint.h>, <string.h>), no C++ standard library, no exceptions and no RTTI:
then nothing of libc++ is compiled, and the first build of all takes seconds instead of a minute.

Standard library only: setup.py runs this inside an isolated build environment.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from jghand_engine.errors import InputError, JGHandError, RetryError
from jghand_engine.files import writing

SOURCE_FOLDER = Path(__file__).resolve().parent
LIBRARY_FOLDER = SOURCE_FOLDER / "lib"

# never -ffast-math: culling of non-finite input and float-to-int rounding rely on IEEE arithmetic (RENDERING 4.3)
FLAGS = (
    *("-O3", "-std=c++17", "-shared", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast"),
    *("-fno-exceptions", "-fno-rtti", "-fno-threadsafe-statics", "-fvisibility=hidden", "-Wall", "-Wextra"),
)
STAMP_PATTERN = re.compile(rb"JGHAND-BUILD sources=([0-9a-f]{64}) compiler=([^\0]*)\0")


@dataclass(frozen=True)
class Target:
    """One library: `zig` triple, `cpu` as zig spells it, `march` for other compilers, and the wheel's platform tag.

    `folder` holds its sources; `detector` is the tiny library that tells which variant this processor can run.
    """

    platform: str
    variant: str
    zig: str
    cpu: str
    march: str
    suffix: str
    wheel_tag: str
    folder: str = ""

    @property
    def name(self) -> str:
        return f"{self.platform}_{self.variant}"

    @property
    def file_name(self) -> str:
        return f"jghand_{self.name}{self.suffix}"


def _x86_targets(system: str, zig: str, suffix: str, wheel_tag: str) -> tuple[Target, ...]:
    variants = (
        ("detector", "baseline", "x86-64", "detector"),
        ("v3", "x86_64_v3", "x86-64-v3", ""),
        ("v4", "x86_64_v4", "x86-64-v4", ""),
    )
    return tuple(
        Target(f"{system}_x86_64", name, zig, cpu, march, suffix, wheel_tag, folder)
        for name, cpu, march, folder in variants
    )


TARGETS: dict[str, Target] = {
    target.name: target
    for target in (
        *_x86_targets("linux", "x86_64-linux-gnu.2.28", ".so", "manylinux_2_28_x86_64"),
        *_x86_targets("windows", "x86_64-windows-gnu", ".dll", "win_amd64"),
        *_x86_targets("macos", "x86_64-macos", ".dylib", "macosx_11_0_x86_64"),
        Target(
            "linux_aarch64", "neon", "aarch64-linux-gnu.2.28", "generic", "armv8-a", ".so", "manylinux_2_28_aarch64"
        ),
        Target("macos_aarch64", "neon", "aarch64-macos", "apple_m1", "armv8.4-a", ".dylib", "macosx_11_0_arm64"),
    )
}


def host_platform() -> str:
    """This machine in the words of TARGETS, for example linux_x86_64."""
    systems = {"linux": "linux", "darwin": "macos", "win32": "windows"}
    machines = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
    machine = platform.machine().lower()
    return f"{systems.get(sys.platform, sys.platform)}_{machines.get(machine, machine)}"


def host_targets() -> list[Target]:
    """The libraries of this machine; empty where there are no kernels for its processor."""
    return [target for target in TARGETS.values() if target.platform == host_platform()]


# ---- compilers ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Compiler:
    """`command` starts it, `name` is written into the library."""

    command: tuple[str, ...]
    name: str
    is_zig: bool


def find_compiler() -> Compiler:
    """JGHAND_CXX, else the ziglang wheel of this Python. Without any: RetryError."""
    if command := os.environ.get("JGHAND_CXX", "").strip():
        # its name stands in a C string, where backslashes and quotes mean something else
        return Compiler(tuple(shlex.split(command)), re.sub(r"[\\\"]", "/", command), is_zig=False)
    if importlib.util.find_spec("ziglang") is None:
        raise RetryError(
            "no compiler for the native library",
            remedy="Install one with `pip install ziglang==0.17.0`, or name a clang++ in JGHAND_CXX.",
        )
    return Compiler((sys.executable, "-m", "ziglang", "c++"), f"zig {_zig_version()}", is_zig=True)


def _zig_version() -> str:
    from importlib import metadata

    return metadata.version("ziglang")


def _arguments(compiler: Compiler, target: Target) -> list[str]:
    """Flags beyond FLAGS for one compiler and one target."""
    arguments = [] if target.suffix == ".dll" else ["-fPIC"]
    if target.variant == "v4":
        arguments.append("-mprefer-vector-width=512")
    if compiler.is_zig:
        return [*arguments, "-target", target.zig, f"-mcpu={target.cpu}", "-s", "-nostdlib++"]
    arguments += [f"-march={target.march}", "-Wno-psabi"]
    if target.suffix == ".so":
        arguments += ["-s", "-nodefaultlibs", "-lm", "-lc", "-lgcc"]
    return arguments


# ---- stamps ---------------------------------------------------------------------------------------------------------


def source_files(folder: str = "") -> list[Path]:
    """Every C++ file and header of one library, in a fixed order."""
    place = SOURCE_FOLDER / folder
    return sorted([*place.glob("*.cpp"), *place.glob("*.h")])


def source_hash(target: Target) -> str:
    """SHA-256 over the sources and the flags of a target; what a library must carry to be up to date."""
    zig_arguments = _arguments(Compiler((), "", is_zig=True), target)
    digest = hashlib.sha256(repr((FLAGS, zig_arguments, target)).encode())
    for path in source_files(target.folder):
        digest.update(path.name.encode() + b"\0" + path.read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()


@dataclass(frozen=True)
class Stamp:
    """What a library says about its own build."""

    sources: str
    compiler: str


def read_stamp(path: Path) -> Stamp | None:
    """The stamp inside a built library, without loading it; None when there is no such file or no stamp in it."""
    try:
        match = STAMP_PATTERN.search(path.read_bytes())
    except OSError:
        return None
    return Stamp(match[1].decode(), match[2].decode("utf-8", "replace")) if match else None


def has_these_sources(target: Target, folder: Path = LIBRARY_FOLDER) -> bool:
    """Whether the library was built from the sources as they are, by whatever compiler: then it can be used."""
    stamp = read_stamp(folder / target.file_name)
    return stamp is not None and stamp.sources == source_hash(target)


# ---- building -------------------------------------------------------------------------------------------------------


def build(target: Target, folder: Path = LIBRARY_FOLDER) -> Path:
    """Compiles one library into `folder` and returns its path. A failing compiler is a RetryError with its output."""
    compiler = find_compiler()
    path = folder / target.file_name
    stamp = f"JGHAND-BUILD sources={source_hash(target)} compiler={compiler.name}"
    sources = [file for file in source_files(target.folder) if file.suffix == ".cpp"]
    # linkers leave an import library beside a Windows library, so they work in a folder of their own
    with writing(path) as temporary, tempfile.TemporaryDirectory() as work:
        output = Path(work) / path.name
        defines = [f'-DJG_BUILD_STAMP="{stamp}"', f'-DJG_VARIANT="{target.variant}"']
        # libraries after the sources: a linker that drops unneeded ones looks at them in order
        command = [*compiler.command, *FLAGS, *defines, *map(str, sources), *_arguments(compiler, target)]
        try:
            result = subprocess.run(
                [*command, "-o", str(output)], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
            )
        except OSError as error:
            raise InputError(
                f"compiler {compiler.name}",
                wanted="a C++ compiler",
                came=str(error),
                remedy="Correct JGHAND_CXX.",
            ) from error
        if result.returncode != 0:
            raise RetryError(f"building {path.name} with {compiler.name} failed", came=result.stderr[-4000:])
        shutil.copyfile(output, temporary)
    return path


def build_all(targets: list[Target], folder: Path = LIBRARY_FOLDER) -> list[Path]:
    """Builds what is not of these sources, two at a time."""
    stale = [target for target in targets if not has_these_sources(target, folder)]
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(lambda target: build(target, folder), stale))


def main(names: list[str]) -> None:
    if names == ["all"]:
        targets = list(TARGETS.values())
    else:
        if unknown := [name for name in names if name not in TARGETS]:
            raise InputError("build target", wanted=f"all | {' | '.join(TARGETS)}", came=", ".join(unknown))
        targets = [TARGETS[name] for name in names] if names else host_targets()
    for path in build_all(targets):
        print(f"{path} {path.stat().st_size} bytes")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except JGHandError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
