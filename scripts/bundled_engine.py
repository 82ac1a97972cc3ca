"""What the extension's zip carries of the engine, for one platform or for all of them.

`engine/common` holds the package and the pure Python packages that it wants, `engine/PLATFORM` what is compiled for a
platform but for the kernels, which lie in the package; Blender's own Python runs it as a process of its own
(blender_addon/renderer/process.py). The kernels are built by zig for every platform from this one; zig and the
packages come from PyPI once and are kept in `.envs`.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # jghand_engine.native.build needs nothing but the standard library

from jghand_engine.errors import JGHandError
from jghand_engine.native import build as kernels

PACKAGE = ROOT / "jghand_engine"
CONSTRAINTS = ROOT / "constraints" / "engine.txt"
CACHE = ROOT / ".envs" / "extension"
# Blender's Python has numpy; of the rest the drawing half imports safetensors, and the command line the others
PURE = (
    *("tyro", "rich", "docstring_parser", "typeguard", "typing_extensions"),
    *("markdown-it-py", "mdurl", "Pygments"),
)
COMPILED = ("safetensors",)  # abi3: one file for every Python of a platform
# the sources of the kernels are carried: the library is compared with them before it is loaded
NOT_CARRIED = {".pyc"}


@dataclass(frozen=True)
class Platform:
    """A platform in Blender's words, in those of the kernels, and the tags of its wheels, best first."""

    blender: str
    kernels: str
    tags: tuple[str, ...]


PLATFORMS = {
    each.blender: each
    for each in (
        Platform("linux-x64", "linux_x86_64", ("manylinux_2_17_x86_64", "manylinux2014_x86_64")),
        Platform("linux-arm64", "linux_aarch64", ("manylinux_2_17_aarch64", "manylinux2014_aarch64")),
        Platform("windows-x64", "windows_x86_64", ("win_amd64",)),
        Platform("macos-arm64", "macos_aarch64", ("macosx_11_0_arm64",)),
        Platform("macos-x64", "macos_x86_64", ("macosx_10_12_x86_64",)),
    )
}


class BundleError(Exception):
    """The engine cannot be put into the zip; the text says why and what to do."""


def host_platform() -> str | None:
    """This machine in Blender's words; None where the kernels are not built for it."""
    here = kernels.host_platform()
    return next((each.blender for each in PLATFORMS.values() if each.kernels == here), None)


def files(platforms: Sequence[str]) -> Iterator[tuple[str, bytes]]:
    """Name in the zip and content of all that is carried for these platforms. BundleError."""
    chosen = [PLATFORMS[name] for name in platforms]
    for path in sorted(PACKAGE.rglob("*")):
        name = path.relative_to(PACKAGE)
        if path.is_file() and path.suffix not in NOT_CARRIED and name.parts[:2] != ("native", "lib"):
            yield f"engine/common/jghand_engine/{name.as_posix()}", path.read_bytes()
    for path in built_kernels(chosen):
        yield f"engine/common/jghand_engine/native/lib/{path.name}", path.read_bytes()
    for package in PURE:
        yield from _unpacked(_wheel(package, ()), "engine/common")
    for platform in chosen:
        for package in COMPILED:
            yield from _unpacked(_wheel(package, platform.tags), f"engine/{platform.kernels}")
    yield "engine/constraints.txt", CONSTRAINTS.read_bytes()


def built_kernels(platforms: Sequence[Platform]) -> list[Path]:
    """The kernels of these platforms, built where they are not, or not of these sources. BundleError."""
    wanted = [target for target in kernels.TARGETS.values() if target.platform in {each.kernels for each in platforms}]
    folder = CACHE / "kernels"
    folder.mkdir(parents=True, exist_ok=True)
    if not all(kernels.has_these_sources(target, folder) for target in wanted):
        _need_zig()
    try:
        kernels.build_all(wanted, folder)
    except JGHandError as error:
        raise BundleError(str(error)) from error
    return [folder / target.file_name for target in wanted]


def _need_zig() -> None:
    """Makes zig known to this Python and to those that it starts."""
    if os.environ.get("JGHAND_CXX") or importlib.util.find_spec("ziglang") is not None:
        return
    folder = CACHE / "zig"
    if not (folder / "ziglang").is_dir():
        _pip("install", "--no-deps", "--target", str(folder), "ziglang")
    sys.path.insert(0, str(folder))
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH", ""))))


def _wheel(package: str, tags: Sequence[str]) -> Path:
    """The wheel of a package as constraints/engine.txt pins it: pure, or for one platform. BundleError."""
    folder = CACHE / "wheels" / (tags[0] if tags else "any")
    stem = package.replace("-", "_").lower()
    version = _pinned(package)

    def found() -> Path | None:
        there = (path for path in folder.glob("*.whl") if path.name.lower().startswith(f"{stem}-{version}-"))
        return next(there, None)

    if found() is None:
        platforms = [word for tag in tags for word in ("--platform", tag)]
        abi = ("--implementation", "cp", "--abi", "abi3", "--python-version", "3.11") if tags else ()
        only = ("--no-deps", "--only-binary=:all:", "--dest", str(folder))
        _pip("download", *only, *platforms, *abi, f"{package}=={version}")
    path = found()
    if path is None:
        raise BundleError(f"pip has not brought a wheel of {package} {version} for {tags[0] if tags else 'any system'}")
    return path


def _pinned(package: str) -> str:
    for line in CONSTRAINTS.read_text(encoding="utf-8").splitlines():
        name, _, version = line.partition("==")
        if name.strip().lower().replace("_", "-") == package.lower().replace("_", "-"):
            return version.split(";")[0].strip()
    raise BundleError(f"{CONSTRAINTS} does not pin {package}")


def _pip(*words: str) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q", *words, "-c", str(CONSTRAINTS)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BundleError(f"{' '.join(command)} failed:\n{done.stderr.strip() or done.stdout.strip()}")


def _unpacked(wheel: Path, folder: str) -> Iterator[tuple[str, bytes]]:
    """The files of a wheel, its license included."""
    with zipfile.ZipFile(wheel) as archive:
        for name in sorted(archive.namelist()):
            if not name.endswith("/") and ".data/" not in name:
                yield f"{folder}/{name}", archive.read(name)
