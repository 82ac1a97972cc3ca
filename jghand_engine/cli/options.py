"""Options that several commands share. The docstring of a field is its line in `--help`.

Nothing heavy is imported here: `jghand --help` must answer at once.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import tyro

from jghand_engine.avatar import BUILTIN
from jghand_engine.errors import InputError
from jghand_engine.files import check_place
from jghand_engine.hand.sequence import FPS_MAX, FPS_MIN
from jghand_engine.native import contract

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.avatar.scene_light import SceneLight

# the widest lens, millimeters: one that sees around the hand
APERTURE_MAX_MM = 200.0

OrderName = Literal["standard", "openpose", "mediapipe", "mano21", "interhand", "mano16_tips", "openxr", "level"]
UnitName = Literal["m", "cm", "mm"]
HandName = Literal["right", "left"]
PresetName = Literal["draft", "viewport", "final", "reference"]
BackendName = Literal["auto", "gpu", "v4", "v3", "neon"]
CameraName = Literal["quarter", "front", "back", "side", "outside", "top", "quarter-back"]
# an option that may be left out, shown without "(default: None)"
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
FiguresFile = Annotated[
    Path | None,
    tyro.conf.arg(metavar="FILE", help_behavior_hint="", help="Also write what was done, with figures, as JSON."),
]


@dataclass(frozen=True)
class FormatOptions:
    """How a motion file is to be read. What the file says itself may be left out."""

    order: Annotated[OrderName | None, tyro.conf.arg(help_behavior_hint="")] = None
    """How the file lists the joints; else it is recognized by the bones. standard, openpose, mediapipe and mano21 are
    the same."""
    unit: Annotated[UnitName | None, tyro.conf.arg(help_behavior_hint="")] = None
    """Length unit of the file; else it is recognized by the size of the hand."""
    hand: Annotated[HandName | None, tyro.conf.arg(help_behavior_hint="")] = None
    """Which hand it is. Never guessed: joints alone do not tell."""
    fps: Annotated[float | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="")] = None
    """Frames per second of the file, whatever it says itself; an animation of USD, which has times in seconds,
    is taken at this rate. Left out: what the file says, else 30."""
    any_proportions: bool = False
    """Take joints whose bone lengths are no hand's, such as a cartoon's: a wrong order or unit is not noticed then."""
    part: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Which of several skeletons, people or captures of a file: its name, or a part of it."""

    def checked_fps(self) -> float | None:
        """`fps`. InputError when no motion can have it (NaN included)."""
        if self.fps is not None and not FPS_MIN <= self.fps <= FPS_MAX:
            wanted = f"{FPS_MIN:g} to {FPS_MAX:g} frames per second"
            raise InputError("--fps", wanted=wanted, came=f"{self.fps:g}")
        return self.fps


@dataclass(frozen=True)
class ForeignOptions:
    """What files of other programs leave open."""

    bones: File = None
    """Names of a rig's bones by joint as JSON, {"wrist": "Hand_R", "thumb1": …}: for names that are not recognized."""
    labels: Literal["auto", "true", "mirrored"] = "auto"
    """Whether a detector's "Left" and "Right" are true or those of a mirrored picture. auto: as is usual there."""
    hand_length: Annotated[float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="")] = None
    """Scale the hand to this length, wrist to the middle finger's tip, whatever the unit of the file is."""
    file_up: Annotated[Literal["y", "z"] | None, tyro.conf.arg(help_behavior_hint="")] = None
    """The axis that points up in the file, where it does not say so (BVH), or says so wrongly; for --up."""


@dataclass(frozen=True)
class MotionOptions:
    """Which hand does what."""

    motion: File = None
    """A motion: joints of OpenPose, MediaPipe, FreeMoCap, headsets, InterHand; BVH, USD; or JGHand's own
    .npz, .npy, .json, .csv (docs/MOTION.md)."""
    poses: Annotated[str | None, tyro.conf.arg(metavar="NAME,NAME,…", help_behavior_hint="")] = None
    """Instead of a file: poses by name, with smooth ways between them, such as open,fist,point."""
    format: FormatOptions = field(default_factory=FormatOptions)
    frames: Annotated[str, tyro.conf.arg(metavar="FIRST:LAST[:STEP]", help_behavior_hint="(default: all)")] = ":"
    """Only these frames, counted from 0, the last one included; FIRST-LAST is the same. Files have their numbers."""
    keep_bone_lengths: bool = False
    """Follow the bone lengths of every frame. Else each bone keeps its median, as estimates wobble and would pulse."""
    on_missing: Literal["fill", "hold", "stop"] = "fill"
    """A frame without some joint: turn the bones evenly from before to after and say how often, hold the last whole
    pose, or stop with an error."""

    def check(self) -> None:
        """InputError for what these words alone show to be wrong."""
        if (self.motion is None) == (self.poses is None):
            came = "none of them" if self.motion is None else "both"
            raise InputError("motion", wanted="either --motion FILE or --poses NAME,NAME,…", came=came)
        self.frame_slice()
        self.format.checked_fps()

    def frame_slice(self) -> slice:
        """`frames` as a slice. Raises InputError."""
        text = re.sub(r"^(\d+)-(?=\d)", r"\1:", self.frames.strip())
        match = re.fullmatch(r"(\d*)(?::(\d*)(?::(\d+))?)?", text)
        if not match or not text:
            raise InputError("--frames", wanted="FIRST:LAST or FIRST:LAST:STEP, such as 0:99", came=repr(self.frames))
        first = int(match[1] or 0)
        if ":" not in text:
            return slice(first, first + 1, 1)
        part = slice(first, int(match[2]) + 1 if match[2] else None, int(match[3] or 1))
        if part.step == 0 or (part.stop is not None and part.stop <= first):
            raise InputError("--frames", wanted="a step of 1 or more, and FIRST before LAST", came=repr(self.frames))
        return part


@dataclass(frozen=True)
class AvatarOptions:
    """Which hand is shown."""

    avatar: Annotated[str, tyro.conf.arg(metavar="FILE")] = BUILTIN
    """A .jghand file, or a hand that comes with JGHand: builtin, learned from pictures, painted, or one of the family
    in its assets/hands by its name."""


@dataclass(frozen=True)
class ShownAvatarOptions(AvatarOptions):
    """Which hand is shown."""

    forearm: bool = True
    """Show the forearm of a hand that has one. Left out, and of hands that have none, the hand fades out at the
    wrist."""

    def load(self) -> HandAvatar:
        """The avatar as it is shown. InputError for a file that is none."""
        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.avatar.forearm import ended

        return ended(load_avatar_called(self.avatar), forearm=self.forearm)


@dataclass(frozen=True)
class LightOptions:
    """In which light the hand is shown."""

    light: File = None
    """Show the hand in this light, not in that of its capture: lamps and a world as JSON, as Blender writes them, or
    the panorama of a world (.hdr, .exr, .npy); docs/LIGHT.md. It is shown through sRGB's curve."""
    lamp: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(metavar="KIND:NAME=VALUE,…", help_behavior_hint="(repeatable)"),
    ] = ()
    """A lamp beside those of --light, or without it: sun, point, spot or area with the fields of a light file, such as
    sun:rgb=3/2.7/2.2,place=0.8/0.6/0.6,angle=0.01."""

    def read(self) -> SceneLight | None:
        """The light; None for that of the hand's capture. InputError names what is wrong."""
        from jghand_engine.avatar.light_records import light_of
        from jghand_engine.export.light_file import lamp_of_words, read_light

        lamps = tuple(map(lamp_of_words, self.lamp))
        if self.light is not None:
            return read_light(self.light, lamps)
        return light_of(lamps, None) if lamps else None


@dataclass(frozen=True)
class PictureOptions:
    """How the pictures are made."""

    camera: Annotated[str, tyro.conf.arg(metavar="SIDE|FILE.json")] = "quarter"
    """Side that is seen: quarter, front (the palm), back, side (the thumb), outside (the little finger), top (the
    finger tips) or quarter-back. Or a pinhole camera as JSON (width, height, fx, fy, cx, cy, camera_from_world), as
    --out holds one."""
    size: Annotated[str | None, tyro.conf.arg(metavar="WIDTHxHEIGHT", help_behavior_hint="(default: 512x334)")] = None
    """Pixels. A camera file has its own."""
    preset: Annotated[PresetName | None, tyro.conf.arg(help_behavior_hint="(default: final)")] = None
    """Accuracy against time."""
    background: Annotated[str, tyro.conf.arg(metavar="COLOR")] = "transparent"
    """transparent, or a color such as #e8e6e3. A video has no transparency: there it is a light gray."""
    threads: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """Threads of the renderer; 0 chooses."""
    backend: BackendName = "auto"
    """What draws: gpu is a graphics card (docs/GPU.md), v4, v3 and neon are kernels of the processor. auto is the best
    of these, and the card where `jghand bench --backend gpu` found it faster."""

    @property
    def camera_file(self) -> Path | None:
        """The file that --camera names; None for a side. InputError for what is neither."""
        if self.camera in get_args(CameraName):
            return None
        if not self.camera.lower().endswith(".json"):
            wanted = f"{', '.join(get_args(CameraName))} or a file that ends in .json"
            raise InputError("--camera", wanted=wanted, came=repr(self.camera))
        return Path(self.camera)

    def size_px(self) -> tuple[int, int]:
        """Width and height of what a side shows. InputError for a size beside a camera file, which has its own."""
        if self.size is not None and self.camera_file is not None:
            raise InputError("--size", wanted="a camera without a size of its own", came=f"--camera {self.camera}",
                             remedy="Leave --size out, or change width, height, fx and fy in the file.")  # fmt: skip
        return pixels(self.size or "512x334")

    def background_rgb(self) -> tuple[float, float, float] | None:
        """sRGB 0..1, None for transparent. Raises InputError."""
        return None if self.background == "transparent" else color(self.background)


@dataclass(frozen=True)
class EffectOptions:
    """Which effects are simulated, and what the camera does."""

    effects: Annotated[str, tyro.conf.arg(metavar="auto|all|none|NAME,…")] = "auto"
    """auto: what the scene calls for. all: everything on every frame. none: only what no picture can do without.
    Names: these alone, when they are called for (docs/EFFECTS.md lists them)."""
    shutter: Annotated[float, tyro.conf.arg(metavar="PART")] = 0.0
    """Motion blur: the part of the time between frames that the shutter is open, such as 0.5 (180 degrees)."""
    aperture: Annotated[float, tyro.conf.arg(metavar="MM")] = 0.0
    """Depth of field: diameter of the lens's opening in millimeters, such as 10; 0 is a pinhole."""
    focus: Annotated[float | None, tyro.conf.arg(metavar="METERS", help_behavior_hint="(default: the hand)")] = None
    """Depth that is sharp, in meters from the camera."""
    explain: bool = False
    """Print for the first frame what ran and what did not, why, and what it cost; and the sum over all frames."""

    def check(self) -> None:
        """InputError for what no camera can do."""
        if not 0 <= self.shutter <= 1:
            raise InputError("--shutter", wanted="0 to 1", came=f"{self.shutter:g}")
        if not 0 <= self.aperture <= APERTURE_MAX_MM:
            raise InputError("--aperture", wanted=f"0 to {APERTURE_MAX_MM:g} mm", came=f"{self.aperture:g}")
        if self.focus is not None and not self.focus > contract.Z_NEAR_M:
            raise InputError("--focus", wanted=f"meters beyond {contract.Z_NEAR_M:g}", came=f"{self.focus:g}")


def check_places(written: Sequence[tuple[str, Path]], read: Sequence[Path], *, overwrite: bool) -> None:
    """Before the work, of files with the options that name them: InputError where one is a file that is `read`, or that
    of another option; and as `files.check_place`. A report of --json is replaced, as every command does."""
    taken: dict[Path, str] = {}
    for option, path in written:
        if path.exists() and any(one.exists() and path.samefile(one) for one in read):
            raise InputError(f"{option} {path}", wanted="a file of its own", came="one that is read")
        other = taken.setdefault(path.resolve(), option)
        if other != option:
            raise InputError(f"{option} {path}", wanted="a file of its own", came=f"that of {other}")
        check_place(path, overwrite=overwrite or option == "--json", option=option)


def color(text: str) -> tuple[float, float, float]:
    """`#rrggbb` as sRGB 0..1. Raises InputError."""
    match = re.fullmatch(r"#?([0-9a-fA-F]{2})([0-9a-fA-F]{2})([0-9a-fA-F]{2})", text.strip())
    if not match:
        raise InputError("--background", wanted="transparent or a color as #rrggbb", came=repr(text))
    red, green, blue = (int(part, 16) / 255 for part in match.groups())
    return red, green, blue


def pixels(text: str) -> tuple[int, int]:
    """`WIDTHxHEIGHT` as (width, height). Raises InputError."""
    match = re.fullmatch(r"(\d{1,5})[xX](\d{1,5})", text.strip())
    if not match or not all(int(edge) for edge in match.groups()):
        raise InputError("--size", wanted="WIDTHxHEIGHT in pixels, such as 512x334", came=repr(text))
    return int(match[1]), int(match[2])


def parse_shard(text: str) -> tuple[int, int]:
    """`2/3` as (2, 3). Raises InputError."""
    match = re.fullmatch(r"(\d{1,4})/(\d{1,4})", text.strip())
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise InputError(
            "--shard", wanted="NUMBER/COUNT with a number from 1 to the count, such as 1/2", came=repr(text)
        )
    return int(match[1]), int(match[2])


def pose_list(text: str) -> list[str]:
    """`open, fist` as a list of names."""
    return [name.strip() for name in text.split(",") if name.strip()]
