"""Export of an animated hand as an OpenUSD stage (EXPORT 1 to 8).

    hand.usda          what others reference: the variants                      usd_stage
    hand.splats.usdc   the Gaussians, posed, per frame                          usd_splats, usd_clips, fed by usd_motion
    hand.skinned.usdc  Gaussians that follow the skeleton, and a stand-in       usd_skinned
    hand.rig.usdc      skeleton, animation, skinned mesh                        usd_rig, usd_skeleton
    hand.shot.usda     the hand and the cameras                                 usd_stage, usd_cameras

or one file of all that (usd_package). The colors of a trained avatar change with the pose, as its light falls on it:
every frame then has its own, and the file is three times as large. What its skin mirrors depends on the camera, and is
left out, as is the self-shadow.

Everything is written into a folder beside the target and moved when it is complete, all files or none (usd_arrival).
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.fast_posing import PosedFrame
from jghand_engine.errors import InputError
from jghand_engine.export.splats.ellipsoids import SteadyAxes
from jghand_engine.export.splats.made_from import made_from
from jghand_engine.export.usd.arrival import arriving, check_earlier
from jghand_engine.export.usd.clips import ClippedSplats
from jghand_engine.export.usd.half import HalfPrice
from jghand_engine.export.usd.layers import TimeRange, usd_errors
from jghand_engine.export.usd.motion import HandMotion
from jghand_engine.export.usd.options import IDENTIFIER, LayerNames, Package, UsdOptions, UsdReport, Variant
from jghand_engine.export.usd.package import frames_of_flat, write_archive, write_flat
from jghand_engine.export.usd.provenance import provenance
from jghand_engine.export.usd.rig import Rig, vertex_colors, write_rig
from jghand_engine.export.usd.seal import seal
from jghand_engine.export.usd.skeleton import build_skeleton, in_motion
from jghand_engine.export.usd.skinned import SkinnedCloud, write_skinned
from jghand_engine.export.usd.space import Expected, check_space
from jghand_engine.export.usd.splats import Cloud, Look, Sample, SplatLayer
from jghand_engine.export.usd.stage import Interface, describe, write_interface, write_shot
from jghand_engine.files import make_folder
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.render.camera import Camera
from jghand_engine.template.builtin import load_template
from jghand_engine.template.mesh import HandTemplate, mirrored


def export_usd(
    folder: Path | str,
    avatar: HandAvatar,
    sequence: PoseSequence,
    cameras: Mapping[str, Camera] | Sequence[Camera] = (),
    options: UsdOptions | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> UsdReport:
    """Writes the animated hand into `folder`, which may hold other files; an earlier export of that name is replaced,
    unless somebody has changed it.

    cameras:  by name, or in a row (cam0, cam1, ...); only the shot layer has them.
    progress: called with (frames done, frames) after every frame.
    Raises InputError for a motion with gaps, a template that is not the avatar's, a folder that cannot be written,
    files in the way that are others' work, a .usdz that would be too large; RetryError for a full or too small disk. On
    any failure the folder is left as it was; what a process that was killed left is removed by the next one.
    """
    options = options or UsdOptions()
    motion = HandMotion(avatar, sequence)
    named_cameras = name_cameras(cameras)
    template = template_of(avatar, options.template, motion.handedness)
    names, package = LayerNames(options.name), Package(options.package)
    target = make_folder(folder)
    if not options.overwrite:
        check_earlier(target, names, package)
    stamp = made_from(avatar, sequence)
    about = provenance(avatar.info, stamp)
    span = TimeRange(len(motion), float(sequence.fps), options.first_frame, options.up, about)
    clock = _Clock()
    with clock("rig"):
        cloud = motion.cloud()
    job = _Job(names, motion, cloud, span, options)
    check_space(target, Expected(len(avatar), len(motion), job.sample_bytes), package)
    with usd_errors(target), arriving(target, names, package) as (layers, arrived):
        with clock("rig"):
            skeleton = build_skeleton(motion.rest_poses())
            colors = vertex_colors(template.vertices_m, cloud)
            write_rig(layers / names.rig, Rig(skeleton, in_motion(skeleton, motion.poses()), template, colors), span)
        with clock("skinned points"):
            skinned = SkinnedCloud(cloud, motion.avatar.bone_weights.numpy(), options.width_factor)
            write_skinned(layers / names.skinned, skinned, span)
        hand = describe(avatar, motion.handedness, options)
        interface = Interface(avatar.info.name, hand, options.variants, Variant(options.default_variant))
        if package is Package.USDC:
            sigma_error, half = _write_flat(job, interface, (layers, arrived), clock, progress)
        else:
            with clock("splats"):
                splats = job.writer(layers)
            sigma_error, half = _write_frames(job, splats, clock, progress)
            with clock("stage"):
                write_interface(layers, names, interface, span)
        if package is Package.LAYERS:
            with clock("stage"):
                write_shot(layers, names, named_cameras, sequence.joints_m, span)
                for name in (names.interface, names.shot):
                    seal(layers / name)
        if package is Package.USDZ:
            with clock("package"):
                write_archive(layers, names, arrived / names.stage(package))
        sizes = {path.name: path.stat().st_size for path in sorted(arrived.iterdir()) if path.is_file()}
    shot = target / names.shot if package is Package.LAYERS else None
    return UsdReport(
        target / names.stage(package), shot, len(motion), len(avatar), sizes, clock.seconds, sigma_error, stamp, half
    )


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
            remedy="Give the file that it was trained on as its template.",
        )
    return mirrored(template) if handedness is Handedness.LEFT else template


@dataclass(frozen=True)
class _Job:
    """What the Gaussians of an export are written of, frame after frame."""

    names: LayerNames
    motion: HandMotion
    cloud: Cloud
    span: TimeRange
    options: UsdOptions
    _axes: SteadyAxes = field(default_factory=SteadyAxes)

    def writer(self, folder: Path) -> SplatLayer | ClippedSplats:
        """A file in `folder`, or many of a long take."""
        if self.options.has_clips(self.span.frames):
            return ClippedSplats(folder, self.names, self.cloud, self.span, self._look, self._rest())
        return self.layer(folder)

    def layer(self, folder: Path) -> SplatLayer:
        """One file with what does not move."""
        return SplatLayer.new(folder / self.names.splats, self.cloud, self.span, self._look, self._rest())

    @property
    def sample_bytes(self) -> int:
        """Of a frame as it is written; 0 where none is."""
        if self.options.package == Package.USDC and not Variant(self.options.default_variant).has_frames:
            return 0
        colored, turned = self.motion.colors_move, self.motion.has_ellipsoids
        return self._look.sample_bytes(
            len(self.cloud.sigma_m), colored=colored, sized=self.has_sizes_per_frame, turned=turned
        )

    @property
    def _look(self) -> Look:
        return Look(self.options.radiance, self.options.width_factor, self.options.is_half)

    def _rest(self) -> Sample:
        shape = self.sample(self.motion.rest()) if self.motion.has_ellipsoids else Sample(self.cloud.rest_m)
        return Sample(self.cloud.rest_m, scales_m=shape.scales_m, turns_xyzw=shape.turns_xyzw)

    def sample(self, posed: PosedFrame, wrist_m: np.ndarray | None = None) -> Sample:
        """A frame as it is written; asked for in the order of time, as ellipsoids keep the axes of the one before."""
        scales_m, turns_xyzw = None, None
        if posed.covariance_m2 is not None:
            scales_m, turns_xyzw = self._axes(posed.covariance_m2)
        sigma_m = posed.sigma_m if self.has_sizes_per_frame else None
        return Sample(posed.positions_m, sigma_m, posed.rgb, scales_m, turns_xyzw, wrist_m)

    @property
    def has_sizes_per_frame(self) -> bool:
        return self.options.sizes == "per_frame" or self.motion.has_ellipsoids


def _write_flat(
    job: _Job,
    interface: Interface,
    folders: tuple[Path, Path],
    clock: _Clock,
    progress: Callable[[int, int], None] | None,
) -> tuple[float, HalfPrice | None]:
    """One file with the chosen variant; returns as `_write_frames` does. The frames come last: flattened with the
    rest they would all be in memory at once. folders: of the layers, and of the file."""
    layers, arrived = folders
    target = arrived / job.names.stage(Package.USDC)
    with clock("splats"):
        still = job.layer(layers)
        still.finish()
    with clock("stage"):
        write_interface(layers, job.names, interface, job.span)
    with clock("package"):
        write_flat(layers / job.names.interface, target)
        frames = frames_of_flat(target, interface.default, still.prims, job.span)
    if frames is None:
        if progress:
            progress(job.span.frames, job.span.frames)
        return 0.0, still.prims.price
    return _write_frames(job, frames, clock, progress)


def _write_frames(
    job: _Job, layer: SplatLayer | ClippedSplats, clock: _Clock, progress: Callable[[int, int], None] | None
) -> tuple[float, HalfPrice | None]:
    """Writes every frame; returns the largest relative error of a written radius, and what half precision lost."""
    sigma_error = 0.0
    for index in range(job.span.frames):
        with clock("posing"):
            posed = job.motion.frame(index)
            if not job.has_sizes_per_frame:
                sigma_error = max(sigma_error, float(np.abs(job.cloud.sigma_m / posed.sigma_m - 1).max(initial=0)))
            sample = job.sample(posed, job.motion.wrist_m(index))
        with clock("splats"):
            layer.put(index, sample)
        if progress:
            progress(index + 1, job.span.frames)
    with clock("splats"):
        return sigma_error, layer.finish()


class _Clock:
    """Adds up seconds by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextlib.contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
