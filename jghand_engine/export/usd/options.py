"""What an export to USD is asked for, presets for the programs that will read it, and what it reports."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Literal

from jghand_engine.errors import InputError
from jghand_engine.export.usd.half import HalfPrice
from jghand_engine.limits import USD_BALL_WIDTH_FACTOR, USD_CLIPS_ABOVE_FRAMES
from jghand_engine.template.mesh import HandTemplate

IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class Variant(StrEnum):
    """What of the hand is drawn. Blender up to 5.2 cannot choose: it takes what the file says."""

    SPLATS = "splats"
    POINTS = "points"
    POINTS_SKINNED = "points_skinned"
    MESH = "mesh"

    @property
    def has_frames(self) -> bool:
        """Whether Gaussians are written in every frame; in the others all follows the skeleton."""
        return self in (Variant.SPLATS, Variant.POINTS)


class Package(StrEnum):
    """layers: files that refer to each other, with all variants and a shot · usdc: one file with the chosen variant
    alone · usdz: one file with all variants."""

    LAYERS = "layers"
    USDC = "usdc"
    USDZ = "usdz"


@dataclass(frozen=True)
class UsdOptions:
    """name:       stem of the files
    default_variant: what a reader shows that cannot choose (Blender)
    radiance:        "srgb" keeps the avatar's display-referred colors in the splats, "linear" writes light
    sizes:           "constant": radii of the mean hand; "per_frame": as the engine shrinks and stretches them, in
                     larger files. Gaussians that are no balls have theirs in every frame
    width_factor:    diameter of the points of all variants, in two standard deviations
    template:        surface of the avatar; None takes the built-in one
    first_frame:     time code of the first frame
    up:              the axis of the motion's world that points up; written down, nothing is turned
    precision:       "half": the splats in half the size, at a price that the report says; there are no `points` then
    package:         the files that are written
    overwrite:       also files of these names that somebody else made, and text layers that somebody changed
    """

    name: str = "hand"
    default_variant: Variant = Variant.SPLATS
    radiance: Literal["srgb", "linear"] = "srgb"
    sizes: Literal["constant", "per_frame"] = "constant"
    width_factor: float = 1.0
    template: HandTemplate | None = None
    first_frame: int = 0
    up: Literal["y", "z"] = "y"
    precision: Literal["float", "half"] = "float"
    package: Package = Package.LAYERS
    overwrite: bool = False

    def __post_init__(self) -> None:
        if not IDENTIFIER.fullmatch(self.name):
            raise InputError("name of the USD files", wanted="letters, digits and _", came=repr(self.name))
        for thing, value, wanted in (
            ("default variant", self.default_variant, tuple(Variant)),
            ("radiance", self.radiance, ("srgb", "linear")),
            ("sizes", self.sizes, ("constant", "per_frame")),
            ("up", self.up, ("y", "z")),
            ("precision", self.precision, ("float", "half")),
            ("package", self.package, tuple(Package)),
        ):
            if value not in wanted:
                raise InputError(thing, wanted=" or ".join(wanted), came=repr(value))
        if not (math.isfinite(self.width_factor) and self.width_factor > 0):
            raise InputError("width factor", wanted="a finite number above 0", came=str(self.width_factor))
        if self.is_half and self.default_variant == Variant.POINTS:
            raise InputError(
                "default variant", wanted="splats, points_skinned or mesh in half precision", came="points",
                remedy="USD's points know no half precision: leave it out, or choose points_skinned.",
            )  # fmt: skip
        if self.is_half and self.package == Package.USDC and self.default_variant != Variant.SPLATS:
            raise InputError(
                "precision half of package usdc", wanted="the variant splats, which it is of",
                came=str(self.default_variant), remedy="Leave it out: it would change nothing in this file.",
            )  # fmt: skip

    @property
    def is_half(self) -> bool:
        """Whether the splats are in half precision."""
        return self.precision == "half"

    @property
    def variants(self) -> tuple[Variant, ...]:
        """Those that the stage offers."""
        return tuple(one for one in Variant if not (self.is_half and one is Variant.POINTS))

    def has_clips(self, frames: int) -> bool:
        """Whether the Gaussians of a take are cut into files that are read one at a time; single files never are."""
        return self.package == Package.LAYERS and frames > USD_CLIPS_ABOVE_FRAMES


@dataclass(frozen=True)
class Preset:
    """What suits a program (EXPORT 4). variant: what it shows · width_factor: of points · advice: what its user has to
    know, in sentences."""

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
        USD_BALL_WIDTH_FACTOR,
    ),
    "blender": Preset(
        Variant.POINTS,
        "Set the scene's frame rate to that of the stage: Blender's importer leaves it. A Blender that draws splats "
        "itself wants --default-variant splats.",
        USD_BALL_WIDTH_FACTOR,
    ),
    "houdini": Preset(
        Variant.POINTS, "Widths are two standard deviations. SOPs that want splats read PLY: jghand export splats."
    ),
}


@dataclass(frozen=True)
class UsdReport:
    """What an export did.

    stage: path of the interface layer or of the single file · shot: path of the shot; None of a single file ·
    bytes: size by file name · seconds: time by stage of the work · sigma_error: largest relative difference between a
    written radius and the engine's (0 with sizes per frame) · made_from: what the function of that name says ·
    half: what half precision lost, None without
    """

    stage: Path
    shot: Path | None
    frames: int
    gaussians: int
    bytes: Mapping[str, int] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    sigma_error: float = 0.0
    made_from: Mapping[str, str] = field(default_factory=dict)
    half: HalfPrice | None = None

    @property
    def write_ms_per_frame(self) -> float:
        """Milliseconds per frame to write the Gaussians, posing them not included."""
        return 1e3 * self.seconds["splats"] / self.frames

    @property
    def megabytes_per_frame(self) -> float:
        """Size of the whole export over its frames, 1e6 bytes."""
        return sum(self.bytes.values()) / 1e6 / self.frames


@dataclass(frozen=True)
class LayerNames:
    """File names of one export, all in one folder."""

    name: str

    @property
    def interface(self) -> str:
        return f"{self.name}.usda"

    @property
    def rig(self) -> str:
        return f"{self.name}.rig.usdc"

    @property
    def splats(self) -> str:
        return f"{self.name}.splats.usdc"

    @property
    def skinned(self) -> str:
        """Points that follow the skeleton: all of them, and the tenth that stands in for splats."""
        return f"{self.name}.skinned.usdc"

    @property
    def shot(self) -> str:
        return f"{self.name}.shot.usda"

    @property
    def static(self) -> str:
        """What does not move, of splats that are cut into clips."""
        return f"{self.name}.splats.static.usdc"

    @property
    def manifest(self) -> str:
        """Which attributes the clips hold."""
        return f"{self.name}.splats.manifest.usdc"

    def clip(self, number: int) -> str:
        """A part of a long take."""
        return f"{self.name}.splats.{number:04d}.usdc"

    def stage(self, package: Package) -> str:
        """The file that people open: the interface, or the only one."""
        return self.interface if package is Package.LAYERS else f"{self.name}.{package}"

    def files(self, package: Package = Package.LAYERS) -> tuple[str, ...]:
        """Every file that an export writes, clips aside; those that refer to others after them."""
        if package is not Package.LAYERS:
            return (self.stage(package),)
        return self.rig, self.splats, self.skinned, self.interface, self.shot

    def of_earlier(self, folder: Path, package: Package = Package.LAYERS) -> Iterable[Path]:
        """The files of an earlier export of this name and package, of which none may stand beside a new one's."""
        names = set(self.files(package))
        if package is Package.LAYERS:
            part = re.compile(re.escape(self.name) + r"\.splats\.(static|manifest|\d{4,})\.usdc")
            names |= {path.name for path in folder.iterdir() if part.fullmatch(path.name)}
        return [folder / name for name in sorted(names) if (folder / name).exists()]
