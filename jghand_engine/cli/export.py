"""`jghand export`: a motion becomes a USD stage with splats, points, skeleton, skinned mesh and camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from jghand_engine.cli.console import say, write_json
from jghand_engine.cli.options import AvatarOptions, MotionOptions, ReportOptions

DESCRIPTION = """Write a motion as OpenUSD: hand.usda with its layers (splats, points, skeleton and mesh, cameras).

The skeleton has 63 joints: the 21 that drive the hand, with the names of the motion's joints, and those that
carry the skin between them. A trained avatar has colours of its own in every frame, in the light that it was
learnt in; what its skin mirrors depends on the camera, and is left out.

Examples:
  jghand export --poses open,fist --hand right --out usd
  jghand export --motion capture.npy --order mediapipe --hand right --out usd"""

# the picture that the stage's cameras are made for
CAMERA_PX = (1024, 1024)


@dataclass(frozen=True)
class Export:
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """Where NAME.usda and its layers are written."""
    default_variant: Literal["splats", "points", "mesh"] = "splats"
    """What a program shows that cannot choose: splats for renderers that know them, points for Blender."""
    sizes: Literal["constant", "per_frame"] = "constant"
    """Radii of the splats: of the mean hand, or of every frame at 2.3 times the size of the file."""
    radiance: Literal["srgb", "linear"] = "srgb"
    """Colours of the splats: srgb as a screen shows them, for most viewers; linear as light, for path tracers."""
    width_factor: Annotated[float, tyro.conf.arg(metavar="NUMBER")] = 1.0
    """Size of the points of variant points: 1 is two standard deviations of a splat; more closes gaps between them."""
    name: Annotated[str, tyro.conf.arg(metavar="NAME")] = "hand"
    """Stem of the files: letters, digits and _."""
    motion: MotionOptions = field(default_factory=MotionOptions)
    avatar: AvatarOptions = field(default_factory=AvatarOptions)
    report: ReportOptions = field(default_factory=ReportOptions)

    def run(self) -> None:
        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.cli.framing import framing_camera
        from jghand_engine.cli.inputs import load_motion
        from jghand_engine.cli.stage_export import export_stage, usd_figures
        from jghand_engine.exporters.usd import UsdOptions
        from jghand_engine.exporters.usd_stage import Variant

        options = UsdOptions(
            name=self.name, default_variant=Variant(self.default_variant), radiance=self.radiance,
            sizes=self.sizes, width_factor=self.width_factor,
        )  # fmt: skip
        avatar = load_avatar_called(self.avatar.avatar)
        motion = load_motion(self.motion, avatar)
        sequence = motion.sequence
        for note in motion.notes:
            say(note)
        width, height = CAMERA_PX
        cameras = {
            name: framing_camera(sequence.joints_m, sequence.handedness, name, width=width, height=height)
            for name in ("front", "back")
        }
        report = export_stage(self.out, avatar.for_hand(sequence.handedness), sequence, cameras, options)
        size = sum(report.bytes.values())
        say(f"Wrote {report.stage}: {report.frames} frames, {size / 1e6:.1f} MB, {sum(report.seconds.values()):.1f} s")
        if self.report.json is not None:
            write_json(self.report.json, {
                "command": "export", "motion": motion.source, "notes": motion.notes, "avatar": avatar.info.name,
                **usd_figures(report),
            })  # fmt: skip
