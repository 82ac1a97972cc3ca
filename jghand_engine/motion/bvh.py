"""BVH: Biovision's hierarchy of joints with offsets, and a line of angles for every frame.

Conventions, which no standard fixes: angles are degrees and turn in the order of the CHANNELS, the first one outermost;
a joint with position channels takes them instead of its OFFSET, as in Blender, unless they are around zero where the
offset is not: then they are added. Nothing says unit or up axis; y is usually up. An End Site is the end of a bone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from jghand_engine.hand.sequence import FPS_MAX, FPS_MIN, MOTION_FRAMES_MAX
from jghand_engine.motion.bone_names import BoneMap, hands_among
from jghand_engine.motion.clocks import whole_rate
from jghand_engine.motion.content import MotionContent, check_size
from jghand_engine.motion.skeleton import hand_tracks, in_world, with_ancestors

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
    """A joint of the header. channels: their names, the first one's column in a line of motion is `column`."""

    name: str
    parent: int
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    channels: tuple[str, ...] = ()
    column: int = 0


@dataclass
class _Header:
    joints: list[_Joint] = field(default_factory=list)
    ends: dict[int, np.ndarray] = field(default_factory=dict)
    columns: int = 0
    frames: int = 0
    frame_time_s: float = 0.0


def read(file: Path, bones: BoneMap | None = None, up: str | None = None) -> MotionContent:
    """The hands of a BVH file, found by a map where there is one. up: the axis that points up, where it is known.
    ValueError says what is wrong."""
    check_size(file, text=True)
    with open(file, encoding="utf-8-sig", errors="replace") as lines:
        header = _header(lines)
        # a number and the space behind it are two bytes
        if header.frames * max(header.columns, 1) * 2 > file.stat().st_size + 2:
            raise ValueError(f"{header.frames} frames of {header.columns} numbers, more than the file holds")
        skeleton = _Bvh(header, lines, bones)
    tracks, lacking = hand_tracks(skeleton, "", bones)
    # frame times in text have six digits
    fps = whole_rate(1 / header.frame_time_s)
    if up is None:
        up, said = _up(skeleton)
        lacking = [*lacking, *said]
    notes = (*skeleton.notes, *lacking)
    return MotionContent("BVH", tuple(tracks), fps=fps, notes=notes, up=up, is_skeleton=True)


def _up(skeleton: _Bvh) -> tuple[str, list[str]]:
    """The axis along which a body stands at rest: z where it is by far longer that way than along y, as Blender writes
    BVH, else y. A hand alone does not tell it: y, as nearly everybody writes it, and a sentence."""
    _, along_y, along_z = np.ptp(skeleton.rest[:, :3, 3], axis=0)
    has_body = any(word in name.casefold() for name in skeleton.names for word in ("spine", "hips", "pelvis", "head"))
    if not has_body:
        return "y", ["It does not say which axis points up: y is taken; --file-up says otherwise."]
    return ("z" if along_z > _Z_UP_MIN * along_y else "y"), []


class _Bvh:
    """A skeleton of BVH whose motion is read for the joints that matter: the hands' and those above."""

    def __init__(self, header: _Header, lines: Iterator[str], bones: BoneMap | None) -> None:
        self._joints, self.ends = header.joints, header.ends
        self.names = tuple(joint.name for joint in header.joints)
        self._parents = [joint.parent for joint in header.joints]
        self.rest = np.tile(np.eye(4), (len(self.names), 1, 1))
        for place, joint in enumerate(header.joints):
            above = self.rest[joint.parent, :3, 3] if joint.parent >= 0 else 0.0
            self.rest[place, :3, 3] = above + np.array(joint.offset)
        wanted = {bone for hand in hands_among(self.names, bones)[0] for bone in hand.bones if bone is not None}
        self._kept = with_ancestors(wanted, self._parents)
        columns = [header.joints[joint].column + at for joint in self._kept for at in range(self._channels(joint))]
        self._numbers = np.concatenate([block[:, columns] for block in _blocks(lines, header)])
        # where the columns of a joint begin among those that were kept
        counts = [self._channels(joint) for joint in self._kept]
        self._first = dict(zip(self._kept, np.cumsum([0, *counts]).tolist(), strict=False))
        self._added = {joint for joint in self._kept if self._positions_are_added(joint)}
        shown = ", ".join(self.names[joint] for joint in sorted(self._added)[:3])
        self.notes = [f"Positions of {shown}… are around zero: they were added to the offsets."] if shown else []

    @property
    def frame_count(self) -> int:
        return len(self._numbers)

    def world(self, joints: list[int], first: int, last: int) -> np.ndarray:
        """See AnimatedSkeleton."""
        world = in_world(self._kept, self._parents, lambda joint: self._local(joint, first, last))
        return np.stack([world[joint] for joint in joints], axis=1)

    def _channels(self, joint: int) -> int:
        return len(self._joints[joint].channels)

    def _local(self, joint: int, first: int, last: int) -> np.ndarray:
        """Transforms (F, 4, 4) of a joint in its parent's frame."""
        one = self._joints[joint]
        result = np.tile(np.eye(4), (last - first, 1, 1))
        result[:, :3, 3] = one.offset
        for place, channel in enumerate(one.channels, self._first[joint]):
            numbers = self._numbers[first:last, place]
            if channel in _ROTATIONS:
                result[:, :3, :3] = result[:, :3, :3] @ _turns(_ROTATIONS[channel], np.radians(numbers))
            else:
                added = one.offset[_POSITIONS[channel]] if joint in self._added else 0.0
                result[:, _POSITIONS[channel], 3] = added + numbers
        return result

    def _positions_are_added(self, joint: int) -> bool:
        """Whether the positions of a joint that is no root are around zero, and its offset is not."""
        one = self._joints[joint]
        places = {
            at: _POSITIONS[name] for at, name in enumerate(one.channels, self._first[joint]) if name in _POSITIONS
        }
        if one.parent < 0 or not places:
            return False
        offset = np.array([one.offset[axis] for axis in places.values()])
        middle = np.median(self._numbers[:, list(places)], axis=0)
        return bool(np.linalg.norm(middle) < _ADDED_MAX * np.linalg.norm(offset))


def _turns(axis: int, angles_rad: np.ndarray) -> np.ndarray:
    """Rotations (F, 3, 3) about x, y or z."""
    cosine, sine = np.cos(angles_rad), np.sin(angles_rad)
    turns = np.zeros((len(angles_rad), 3, 3))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turns[:, axis, axis] = 1.0
    turns[:, a, a] = turns[:, b, b] = cosine
    turns[:, a, b], turns[:, b, a] = -sine, sine
    return turns


def _header(lines: Iterator[str]) -> _Header:
    """Everything before the first frame. ValueError."""
    header, path, opened, in_end = _Header(), [], -1, False
    first = next((words for line in lines if (words := line.split())), [])
    if [word.casefold() for word in first] != ["hierarchy"]:
        raise ValueError("it does not begin with HIERARCHY")
    for words in (words for line in lines for words in _statements(line)):
        word = words[0].casefold()
        if word in ("root", "joint"):
            if len(words) < 2 or (word == "joint") != bool(path):
                raise ValueError(f"a {word.upper()} without a name, or in a wrong place")
            header.joints.append(_Joint("_".join(words[1:]), path[-1] if path else -1))
            opened = len(header.joints) - 1
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
            offset = tuple(float(number) for number in words[1:])
            if len(offset) != 3 or not path or not np.isfinite(offset).all():
                raise ValueError("an OFFSET outside of a joint, or one that is not three numbers")
            if in_end:
                header.ends[path[-1]] = np.array(offset)
            else:
                header.joints[path[-1]].offset = offset
        elif word == "channels":
            names = tuple(name.casefold() for name in words[2:])
            if not path or words[1:2] != [str(len(names))] or not set(names) <= {*_ROTATIONS, *_POSITIONS}:
                raise ValueError(f"CHANNELS that are none: {' '.join(words)[:80]}")
            header.joints[path[-1]].channels, header.joints[path[-1]].column = names, header.columns
            header.columns += len(names)
        elif word == "motion":
            if path or not header.joints:
                raise ValueError("MOTION before the end of the hierarchy")
            return _with_frames(header, lines)
        else:
            raise ValueError(f"an unknown word {words[0][:40]!r}")
    raise ValueError("no MOTION in it")


def _statements(line: str) -> Iterator[list[str]]:
    """The words of a line, and its braces alone: one may stand behind a name."""
    words = line.replace("{", "\n{\n").replace("}", "\n}\n").split("\n")
    return (statement for part in words if (statement := part.split()))


def _with_frames(header: _Header, lines: Iterator[str]) -> _Header:
    """Reads `Frames: n` and `Frame Time: seconds`."""
    for line in lines:
        key, _, value = line.partition(":")
        if not line.strip():
            continue
        if key.strip().casefold() == "frames":
            header.frames = int(value)
        elif " ".join(key.split()).casefold() == "frame time":
            header.frame_time_s = float(value)
            break
        else:
            raise ValueError(f"{line.strip()[:60]!r} where frames and their time were wanted")
    if not 1 <= header.frames <= MOTION_FRAMES_MAX:
        raise ValueError(f"{header.frames} frames")
    if not 1 / FPS_MAX <= header.frame_time_s <= 1 / FPS_MIN:
        raise ValueError(f"a frame time of {header.frame_time_s:g} s")
    return header


def _blocks(lines: Iterator[str], header: _Header) -> Iterator[np.ndarray]:
    """Blocks of whole frames (n, columns). What stands behind the last frame is not looked at. ValueError."""
    rows = (line for line in lines if not line.isspace())
    for first in range(0, header.frames, _LINES_AT_ONCE):
        some = list(islice(rows, min(_LINES_AT_ONCE, header.frames - first)))
        if not some:
            raise ValueError(f"{header.frames} frames said, {first} there")
        numbers = [line.split() for line in some]
        wrong = next((first + place for place, row in enumerate(numbers) if len(row) != header.columns), None)
        if wrong is not None:
            raise ValueError(f"frame {wrong} has not the {header.columns} numbers of its channels")
        try:
            block = np.array(numbers, dtype=np.float64)
        except ValueError as error:
            raise ValueError("a line of motion with something that is no number") from error
        if not np.isfinite(block).all():
            raise ValueError("angles or positions that are no finite numbers")
        if len(some) < min(_LINES_AT_ONCE, header.frames - first):
            raise ValueError(f"{header.frames} frames said, {first + len(some)} there")
        yield block
