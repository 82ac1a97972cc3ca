"""Makes the project's two Python environments, with nothing but the standard library.

`.envs/engine` holds the engine (torch, usd-core, the compiled kernels), `.envs/blender` holds Blender as a Python
module (bpy). They never share one: bpy wants an older numpy and brings its own USD. Each is installed from one
constraints file. A stamp in the environment remembers what it was made from, so that a second call costs nothing and a
half-made or outdated environment is finished or made anew.

Only Linux is tried by the project's tests; the ways of macOS and Windows are written but not tried.
"""

from __future__ import annotations

import glob
import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENTS = ROOT / ".envs"
STAMP = "jghand_stamp.txt"

# variables that would let another Python's packages leak into an environment
LEAKING_VARIABLES = ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP", "VIRTUAL_ENV", "CONDA_PREFIX")

# what bpy needs from a Linux system beside Python; a desktop has them, a bare server does not
BLENDER_APT_PACKAGES = (
    "libgl1 libegl1 libegl-mesa0 libgl1-mesa-dri libsm6 libice6 libxkbcommon0 libxi6 libxfixes3 libxrender1 libxxf86vm1"
)

Version = tuple[int, int]


class SetupError(Exception):
    """The set-up cannot go on; the text says what is missing and what to do."""


class MissingLibraryError(SetupError):
    """The environment is whole, the system lacks a library that it needs."""


@dataclass(frozen=True)
class Environment:
    """What one environment is made of.

    name: folder below `.envs` and stem of its constraints file · pythons: usable Python versions, best first; a last
    entry of None means "and any newer" · packages: what pip installs · sources: glob patterns whose change asks for a
    new installation · builds: True if the project itself is installed (and its kernels compiled) · check: a statement
    that must run in the finished environment.
    """

    name: str
    pythons: tuple[Version | None, ...]
    packages: tuple[str, ...]
    sources: tuple[str, ...]
    builds: bool
    check: str

    @property
    def folder(self) -> Path:
        return ENVIRONMENTS / self.name

    @property
    def constraints(self) -> Path:
        return ROOT / "constraints" / f"{self.name}.txt"

    @property
    def python(self) -> Path:
        """The environment's interpreter (which need not exist yet)."""
        return self.folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")

    def usable(self, version: Version) -> bool:
        open_ended = None in self.pythons
        return version in self.pythons or (open_ended and version > max(v for v in self.pythons if v))


ENGINE = Environment(
    name="engine",
    pythons=((3, 11), (3, 12), (3, 13), None),
    packages=("--no-build-isolation", "--editable", ".[dev,video]"),
    sources=("pyproject.toml", "setup.py", "jghand_engine/native/build.py", "jghand_engine/native/**/*.cpp",
             "jghand_engine/native/**/*.h"),
    builds=True,
    check="import torch, numpy, pxr, jghand_engine",
)  # fmt: skip
# bpy 5.0 is built for Python 3.11 and nothing else, bpy 5.2 for Python 3.13 and nothing else
BLENDER = Environment(
    name="blender",
    pythons=((3, 11), (3, 13)),
    packages=("bpy", "numpy", "pytest"),
    sources=(),
    builds=False,
    check="import bpy",
)


def say(text: str) -> None:
    print(text, flush=True)


def clean_variables() -> dict[str, str]:
    """This process's environment variables without those that mix Python installations."""
    kept = {name: value for name, value in os.environ.items() if name not in LEAKING_VARIABLES}
    return {**kept, "PYTHONNOUSERSITE": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}


def ensure(environment: Environment) -> Path:
    """Makes or updates the environment if that is needed; returns its interpreter. Raises SetupError."""
    wanted = _fingerprint(environment)
    stamp = environment.folder / STAMP
    if stamp.is_file() and stamp.read_text(encoding="utf-8").strip() == wanted and _version_of(environment.python):
        return environment.python
    started = time.perf_counter()
    say(f"Setting up {environment.folder.relative_to(ROOT)}")
    existed = environment.folder.exists()
    try:
        _fill(environment)
    except MissingLibraryError:
        raise
    except SetupError:
        if not existed:
            raise
        say("  it cannot be brought up to date; making it anew")
        _remove(environment)
        _fill(environment)
    stamp.write_text(wanted + "\n", encoding="utf-8")
    say(f"  ready after {time.perf_counter() - started:.0f} s")
    return environment.python


# ---- finding an interpreter ------------------------------------------------------------------------------------------


def find_python(versions: tuple[Version | None, ...]) -> list[str]:
    """The command of the first installed Python of one of the versions, in their order. Raises SetupError.

    A candidate counts only if it runs and can make environments: shims and Debian's Python without its venv package do
    not.
    """
    named = [version for version in versions if version]
    for version in named:
        for command in _candidates(version):
            if _probe(command) == version:
                return command
    if None in versions and sys.version_info[:2] > max(named) and _probe([sys.executable]):
        return [sys.executable]
    texts = [f"{major}.{minor}" for major, minor in named]
    listing = " or ".join(texts) + (" or newer" if None in versions else "")
    raise SetupError(
        f"No usable Python {listing} was found. Install Python {texts[0]} with its venv module, from python.org, with "
        f"Homebrew (brew install python@{texts[0]}) or with your system's packages (python{texts[0]} and "
        f"python{texts[0]}-venv), so that the command python{texts[0]} works; then start again."
    )


def _candidates(version: Version) -> Iterator[list[str]]:
    """Commands that may be Python `version`, nearest first."""
    text = f"{version[0]}.{version[1]}"
    short = text.replace(".", "")
    if sys.version_info[:2] == version:
        yield [sys.executable]
    for folder in os.environ.get("PATH", "").split(os.pathsep):
        found = shutil.which(f"python{text}", path=folder) if folder else None
        if found:
            yield [found]
    if os.name == "nt":
        if shutil.which("py"):
            yield ["py", f"-{text}"]
        yield [os.path.expandvars(rf"%LOCALAPPDATA%\Programs\Python\Python{short}\python.exe")]
        yield [rf"C:\Program Files\Python{short}\python.exe"]
    patterns = (
        f"/opt/homebrew/opt/python@{text}/bin/python{text}",
        f"/usr/local/opt/python@{text}/bin/python{text}",
        f"/Library/Frameworks/Python.framework/Versions/{text}/bin/python{text}",
        f"~/.pyenv/versions/{text}.*/bin/python{text}",
        f"~/.local/share/uv/python/cpython-{text}.*/bin/python{text}",
    )
    for pattern in patterns:
        for path in sorted(glob.glob(os.path.expanduser(pattern))):
            yield [path]


def _probe(command: list[str]) -> Version | None:
    """The version of a Python that runs and can make environments, else None."""
    code = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2])"
    try:
        done = subprocess.run(
            [*command, "-c", code], capture_output=True, text=True, timeout=60, env=clean_variables(), check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    match = re.fullmatch(r"(\d+)\.(\d+)", done.stdout.strip())
    return (int(match[1]), int(match[2])) if done.returncode == 0 and match else None


def _version_of(python: Path) -> Version | None:
    return _probe([str(python)]) if python.exists() else None


# ---- making and filling ------------------------------------------------------------------------------------------


def _fingerprint(environment: Environment) -> str:
    """A hash of everything the environment is made from, this file's recipe and the project's place included."""
    digest = hashlib.sha256(f"{environment} {ROOT}".encode())
    for pattern in (*environment.sources, environment.constraints.relative_to(ROOT).as_posix()):
        for path in sorted(ROOT.glob(pattern)):
            digest.update(path.relative_to(ROOT).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _fill(environment: Environment) -> None:
    _make(environment)
    _install(environment)
    _check(environment)


def _remove(environment: Environment) -> None:
    try:
        shutil.rmtree(environment.folder)
    except OSError as error:
        raise SetupError(
            f"Cannot remove {environment.folder}: {error.strerror}. Close what uses it, delete the folder, start again."
        ) from error


def _make(environment: Environment) -> None:
    """Makes the bare environment unless a usable one is there."""
    folder = environment.folder
    version = _version_of(environment.python)
    if version and environment.usable(version):
        return
    command = find_python(environment.pythons)
    if folder.exists():
        say("  the environment there is unfinished or of another Python; removing it")
        _remove(environment)
    folder.parent.mkdir(parents=True, exist_ok=True)
    _step(f"making it with {' '.join(command)}", [*command, "-m", "venv", str(folder)])


def _install(environment: Environment) -> None:
    """Installs the pinned packages (and, for the engine, builds the kernels)."""
    # a stamp of an older state must not survive an installation that breaks off
    (environment.folder / STAMP).unlink(missing_ok=True)
    pip = [str(environment.python), "-m", "pip", "install", "--quiet", "-c", str(environment.constraints)]
    if environment.builds:
        _step("installing the build tools", [*pip, "setuptools", "ziglang"], retry=True)
        _step("installing the packages and building the kernels", [*pip, *environment.packages], retry=True)
    else:
        _step("installing the packages", [*pip, *environment.packages], retry=True)


def _step(text: str, command: list[str], *, retry: bool = False) -> None:
    """Runs one command in the project's folder and says how long it took; a failure shows the end of its output."""
    print(f"  {text} ... ", end="", flush=True)
    started = time.perf_counter()
    done = subprocess.run(command, cwd=ROOT, env=clean_variables(), capture_output=True, text=True, check=False)
    if done.returncode and retry:
        print("once more ... ", end="", flush=True)
        done = subprocess.run(command, cwd=ROOT, env=clean_variables(), capture_output=True, text=True, check=False)
    say(f"{time.perf_counter() - started:.0f} s")
    if done.returncode:
        end = "\n".join((done.stdout + done.stderr).strip().splitlines()[-25:])
        raise SetupError(f"This step failed: {text}.\n{end}\n\nThe command was: {' '.join(command)}")


def _check(environment: Environment) -> None:
    """Imports what the environment is for."""
    done = subprocess.run(
        [str(environment.python), "-c", environment.check],
        cwd=ROOT, env=clean_variables(), capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode == 0:
        return
    lines = done.stderr.strip().splitlines()
    reason = lines[-1] if lines else f"exit code {done.returncode}"
    text = f"The environment {environment.folder.relative_to(ROOT)} does not work: {reason}"
    if sys.platform.startswith("linux") and re.search(r"\.so[.\d]*: cannot open shared object", done.stderr):
        raise MissingLibraryError(
            f"{text}\nA system library is missing. On Debian or Ubuntu, install Blender's with:\n"
            f"  sudo apt-get install -y {BLENDER_APT_PACKAGES}"
        )
    raise SetupError(text)
