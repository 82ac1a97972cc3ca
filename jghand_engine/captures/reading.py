"""What every reader of a data set needs: its root, cameras, a look at its joints, and the count of what is left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.orders import JointOrder, check_hand_size, check_order
from jghand_engine.json_files import numbers
from jghand_engine.render.camera import Camera

# folders between the one that the user names and the one that holds the set, upwards and downwards
FOLDER_LEVELS_UP = 6
FOLDER_LEVELS_DOWN = 2
# by how much a stored camera rotation may fail to be one: text with six digits
CAMERA_ROTATION_TOLERANCE = 1e-4
# ... and the skew of a camera that is taken for none, px: none of the data sets has any
CAMERA_SKEW_MAX_PX = 1e-3

# is told what is wrong, and the reading goes on without it
Report = Callable[[InputError], None]


# ---- folders ---------------------------------------------------------------------------------------------------------


def find_roots(folder: Path, is_root: Callable[[Path], bool]) -> list[Path]:
    """The folders that hold a data set: `folder` itself, or else the nearest above it, or else those nearest below.

    InputError when `folder` is not there. Folders that cannot be looked into, such as a disk's lost+found, hold none.
    """
    if not folder.is_dir():
        came = "a file" if folder.exists() else "no such folder"
        raise InputError(f"data set {folder}", wanted="a folder", came=came, remedy="Check the name.")
    inside = folder.resolve()
    for candidate in [inside, *list(inside.parents)[:FOLDER_LEVELS_UP]]:
        if _holds(is_root, candidate):
            return [candidate]
    level = [inside]
    for _ in range(FOLDER_LEVELS_DOWN):
        level = [below for above in level for below in subfolders(above)]
        found = [candidate for candidate in level if _holds(is_root, candidate)]
        if found:
            return found
    return []


def _holds(is_root: Callable[[Path], bool], folder: Path) -> bool:
    try:
        return is_root(folder)
    except OSError:
        return False


def subfolders(folder: Path) -> list[Path]:
    """The folders in a folder, sorted; none where it cannot be looked into."""
    try:
        return sorted(entry for entry in folder.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    except OSError:
        return []


def one_root(folder: Path, roots: list[Path]) -> Path:
    """The only one of `roots`. InputError when there is another number of them."""
    if len(roots) != 1:
        names = ", ".join(str(root.relative_to(folder.resolve())) for root in roots) or "nothing known"
        raise InputError(
            f"data set {folder}",
            wanted="one data set",
            came=f"{len(roots)} inside: {names}",
            remedy="Name the folder of one of them.",
        )
    return roots[0]


# ---- cameras and joints ----------------------------------------------------------------------------------------------


def calibrated_camera(
    what: str, size_px: tuple[int, int], intrinsics: Any, rotation: Any, translation_m: Any
) -> Camera:
    """The camera x_camera = rotation @ x_world + translation_m with OpenCV axes.

    what: names it in errors · size_px: (width, height) · intrinsics: (3, 3) K in pixels · rotation: (3, 3) ·
    translation_m: (3,) meters. InputError when K is no pinhole without skew, or the rotation is none.
    """
    k, r, t = (
        _finite(what, *part)
        for part in (("K", intrinsics, (3, 3)), ("R", rotation, (3, 3)), ("t", translation_m, (3,)))
    )
    if not (np.allclose(k[2], (0, 0, 1)) and k[1, 0] == 0 and abs(k[0, 1]) < CAMERA_SKEW_MAX_PX):
        raise InputError(f"K of {what}", wanted="[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", came=str(k.tolist()))
    with np.errstate(over="ignore", invalid="ignore"):
        off = float(np.abs(r @ r.T - np.eye(3)).max())
    if not off <= CAMERA_ROTATION_TOLERANCE or np.linalg.det(r) < 0:
        raise InputError(
            f"rotation of {what}",
            wanted="a rotation matrix, x_camera = R x_world + t",
            came=f"a matrix that is {off:.2g} off" if not off <= CAMERA_ROTATION_TOLERANCE else "a mirroring",
            remedy="Download the camera file again; axes must be OpenCV's (x right, y down, z forward).",
        )
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = r, t
    return Camera(*size_px, k[0, 0], k[1, 1], k[0, 2], k[1, 2], matrix)


def _finite(what: str, part: str, values: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = numbers(values, shape, f"{part} of {what}")
    if not np.isfinite(array).all():
        raise InputError(f"{part} of {what}", wanted="finite numbers", came="NaN or infinity")
    return array


class Sieve:
    """Counts dropped images by reason; raises what is broken, or hands it to `report` and goes on."""

    def __init__(self, report: Report | None = None) -> None:
        self._counts: Counter[str] = Counter()
        self._report = report

    def drop(self, reason: str, count: int = 1) -> None:
        """Notes that `count` images are left out."""
        if count:
            self._counts[reason] += count

    def broken(self, error: InputError) -> None:
        """An image, or what belongs to it, cannot be used: raises `error`, unless there is somebody to report to."""
        self.wrong(error)
        self.drop("broken or missing")

    def wrong(self, error: InputError) -> None:
        """Something is wrong with the whole: raises `error`, unless there is somebody to report to."""
        if self._report is None:
            raise error
        self._report(error)

    def check_joints(self, joints_m: np.ndarray, order: JointOrder, unit: str, source: str) -> None:
        """Joints of a data set that cannot be a hand are `wrong` with the whole. METHOD 2.1, medians over the poses.

        joints_m: (P, 21, 3) level order, meters · order, unit: as the data set's layout has them · source: the file to
        name
        """
        try:
            check_hand_size(joints_m, unit)
            check_order(joints_m, order)
        except InputError as error:
            thing = f"joints in {source} ({error.thing})"
            self.wrong(InputError(thing, wanted=error.wanted, came=error.came, remedy=error.remedy))

    @property
    def dropped(self) -> tuple[tuple[str, int], ...]:
        """Reasons and numbers, sorted."""
        return tuple(sorted(self._counts.items()))
