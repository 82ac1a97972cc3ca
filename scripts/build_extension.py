"""Builds the Blender extension: the zip that an artist installs, and the index of a repository that serves it.

    python scripts/build_extension.py                       dist/jghand-0.1.0-PLATFORM.zip for this machine
    python scripts/build_extension.py --platforms all       one for each platform, and one for all of them
    python scripts/build_extension.py --platforms none      without the engine, for one that is found elsewhere
    python scripts/build_extension.py --out FOLDER          the same in another folder
    python scripts/build_extension.py --zip-only            no index, and no check by Blender

The zip needs nothing but Python 3.11 or newer, and for the engine PyPI the first time. It holds `blender_addon`, a
copy of what extension and engine share, and the engine itself with its kernels
(scripts/bundled_engine.py); the same files give the same bytes. Blender's own tool checks it and writes the index; the
tool comes with every Blender as a module (`.envs/blender`, made by scripts/test.py) and needs no Blender to run. A
folder with the results on any web server is a repository: its address is that of index.json.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bundled_engine
from bundled_engine import PLATFORMS, BundleError

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "blender_addon"
MANIFEST = "blender_manifest.toml"
# what lies elsewhere in the project and at these places in the zip; what `shared` has of the engine imports one another
_SHARED = (
    *("errors.py", "hand/__init__.py"),
    *(f"hand/{name}.py" for name in ("joints", "rotations", "canonical", "kinematics", "shapes")),
)
FROM_ELSEWHERE = {
    "assets/hand_right.npz": ROOT / "jghand_engine" / "assets" / "hand_right.npz",
    "core/conventions.py": ROOT / "jghand_engine" / "motion" / "conventions.py",
    **{f"core/shared/{name}": ROOT / "jghand_engine" / name for name in _SHARED},
    "core/protocol.py": ROOT / "jghand_engine" / "service" / "protocol.py",
    "LICENSE-MIT": ROOT / "LICENSE",  # of these files
}
# what an extension may hold; anything else in the folder is there by mistake
KNOWN_SUFFIXES = {".py", ".toml", ".json", ".blend", ".txt", ".npz", ".png", ".html"}
KNOWN_NAMES = {"LICENSE", "NOTICE"}
PASSED_OVER = {"__pycache__", ".pytest_cache", ".ruff_cache"}
# the first moment that a zip can name, and rights that everybody can read: both are part of a zip's bytes
MOMENT = (1980, 1, 1, 0, 0, 0)
RIGHTS = 0o100644
# a file of Git LFS that was never fetched
POINTER = b"version https://git-lfs"
# a download that nobody has to think about; what the engine and its avatars need is about a third of it
SIZE_MAX = 25_000_000
TOOL = "bl_pkg/cli/blender_ext.py"


class BuildError(Exception):
    """The extension cannot be built; the text says why and what to do."""


def members(source: Path = SOURCE) -> dict[str, Path]:
    """Name in the zip -> file, sorted by name. BuildError: a file that nobody expects in an extension."""
    found = dict(FROM_ELSEWHERE)
    for path in _files(source):
        name = path.relative_to(source).as_posix()
        if path.suffix not in KNOWN_SUFFIXES and path.name not in KNOWN_NAMES:
            raise BuildError(f"{path} is of no kind that an extension holds. Move it away, or add it to this script.")
        if name in FROM_ELSEWHERE:
            raise BuildError(f"{path} is put there by this script. Delete it.")
        found[name] = path
    return dict(sorted(found.items()))


def _files(folder: Path) -> Iterator[Path]:
    for path in folder.iterdir():
        if path.name in PASSED_OVER:
            continue
        if path.is_dir():
            yield from _files(path)
        else:
            yield path


def build(out: Path, source: Path = SOURCE, platforms: Sequence[str] = ()) -> Path:
    """Writes the zip into folder `out` and returns its path: {id}-{version}.zip, as the manifest says, and with the
    platform in its name where it is for one.

    platforms: those that the engine is carried for, in Blender's words; none: without the engine. BuildError.
    """
    text = (source / MANIFEST).read_text(encoding="utf-8")
    manifest = tomllib.loads(text)
    out.mkdir(parents=True, exist_ok=True)
    stem = f"{manifest['id']}-{manifest['version']}"
    if len(platforms) == 1:
        stem += f"-{platforms[0].replace('-', '_')}"
    path = out / f"{stem}.zip"
    unfinished = path.with_suffix(".part")
    with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, content in _contents(source, platforms):
            if content.startswith(POINTER):
                raise BuildError(f"{name} is a pointer of Git LFS. Fetch the file itself (git lfs pull).")
            if name == MANIFEST:
                content = _with_platforms(text, platforms).encode()
            entry = zipfile.ZipInfo(name, MOMENT)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, RIGHTS << 16
            entry.create_system = 3  # else Windows and the others write different bytes
            archive.writestr(entry, content)
    size = unfinished.stat().st_size
    if size > SIZE_MAX:
        raise BuildError(f"{path.name} would have {size / 1e6:.1f} MB; {SIZE_MAX / 1e6:.0f} MB is what it may have.")
    os.replace(unfinished, path)
    return path


def _contents(source: Path, platforms: Sequence[str]) -> Iterator[tuple[str, bytes]]:
    for name, file in members(source).items():
        yield name, file.read_bytes()
    if platforms:
        yield from bundled_engine.files(platforms)


def _with_platforms(manifest: str, platforms: Sequence[str]) -> str:
    """The manifest that says for which platforms the zip is; as it was, where it is for every one."""
    if not platforms:
        return manifest
    names = ", ".join(f'"{name}"' for name in platforms)
    line = f"platforms = [{names}]\n"
    return manifest.replace("\n[permissions]", f"{line}\n[permissions]", 1)


def find_tool() -> Path | None:
    """Blender's tool for extensions, in one of the project's environments; the newest Blender's, if there are more."""
    return max((ROOT / ".envs").glob(f"blender*/**/{TOOL}"), key=lambda path: path.parents[4].name, default=None)


def run_tool(tool: Path, *arguments: object) -> None:
    """Runs Blender's tool; BuildError with what it said when it finds something wrong."""
    command = [sys.executable, str(tool), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BuildError(f"Blender's tool says no to: {' '.join(map(str, arguments))}\n{done.stdout}{done.stderr}")


def check_and_index(tool: Path, archives: Sequence[Path]) -> None:
    """Lets Blender's tool check the zips, then write index.json and index.html of all zips in their folder."""
    for archive in archives:
        run_tool(tool, "validate", archive)
    run_tool(tool, "server-generate", "--repo-dir", archives[0].parent, "--html")


def zips_of(choice: str) -> list[tuple[str, ...]]:
    """The platforms of each zip that `--platforms` asks for. BuildError."""
    if choice == "none":
        return [()]
    if choice == "all":
        return [*((name,) for name in PLATFORMS), tuple(PLATFORMS)]
    names = [choice] if choice != "this" else [name for name in [bundled_engine.host_platform()] if name]
    if not names or any(name not in PLATFORMS for name in names):
        raise BuildError(f"The engine is built for {', '.join(PLATFORMS)}. Name one of them, all, or none.")
    return [tuple(names)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the results (default dist)")
    parser.add_argument(
        "--platforms",
        default="this",
        help="this (default) | all | none | " + " | ".join(PLATFORMS),
        metavar="WHICH",
    )
    parser.add_argument("--zip-only", action="store_true", help="write the zip alone, unchecked")
    options = parser.parse_args()
    paths = [build(options.out, platforms=platforms) for platforms in zips_of(options.platforms)]
    for path in paths:
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
    if options.zip_only:
        return 0
    tool = find_tool()
    if tool is None:
        print(
            "Not checked by Blender's tool for extensions, and without an index: `.envs/blender`, which has that tool, "
            "is made by `python scripts/test.py --only blender`."
        )
        return 0
    check_and_index(tool, paths)
    print(f"{options.out / 'index.json'}: every zip of this folder, for Blender's list of repositories")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (BuildError, BundleError) as problem:
        sys.exit(str(problem))
