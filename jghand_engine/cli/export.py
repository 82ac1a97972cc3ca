"""`jghand export`: a motion becomes a USD stage (splats, points, skeleton, skinned mesh, camera), splat files, a web
page, or meshes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jghand_engine.cli.console import progress, say, write_figures
from jghand_engine.cli.failures import polite_kill_is_ctrl_c
from jghand_engine.cli.learning import hand_template
from jghand_engine.cli.options import CameraName, FiguresFile, File, LightOptions, MotionOptions, ShownAvatarOptions
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.cli.inputs import Motion
    from jghand_engine.export.mesh import MeshReport
    from jghand_engine.export.splats.files import SplatReport
    from jghand_engine.export.usd.package import UsdOptions, UsdReport
    from jghand_engine.hand.sequence import PoseSequence
    from jghand_engine.render.camera import Camera

DESCRIPTION = """Write a motion as OpenUSD, as splat files, as a web page, or as meshes.

OpenUSD: hand.usda with its layers: splats, points, skeleton and mesh, cameras. Splat files: one for every
frame, hand.0000.ply and so on. The web page plays the motion and poses the hand.

A USD stage offers the variants splats, points, points_skinned and mesh, whatever --for says: that chooses the one which
is shown first, and how large points are. Only --package usdc leaves some out.

The skeleton has 63 joints, with a forearm 85: the 21 that drive the hand, with the names of the motion's joints, and
those that carry the skin between them. A trained avatar has colors of its own in every frame, in the light that it was
learned in; what its skin mirrors depends on the camera, and is left out. The mesh of a USD stage has no light in it,
but albedo and roughness, which other programs light.

Examples:
  jghand export --poses open,fist --hand right --out usd
  jghand export --motion capture.npy --order mediapipe --hand right --out usd
  jghand export --poses open,fist --for blender --out usd
  jghand export --poses open,fist --for usdview --package usdz --out usd
  jghand export ply --poses open,fist --out splats
  jghand export glb --poses fist --frames 0 --out splats
  jghand export ply --poses open --light studio.hdr --out splats
  jghand export ply --poses open --surfels 200000 --out splats
  jghand export web --poses open,fist,ok --out page
  jghand export mesh --poses fist --frames 0 --out meshes"""

# the picture that the stage's cameras are made for
CAMERA_PX = (1024, 1024)


@dataclass(frozen=True)
class UsdStageOptions:
    """What a USD stage holds"""

    consumer: Annotated[Literal["generic", "omniverse", "usdview", "blender", "houdini"], tyro.conf.arg(name="for")] = (
        "generic"
    )
    """The program that reads it. docs/EXPORT.md says what is known of each."""
    default_variant: Annotated[
        Literal["splats", "points", "points_skinned", "mesh"] | None, tyro.conf.arg(help_behavior_hint="")
    ] = None
    """What a program shows that cannot choose; left out, what suits --for: splats, for blender and houdini points, for
    usdview points_skinned (a small file; without what training added to the pose)."""
    radiance: Literal["srgb", "linear", "albedo"] = "srgb"
    """Colors of the splats: srgb as a screen shows them, for most viewers; linear as light, for path tracers; albedo
    without any light: then other programs light splats and points, as they always do the mesh."""
    width_factor: Annotated[float | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="")] = None
    """Size of the points: 1 is two standard deviations of a splat, 2 closes the gaps between them. Left out: 2 for
    blender and usdview, else 1."""
    package: Literal["layers", "usdc", "usdz"] = "layers"
    """layers: files that refer to each other, and the shot with its cameras. usdc: one file with the chosen variant
    alone. usdz: one file with all variants."""


@dataclass(frozen=True)
class SplatFileOptions(LightOptions):
    """What splat files hold. A light is baked into them without what skin mirrors of it"""

    axes: Annotated[Literal["rdf", "rub"] | None, tyro.conf.arg(help_behavior_hint="")] = None
    """Axes of the numbers. Left out: rdf (x right, y down, z forward), which viewers expect of ply, splat and sog, or
    rub (y up), which is glTF's and SPZ's own."""
    surfels: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """Write the skin as so many flat splats with the colors of the hand's texture, for close-ups: 200000, or 400000. 0
    is the avatar's own Gaussians, which are coarser than its skin."""


@dataclass(frozen=True)
class WebPageOptions:
    """What a web page shows"""

    camera: CameraName = "quarter"
    """Side that is seen at first: front is the palm. Whoever looks at the page turns the hand as they like."""
    gaussians: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """How many of the avatar's Gaussians: fewer make a smaller page for slower phones. 0 is all of them."""


@dataclass(frozen=True)
class Export:
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """Where the files are written."""
    format: Annotated[
        Literal["usd", "ply", "glb", "splat", "spz", "sog", "web", "mesh", "mesh-obj", "mesh-ply"], tyro.conf.Positional
    ] = "usd"
    """usd: one animated stage. ply, glb, splat, spz, sog: a file of splats for every frame; ply and glb keep every
    number as it is, splat, spz and sog are 2, 6 and 9 times smaller than ply, and sog needs the extra formats. web: a
    folder whose index.html any browser opens. mesh: the posed surface of every frame, colored, as GLB; or as OBJ or
    PLY. Meshes need the extra learn."""
    name: Annotated[str, tyro.conf.arg(metavar="NAME")] = "hand"
    """Stem of the files: letters, digits and _. Of a web page its title, any text; left out, the avatar's name."""
    first_frame: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """Number of the first frame in the files; in the names of splat files that of the motion's first frame, also where
    --frames begins later."""
    overwrite: bool = False
    """Also replace files that are there, a stage with what somebody has put into its shot, too. Splat files of frames
    that are not written (--frames) stay, whatever motion they are of."""
    up: Literal["y", "z"] = "y"
    """The axis that points up in the world of the motion. USD says it, splats and meshes are turned; light comes from
    above in any. A web page wants a motion with y up."""
    template: File = None
    """For usd and mesh: the MANO file of an avatar that was trained on it (`jghand train --template`), whose surface
    becomes the mesh."""
    usd: UsdStageOptions = field(default_factory=UsdStageOptions)
    splats: SplatFileOptions = field(default_factory=SplatFileOptions)
    web: WebPageOptions = field(default_factory=WebPageOptions)
    motion: MotionOptions = field(default_factory=MotionOptions)
    avatar: ShownAvatarOptions = field(default_factory=ShownAvatarOptions)
    json: FiguresFile = None

    def run(self) -> None:
        self.motion.check()
        self._check_options()
        from jghand_engine.cli.inputs import load_motion

        avatar = self.avatar.load()
        motion = load_motion(self.motion, avatar)
        for note in motion.notes:
            say(note)
        write = {"usd": self._write_usd, "web": self._write_web}.get(self.format, self._write_splats)
        write = self._write_meshes if self._is_mesh else write
        with polite_kill_is_ctrl_c():
            figures = write(avatar.for_hand(motion.sequence.handedness), motion)
        write_figures(self.json, {
            "command": "export", "format": self.format, "motion": motion.source, "notes": motion.notes,
            "avatar": avatar.info.name, **figures,
        })  # fmt: skip

    def _check_options(self) -> None:
        """InputError for options of another format: they would change nothing."""
        plain = self._is_mesh or self.format in ("usd", "web")
        unused = {
            "ply": plain and self.splats != SplatFileOptions(),
            "usd or mesh": not self._is_mesh and self.format != "usd" and self.template is not None,
            "usd": self.format != "usd" and self.usd != UsdStageOptions(),
            # a page has no numbers of frames, and is turned as one likes
            "usd or ply": self.format == "web" and (self.first_frame, self.up, self.overwrite) != (0, "y", False),
            "web": self.format != "web" and self.web != WebPageOptions(),
        }
        for other in (other for other, given in unused.items() if given):
            raise InputError(
                f"jghand export {self.format}", wanted="its own options",
                came=f"one of jghand export {other}, which is without effect",
                remedy=f"Leave it out, or write jghand export {other}.",
            )  # fmt: skip

    @property
    def _is_mesh(self) -> bool:
        return self.format.startswith("mesh")

    def _write_usd(self, avatar: HandAvatar, motion: Motion) -> dict[str, Any]:
        from jghand_engine.export.usd.package import PRESETS
        from jghand_engine.render.framing import framing_camera

        options, sequence = self._usd_options(), motion.sequence
        width, height = CAMERA_PX
        cameras = {
            name: framing_camera(sequence.joints_m, sequence.handedness, name, width=width, height=height)
            for name in ("front", "back")
        }
        report = export_stage(self.out, avatar, sequence, cameras, options)
        size = sum(report.bytes.values())
        say(f"Wrote {report.stage}: {report.frames} frames, {size / 1e6:.1f} MB, {sum(report.seconds.values()):.1f} s")
        if self.usd.consumer != "generic":
            say(f"For {self.usd.consumer}: {PRESETS[self.usd.consumer].advice}")
        return {"for": self.usd.consumer, **usd_figures(report)}

    def _usd_options(self) -> UsdOptions:
        from jghand_engine.export.usd.package import PRESETS, UsdOptions
        from jghand_engine.export.usd.stage import Variant

        given, preset = self.usd, PRESETS[self.usd.consumer]
        variant = preset.variant if given.default_variant is None else Variant(given.default_variant)
        return UsdOptions(
            name=self.name,
            default_variant=variant,
            radiance=given.radiance,
            width_factor=preset.width_factor if given.width_factor is None else given.width_factor,
            first_frame=self.first_frame,
            up=self.up,
            package=given.package,
            overwrite=self.overwrite,
            template=None if self.template is None else hand_template(self.template),
        )

    def _write_splats(self, avatar: HandAvatar, motion: Motion) -> dict[str, Any]:
        from jghand_engine.export.made_from import made_from
        from jghand_engine.export.splats.files import SplatOptions, export_splats

        options = SplatOptions(
            self.name, self.format, self.first_frame, self.overwrite, self.splats.axes, self.up, self.splats.read(),
            self.splats.surfels,
        )  # fmt: skip
        with progress(f"Writing {self.format}", len(motion.frames)) as bar:
            report = export_splats(self.out, avatar, motion.whole, options, frames=motion.frames, progress=bar.reach)
        figures = {"axes": report.axes, "light": report.light, "gaussians": report.gaussians}
        about = f"axes {report.axes}, light: {report.light}"
        return self._told(report, about, figures, made_from(avatar, motion.sequence))

    def _write_meshes(self, avatar: HandAvatar, motion: Motion) -> dict[str, Any]:
        from jghand_engine.export.made_from import made_from
        from jghand_engine.export.mesh import MESH_FORMATS, export_meshes
        from jghand_engine.export.splats.files import FrameFiles

        names = FrameFiles(self.name, MESH_FORMATS[self.format], self.first_frame, self.overwrite)
        template = None if self.template is None else hand_template(self.template)
        with progress("Writing meshes", len(motion.frames)) as bar:
            report = export_meshes(
                self.out, avatar, motion.whole, names, up=self.up, template=template, frames=motion.frames,
                progress=bar.reach,
            )  # fmt: skip
        figures = {"vertices": report.vertices, "faces": report.faces}
        about = f"{report.vertices} vertices, {report.faces} faces"
        return self._told(report, about, figures, made_from(avatar, motion.sequence))

    def _told(
        self, report: SplatReport | MeshReport, about: str, figures: dict[str, Any], source: dict[str, str]
    ) -> dict[str, Any]:
        """Says what files of frames were written; the same as plain data, with `figures` of its format."""
        first, last = report.files[0], report.files[-1]
        which = str(first) if first == last else f"{first} to {last.name}"
        say(f"Wrote {which}: {len(report.files)} frames, {report.bytes / 1e6:.1f} MB, {about}")
        if report.kept:
            say(f"{report.kept} other frames of {self.name} stay there. Nothing tells whether they show this motion.")
        return {
            "files": [str(path) for path in report.files], "frames": len(report.files), **figures,
            "bytes": report.bytes, "kept": report.kept, "made_from": source,
        }  # fmt: skip

    def _write_web(self, avatar: HandAvatar, motion: Motion) -> dict[str, Any]:
        from jghand_engine.export.made_from import made_from
        from jghand_engine.export.web.page import WebOptions, WebView, export_web

        sequence = motion.sequence
        view = WebView.of_motion(sequence.joints_m, sequence.handedness, self.web.camera)
        title = "" if self.name == Export.name else self.name
        report = export_web(self.out, avatar, sequence, view, WebOptions(title, self.web.gaussians))
        size = sum(report.bytes.values())
        say(f"Wrote {report.page}: {report.frames} frames, {report.gaussians} Gaussians, {size / 1e6:.1f} MB. Open it.")
        if report.correctives == "network":
            say("This avatar has no linear tier: the page computes its network and is slow. `jghand distill` adds one.")
        return {
            "page": str(report.page), "frames": report.frames, "gaussians": report.gaussians,
            "correctives": report.correctives, "bytes": report.bytes, "made_from": made_from(avatar, sequence),
        }  # fmt: skip


def export_stage(
    folder: Path, avatar: HandAvatar, sequence: PoseSequence, cameras: Mapping[str, Camera], options: UsdOptions
) -> UsdReport:
    """Writes the stage and shows how far it is."""
    from jghand_engine.export.usd.package import export_usd

    with progress("Writing USD", len(sequence)) as bar:
        return export_usd(folder, avatar, sequence, cameras, options, progress=bar.reach)


def usd_figures(report: UsdReport) -> dict[str, Any]:
    return {**vars(report), "stage": str(report.stage), "shot": None if report.shot is None else str(report.shot)}
