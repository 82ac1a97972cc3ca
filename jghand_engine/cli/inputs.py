"""From options to data: the motion and the avatar that a command works on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.cli.console import say
from jghand_engine.cli.options import ForeignOptions, FormatOptions, MotionOptions, pose_list
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.hand.poses import MotionOptions as PoseMotionOptions
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.json_files import read_small_json
from jghand_engine.motion.bone_names import BoneMap, bone_map
from jghand_engine.motion.clocks import DEFAULT_FPS
from jghand_engine.motion.content import MotionFormat
from jghand_engine.motion.read import MotionRead, read_motion_file
from jghand_engine.motion.repair import fill_gaps

# bones that vary by less than this (standard deviation, meters) are constant: text with few digits
BONE_WOBBLE_MIN_M = 1e-4


@dataclass(frozen=True)
class Motion:
    """What is shown of a steady motion. source, files: where it is from · notes: what was done to make it so, sentences
    for people · whole: the motion that it is cut from · frames: their numbers in it"""

    sequence: PoseSequence
    source: str
    notes: list[str]
    files: tuple[Path, ...]
    whole: PoseSequence
    frames: range


def load_motion(options: MotionOptions, avatar: HandAvatar) -> Motion:
    """Reads or makes the motion and repairs it as the options say; named poses take the bone lengths of `avatar`.

    The whole motion is repaired and then cut, so that a part of it looks as it does in the whole. Raises InputError.
    """
    options.check()
    notes: list[str] = []
    files: tuple[Path, ...] = ()
    if options.motion is not None:
        read, source = read_file(options.motion, options.format), str(options.motion)
        sequence, notes, files = read.sequence, list(read.notes), read.files
    else:
        sequence, source = _from_names(str(options.poses), options.format, avatar), f"poses {options.poses}"
    part = options.frame_slice()
    shown = sequence.section(part.start, part.stop, part.step)
    if shown.filled.any():
        notes.append(f"{int(shown.filled.sum())} of {len(shown)} frames were filled in by whoever made the motion.")
    if shown.gaps and options.on_missing == "stop":
        shown.without_gaps()
    sequence, said = without_gaps(sequence, hold=options.on_missing == "hold")
    if shown.gaps:
        notes.append(said)
    if not options.keep_bone_lengths:
        wobble_m = sequence.bone_lengths_m.std(0).max()
        if wobble_m > BONE_WOBBLE_MIN_M:
            notes.append(
                f"Bone lengths varied by up to {1e3 * wobble_m:.1f} mm (standard deviation): every bone keeps its "
                "median length (--keep-bone-lengths follows the file)."
            )
        sequence = sequence.with_constant_bone_lengths()
    cut = sequence.section(part.start, part.stop, part.step)
    if part.stop is not None and part.stop > len(sequence):
        notes.append(f"--frames {options.frames}: the motion has {len(sequence)} frames, 0 to {len(sequence) - 1}.")
    return Motion(cut, source, notes, files, sequence, range(len(sequence))[part])


def without_gaps(sequence: PoseSequence, *, hold: bool) -> tuple[PoseSequence, str]:
    """The motion whose missing joints are filled, or whose frames with gaps hold the last whole pose, and a sentence.

    Raises InputError when there is too little to go by.
    """
    if hold:
        said = f"{sequence.gaps.sentence()}: the last whole pose was held." if sequence.gaps else ""
        return sequence.with_gaps_held(), said
    filled = fill_gaps(sequence)
    return filled.sequence, filled.sentence()


def read_file(path: Path, options: FormatOptions, foreign: ForeignOptions | None = None) -> MotionRead:
    """The motion of a file, as it is, and what was recognized on the way. Raises InputError."""
    foreign = foreign or ForeignOptions()
    wanted = MotionFormat(
        order=None if options.order is None else JointOrder(options.order),
        unit=options.unit,
        handedness=None if options.hand is None else Handedness(options.hand),
        fps=options.checked_fps(),
        check_hand=not options.any_proportions,
        part=options.part,
        mirrored_labels=None if foreign.labels == "auto" else foreign.labels == "mirrored",
        hand_length_m=None if foreign.hand_length is None else 1e-3 * foreign.hand_length,
        bones=None if foreign.bones is None else _bones(foreign.bones),
        up=foreign.file_up,
    )
    return read_motion_file(path, wanted)


def _bones(path: Path) -> BoneMap:
    try:
        return bone_map(read_small_json(path))
    except ValueError as error:
        raise InputError(f"--bones {path}", wanted="names of bones by joint", came=str(error)) from error


def read_sequence(path: Path, options: FormatOptions) -> PoseSequence:
    """The motion of a file, as it is; what was recognized on the way is said. Raises InputError."""
    read = read_file(path, options)
    for note in read.notes:
        say(note)
    return read.sequence


def _from_names(names: str, options: FormatOptions, avatar: HandAvatar) -> PoseSequence:
    fps = options.checked_fps()
    motion = PoseMotionOptions(fps=DEFAULT_FPS if fps is None else fps)
    hand = Handedness(options.hand or Handedness.RIGHT)
    poses = pose_list(names)
    return pose_sequence_of_names(poses, avatar.rest_joints_m, handedness=hand, options=motion, fist=avatar.fist)
