"""BVH: Biovision's hierarchy of joints with offsets, and a line of angles for every frame.

Conventions, which no standard fixes: angles are degrees and turn in the order of the CHANNELS, the first one outermost;
a joint with position channels takes them instead of its OFFSET, as in Blender, unless they are around zero where the
offset is not: then they are added. Nothing says unit or up axis; y is usually up. An End Site is the end of a bone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from jghand_engine.hand.rotations import axis_rotation
from jghand_engine.hand.sequence import FPS_MAX, FPS_MIN, MOTION_FRAMES_MAX
from jghand_engine.motion.bone_names import hands_among
from jghand_engine.motion.clocks import whole_rate
from jghand_engine.motion.content import MotionContent, MotionFormat, Reader, Source, check_size
from jghand_engine.motion.skeleton import Skeleton, hand_tracks

# positions of a joint smaller than this part of its offset are moves from there, not its place
_ADDED_MAX = 0.25
# a body that is so much longer along z than along y stands along z
_Z_UP_MIN = 2.0
# lines of motion that are turned into numbers at once
_LINES_AT_ONCE = 64
_ROTATIONS = {"xrotation": 0, "yrotation": 1, "zrotation": 2}
_POSITIONS = {"xposition": 0, "yposition": 1, "zposition": 2}


@dataclass
class _Joint:
    """A joint of the header.

    parent:   its place, -1 for none; parents come first
    channels: their names
    columns:  of a line of motion, one for each channel
    end:      where its bone ends, in its own frame
    numbers:  (F, channels) the motion
    added:    whether its positions are added to the offset
    """

    name: str
    parent: int
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    channels: tuple[str, ...] = ()
    columns: range = range(0)
    end: np.ndarray | None = None
    numbers: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    added: bool = False


def _recognizes(source: Source) -> bool:
    return source.head[:9].upper() == b"HIERARCHY"


def _read(source: Source, wanted: MotionFormat) -> MotionContent:
    check_size(source.path, text=True)
    with open(source.path, encoding="utf-8-sig", errors="replace") as lines:
        joints = _joints(lines)
        frames, frame_time_s = _frames_and_time(lines)
        names = [joint.name for joint in joints]
        found, _ = hands_among(names, wanted.bones)
        moving = sorted(
            {place for hand in found for bone in hand.bones if bone is not None for place in _path(joints, bone)}
        )
        _read_motion(lines, frames, joints, [joints[place] for place in moving])
    rest = np.tile(np.eye(4), (len(joints), 1, 1))
    for place, joint in enumerate(joints):
        rest[place, :3, 3] = joint.offset + (rest[joint.parent, :3, 3] if joint.parent >= 0 else 0.0)

    def world(bones: list[int], first: int, last: int) -> np.ndarray:
        placed: dict[int, np.ndarray] = {}
        for place in moving:
            local, parent = _local(joints[place], first, last), joints[place].parent
            placed[place] = placed[parent] @ local if parent >= 0 else local
        return np.stack([placed[bone] for bone in bones], axis=1)

    ends = {place: joint.end for place, joint in enumerate(joints) if joint.end is not None}
    tracks, notes = hand_tracks(Skeleton(names, rest, frames, world, ends), "", wanted.bones)
    added = [joint.name for joint in joints if joint.added]
    if added:
        notes.append(f"Positions of {', '.join(added[:3])}… are around zero: they were added to the offsets.")
    up, guess = (wanted.up, []) if wanted.up is not None else _up(names, rest)
    # frame times in text have six digits
    fps = whole_rate(1 / frame_time_s)
    # the last note stands in the refusal of a file without a hand
    return MotionContent("BVH", tuple(tracks), fps=fps, notes=(*guess, *notes), up=up)


def _up(names: list[str], rest: np.ndarray) -> tuple[str, list[str]]:
    """The axis along which a body stands at rest: z where it is by far longer that way than along y, as Blender writes
    BVH, else y. A hand alone does not tell it: y, as nearly everybody writes it, and a sentence."""
    _, along_y, along_z = np.ptp(rest[:, :3, 3], axis=0)
    has_body = any(word in name.casefold() for name in names for word in ("spine", "hips", "pelvis", "head"))
    if not has_body:
        return "y", ["It does not say which axis points up: y is taken; jghand motion --file-up sets another."]
    return ("z" if along_z > _Z_UP_MIN * along_y else "y"), []


def _path(joints: list[_Joint], place: int) -> Iterator[int]:
    while place >= 0:
        yield place
        place = joints[place].parent


def _local(joint: _Joint, first: int, last: int) -> np.ndarray:
    """Transforms (F, 4, 4) in the parent's frame."""
    result = np.tile(np.eye(4), (last - first, 1, 1))
    result[:, :3, 3] = joint.offset
    for channel, numbers in zip(joint.channels, joint.numbers[first:last].T, strict=True):
        if channel in _ROTATIONS:
            turns = axis_rotation(np.eye(3)[_ROTATIONS[channel]], np.radians(numbers))
            result[:, :3, :3] = result[:, :3, :3] @ turns
        else:
            axis = _POSITIONS[channel]
            result[:, axis, 3] = numbers + (joint.offset[axis] if joint.added else 0.0)
    return result


# ---- text ------------------------------------------------------------------------------------------------------------


def _joints(lines: Iterator[str]) -> list[_Joint]:
    joints: list[_Joint] = []
    path: list[int] = []
    opened, columns, in_end = -1, 0, False
    next((line for line in lines if line.strip()), "")
    for words in (words for line in lines for words in _statements(line)):
        word = words[0].casefold()
        if word in ("root", "joint"):
            if len(words) < 2 or (word == "joint") != bool(path):
                raise ValueError(f"a {word.upper()} without a name, or in a wrong place")
            joints.append(_Joint("_".join(words[1:]), path[-1] if path else -1))
            opened = len(joints) - 1
        elif word == "end":
            in_end, opened = True, path[-1] if path else -1
        elif word == "{":
            path.append(opened)
        elif word == "}":
            if not path:
                raise ValueError("a closing brace too many")
            path.pop()
            in_end = False
        elif word == "offset":
            offset = np.array(words[1:], dtype=np.float64)
            if len(offset) != 3 or not path or not np.isfinite(offset).all():
                raise ValueError("an OFFSET outside of a joint, or one that is not three numbers")
            setattr(joints[path[-1]], "end" if in_end else "offset", offset)
        elif word == "channels":
            names = tuple(name.casefold() for name in words[2:])
            if not path or words[1:2] != [str(len(names))] or not set(names) <= {*_ROTATIONS, *_POSITIONS}:
                raise ValueError(f"CHANNELS that are none: {' '.join(words)[:80]}")
            joints[path[-1]].channels, joints[path[-1]].columns = names, range(columns, columns + len(names))
            columns += len(names)
        elif word == "motion":
            if path or not joints:
                raise ValueError("MOTION before the end of the hierarchy")
            return joints
        else:
            raise ValueError(f"an unknown word {words[0][:40]!r}")
    raise ValueError("no MOTION in it")


def _statements(line: str) -> Iterator[list[str]]:
    """The words of a line, and its braces alone: one may stand behind a name."""
    words = line.replace("{", "\n{\n").replace("}", "\n}\n").split("\n")
    return (statement for part in words if (statement := part.split()))


def _frames_and_time(lines: Iterator[str]) -> tuple[int, float]:
    entries = (line.partition(":") for line in lines if line.strip())
    numbers = {" ".join(name.split()).casefold(): number for name, _, number in islice(entries, 2)}
    if set(numbers) != {"frames", "frame time"}:
        raise ValueError(f"{', '.join(numbers)[:60]!r} where frames and their time were wanted")
    frames, frame_time_s = int(numbers["frames"]), float(numbers["frame time"])
    if not 1 <= frames <= MOTION_FRAMES_MAX:
        raise ValueError(f"{frames} frames")
    if not 1 / FPS_MAX <= frame_time_s <= 1 / FPS_MIN:
        raise ValueError(f"a frame time of {frame_time_s:g} s")
    return frames, frame_time_s


def _read_motion(lines: Iterator[str], frames: int, joints: list[_Joint], moving: list[_Joint]) -> None:
    """Gives the joints that matter their numbers. What stands behind the last frame is not looked at."""
    columns, width = [column for joint in moving for column in joint.columns], sum(len(one.channels) for one in joints)
    rows = (line.split() for line in lines if not line.isspace())
    blocks = []
    for first in range(0, frames, _LINES_AT_ONCE):
        some = list(islice(rows, min(_LINES_AT_ONCE, frames - first)))
        wrong = next((first + place for place, row in enumerate(some) if len(row) != width), None)
        if wrong is not None:
            raise ValueError(f"frame {wrong} has not the {width} numbers of its channels")
        if len(some) < min(_LINES_AT_ONCE, frames - first):
            raise ValueError(f"{frames} frames declared, {first + len(some)} there")
        block = np.array(some, dtype=np.float64)
        if not np.isfinite(block).all():
            raise ValueError("angles or positions that are no finite numbers")
        blocks.append(block[:, columns])
    table, first = np.concatenate(blocks), 0
    for joint in moving:
        joint.numbers = table[:, first : first + len(joint.columns)]
        joint.added = _positions_are_added(joint)
        first += len(joint.columns)


def _positions_are_added(joint: _Joint) -> bool:
    """Whether the positions of a joint that is no root are around zero, and its offset is not."""
    places = {at: _POSITIONS[name] for at, name in enumerate(joint.channels) if name in _POSITIONS}
    if joint.parent < 0 or not places:
        return False
    middle = np.median(joint.numbers[:, list(places)], axis=0)
    return bool(np.linalg.norm(middle) < _ADDED_MAX * np.linalg.norm(joint.offset[list(places.values())]))


READER = Reader((".bvh",), _recognizes, _read)
