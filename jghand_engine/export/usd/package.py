"""Export of an animated hand as an OpenUSD stage (docs/EXPORT.md).

    hand.usda          what others reference: the variants        stage
    hand.splats.usdc   the Gaussians, posed, per frame            splats
    hand.rig.usdc      skeleton, animation, skinned mesh          rig
    hand.skin.png      its albedo, of a hand with detail          skin
    hand.normal.png    its normals, of one with a relief          skin
    hand.skinned.usdc  Gaussians that follow the skeleton         rig
    hand.shot.usda     the hand and the cameras                   shot

or one file of all that, a .usdc with the pictures beside it. The colors of a trained avatar change with the pose, as
its light falls on it: every frame then has its own, and the file is three times as large. What its skin mirrors depends
on the camera, and is left out, as is the self-shadow. The mesh carries no light, but a material that other programs
light; so do splats and points where that is asked for.

Everything is written into a temporary folder beside the target and renamed into place when it is complete.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pxr import Sdf, Usd

from jghand_engine import __version__
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import Learned
from jghand_engine.avatar.relighting import material_of
from jghand_engine.color import linear_to_srgb
from jghand_engine.errors import InputError, RetryError
from jghand_engine.export.made_from import made_from
from jghand_engine.export.mesh import template_of
from jghand_engine.export.motion import HandMotion, check_balls
from jghand_engine.export.png import encode_png
from jghand_engine.export.skin import SkinTexture, normal_map, with_detail_in_colors
from jghand_engine.export.usd.rig import (
    SKIN,
    build_skeleton,
    in_motion,
    vertex_material,
    write_rig,
    write_skinned,
)
from jghand_engine.export.usd.shot import write_shot
from jghand_engine.export.usd.splats import Cloud, Look, Sample, SplatLayer
from jghand_engine.export.usd.stage import (
    HAND_PATH,
    RIG_PATH,
    LayerNames,
    TimeRange,
    Variant,
    usd_errors,
    write_interface,
)
from jghand_engine.files import make_folder, sync
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.render.camera import Camera
from jghand_engine.template.mesh import HandTemplate

IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
CREATOR = "JGHand"
Package = Literal["layers", "usdc", "usdz"]
PACKAGES: tuple[Package, ...] = ("layers", "usdc", "usdz")
IMAGE_STATES = {"srgb": "display-referred sRGB", "linear": "linear light", "albedo": "linear albedo"}
# what Omniverse, usdview and Blender draw points as is a ball without a soft edge: two standard deviations close the
# skin (as the extension has it)
BALL_WIDTH_FACTOR = 2.0
# by how much constant radii may be off, as a part, in the mean of a frame: no pose changes those of a hand of one size,
# growing or longer bones do. And how many frames are looked at for it
SIZE_ERROR_MAX, SIZED_FRAMES = 0.01, 16
# bytes of the files in a .usdz: more would make it a zip with numbers of 64 bits, which USD does not read
USDZ_BYTES_MAX = int(zipfile.ZIP64_LIMIT / 1.05)
# in a .usdz each file begins at a multiple of this, so that readers map it into memory
USDZ_ALIGNMENT = 64


@dataclass(frozen=True)
class UsdOptions:
    """How a stage is written.

    name: stem of the files
    default_variant: what a reader shows that cannot choose (Blender)
    radiance: "srgb" keeps the avatar's display-referred colors in the splats, "linear" writes light, "albedo" no light:
        other programs light splats and points as they do the mesh
    width_factor: diameter of the points of all variants, in two standard deviations
    template: surface of the avatar; None takes the built-in one
    first_frame: time code of the first frame
    up: the axis of the motion's world that points up; written down, nothing is turned but the light
    package: "layers": files that refer to each other, with all variants and a shot; "usdc": one file with the chosen
        variant alone; "usdz": one file with all variants
    overwrite: also replace files of these names that are there
    """

    name: str = "hand"
    default_variant: Variant = Variant.SPLATS
    radiance: Literal["srgb", "linear", "albedo"] = "srgb"
    width_factor: float = 1.0
    template: HandTemplate | None = None
    first_frame: int = 0
    up: Literal["y", "z"] = "y"
    package: Package = "layers"
    overwrite: bool = False

    def __post_init__(self) -> None:
        if not IDENTIFIER.fullmatch(self.name):
            raise InputError("name of the USD files", wanted="letters, digits and _", came=repr(self.name))
        if not (math.isfinite(self.width_factor) and self.width_factor > 0):
            raise InputError("width factor", wanted="a finite number above 0", came=str(self.width_factor))

    @property
    def is_lit(self) -> bool:
        """Whether other programs light splats and points."""
        return self.radiance == "albedo"

    def files(self, avatar: HandAvatar) -> tuple[str, ...]:
        """Names of the files, those that refer to others after them."""
        names = LayerNames(self.name)
        pictures = () if self.package == "usdz" else names.pictures(avatar.detail).values()
        if self.package != "layers":
            return *pictures, f"{self.name}.{self.package}"
        return *pictures, names.rig, names.splats, names.skinned, names.interface, names.shot


@dataclass(frozen=True)
class Preset:
    """What suits a program (EXPORT 4).

    variant: what it shows
    advice: what its user has to know, in sentences
    width_factor: of points
    """

    variant: Variant
    advice: str
    width_factor: float = 1.0


PRESETS: Mapping[str, Preset] = {
    "generic": Preset(
        Variant.SPLATS, "Programs that know no splats show points: by fallbackPrimTypes, or as variant points."
    ),
    "omniverse": Preset(
        Variant.SPLATS,
        "Splats glow there and throw no shadow. A path tracer may take their colors for light: where they look too "
        "bright, add --radiance linear. Not tried by us; NVIDIA's validator finds nothing.",
    ),
    "usdview": Preset(
        Variant.POINTS_SKINNED,
        "Storm draws no splats: these are points that follow the skeleton, without what training added to the pose. "
        "With the plugin hdParticleField choose the variant splats.",
        BALL_WIDTH_FACTOR,
    ),
    "blender": Preset(
        Variant.POINTS,
        "Set the scene's frame rate to that of the stage: Blender's importer leaves it. A Blender that draws splats "
        "itself wants --default-variant splats.",
        BALL_WIDTH_FACTOR,
    ),
    "houdini": Preset(
        Variant.POINTS, "Widths are two standard deviations. SOPs that want splats read PLY: jghand export ply."
    ),
}


@dataclass(frozen=True)
class UsdReport:
    """What an export did.

    stage: path of the interface layer or of the single file
    shot: path of the shot; None of a single file
    bytes: size by file name
    seconds: time by step of the work
    sigma_error: largest relative difference between a written radius and the engine's (0 with radii in every frame)
    made_from: what the function of that name says
    """

    stage: Path
    shot: Path | None
    frames: int
    gaussians: int
    bytes: Mapping[str, int] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    sigma_error: float = 0.0
    made_from: Mapping[str, str] = field(default_factory=dict)


def export_usd(
    folder: Path | str,
    avatar: HandAvatar,
    sequence: PoseSequence,
    cameras: Mapping[str, Camera] | Sequence[Camera] = (),
    options: UsdOptions | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> UsdReport:
    """Writes the animated hand into `folder`, which may hold other files.

    cameras: by name, or in a row (cam0, cam1, …); only the shot layer has them
    progress: called with (frames done, frames) after every frame
    Raises InputError for a motion with gaps, Gaussians that are no balls, a template that is not the avatar's, a folder
    that cannot be written, files in the way, a .usdz that would be too large; RetryError for a full disk.
    On any failure the folder is left as it was.
    """
    options = options or UsdOptions()
    check_balls(avatar)
    motion = HandMotion(with_detail_in_colors(avatar), sequence, up=options.up)
    named_cameras = name_cameras(cameras)
    template = template_of(avatar, options.template, motion.handedness)
    target = make_folder(folder)
    files = options.files(avatar)
    _check_place(target, files, overwrite=options.overwrite)
    stamp = made_from(avatar, sequence)
    span = TimeRange(
        len(motion), float(sequence.fps), options.first_frame, options.up, provenance(motion.avatar, stamp)
    )
    writer = _Writer(motion, options, span, progress)
    with usd_errors(target), _arriving(target, files, single=options.package != "layers") as (layers, arrived):
        writer.write(layers, arrived, avatar, template, named_cameras)
        sizes = {path.name: path.stat().st_size for path in sorted(arrived.iterdir())}
    names, is_single = writer.names, options.package != "layers"
    return UsdReport(
        target / (files[-1] if is_single else names.interface), None if is_single else target / names.shot,
        len(motion), len(avatar), sizes, writer.seconds, writer.sigma_error, stamp,
    )  # fmt: skip


def name_cameras(cameras: Mapping[str, Camera] | Sequence[Camera]) -> dict[str, Camera]:
    """Cameras by a name that USD accepts; InputError otherwise."""
    named = dict(cameras) if isinstance(cameras, Mapping) else {f"cam{i}": c for i, c in enumerate(cameras)}
    for name in named:
        if not IDENTIFIER.fullmatch(name):
            raise InputError("camera name", wanted="letters, digits and _, no digit first", came=repr(name))
    return named


def provenance(avatar: HandAvatar, stamp: Mapping[str, str]) -> dict[str, Any]:
    """customLayerData of every layer: who wrote it, of what, under which license. stamp: what it was made from."""
    info = avatar.info
    # keys as earlier exports have them
    about = {**stamp, "avatar": info.name, "template": info.template, "licence": info.license}
    if info.learned_from is not None:
        about |= {
            "learnt_from": info.learned_from.capture,
            "learned_from_pictures": info.learned_from.pictures,
            "learned_from_digest": info.learned_from.digest,
        }
    return {"creator": f"{CREATOR} {__version__}", "jghand": about}


def describe(motion: HandMotion, options: UsdOptions) -> dict[str, Any]:
    """customData of the hand: what a client cannot see from the attributes. imageState is that of the radiance."""
    avatar, learned = motion.avatar, motion.avatar.learned
    still = learned is None or learned.correctives is None
    still_colored = learned is None or options.is_lit
    return {
        "gaussians": len(avatar),
        "handedness": str(motion.handedness),
        "imageState": IMAGE_STATES[options.radiance],
        "licence": avatar.info.license,
        # learned pose offsets are in the per-frame positions; what is skinned shows plain skinning
        "offsets": "none" if still else "in the positions of the splats",
        "skinnedOffsets": "none",
        "colors": "constant" if still_colored else f"per frame, in the light of the {motion.light}",
        "material": _material(learned),
        "gloss": "none" if learned is None else "left out: it depends on the camera",
    }


def _material(learned: Learned | None) -> str:
    if learned is None:
        return "painted"
    is_estimated = learned.response is None or learned.response.film_light is not None
    return "estimated" if is_estimated else "known"


class _Writer:
    """Writes one stage. What it measured on the way: seconds by step, errors of radii."""

    def __init__(
        self,
        motion: HandMotion,
        options: UsdOptions,
        span: TimeRange,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        self.names, self._motion, self._options, self._span = LayerNames(options.name), motion, options, span
        self._progress = progress or (lambda done, frames: None)
        self._look = Look(options.radiance != "srgb", options.width_factor)
        self.seconds: dict[str, float] = {}
        self.sigma_error = 0.0
        with self._clock("rig"):
            self._material = material_of(motion.avatar)
            self._cloud = Cloud(*motion.rest_arrays())
            if options.is_lit:
                self._cloud = replace(self._cloud, rgb=linear_to_srgb(self._material.albedo), material=self._material)
            self._has_sizes = self._changes_size()

    def write(
        self, layers: Path, arrived: Path, avatar: HandAvatar, template: HandTemplate, cameras: Mapping[str, Camera]
    ) -> None:
        """Writes layers into `layers`, and the single file, where one is wanted, into `arrived`. avatar: as it was
        given, with its detail"""
        options, motion, names, span = self._options, self._motion, self.names, self._span
        with self._clock("rig"):
            skeleton = build_skeleton(motion.rest_poses())
            material = vertex_material(template.vertices_m, self._cloud.rest_m, self._material)
            poses, weights = in_motion(skeleton, motion.poses()), motion.map_weights(template)
            pictures = self._pictures(layers if options.package == "usdz" else arrived, avatar, template)
            write_rig(layers / names.rig, skeleton, poses, template, weights, material, pictures, span)
        with self._clock("skinned points"):
            weights = motion.avatar.map_weights(motion.avatar.position_m, motion.avatar.bone_weights)
            write_skinned(layers / names.skinned, self._cloud, weights, options.width_factor, span)
        with self._clock("splats"):
            splats = SplatLayer.new(layers / names.splats, self._cloud, span, self._look)
        if options.package != "usdc":
            self._write_frames(splats)
        else:
            with self._clock("splats"):
                splats.finish()
        with self._clock("stage"):
            write_interface(
                layers, names, span, asset=motion.avatar.info.name,
                about=describe(motion, options),
                variants=tuple(Variant), default=Variant(options.default_variant), lit=options.is_lit,
            )  # fmt: skip
            if options.package == "layers":
                write_shot(layers, names, cameras, motion.sequence.joints_m, span)
        with self._clock("package"):
            if options.package == "usdz":
                files = (names.interface, names.rig, names.splats, names.skinned, *pictures.values())
                write_archive([layers / name for name in files], arrived / f"{options.name}.usdz")
            elif options.package == "usdc":
                frames = self._flattened(layers / names.interface, pictures, arrived / f"{options.name}.usdc")
        if options.package == "usdc":
            # after the rest: flattened with it they would all be in memory at once
            self._write_frames(frames)

    def _pictures(self, folder: Path, avatar: HandAvatar, template: HandTemplate) -> dict[str, str]:
        """Writes the textures of the mesh into `folder` and gives their names; none for a hand without detail."""
        if avatar.detail is None:
            return {}
        texture, names = SkinTexture(avatar, template, self._cloud.rest_m), self.names.pictures(avatar.detail)
        colors = texture.of_colors(linear_to_srgb(material_of(avatar).albedo))
        (folder / names["diffuseColor"]).write_bytes(encode_png(colors))
        normals = normal_map(avatar.detail)
        if normals is not None:
            (folder / names["normal"]).write_bytes(encode_png(normals))
        return names

    def _flattened(self, interface: Path, pictures: dict[str, str], target: Path) -> SplatLayer | None:
        """Puts a stage with its chosen variant into one file, beside `pictures`; gives what adds the frames of
        Gaussians to it, None where the variant has none. RetryError when USD cannot."""
        # the comment would tell a place on our disk, as the identifier does that flattening makes of a relative one
        layer = Usd.Stage.Open(str(interface)).Flatten(addSourceFileComment=False)
        layer.GetPrimAtPath(HAND_PATH).assetInfo["identifier"] = Sdf.AssetPath(f"./{target.name}")
        for name, file in pictures.items():
            layer.GetAttributeAtPath(f"{RIG_PATH}/{SKIN}/{name}.inputs:file").default = Sdf.AssetPath(f"./{file}")
        if not layer.Export(str(target)):
            raise RetryError(f"cannot write {target.name}", remedy="Check the disk and try again.")
        variant = Variant(self._options.default_variant)
        paths = {Variant.SPLATS: (f"{HAND_PATH}/Splats", None), Variant.POINTS: (None, f"{HAND_PATH}/Points")}
        if variant not in paths:  # all of it follows the skeleton
            return None
        return SplatLayer(Usd.Stage.Open(str(target)), self._span, self._look, self._cloud.sigma_m, *paths[variant])

    def _write_frames(self, layer: SplatLayer | None) -> None:
        if layer is None:
            self._progress(self._span.frames, self._span.frames)
            return
        colors_move = self._motion.colors_move and not self._options.is_lit
        for index in range(self._span.frames):
            with self._clock("posing"):
                posed = self._motion.frame(index)
                if not self._has_sizes:
                    off = np.abs(self._cloud.sigma_m / posed.sigma_m - 1).max(initial=0)
                    self.sigma_error = max(self.sigma_error, float(off))
                rgb = posed.rgb if colors_move else None
                sample = Sample(posed.position_m, posed.sigma_m if self._has_sizes else None, rgb)
            with self._clock("splats"):
                layer.put(index, sample)
            self._progress(index + 1, self._span.frames)
        with self._clock("splats"):
            layer.finish()

    def _changes_size(self) -> bool:
        """Whether radii are written in every frame, of which some tell: elsewhere those of the mean hand do, in files
        of less than half the size."""
        for index in range(0, len(self._motion), math.ceil(len(self._motion) / SIZED_FRAMES)):
            off = np.abs(self._cloud.sigma_m / self._motion.frame(index).sigma_m - 1)
            if off.mean() > SIZE_ERROR_MAX:
                return True
        return False

    @contextlib.contextmanager
    def _clock(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


# ---- files -----------------------------------------------------------------------------------------------------------


def write_archive(files: Sequence[Path], target: Path) -> None:
    """A .usdz: a zip of stored files, the one that is opened first. Not by USD, which takes memory for all that it
    packs. InputError where they are too large for one."""
    if (size := sum(path.stat().st_size for path in files)) > USDZ_BYTES_MAX:
        wanted = f"at most {USDZ_BYTES_MAX / 1e9:.2f} GB, which is what a .usdz can hold"
        remedy = "Export layers, or fewer frames."
        raise InputError(f"{target.name}", wanted=wanted, came=f"{size / 1e9:.2f} GB", remedy=remedy)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as archive:
        for path in files:
            entry = zipfile.ZipInfo(path.name)
            # a local header has 30 bytes, the name, and an extra field of at least 4 that fills up to the alignment
            missing = -(archive.start_dir + 30 + len(path.name)) % USDZ_ALIGNMENT
            if missing:
                missing += USDZ_ALIGNMENT if missing < 4 else 0
                entry.extra = (0x1986).to_bytes(2, "little") + (missing - 4).to_bytes(2, "little") + bytes(missing - 4)
            with path.open("rb") as source, archive.open(entry, "w") as out:
                shutil.copyfileobj(source, out, 2**20)


def _check_place(folder: Path, files: Sequence[str], *, overwrite: bool) -> None:
    """InputError for files in the way."""
    for path in (folder / name for name in files):
        if path.is_dir():
            raise InputError(f"{path}", wanted="no folder of that name", came="a folder", remedy="Choose another name.")
        if path.exists() and not overwrite:
            remedy = "Choose another name or folder, or replace it (--overwrite)."
            raise InputError(f"{path}", wanted="no file of that name", came="one that is there", remedy=remedy)


@contextlib.contextmanager
def _arriving(folder: Path, files: Sequence[str], *, single: bool) -> Iterator[tuple[Path, Path]]:
    """Two temporary folders in `folder`, for layers and for files that arrive; on success these are renamed into place,
    what refers to others last. They are the same folder where the layers are what arrives."""
    temporary = Path(tempfile.mkdtemp(prefix=f".{files[-1]}.", dir=folder))
    try:
        layers, alone, earlier = (temporary / name for name in ("layers", "single", "earlier"))
        for made in (layers, alone, earlier):
            made.mkdir()
        arrived = alone if single else layers
        yield layers, arrived
        for name in files:
            sync(arrived / name)
        replaced = [(folder / name, earlier / name) for name in files if (folder / name).exists()]
        _move_all([*replaced, *((arrived / name, folder / name) for name in files)])
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _move_all(moves: Sequence[tuple[Path, Path]]) -> None:
    """Renames files, all or none: layers of two exports must never stand together, and Windows moves no file that
    another program has open."""
    try:
        for source, target in moves:
            os.replace(source, target)
    except BaseException:
        for source, target in reversed(moves):
            # what the disk says: Ctrl-C may come between a move and any note of it
            if target.exists() and not source.exists():
                os.replace(target, source)
        raise
