"""`jghand motion`: a motion file of any program as one of JGHand's, cut, at another rate, or mirrored."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jghand_engine.cli.console import progress, say, write_figures
from jghand_engine.cli.options import FiguresFile, ForeignOptions, FormatOptions
from jghand_engine.errors import InputError
from jghand_engine.files import check_place
from jghand_engine.hand.sequence import FPS_MAX, FPS_MIN

if TYPE_CHECKING:
    from jghand_engine.hand.sequence import PoseSequence

DESCRIPTION = """Convert a motion of another program: OpenPose, MediaPipe, FreeMoCap, headsets, BVH, USD.

Examples:
  jghand motion dance.bvh --hand left --out left.npz
  jghand motion openpose_folder --out motion.npz --to-fps 24 --start 1.5 --end 4
  jghand motion capture.npy --unit mm --order interhand --hand right --mirror --out left.npz
  jghand motion walk.usda --hand right --in-place --hand-length 185 --out right.npz"""

SECONDS = tyro.conf.arg(metavar="SECONDS", help_behavior_hint="")


@dataclass(frozen=True)
class Motion:
    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """A motion file, a folder of OpenPose's frames, or a recording of FreeMoCap. docs/MOTION.md has the formats."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """.npz, .json or .csv: 21 joints, meters, everything declared."""
    start: Annotated[float | None, SECONDS] = None
    """Cut off what is before, seconds from the beginning of the file."""
    end: Annotated[float | None, SECONDS] = None
    """Cut off what is after."""
    to_fps: Annotated[float | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="")] = None
    """Take the motion at another rate: bones turn from frame to frame and keep their lengths."""
    mirror: bool = False
    """Make it the other hand's."""
    in_place: bool = False
    """Keep the wrist where it first is: the hand turns and moves its fingers on the spot."""
    up: Annotated[Literal["y", "z"] | None, tyro.conf.arg(help_behavior_hint="")] = None
    """Turn the motion so that this axis points up. Which one does in the file it or its format says, else --file-up."""
    on_missing: Literal["fill", "hold", "keep", "stop"] = "fill"
    """A frame without some joint: turn the bones evenly from before to after, hold the last whole pose, leave the gap,
    or stop with an error."""
    overwrite: bool = False
    """Replace a file that is there."""
    format: FormatOptions = field(default_factory=FormatOptions)
    foreign: ForeignOptions = field(default_factory=ForeignOptions)
    json: FiguresFile = None

    def run(self) -> None:
        from jghand_engine.cli.inputs import read_file
        from jghand_engine.motion.files import write_motion

        self._check()
        with progress("Reading the motion", 3) as bar:
            read = read_file(self.file, self.format, self.foreign)
            bar.advance()
            sequence, said = self._changed(read.sequence, read.up)
            length_mm = _length_mm(sequence)
            bar.advance()
            write_motion(self.out, sequence)
            bar.advance()
        notes = [*read.notes, *said]
        for note in notes:
            say(note)
        long = "of unknown length" if length_mm is None else f"of {length_mm:.0f} mm"
        say(
            f"Wrote {self.out} from {read.kind}: {sequence.handedness} hand {long}, {len(sequence)} frames at "
            f"{sequence.fps:g} fps ({sequence.duration_s:.1f} s)"
        )
        write_figures(self.json, {
            "command": "motion", "file": str(self.file), "out": str(self.out), "format": read.kind, "notes": notes,
            "hand": str(sequence.handedness), "frames": len(sequence), "fps": sequence.fps,
            "seconds": sequence.duration_s, "filled_frames": int(sequence.filled.sum()),
            "frames_with_missing_joints": len(sequence.gaps.frames), "hand_length_mm": length_mm,
        })  # fmt: skip

    def _check(self) -> None:
        """What can be refused before the file is read. Raises InputError."""
        from jghand_engine.motion.files import check_written_suffix

        check_written_suffix(self.out)
        if self.to_fps is not None and not FPS_MIN <= self.to_fps <= FPS_MAX:
            wanted = f"{FPS_MIN:g} to {FPS_MAX:g} frames per second"
            raise InputError("--to-fps", wanted=wanted, came=f"{self.to_fps:g}")
        check_place(self.out, overwrite=self.overwrite)

    def _changed(self, sequence: PoseSequence, up: str | None) -> tuple[PoseSequence, list[str]]:
        """The motion as the options want it, and sentences about it. The whole is repaired and taken at another rate
        before it is cut, so that the part looks as it does in the whole and has both its ends."""
        from jghand_engine.cli.inputs import without_gaps
        from jghand_engine.motion.tools import cut, in_place, turned_up

        said = []
        if self.on_missing in ("fill", "hold"):
            sequence, gaps = without_gaps(sequence, hold=self.on_missing == "hold")
            said += [gaps] if gaps else []
        if self.to_fps is not None:
            sequence = sequence.resampled(self.to_fps)
        sequence = cut(sequence, self.start, self.end)
        if self.on_missing == "stop":
            sequence.without_gaps()
        if self.in_place:
            sequence = in_place(sequence)
        if self.up is not None and up is None:
            said.append("Which axis points up is not known, so it is left as it is: --file-up says it.")
        elif self.up is not None and up is not None:
            sequence = turned_up(sequence, up, self.up)
        return (sequence.mirrored() if self.mirror else sequence), said


def _length_mm(sequence: PoseSequence) -> float | None:
    """From the wrist to the middle finger's tip; None where no frame shows all of it."""
    from jghand_engine.hand.orders import hand_length

    try:
        return 1e3 * hand_length(sequence.joints_m)
    except InputError:
        return None
