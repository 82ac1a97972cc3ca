"""What a user asks of a capture: hand, poses, cameras, and light, skin and sampling of its images. DATA 4."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jghand_engine.captures.making.lights import VariedLight
from jghand_engine.captures.making.poses import POSES_MAX
from jghand_engine.captures.skin.person import Person
from jghand_engine.errors import InputError
from jghand_engine.files import read_bytes
from jghand_engine.hand.sequence import PoseSequence

# rays per pixel: 1 is a test, beyond the most the denoiser has nothing left to do
SAMPLES = (1, 4096)
CAMERAS_MAX = 500
# edges of an image, pixels: below nothing is seen of a hand, above Cycles takes minutes an image
EDGES_PX = (16, 4096)
# the environments that come with Blender (Poly Haven, CC0)
HDRI_NAMES = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")


@dataclass(frozen=True)
class AreaLight:
    """A square lamp at `place_m`, aimed at the middle of the hands."""

    place_m: tuple[float, float, float]
    edge_m: float
    watts: float
    rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Light:
    """hdri: a name of HDRI_NAMES or an image file; hdri_turn_deg: its turn about the vertical (+y) axis. The default
    lamps are large and on all sides: a soft key on the palm, a softer one on the back, weak ones above and below."""

    hdri: str = "studio"
    hdri_strength: float = 0.55
    hdri_turn_deg: float = 0.0
    lamps: tuple[AreaLight, ...] = (
        AreaLight((0.45, 0.45, 0.65), 0.40, 5.0, (1.0, 0.97, 0.93)),
        AreaLight((-0.55, 0.30, -0.60), 0.50, 5.0, (1.0, 0.98, 0.96)),
        AreaLight((-0.25, 0.80, 0.10), 0.40, 1.2),
        AreaLight((0.25, -0.65, 0.30), 0.50, 2.0),
    )

    def check(self) -> None:
        """InputError for an environment that is none."""
        if not self.hdri_strength >= 0:
            raise InputError("strength of the environment", wanted="0 or more", came=f"{self.hdri_strength:g}")
        is_picture = Path(self.hdri).suffix.lower() in (".exr", ".hdr") and Path(self.hdri).is_file()
        if self.hdri not in HDRI_NAMES and not is_picture:
            wanted = f"varied, one of {', '.join(HDRI_NAMES)}, or an .exr or .hdr file"
            raise InputError("light", wanted=wanted, came=self.hdri)


@dataclass(frozen=True)
class Sampling:
    """Rays per pixel of whole views, Loop's subdivisions of the mesh, bounces, and the noise at which a pixel is
    done."""

    samples: int = 6
    subdivisions: int = 1
    bounces: int = 4
    adaptive_threshold: float = 0.02


@dataclass(frozen=True)
class CaptureOptions:
    """What decides the images of a capture.

    identity:       number or name
    cameras:        that see a pose
    close_ups:      of them
    poses:          how many
    width, height:  pixels of pictures of the whole hand
    skin:           whose
    motion:         where poses come from instead of the generator
    wrist_turn_deg: how far hands turn as a whole, so that light falls from different sides
    seed:           of all that varies
    light:          the same in all images, or another in each
    """

    identity: str
    cameras: int = 16
    close_ups: int = 4
    poses: int = 25
    width: int = 501
    height: int = 768
    skin: Person = field(default_factory=Person)
    motion: PoseSequence | None = None
    wrist_turn_deg: float = 25.0
    seed: int = 0
    light: Light | VariedLight = field(default_factory=Light)
    sampling: Sampling = field(default_factory=Sampling)

    def check(self) -> None:
        """InputError names what cannot be; what other rooms check is left to them."""
        sampling, light = self.sampling, self.light
        for name, value, (least, most) in (
            ("samples", sampling.samples, SAMPLES),
            ("subdivisions", sampling.subdivisions, (0, 4)),
            ("wrist turn", self.wrist_turn_deg, (0, 180)),
            ("poses of a capture", self.poses, (1, POSES_MAX)),
            ("seed", self.seed, (0, math.inf)),
        ):
            if not least <= value <= most:
                wanted = f"{least:g} or more" if most == math.inf else f"{least:g} to {most:g}"
                raise InputError(name, wanted=wanted, came=f"{value:g}")
        if not 1 <= self.cameras <= CAMERAS_MAX:
            raise InputError("cameras of a capture", wanted=f"1 to {CAMERAS_MAX}", came=str(self.cameras))
        if not 0 <= self.close_ups < self.cameras:
            wanted = f"0 to {self.cameras - 1} of {self.cameras}"
            raise InputError("close-ups", wanted=wanted, came=str(self.close_ups))
        low, high = EDGES_PX
        if not (low <= self.width <= high and low <= self.height <= high):
            raise InputError("image", wanted=f"edges of {low} to {high} pixels", came=f"{self.width}x{self.height}")
        if isinstance(light, Light):
            light.check()
        self.skin.check()

    def description(self) -> dict[str, Any]:
        """Everything that decides the images, as JSON; of files what is in them, not where they lie."""
        plain = {
            name: getattr(self, name)
            for name in ("identity", "cameras", "close_ups", "poses", "width", "height", "wrist_turn_deg", "seed")
        }
        motion = None
        if self.motion is not None:
            motion = hashlib.sha256(self.motion.handedness.encode() + self.motion.joints_m.tobytes()).hexdigest()
        light = dataclasses.asdict(self.light)
        if isinstance(self.light, Light) and is_file(self.light.hdri):
            light["hdri"] = hashlib.sha256(read_bytes(Path(self.light.hdri))).hexdigest()
        return {
            **plain,
            "skin": dataclasses.asdict(self.skin),
            "motion": motion,
            "light": light,
            "sampling": dataclasses.asdict(self.sampling),
        }


def is_file(environment: str) -> bool:
    """Whether an environment is an image file, and not one of those that come with Blender."""
    return bool(Path(environment).suffix)
