"""Export of an animated hand as an OpenUSD stage (EXPORT 1 to 8).

    hand.usda         what others reference: variants splats, points, mesh        usd_stage
    hand.splats.usdc  the Gaussians, posed, per frame                             usd_splats, fed by usd_motion
    hand.rig.usdc     skeleton, animation, skinned mesh                           usd_rig, usd_skeleton
    hand.shot.usda    the hand and the cameras                                    usd_stage, usd_cameras

The colours of a trained avatar change with the pose, as its light falls on it: every frame then has its own, and the
file is three times as large. What its skin mirrors depends on the camera, and is left out, as is the self-shadow.

Everything is written into a folder beside the target and moved when it is complete, all files or none.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import math
import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from jghand_engine import __version__
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.errors import DiskFullError, InputError
from jghand_engine.exporters.usd_layers import TimeRange, usd_errors
from jghand_engine.exporters.usd_motion import HandMotion
from jghand_engine.exporters.usd_rig import Rig, vertex_colours, write_rig
from jghand_engine.exporters.usd_skeleton import build_skeleton
from jghand_engine.exporters.usd_splats import Cloud, SplatLayer
from jghand_engine.exporters.usd_stage import LayerNames, Variant, describe, write_interface, write_shot
from jghand_engine.files import file_error, make_folder, sync
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.limits import USD_DISK_RESERVE, USD_STATIC_BYTES, USD_STATIC_BYTES_PER_GAUSSIAN
from jghand_engine.splat.camera import Camera
from jghand_engine.template.builtin import load_template
from jghand_engine.template.mesh import HandTemplate, mirrored

IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True)
class UsdOptions:
    """name:       stem of the files
    default_variant: what a reader shows that cannot choose (Blender)
    radiance:        "srgb" keeps the avatar's display-referred colours in the splats, "linear" writes light
    sizes:           "constant": radii of the mean hand; "per_frame": as the engine shrinks and stretches them, at
                     2.3 times the size of the file
    width_factor:    diameter of the points of variant `points`, in two standard deviations
    template:        surface of the avatar; None takes the built-in one
    first_frame:     time code of the first frame
    up:              the axis of the motion's world that points up; written down, nothing is turned
    """

    name: str = "hand"
    default_variant: Variant = Variant.SPLATS
    radiance: Literal["srgb", "linear"] = "srgb"
    sizes: Literal["constant", "per_frame"] = "constant"
    width_factor: float = 1.0
    template: HandTemplate | None = None
    first_frame: int = 0
    up: Literal["y", "z"] = "y"

    def __post_init__(self) -> None:
        if not IDENTIFIER.fullmatch(self.name):
            raise InputError("name of the USD files", wanted="letters, digits and _", came=repr(self.name))
        if self.default_variant not in tuple(Variant):
            raise InputError("default variant", wanted=" or ".join(Variant), came=repr(self.default_variant))
        for thing, value, wanted in (
            ("radiance", self.radiance, ("srgb", "linear")),
            ("sizes", self.sizes, ("constant", "per_frame")),
            ("up", self.up, ("y", "z")),
        ):
            if value not in wanted:
                raise InputError(thing, wanted=" or ".join(wanted), came=repr(value))
        if not (math.isfinite(self.width_factor) and self.width_factor > 0):
            raise InputError("width factor", wanted="a finite number above 0", came=str(self.width_factor))


@dataclass(frozen=True)
class UsdReport:
    """What an export did.

    stage: path of the interface layer · shot: path of the shot · bytes: size by file name ·
    seconds: time by stage of the work · sigma_error: largest relative difference between a written radius and the
    engine's (0 with sizes per frame) · made_from: what the function of that name says
    """

    stage: Path
    shot: Path
    frames: int
    gaussians: int
    bytes: Mapping[str, int] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    sigma_error: float = 0.0
    made_from: Mapping[str, str] = field(default_factory=dict)

    @property
    def write_ms_per_frame(self) -> float:
        """Milliseconds per frame to write the Gaussians, posing them not included."""
        return 1e3 * self.seconds["splats"] / self.frames

    @property
    def megabytes_per_frame(self) -> float:
        """Size of the whole export over its frames, 1e6 bytes."""
        return sum(self.bytes.values()) / 1e6 / self.frames


def export_usd(
    folder: Path | str,
    avatar: HandAvatar,
    sequence: PoseSequence,
    cameras: Mapping[str, Camera] | Sequence[Camera] = (),
    options: UsdOptions | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> UsdReport:
    """Writes the animated hand into `folder`, which may hold other files; an earlier export of that name is replaced.

    cameras:  by name, or in a row (cam0, cam1, ...); only the shot layer has them.
    progress: called with (frames done, frames) after every frame.
    Raises InputError for a motion with gaps, a template that is not the avatar's, or a folder that cannot be written,
    RetryError for a disk that is full or too small. On any failure the folder is left as it was.
    """
    options = options or UsdOptions()
    motion = HandMotion(avatar, sequence)
    named_cameras = name_cameras(cameras)
    template = template_of(avatar, options.template, motion.handedness)
    names = LayerNames(options.name)
    target = make_folder(folder)
    check_space(target, len(avatar), len(motion), options, coloured=motion.colours_move)
    span = TimeRange(len(motion), float(sequence.fps), options.first_frame, options.up)
    clock = _Clock()
    with usd_errors(target), _arriving(target, names) as temporary:
        with clock("rig"):
            cloud = motion.cloud()
            colours = vertex_colours(template.vertices_m, cloud)
            skeleton = build_skeleton(motion.rest_poses(), motion.poses())
            write_rig(temporary / names.rig, Rig(skeleton, template, colours), span)
        sigma_error = _write_splats(temporary / names.splats, motion, cloud, span, options, clock, progress)
        with clock("stage"):
            stamp = made_from(avatar, sequence)
            about = describe(avatar, motion.handedness, sizes=options.sizes, radiance=options.radiance)
            default = Variant(options.default_variant)
            write_interface(temporary, names, avatar.info, about, stamp, span, default)
            write_shot(temporary, names, named_cameras, sequence.joints_m, span)
        sizes = {path.name: path.stat().st_size for path in sorted(temporary.iterdir())}
    stage, shot = target / names.interface, target / names.shot
    return UsdReport(stage, shot, len(motion), len(avatar), sizes, clock.seconds, sigma_error, stamp)


def made_from(avatar: HandAvatar, sequence: PoseSequence) -> dict[str, str]:
    """What tells whether a stage is still that of an avatar and a motion: SHA-256 of the avatar's Gaussians and of the
    joints (F, 21, 3) float32 little-endian metres in standard order, and the engine's version."""
    gaussians = hashlib.sha256()
    for tensor in (avatar.position_m, avatar.sigma_m, avatar.opacity, avatar.rgb, avatar.bone_weights):
        gaussians.update(tensor.numpy().tobytes())
    joints_m = from_level(sequence.joints_m, JointOrder.STANDARD).astype("<f4")
    return {
        "engine_version": __version__,
        "avatar_sha256": gaussians.hexdigest(),
        "joints_sha256": hashlib.sha256(joints_m.tobytes()).hexdigest(),
    }


def name_cameras(cameras: Mapping[str, Camera] | Sequence[Camera]) -> dict[str, Camera]:
    """Cameras by a name that USD accepts; InputError otherwise."""
    named = dict(cameras) if isinstance(cameras, Mapping) else {f"cam{i}": c for i, c in enumerate(cameras)}
    for name in named:
        if not IDENTIFIER.fullmatch(name):
            raise InputError("camera name", wanted="letters, digits and _, no digit first", came=repr(name))
    return named


def template_of(avatar: HandAvatar, template: HandTemplate | None, handedness: Handedness) -> HandTemplate:
    """The surface of the avatar's hand, mirrored for a left one. InputError when it is not the one the avatar was
    made on: the skin would follow other joints."""
    template = template or load_template()
    if template.identifier != avatar.info.template or not np.allclose(
        template.joints_m, avatar.canonical_joints_m.numpy(), rtol=0, atol=1e-7
    ):
        raise InputError(
            "template",
            wanted=f"{avatar.info.template!r}, on which the avatar was made",
            came=repr(template.identifier),
            remedy="Give the avatar's own template (UsdOptions.template).",
        )
    return mirrored(template) if handedness is Handedness.LEFT else template


def check_space(folder: Path, gaussians: int, frames: int, options: UsdOptions, *, coloured: bool = False) -> None:
    """Raises RetryError when the export cannot fit on the disk of `folder`: said before minutes of work, not after.

    coloured: whether every frame has colours of its own
    """
    # a position is three float32; per-frame sizes add three scales and a width, colours two times three
    sample = (12 if options.sizes == "constant" else 28) + (24 if coloured else 0)
    expected = gaussians * (frames + 1) * sample + gaussians * USD_STATIC_BYTES_PER_GAUSSIAN + USD_STATIC_BYTES
    with usd_errors(folder):
        free = shutil.disk_usage(folder).free * (1 - USD_DISK_RESERVE)
    if expected > free:
        raise DiskFullError(
            f"cannot write the USD stage in {folder}: the disk is too small",
            wanted=f"{expected / 1e6:.0f} MB",
            came=f"{free / 1e6:.0f} MB free",
            remedy="Free some space, choose another folder, or export fewer Gaussians or frames.",
        )


def _write_splats(
    path: Path,
    motion: HandMotion,
    cloud: Cloud,
    span: TimeRange,
    options: UsdOptions,
    clock: _Clock,
    progress: Callable[[int, int], None] | None,
) -> float:
    """Writes every frame; returns the largest relative error of a written radius."""
    per_frame, sigma_error = options.sizes == "per_frame", 0.0
    with clock("splats"):
        layer = SplatLayer(path, cloud, span, radiance=options.radiance, width_factor=options.width_factor)
    for index in range(span.frames):
        with clock("posing"):
            posed = motion.frame(index)
            if not per_frame:
                sigma_error = max(sigma_error, float(np.abs(cloud.sigma_m / posed.sigma_m - 1).max(initial=0)))
        with clock("splats"):
            layer.put(index, posed.positions_m, posed.sigma_m if per_frame else None, posed.rgb)
        if progress:
            progress(index + 1, span.frames)
    with clock("splats"):
        layer.finish()
    return sigma_error


@contextlib.contextmanager
def _arriving(folder: Path, names: LayerNames) -> Iterator[Path]:
    """A temporary folder in `folder`; on success its files take the place of an earlier export's, all or none."""
    for target in (folder / name for name in names.all):
        if target.is_dir():
            raise file_error(target, IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR)))
    temporary = Path(tempfile.mkdtemp(prefix=f".{names.name}.", dir=folder))
    try:
        yield temporary
        for name in names.all:
            sync(temporary / name)
        _exchange(temporary, folder, names)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _exchange(arrived: Path, folder: Path, names: LayerNames) -> None:
    """Moves the layers from `arrived` to `folder`. Layers of two exports must never stand together, so the earlier ones
    wait aside, and on any failure everything goes back. Where even that fails they stay in their hidden folder."""
    aside = Path(tempfile.mkdtemp(prefix=f".{names.name}.earlier.", dir=folder))
    earlier = [(folder / name, aside / name) for name in names.all if (folder / name).exists()]
    moved = []
    try:
        for source, target in (*earlier, *((arrived / name, folder / name) for name in names.all)):
            os.replace(source, target)
            moved.append((source, target))
    except BaseException:
        for source, target in reversed(moved):
            os.replace(target, source)
        aside.rmdir()
        raise
    shutil.rmtree(aside, ignore_errors=True)


class _Clock:
    """Adds up seconds by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextlib.contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
