"""Posed Gaussians as PLY files, one per frame, in the layout that splat viewers share (EXPORT 9).

    binary_little_endian, `element vertex N`, all `property float`:
    x y z · nx ny nz (0) · f_dc_0..2 = (rgb - 0.5) / SH_C0, display-referred sRGB · opacity as logit ·
    scale_0..2 as ln(sigma), metres · rot_0..3 = w, x, y, z

The format has no field for axes or units; a comment says them. Only colours of degree 0 are written: what the skin of a
trained avatar mirrors depends on the camera, and is left out, as is the self-shadow.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.errors import InputError, RetryError
from jghand_engine.exporters.usd_motion import HandMotion
from jghand_engine.files import file_error, make_folder, writing
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.limits import PLY_DISK_RESERVE, PLY_OPACITY_MARGIN, SH_C0

PROPERTIES = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)
BYTES_PER_GAUSSIAN = 4 * len(PROPERTIES)
_NAME = re.compile(r"[A-Za-z0-9_-]+")

# maps of column vectors to RUB (x right, y up, z towards the viewer) from a world with that axis up
RUB_FROM_UP = {"y": np.eye(3), "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])}
# what viewers take for granted, as photogrammetry has it: x right, y down, z forward
AXES_FROM_RUB = {"rub": np.eye(3), "rdf": np.diag([1.0, -1.0, -1.0])}


@dataclass(frozen=True)
class PlyOptions:
    """name: stem of the files · axes: rdf (x right, y down, z forward), which viewers take for granted, or rub ·
    first_frame: number of the first file · up: the axis of the motion's world that points up."""

    name: str = "hand"
    axes: Literal["rdf", "rub"] = "rdf"
    first_frame: int = 0
    up: Literal["y", "z"] = "y"

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InputError("name of the PLY files", wanted="letters, digits, - and _", came=repr(self.name))
        for thing, value, wanted in (("axes", self.axes, AXES_FROM_RUB), ("up", self.up, RUB_FROM_UP)):
            if value not in wanted:
                raise InputError(thing, wanted=" or ".join(wanted), came=repr(value))

    def path(self, folder: Path, index: int) -> Path:
        """The file of a frame, counted from 0."""
        return folder / f"{self.name}.{self.first_frame + index:04d}.ply"

    @property
    def axes_from_world(self) -> np.ndarray:
        """(3, 3) from the motion's world to the axes of the file."""
        return AXES_FROM_RUB[self.axes] @ RUB_FROM_UP[self.up]


@dataclass(frozen=True)
class PlyReport:
    """What an export did. files: one per frame · bytes: of all together."""

    files: tuple[Path, ...]
    gaussians: int
    bytes: int


@dataclass(frozen=True)
class PlyCloud:
    """One frame: centres (N, 3) metres · scales (N, 3) or (N, 1) sigma in metres · rotations (N, 4) or (1, 4) unit
    quaternions w, x, y, z · opacity (N,) 0..1 · rgb (N, 3) display-referred sRGB 0..1."""

    positions_m: np.ndarray
    scales_m: np.ndarray
    rotations_wxyz: np.ndarray
    opacity: np.ndarray
    rgb: np.ndarray


def export_ply(
    folder: Path | str,
    avatar: HandAvatar,
    sequence: PoseSequence,
    options: PlyOptions | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> PlyReport:
    """Writes NAME.0000.ply and so on into `folder`, which may hold other files; each is whole or not there.

    progress: called with (frames done, frames) after every frame. Raises InputError for a motion with gaps and for a
    folder that cannot be written or holds other frames of that name, RetryError for a disk that is full or too small.
    """
    options = options or PlyOptions()
    motion = HandMotion(avatar, sequence)
    target = make_folder(folder)
    files = tuple(options.path(target, index) for index in range(len(motion)))
    _refuse_others(target, options, files)
    _check_space(target, len(avatar) * len(motion) * BYTES_PER_GAUSSIAN)
    still = motion.cloud()
    size = 0
    for index, path in enumerate(files):
        posed = motion.frame(index)
        scales_m, rotations = _shapes(posed.sigma_m, posed.covariance_m2, options.axes_from_world)
        rgb = still.rgb if posed.rgb is None else posed.rgb
        centres_m = posed.positions_m @ options.axes_from_world.T
        size += write_ply(path, PlyCloud(centres_m, scales_m, rotations, still.opacity, rgb), axes=options.axes)
        if progress:
            progress(index + 1, len(files))
    return PlyReport(files, len(avatar), size)


def write_ply(path: Path, cloud: PlyCloud, *, axes: str) -> int:
    """Writes one file, whole or not at all; returns its size. axes: those of the arrays, for the comment."""
    count = len(cloud.positions_m)
    table = np.zeros((count, len(PROPERTIES)), "<f4")
    opacity = np.clip(cloud.opacity.astype(np.float64), PLY_OPACITY_MARGIN, 1 - PLY_OPACITY_MARGIN)
    table[:, 0:3] = cloud.positions_m
    table[:, 6:9] = (cloud.rgb - 0.5) / SH_C0
    table[:, 9] = np.log(opacity / (1 - opacity))
    table[:, 10:13] = np.log(cloud.scales_m)
    table[:, 13:17] = cloud.rotations_wxyz
    lines = (
        "ply",
        "format binary_little_endian 1.0",
        f"comment JGHand axes={axes} units=metres color=srgb",
        f"element vertex {count}",
        *(f"property float {name}" for name in PROPERTIES),
        "end_header\n",
    )
    content = "\n".join(lines).encode("ascii") + table.tobytes()
    with writing(path) as temporary:
        temporary.write_bytes(content)
    return len(content)


def _shapes(
    sigma_m: np.ndarray, covariance_m2: np.ndarray | None, axes_from_world: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Scales and rotations: of balls, or of ellipsoids (N, 6) by the axes of their covariance."""
    if covariance_m2 is None:
        return sigma_m[:, None], np.array([[1.0, 0.0, 0.0, 0.0]])
    xx, xy, xz, yy, yz, zz = covariance_m2.astype(np.float64).T
    whole = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], -1).reshape(-1, 3, 3)
    variances, axes = np.linalg.eigh(axes_from_world @ whole @ axes_from_world.T)
    # a rotation has no mirror image in it
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    smallest = np.finfo(np.float32).tiny
    return np.sqrt(np.maximum(variances, smallest)), Rotation.from_matrix(axes).as_quat(scalar_first=True)


def _refuse_others(folder: Path, options: PlyOptions, files: tuple[Path, ...]) -> None:
    """InputError when the folder holds frames that this run would not replace: two motions would be mixed."""
    pattern = re.compile(re.escape(options.name) + r"\.-?\d+\.ply")
    others = sorted({path.name for path in folder.iterdir() if pattern.fullmatch(path.name)} - {p.name for p in files})
    if others:
        raise InputError(
            f"folder {folder}",
            wanted=f"no frames of {options.name} but the {len(files)} of this run",
            came=f"{len(others)} others ({others[0]} to {others[-1]})",
            remedy="Remove them, or choose another folder or name.",
        )


def _check_space(folder: Path, expected: int) -> None:
    try:
        free = shutil.disk_usage(folder).free * (1 - PLY_DISK_RESERVE)
    except OSError as error:
        raise file_error(folder, error) from error
    if expected > free:
        raise RetryError(
            f"cannot write the PLY files in {folder}: the disk is too small",
            wanted=f"{expected / 1e6:.0f} MB",
            came=f"{free / 1e6:.0f} MB free",
            remedy="Free some space, choose another folder, or export fewer Gaussians or frames.",
        )
