"""A folder with Debian, a real Blender and a virtual screen, and running a command in it.

Blender as a module (bpy) has no window. Where no Blender with a virtual screen is installed, Debian's unstable suite
has both; this unpacks them into one folder (about 1.3 GB, two minutes), touches nothing else of the system, and starts
commands there. Needs root, the right to mount, and mmdebstrap; whatever is missing is said as `NotPossibleError`.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

# Debian's suite: the one that has a Blender this extension supports (5.2 LTS when this was written)
SUITE = "sid"
DEBIAN = "http://deb.debian.org/debian"
MIRROR_VARIABLE = "JGHAND_DEBIAN_MIRROR"
PACKAGES = (
    # JGHand and the extension system want the last three, and apt takes them for optional
    "blender", "python3-numpy", "python3-cattr", "python3-requests",
    # MediaPipe, which finds hands in films, wants this one
    "libgles2",
    # a screen without a monitor, a hand on mouse and keyboard, pictures of the screen
    "xvfb", "xauth", "xdotool", "imagemagick",
    "libgl1", "libglx-mesa0", "libegl1", "libegl-mesa0", "libgl1-mesa-dri", "fonts-dejavu-core", "ca-certificates",
)  # fmt: skip
# what a run on this machine itself needs
PROGRAMS = ("blender", "Xvfb", "xdotool", "import")


class NotPossibleError(Exception):
    """There is no way to a Blender with a window here; the text says what is missing."""


@dataclass(frozen=True)
class Place:
    """Where commands are run: in `folder`, or on this machine itself (None)."""

    folder: Path | None

    def command(self, command: Sequence[str], seen: Sequence[Path], variables: Mapping[str, str]) -> list[str]:
        """The command line that runs `command` there.

        seen: folders of this machine that the command uses; they stand at the same paths there. variables: its whole
        environment, but for PATH and locale.
        """
        settings = [f"{name}={value}" for name, value in variables.items()]
        clean = ["env", "-i", "PATH=/usr/local/bin:/usr/bin:/bin", "LANG=C.UTF-8", *settings, *command]
        if self.folder is None:
            return clean
        lines = ["set -eu"]
        for path in map(Path, ("/proc", "/dev", "/dev/pts", "/sys", *map(str, seen))):
            there = shlex.quote(f"{self.folder}{path}")
            lines.append(f"mkdir -p {there}; mount --bind {shlex.quote(str(path))} {there}")
        lines.append(f'exec chroot {shlex.quote(str(self.folder))} "$@"')
        # the mounts live in a space of their own and end with the command: deleting the folder cannot reach through
        return ["unshare", "--mount", "--", "bash", "-c", "\n".join(lines), "bash", *clean]


def find_place(folder: Path) -> Place:
    """The place to run Blender in: this machine when it has all that is needed, else `folder`, made when it is not
    there. NotPossibleError says what is missing."""
    if all(shutil.which(name) for name in PROGRAMS):
        return Place(None)
    if not sys.platform.startswith("linux"):
        raise NotPossibleError("a virtual screen needs Linux")
    if os.geteuid() != 0:
        raise NotPossibleError(f"{', '.join(PROGRAMS)} are not all installed, and a folder with them needs root")
    if subprocess.run(["unshare", "--mount", "true"], capture_output=True, check=False).returncode:
        raise NotPossibleError("this system does not allow mounts, which a folder with Blender needs")
    if not folder.is_dir():
        make_folder(folder)
    return Place(folder.resolve())


def make_folder(folder: Path) -> None:
    """Unpacks Debian with PACKAGES into `folder`. NotPossibleError when that cannot be done."""
    if shutil.which("mmdebstrap") is None:
        raise NotPossibleError("mmdebstrap is not installed (apt-get install -y mmdebstrap)")
    # never deleted from here: what broke off may still have the system's /dev and /proc mounted in it
    unfinished = folder.with_name(f"{folder.name}.unfinished")
    if unfinished.exists():
        raise NotPossibleError(
            f"{unfinished} is being made, or broke off. Wait, or delete it when nothing is mounted in it"
        )
    folder.parent.mkdir(parents=True, exist_ok=True)
    print(f"Making {folder}: Debian {SUITE} with Blender, about 1.3 GB and two minutes", flush=True)
    command = [
        "mmdebstrap", "--mode=root", "--variant=apt", f"--include={','.join(PACKAGES)}",
        "--aptopt=APT::Install-Recommends \"false\"",
        # the suite's list may be older than it likes to be on a slow mirror; signatures are checked all the same
        "--aptopt=Acquire::Check-Valid-Until \"false\"",
        "--dpkgopt=path-exclude=/usr/share/doc/*", "--dpkgopt=path-exclude=/usr/share/man/*",
        "--dpkgopt=path-exclude=/usr/share/locale/*",
        SUITE, str(unfinished), os.environ.get(MIRROR_VARIABLE) or _mirror(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise NotPossibleError(f"the folder could not be made: {' / '.join(done.stderr.strip().splitlines()[-3:])}")
    os.rename(unfinished, folder)


def _mirror() -> str:
    """The Debian mirror that this system's apt uses, else Debian's own."""
    ask = ["apt-get", "indextargets", "--format", "$(ORIGIN)|$(LABEL)|$(SITE)", "Created-By: Packages"]
    try:
        lines = subprocess.run(ask, capture_output=True, text=True, check=False).stdout.splitlines()
    except OSError:
        lines = []
    return next((line.split("|")[2] for line in lines if line.startswith("Debian|Debian|")), DEBIAN)
