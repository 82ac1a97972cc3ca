"""What a user asks of a capture."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jghand_engine.captures.making.look import HDRI_NAMES, Light, Sampling, SkinMaterial
from jghand_engine.captures.making.poses import POSES_MAX
from jghand_engine.errors import InputError
from jghand_engine.hand.sequence import PoseSequence

# rays per pixel: 1 is a test, beyond the most the denoiser has nothing left to do
SAMPLES = (1, 4096)


@dataclass(frozen=True)
class CaptureOptions:
    """identity: number or name; cameras in all and close_ups of them; poses: how many; width, height: pixels; skin: a
    picture in the template's UV, None for the procedural skin; motion: where poses come from instead of the generator;
    wrist_turn_deg: how far hands turn as a whole, so that light falls from different sides; seed of all that varies."""

    identity: str
    cameras: int = 16
    close_ups: int = 2
    poses: int = 60
    width: int = 334
    height: int = 512
    skin: Path | None = None
    motion: PoseSequence | None = None
    wrist_turn_deg: float = 25.0
    seed: int = 0
    light: Light = field(default_factory=Light)
    material: SkinMaterial = field(default_factory=SkinMaterial)
    sampling: Sampling = field(default_factory=Sampling)

    def check(self) -> None:
        """InputError names what cannot be; what other rooms check is left to them."""
        least, most = SAMPLES
        watts = [lamp.watts for lamp in self.light.lamps] or [0.0]
        checks = (
            ("samples", least <= self.sampling.samples <= most, f"{least} to {most} rays per pixel"),
            ("wrist turn", 0 <= self.wrist_turn_deg <= 180, "0 to 180 degrees"),
            ("seed", self.seed >= 0, "0 or a positive number"),
            ("poses of a capture", 1 <= self.poses <= POSES_MAX, f"1 to {POSES_MAX}"),
            ("subdivisions", 0 <= self.sampling.subdivisions <= 4, "0 to 4"),
            ("strength of the environment", 0 <= self.light.hdri_strength < math.inf, "0 or more"),
            ("turn of the environment", math.isfinite(self.light.hdri_turn_deg), "degrees"),
            ("brightness of the lamps", all(0 <= lamp < math.inf for lamp in watts), "0 or more"),
        )
        came = (
            self.sampling.samples, self.wrist_turn_deg, self.seed, self.poses, self.sampling.subdivisions,
            self.light.hdri_strength, self.light.hdri_turn_deg, min(watts),
        )  # fmt: skip
        for (name, good, wanted), value in zip(checks, came, strict=True):
            if not good:
                raise InputError(name, wanted=wanted, came=f"{value:g}")
        hdri = self.light.hdri
        if hdri not in HDRI_NAMES and not (Path(hdri).suffix.lower() in (".exr", ".hdr") and Path(hdri).is_file()):
            raise InputError("environment", wanted=f"one of {', '.join(HDRI_NAMES)} or an .exr or .hdr file", came=hdri)

    def description(self) -> dict[str, Any]:
        """Everything that decides the pictures, as JSON; of files what is in them, not where they lie."""
        plain = {
            name: getattr(self, name)
            for name in ("identity", "cameras", "close_ups", "poses", "width", "height", "wrist_turn_deg", "seed")
        }
        motion = None
        if self.motion is not None:
            motion = hashlib.sha256(self.motion.handedness.encode() + self.motion.joints_m.tobytes()).hexdigest()
        light = dataclasses.asdict(self.light)
        if is_file(self.light.hdri):
            light["hdri"] = _hash(Path(self.light.hdri))
        return {
            **plain,
            "skin": None if self.skin is None else _hash(self.skin),
            "motion": motion,
            "light": light,
            "material": dataclasses.asdict(self.material),
            "sampling": dataclasses.asdict(self.sampling),
        }


def is_file(environment: str) -> bool:
    """Whether an environment is a picture file, and not one of those that come with Blender."""
    return bool(Path(environment).suffix)


def read_input(file: Path) -> bytes:
    """The content of a user's file. InputError when it cannot be read."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror}", remedy="Check the name.") from error


def _hash(file: Path) -> str:
    return hashlib.sha256(read_input(file)).hexdigest()
