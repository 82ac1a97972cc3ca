"""Makes the project's Python environments, with nothing but the standard library.

`.envs/engine` holds the engine (torch, usd-core, the compiled kernels), `.envs/blender` holds Blender as a Python
module (bpy), `.envs/blender52` and `.envs/blender45` other Blenders for tests, where there is a Python for them. They
never share one: bpy wants an older numpy and brings its own USD. Each is installed from one constraints file. A stamp
in the environment remembers what it was made from, so that a second call costs nothing and a half-made or outdated
environment is finished or brought up to date. It is made anew only when its interpreter is broken, or when it does not
work although everything was installed: a failed update must not cost a working one.

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
from dataclasses import dataclass, field, replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENTS = ROOT / ".envs"
STAMP = "jghand_stamp.txt"
# a package index that PyTorch alone is also looked up in: the one on PyPI brings CUDA along on Linux
TORCH_INDEX_VARIABLE = "JGHAND_TORCH_INDEX"

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
    that must run in the finished environment, else it is made anew · last_words: statements of the project's own code;
    what they print is shown, and their failure is no reason to make an environment anew · holds: smaller sets for the
    same folder that this one has too · constrained_as: another stem of the constraints file.
    """

    name: str
    pythons: tuple[Version | None, ...]
    packages: tuple[str, ...]
    sources: tuple[str, ...]
    builds: bool
    check: str
    last_words: str = ""
    holds: tuple[Environment, ...] = ()
    constrained_as: str = field(default="", repr=False)  # the file itself is part of the fingerprint

    @property
    def folder(self) -> Path:
        return ENVIRONMENTS / self.name

    @property
    def constraints(self) -> Path:
        return ROOT / "constraints" / f"{self.constrained_as or self.name}.txt"

    @property
    def python(self) -> Path:
        """The environment's interpreter (which need not exist yet)."""
        return self.folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")

    def usable(self, version: Version) -> bool:
        open_ended = None in self.pythons
        return version in self.pythons or (open_ended and version > max(v for v in self.pythons if v))


# which kernels draw; where none does, their own sentence says why
WHICH_KERNELS = """
from jghand_engine.native import library
print("drawing with the native kernels, variant", library.load().variant)
"""
ENGINE = Environment(
    name="engine",
    pythons=((3, 11), (3, 12), (3, 13), None),
    packages=("--no-build-isolation", "--editable", ".[learn,usd,video,study,farm,formats]"),
    sources=("pyproject.toml", "setup.py", "jghand_engine/native/build.py", "jghand_engine/native/**/*.cpp",
             "jghand_engine/native/**/*.h"),
    builds=True,
    check="import torch, numpy, pxr",
    last_words=WHICH_KERNELS,
)  # fmt: skip
# the tests of tracking want networks that no package of today holds: without them they are skipped
HAND_MODEL = """
from jghand_engine.errors import JGHandError
from jghand_engine.track.mediapipe_hands import fetch_model
try:
    print("finding hands in videos with", fetch_model().name)
except JGHandError as error:
    print(error)
"""
# the engine with the tools of its tests and checks; whoever only uses it need not have them
DEVELOPER = replace(
    ENGINE,
    packages=(*ENGINE.packages[:-1], ".[dev,learn,usd,video,metrics,perceptual,study,track,farm,formats,gpu]"),
    last_words=WHICH_KERNELS + HAND_MODEL,
    holds=(ENGINE,),
)
# bpy 5.0 is built for Python 3.11 and nothing else, bpy 5.2 for Python 3.13 and nothing else
BLENDER = Environment(
    name="blender",
    pythons=((3, 11), (3, 13)),
    packages=("bpy", "numpy", "pytest", "hypothesis"),
    sources=(),
    builds=False,
    check="import bpy",
)
# the long-term version, beside the one above, for the tests of what differs between them
BLENDER52 = replace(BLENDER, name="blender52", pythons=((3, 13),), constrained_as="blender")
# the oldest that the extension supports, also a long-term version
BLENDER45 = replace(BLENDER, name="blender45", pythons=((3, 11),))


def say(text: str) -> None:
    print(text, flush=True)


def clean_variables() -> dict[str, str]:
    """This process's environment variables without those that mix Python installations."""
    kept = {name: value for name, value in os.environ.items() if name not in LEAKING_VARIABLES}
    return {**kept, "PYTHONNOUSERSITE": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}


def ensure(environment: Environment) -> Path:
    """Makes or updates the environment if that is needed; returns its interpreter.

    Raises SetupError. An environment that was there is then still there, and the next call tries again.
    """
    if is_ready(environment):
        return environment.python
    started = time.perf_counter()
    say(f"Setting up {environment.folder.relative_to(ROOT)}")
    made = _make(environment)
    try:
        _install(environment)
    except SetupError as error:
        raise SetupError(f"{error}\n\n{_what_is_left(environment, made)}") from error
    try:
        _check(environment)
    except MissingLibraryError:
        raise
    except SetupError as error:
        if made:
            raise
        say(f"  {error}\n  making it anew")
        _remove(environment)
        _make(environment)
        _install(environment)
        _check(environment)
    for line in _run_in(environment, environment.last_words).splitlines():
        say(f"  {line}")
    lines = [_fingerprint(one) for one in (environment, *environment.holds)]
    (environment.folder / STAMP).write_text("\n".join(lines) + "\n", encoding="utf-8")
    say(f"  ready after {time.perf_counter() - started:.0f} s")
    return environment.python


def is_ready(environment: Environment) -> bool:
    """Whether the environment is there, whole and up to date. Changes nothing."""
    stamp = environment.folder / STAMP
    if not stamp.is_file() or _fingerprint(environment) not in stamp.read_text(encoding="utf-8").splitlines():
        return False
    return _version_of(environment.python) is not None


def _what_is_left(environment: Environment, made: bool) -> str:
    folder = environment.folder.relative_to(ROOT)
    if made:
        return f"{folder} is unfinished; starting again goes on from here."
    return f"{folder} was not brought up to date and is otherwise kept as it was; starting again tries again."


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


def _remove(environment: Environment) -> None:
    try:
        shutil.rmtree(environment.folder)
    except OSError as error:
        raise SetupError(
            f"Cannot remove {environment.folder}: {error.strerror}. Close what uses it, delete the folder, start again."
        ) from error


def _make(environment: Environment) -> bool:
    """Makes the bare environment unless a usable one is there; returns whether it did."""
    folder = environment.folder
    version = _version_of(environment.python)
    if version and environment.usable(version) and _has_pip(environment.python):
        return False
    command = find_python(environment.pythons)
    if folder.exists():
        say("  the environment there is unfinished or of another Python; removing it")
        _remove(environment)
    folder.parent.mkdir(parents=True, exist_ok=True)
    _step(f"making it with {' '.join(command)}", [*command, "-m", "venv", str(folder)])
    return True


def _has_pip(python: Path) -> bool:
    """False where the making of an environment broke off before pip was in it."""
    command = [str(python), "-c", "import pip"]
    return subprocess.run(command, env=clean_variables(), capture_output=True, check=False).returncode == 0


def _install(environment: Environment) -> None:
    """Installs the pinned packages (and, for the engine, builds the kernels)."""
    # a stamp of an older state must not survive an installation that breaks off
    (environment.folder / STAMP).unlink(missing_ok=True)
    pip = [str(environment.python), "-m", "pip", "install", "--quiet", "-c", str(environment.constraints)]
    if environment.builds:
        _step("installing the build tools", [*pip, "setuptools", "ziglang"], retry=True)
        if index := os.environ.get(TORCH_INDEX_VARIABLE, "").strip():
            step = f"installing PyTorch, looked up in {TORCH_INDEX_VARIABLE} too"
            _step(step, [*pip, "--extra-index-url", index, "torch"], retry=True)
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
    _run_in(environment, environment.check)


def _run_in(environment: Environment, statements: str) -> str:
    """Runs statements in the environment and returns what they print. SetupError says why they fail."""
    done = subprocess.run(
        [str(environment.python), "-c", statements],
        cwd=ROOT, env=clean_variables(), capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode == 0:
        return (done.stdout + done.stderr).strip()
    lines = done.stderr.strip().splitlines()
    reason = lines[-1] if lines else f"exit code {done.returncode}"
    text = f"The environment {environment.folder.relative_to(ROOT)} does not work: {reason}"
    if sys.platform.startswith("linux") and re.search(r"\.so[.\d]*: cannot open shared object", done.stderr):
        raise MissingLibraryError(
            f"{text}\nA system library is missing. On Debian or Ubuntu, install Blender's with:\n"
            f"  sudo apt-get install -y {BLENDER_APT_PACKAGES}"
        )
    raise SetupError(text)
