"""BVH: Biovision's hierarchy of joints with offsets, and a line of angles for every frame.

Conventions, which no standard fixes: angles are degrees and turn in the order of the CHANNELS, the first one outermost;
a joint with position channels takes them instead of its OFFSET, as in Blender, unless they are around zero where the
offset is not: then they are added. Nothing says unit or up axis; y is usually up. An End Site is the end of a bone.
The file is read line by line: it never stands in memory.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from jghand_engine import limits
from jghand_engine.motion.foreign.bone_names import BoneMap, hands_among
from jghand_engine.motion.foreign.clocks import whole_rate
from jghand_engine.motion.foreign.content import MotionContent
from jghand_engine.motion.foreign.skeleton import check_depth, down, hand_tracks
from jghand_engine.motion.foreign.text_lines import bounded_lines

KIND = "BVH"
_ROTATIONS = {"xrotation": 0, "yrotation": 1, "zrotation": 2}
_POSITIONS = {"xposition": 0, "yposition": 1, "zposition": 2}


@dataclass
class _Joint:
    """A joint of the header. channels: their names, the first one's column in a line of motion is `column`."""

    name: str
    parent: int
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
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
    with open(file, encoding="utf-8-sig", errors="replace") as stream:
        lines = bounded_lines(stream)
        header = _header(lines)
        # a number and the space behind it are two bytes
        if header.frames * max(header.columns, 1) * 2 > file.stat().st_size + 2:
            raise ValueError(f"{header.frames} frames of {header.columns} numbers, more than the file holds")
        hands, _ = hands_among([joint.name for joint in header.joints], bones)
        wanted = {bone for hand in hands for bone in hand.bones if bone is not None}
        kept = _ancestors(header, wanted)
        check_depth(kept, wanted)
        skeleton = _Bvh(header, kept)
        skeleton.read_motion(lines)
    tracks, lacking = hand_tracks(skeleton, "", bones)
    # frame times in text have six digits
    fps = whole_rate(1 / header.frame_time_s)
    if up is None:
        up, said = _up(skeleton)
        lacking = [*lacking, *said]
    return MotionContent(KIND, tuple(tracks), fps=fps, notes=(*skeleton.notes, *lacking), up=up)


def _up(skeleton: _Bvh) -> tuple[str, list[str]]:
    """The axis along which a body stands at rest: z where it is by far longer that way than along y, as Blender writes
    BVH, else y. A hand alone does not tell it: y, as nearly everybody writes it, and a sentence."""
    rest = skeleton.rest[:, :3, 3]
    _, along_y, along_z = np.ptp(rest, axis=0)
    has_body = any(word in name.casefold() for name in skeleton.names for word in ("spine", "hips", "pelvis", "head"))
    if not has_body:
        return "y", ["It does not say which axis points up: y is taken; --file-up says otherwise."]
    return ("z" if along_z > limits.BVH_Z_UP_MIN * along_y else "y"), []


class _Bvh:
    """A skeleton of BVH whose motion was read for the joints that matter."""

    def __init__(self, header: _Header, kept: list[int]) -> None:
        self._header, self._kept = header, kept
        self.names = tuple(joint.name for joint in header.joints)
        self.rest = self._rest()
        self.ends = header.ends
        self.notes: list[str] = []
        # columns of the kept joints, one after the other, and where each begins among them
        self._columns: list[int] = []
        self._first: dict[int, int] = {}
        for joint in kept:
            self._first[joint] = len(self._columns)
            one = header.joints[joint]
            self._columns += range(one.column, one.column + len(one.channels))
        self._numbers = np.zeros((0, len(self._columns)))

    @property
    def frame_count(self) -> int:
        return len(self._numbers)

    def _rest(self) -> np.ndarray:
        """Joints at rest are not turned."""
        rest = np.tile(np.eye(4), (len(self.names), 1, 1))
        for place, joint in enumerate(self._header.joints):
            above = rest[joint.parent, :3, 3] if joint.parent >= 0 else 0.0
            rest[place, :3, 3] = above + np.array(joint.offset)
        return rest

    def read_motion(self, lines: Iterator[str]) -> None:
        """All lines of motion. ValueError names the first that is none."""
        blocks = [block[:, self._columns] for block in _blocks(lines, self._header)]
        self._numbers = np.concatenate(blocks) if blocks else self._numbers
        if len(self._numbers) < self._header.frames:
            raise ValueError(f"{self._header.frames} frames said, {len(self._numbers)} there")
        self._added = {joint for joint in self._kept if self._positions_are_added(joint)}
        if self._added:
            shown = ", ".join(self.names[joint] for joint in sorted(self._added)[:3])
            self.notes.append(f"Positions of {shown}… are around zero: they were added to the offsets.")

    def world(self, joints: list[int], first: int, last: int) -> np.ndarray:
        """See AnimatedSkeleton."""
        result = np.zeros((last - first, len(joints), 4, 4))
        result[..., 3, 3] = 1.0
        parents = [self._header.joints[joint].parent for joint in self._kept]
        for joint, (turned, moved) in down(self._kept, parents, lambda joint: self._local(joint, first, last), _under):
            for column in (column for column, one in enumerate(joints) if one == joint):
                result[:, column, :3, :3], result[:, column, :3, 3] = turned, moved
        return result

    def _local(self, joint: int, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (F, 3, 3) and translations (F, 3) of a joint in its parent's frame."""
        one = self._header.joints[joint]
        numbers = self._numbers[first:last, self._first[joint] : self._first[joint] + len(one.channels)]
        turned = np.tile(np.eye(3), (last - first, 1, 1))
        moved = np.tile(np.array(one.offset), (last - first, 1))
        for place, channel in enumerate(one.channels):
            if channel in _ROTATIONS:
                turned = turned @ _turns(_ROTATIONS[channel], np.radians(numbers[:, place]))
            elif joint in self._added:
                moved[:, _POSITIONS[channel]] += numbers[:, place]
            else:
                moved[:, _POSITIONS[channel]] = numbers[:, place]
        return turned, moved

    def _positions_are_added(self, joint: int) -> bool:
        """Whether the positions of a joint that is no root are around zero, and its offset is not."""
        one = self._header.joints[joint]
        places = {
            _POSITIONS[name]: self._first[joint] + at for at, name in enumerate(one.channels) if name in _POSITIONS
        }
        if one.parent < 0 or not places:
            return False
        offset = np.array([one.offset[axis] for axis in places])
        middle = np.median(self._numbers[:, list(places.values())], axis=0)
        return bool(np.linalg.norm(middle) < limits.BVH_ADDED_MAX * np.linalg.norm(offset))


_Placed = tuple[np.ndarray, np.ndarray]


def _under(parent: _Placed, local: _Placed) -> _Placed:
    """Rotations (F, 3, 3) and positions (F, 3) in the parent's frame -> in the world."""
    (turned, moved), (turn, move) = parent, local
    return turned @ turn, moved + np.einsum("fij,fj->fi", turned, move)


def _turns(axis: int, angles_rad: np.ndarray) -> np.ndarray:
    """Rotations (F, 3, 3) about x, y or z."""
    cosine, sine = np.cos(angles_rad), np.sin(angles_rad)
    turns = np.zeros((len(angles_rad), 3, 3))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turns[:, axis, axis] = 1.0
    turns[:, a, a] = turns[:, b, b] = cosine
    turns[:, a, b], turns[:, b, a] = -sine, sine
    return turns


def _ancestors(header: _Header, joints: set[int]) -> list[int]:
    """The joints and all above them, parents first."""
    kept = set()
    for joint in joints:
        while joint >= 0 and joint not in kept:
            kept.add(joint)
            joint = header.joints[joint].parent
    return sorted(kept)


def _header(stream: Iterator[str]) -> _Header:
    """Everything before the first frame. ValueError."""
    header, path, opened = _Header(), [], -1
    in_end = False
    lines = islice(stream, limits.BVH_HEADER_LINES_MAX)
    first = next((words for line in lines if (words := line.split())), [])
    if [word.casefold() for word in first] != ["hierarchy"]:
        raise ValueError("it does not begin with HIERARCHY")
    # a brace may stand behind the name
    for words in (words for line in lines for words in _statements(line)):
        word = words[0].casefold()
        if word in ("root", "joint"):
            if len(words) < 2 or (word == "joint") != bool(path):
                raise ValueError(f"a {word.upper()} without a name, or in a wrong place")
            if len(header.joints) >= limits.RIG_PARTS_MAX:
                raise ValueError(f"more than {limits.RIG_PARTS_MAX} joints")
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
            _set_offset(header, words, path, in_end)
        elif word == "channels":
            _set_channels(header, words, path)
        elif word == "motion":
            if path or not header.joints:
                raise ValueError("MOTION before the end of the hierarchy")
            return _with_frames(header, lines)
        else:
            raise ValueError(f"an unknown word {words[0][:40]!r}")
    raise ValueError("no MOTION in it")


def _statements(line: str) -> Iterator[list[str]]:
    words: list[str] = []
    for word in line.replace("{", " { ").replace("}", " } ").split():
        if word in "{}":
            if words:
                yield words
            yield [word]
            words = []
        else:
            words.append(word)
    if words:
        yield words


def _set_offset(header: _Header, words: list[str], path: list[int], in_end: bool) -> None:
    x, y, z = (float(word) for word in words[1:4]) if len(words) == 4 else _refuse("an OFFSET without three numbers")
    if not path or not np.isfinite((x, y, z)).all():
        raise ValueError("an OFFSET outside of a joint, or one that is no number")
    if in_end:
        header.ends[path[-1]] = np.array([x, y, z])
    else:
        header.joints[path[-1]].offset = (x, y, z)


def _set_channels(header: _Header, words: list[str], path: list[int]) -> None:
    names = tuple(word.casefold() for word in words[2:])
    if not path or len(words) < 2 or int(words[1]) != len(names) or not set(names) <= {*_ROTATIONS, *_POSITIONS}:
        raise ValueError(f"CHANNELS that are none: {' '.join(words)[:80]}")
    joint = header.joints[path[-1]]
    joint.channels, joint.column = names, header.columns
    header.columns += len(names)


def _with_frames(header: _Header, lines: Iterator[str]) -> _Header:
    """Reads `Frames: n` and `Frame Time: seconds`."""
    for line in lines:
        words = line.replace(":", " : ").split()
        if not words:
            continue
        key = " ".join(words[: words.index(":")]).casefold() if ":" in words else ""
        value = words[-1]
        if key == "frames":
            header.frames = int(value)
        elif key == "frame time":
            header.frame_time_s = float(value)
            break
        else:
            raise ValueError(f"{line.strip()[:60]!r} where frames and their time were wanted")
    if not 1 <= header.frames <= limits.MOTION_FRAMES_MAX:
        raise ValueError(f"{header.frames} frames")
    if not 1 / limits.FPS_MAX <= header.frame_time_s <= 1 / limits.FPS_MIN:
        raise ValueError(f"a frame time of {header.frame_time_s:g} s")
    return header


def _blocks(stream: Iterator[str], header: _Header) -> Iterator[np.ndarray]:
    """Blocks of whole frames (n, columns). What stands behind the last frame is not looked at."""
    left = header.frames
    while left > 0 and (lines := list(islice(stream, limits.BVH_LINES_AT_ONCE))):
        lines = [line for line in lines if not line.isspace()][:left]
        if not lines:
            continue
        numbers = _numbers("".join(lines))
        if numbers.size != len(lines) * header.columns:
            for number, line in enumerate(lines, header.frames - left):
                if _numbers(line).size != header.columns:
                    raise ValueError(f"frame {number} has not the {header.columns} numbers of its channels")
        if not np.isfinite(numbers).all():
            raise ValueError("angles or positions that are no finite numbers")
        left -= len(lines)
        yield numbers.reshape(len(lines), header.columns)


def _numbers(text: str) -> np.ndarray:
    """The numbers in a text, none behind the first word that is no number."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (DeprecationWarning, ValueError) as error:
            raise ValueError("a line of motion with something that is no number") from error


def _refuse(sentence: str) -> tuple[float, float, float]:
    raise ValueError(sentence)
