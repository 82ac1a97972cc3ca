"""A motion as splat files, one per frame: PLY, .splat, GLB, SPZ or SOG.

Axes (EXPORT 7): for glTF and SPZ it is written down what theirs are, x right, y up, z towards the viewer (some readers
of SPZ do not keep to it); the others get what viewers take for granted, x right, y down, z forward.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.errors import InputError
from jghand_engine.export.motion import HandMotion, check_balls
from jghand_engine.export.skin import with_detail_in_colors
from jghand_engine.export.splats import gltf as gltf_splats
from jghand_engine.export.splats import ply, spz
from jghand_engine.export.splats.cloud import AXES_FROM_RUB, RUB_FROM_UP, SplatCloud
from jghand_engine.export.splats.surfels import Surfels
from jghand_engine.files import make_folder, write_file
from jghand_engine.hand.rotations import quaternions
from jghand_engine.hand.sequence import PoseSequence

_NAME = re.compile(r"[A-Za-z0-9_-]+")


class SplatFormat(NamedTuple):
    """How splats are written.

    encode: a cloud as the content of a file
    axes:   of the numbers, first what is written unless asked otherwise, then what may be asked for
    check:  raises where a package is missing
    """

    encode: Callable[[SplatCloud], bytes]
    axes: tuple[str, ...]
    check: Callable[[], object] = lambda: None


# name of the format and suffix of its files -> the format
FORMATS = {
    "ply": SplatFormat(ply.ply_bytes, ("rdf", "rub")),
    "splat": SplatFormat(ply.splat_bytes, ("rdf", "rub")),
    "glb": SplatFormat(gltf_splats.glb_bytes, ("rub",)),
    "spz": SplatFormat(spz.spz_bytes, ("rub", "rdf")),
    "sog": SplatFormat(ply.sog_bytes, ("rdf", "rub"), ply.sog_converter),
}


@dataclass(frozen=True)
class FrameFiles:
    """Names of files, one per frame.

    name:        stem
    suffix:      without its dot
    first_frame: number of the motion's first frame
    overwrite:   also replace files that are there
    """

    name: str = "hand"
    suffix: str = "ply"
    first_frame: int = 0
    overwrite: bool = False

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InputError("name of the files", wanted="letters, digits, - and _", came=repr(self.name))

    def path(self, folder: Path, index: int) -> Path:
        """The file of a frame, counted from 0."""
        return folder / f"{self.name}.{self.first_frame + index:04d}.{self.suffix}"

    def refuse_others(self, folder: Path, files: tuple[Path, ...], frames: int, beside: Iterable[Path] = ()) -> int:
        """InputError when the folder holds frames that a motion of so many does not have, or files that would be lost.
        Gives how many other frames of that name it holds. beside: what is written with the files"""
        pattern = re.compile(re.escape(self.name) + r"\.(-?\d+)\." + self.suffix)
        there = {path.name: int(found[1]) for path in folder.iterdir() if (found := pattern.fullmatch(path.name))}
        known = range(self.first_frame, self.first_frame + frames)
        if others := sorted(name for name, number in there.items() if number not in known):
            raise InputError(
                f"folder {folder}",
                wanted=f"no frames of {self.name} but {known.start} to {known[-1]}, which the motion has",
                came=f"{len(others)} others ({others[0]} to {others[-1]})",
                remedy="Remove them, or choose another folder or name.",
            )
        again = [path.name for path in files if path.name in there]
        lost = again + [path.name for path in beside if path.exists()]
        if lost and not self.overwrite:
            raise InputError(
                f"folder {folder}",
                wanted=f"none of the files of {self.name} that are to be written",
                came=f"{len(lost)} ({lost[0]} to {lost[-1]})",
                remedy="Replace them with --overwrite, or choose another folder or name.",
            )
        return len(there) - len(again)


@dataclass(frozen=True)
class SplatOptions(FrameFiles):
    """What files are written; their suffix is a key of FORMATS.

    axes:    of the numbers, rdf (x right, y down, z forward) or rub (y up); None: as the format's readers expect it
    up:      the axis of the motion's world that points up
    light:   of a scene, that falls on the hand; None: what the avatar carries
    surfels: how many of them are written in place of the avatar's Gaussians, about; 0: those
    """

    axes: str | None = None
    up: str = "y"
    light: SceneLight | None = None
    surfels: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        for option, value, wanted in (("format", self.suffix, FORMATS), ("up", self.up, RUB_FROM_UP)):
            if value not in wanted:
                raise InputError(option, wanted=" or ".join(wanted), came=repr(value))
        known = FORMATS[self.suffix].axes
        if self.axes is not None and self.axes not in known:
            wanted = " or ".join(known if self.axes in AXES_FROM_RUB else AXES_FROM_RUB)
            raise InputError(f"axes of {self.suffix} files", wanted=wanted, came=repr(self.axes))


@dataclass(frozen=True)
class SplatReport:
    """What an export did.

    files: one per frame written
    axes:  of their numbers
    light: whose their colors show, as `SplatCloud` has it
    bytes: of all files together
    kept:  other frames of that name that were there and stay; nothing tells whether they are of the same motion
    """

    files: tuple[Path, ...]
    axes: str
    light: str
    gaussians: int
    bytes: int
    kept: int


def export_splats(
    folder: Path | str,
    avatar: HandAvatar,
    sequence: PoseSequence,
    options: SplatOptions | None = None,
    *,
    frames: range | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SplatReport:
    """Writes NAME.0000.ply and so on into `folder`, which may hold other files; each is whole or not there.

    frames: which of the motion's are written, each with its number; None: all · progress: called with (frames done,
    frames) after every frame. Raises InputError for a motion with gaps, a folder that cannot be written, or holds
    frames of that name that the motion does not have, or (unless they may be overwritten) those that are to be written,
    and for a package that is missing; RetryError for a full disk.
    """
    options = options or SplatOptions()
    kind = FORMATS[options.suffix]
    kind.check()
    axes = options.axes or kind.axes[0]
    clouds = SplatMotion(avatar, sequence, axes=axes, up=options.up, light=options.light, surfels=options.surfels)
    target, size = make_folder(folder), 0
    frames = range(len(sequence)) if frames is None else frames
    files = tuple(options.path(target, index) for index in frames)
    kept = options.refuse_others(target, files, len(sequence))
    for done, (index, path) in enumerate(zip(frames, files, strict=True), 1):
        content = kind.encode(clouds.cloud(index))
        write_file(path, content)
        size += len(content)
        if progress:
            progress(done, len(files))
    return SplatReport(files, axes, clouds.light, clouds.gaussians, size, kept)


class SplatMotion(HandMotion):
    """An avatar whose Gaussians are balls, driven by a sequence, as clouds.

    axes:    a key of AXES_FROM_RUB
    up:      the motion's axis upwards
    light:   of a scene; None: what the avatar carries
    surfels: about how many make up each cloud, see `Surfels`; 0: the avatar's Gaussians do
    """

    def __init__(
        self,
        avatar: HandAvatar,
        sequence: PoseSequence,
        *,
        axes: str,
        up: str = "y",
        light: SceneLight | None = None,
        surfels: int = 0,
    ) -> None:
        check_balls(avatar)
        super().__init__(avatar if surfels else with_detail_in_colors(avatar), sequence, light, up)
        self._axes, self._axes_from_world = axes, AXES_FROM_RUB[axes] @ RUB_FROM_UP[up]
        self._surfels = Surfels(self.avatar, surfels) if surfels else None

    @property
    def gaussians(self) -> int:
        """How many a cloud has."""
        return len(self.avatar) if self._surfels is None else len(self._surfels)

    def cloud(self, index: int) -> SplatCloud:
        """The Gaussians of a frame."""
        posed, turns = self.frame(index), np.eye(3)
        rgb = np.asarray(self.avatar.rgb, np.float32) if posed.rgb is None else posed.rgb
        positions_m, scales_m, opacity = posed.position_m, posed.sigma_m[:, None], self.avatar.opacity
        if self._surfels is not None:
            pose, opacity = self.sequence.pose(index), self._surfels.opacity
            bones = self._skeleton.bones(pose.joints_m, np.float64, forearm=pose.forearm)
            positions_m, scales_m, turns, rgb = self._surfels.of_pose(bones, posed, rgb)
            turns = self._axes_from_world @ turns
        return SplatCloud(
            positions_m @ self._axes_from_world.T,
            np.broadcast_to(scales_m, (self.gaussians, 3)),
            np.broadcast_to(quaternions(turns), (self.gaussians, 4)),
            np.asarray(opacity, np.float32),
            np.clip(rgb, 0, 1),
            self._axes,
            self.light,
        )
