"""The hands in a skeleton that moves: bones are found by name, joints are where bones begin, by forward kinematics.

A rig often ends at the last bone of a finger and says nothing of the tip. Then the tip is put where the bone leads:
along the axis on which all other bones of the hand lie in their own frames, where there is one (Blender's rigs: +y),
else straight on from the bone before it at rest; with the usual proportion of the last phalanx (TIP_RATIOS).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from jghand_engine import limits
from jghand_engine.hand.joints import FINGERS, JOINT_COUNT
from jghand_engine.hand.orders import JointOrder
from jghand_engine.motion.foreign.bone_names import TIPS, BoneMap, NamedHand, hands_among
from jghand_engine.motion.foreign.content import HandTrack
from jghand_engine.motion.foreign.damage import NoMotionError

_Place = TypeVar("_Place")


class AnimatedSkeleton(Protocol):
    """A skeleton of a file. names: of its joints · rest: (N, 4, 4) world transforms at rest, unit of the file ·
    ends: for some joints the end of their bone in their own frame, where the file says it."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def rest(self) -> np.ndarray: ...
    @property
    def ends(self) -> dict[int, np.ndarray]: ...
    @property
    def frame_count(self) -> int: ...

    def world(self, joints: list[int], first: int, last: int) -> np.ndarray:
        """(last - first, len(joints), 4, 4) world transforms of some joints in frames first to last - 1."""
        ...


@dataclass(frozen=True)
class _Tip:
    """A joint's end in its own frame, and whether it was made up."""

    bone: int
    offset: np.ndarray


def hand_tracks(
    skeleton: AnimatedSkeleton, part: str, bones: BoneMap | None = None
) -> tuple[list[HandTrack], list[str]]:
    """The hands of a skeleton, which people call `part`, over all its frames; and sentences about hands that lack
    bones. [] when there are none. bones: a map made by hand."""
    hands, lacking = hands_among(skeleton.names, bones)
    tracks = []
    for hand in hands:
        tips, made = _tips(skeleton, hand)
        joints = _joints(skeleton, hand, tips)
        name = " ".join(word for word in (part, hand.part) if word)
        side = "hand" if hand.handedness is None else f"{hand.handedness} hand"
        notes = [f"Its {side} was recognized by bones named as {hand.convention} names them."] if bones is None else []
        if made:
            notes.append(
                f"The {side} has no tips of {', '.join(made)}: they were put where the last bones lead, with usual "
                "proportions."
            )
        tracks.append(HandTrack(joints, hand.handedness, JointOrder.STANDARD, name, notes=tuple(notes)))
    return tracks, lacking


def check_depth(kept: Sequence[int], hands: set[int]) -> None:
    """NoMotionError where hands hang on more bones than any rig has. kept: their bones and all above."""
    if len(kept) - len(hands) > limits.RIG_DEPTH_MAX:
        raise NoMotionError(f"its hands hang on {len(kept) - len(hands)} bones, more than {limits.RIG_DEPTH_MAX}")


def down(
    bones: Sequence[int],
    parents: Sequence[int],
    local: Callable[[int], _Place],
    under: Callable[[_Place, _Place], _Place],
) -> Iterator[tuple[int, _Place]]:
    """Every bone and its place in the world, parents first, as `bones` lists them. A place is given up after its last
    child, so that a long chain of bones does not fill the memory.

    local: the place of a bone in its parent's frame · under: a place of the parent's frame in the world
    """
    last_child = dict(zip(parents, bones, strict=True))
    worlds: dict[int, _Place] = {}
    for bone, parent in zip(bones, parents, strict=True):
        world = local(bone) if parent < 0 else under(worlds[parent], local(bone))
        if last_child.get(parent) == bone:
            worlds.pop(parent, None)
        if bone in last_child:
            worlds[bone] = world
        yield bone, world


def _joints(skeleton: AnimatedSkeleton, hand: NamedHand, tips: dict[int, _Tip]) -> np.ndarray:
    """(F, 21, 3) joints in the standard order."""
    wanted = [tips[place].bone if bone is None else bone for place, bone in enumerate(hand.bones)]
    joints = np.empty((skeleton.frame_count, JOINT_COUNT, 3))
    for first in range(0, skeleton.frame_count, limits.SKELETON_FRAMES_AT_ONCE):
        last = min(first + limits.SKELETON_FRAMES_AT_ONCE, skeleton.frame_count)
        world = skeleton.world(wanted, first, last)
        joints[first:last] = world[..., :3, 3]
        for place, tip in tips.items():
            joints[first:last, place] += world[:, place, :3, :3] @ tip.offset
    return joints


def _tips(skeleton: AnimatedSkeleton, hand: NamedHand) -> tuple[dict[int, _Tip], list[str]]:
    """The tips that have no bone of their own, by their places, and the fingers whose tips the file does not say."""
    tips, made = {}, []
    axis = _bone_axis(skeleton, hand)
    for finger, place in enumerate(TIPS):
        last, before = hand.bones[place - 1], hand.bones[place - 2]
        if hand.bones[place] is not None or last is None or before is None:
            continue
        end = skeleton.ends.get(last)
        if end is not None and np.linalg.norm(end) > 0:
            tips[place] = _Tip(last, end)
            continue
        made.append(FINGERS[finger])
        rest = skeleton.rest[last]
        bone = rest[:3, 3] - skeleton.rest[before][:3, 3]
        along = _in_frame(rest, bone) if axis is None else axis
        # scales of the rig are in `along` already, so that the length is that of the world
        world_length = np.linalg.norm(rest[:3, :3] @ along)
        offset = along * (limits.TIP_RATIOS[finger] * np.linalg.norm(bone) / max(world_length, 1e-300))
        tips[place] = _Tip(last, offset)
    return tips, made


def _bone_axis(skeleton: AnimatedSkeleton, hand: NamedHand) -> np.ndarray | None:
    """The direction in their own frames in which the bones of the hand lie, None when they lie in different ones."""
    directions = []
    for place in range(1, JOINT_COUNT):
        bone, following = hand.bones[place], hand.bones[place + 1] if place not in TIPS else None
        if bone is None or following is None:
            continue
        frame = skeleton.rest[bone]
        inside = _in_frame(frame, skeleton.rest[following][:3, 3] - frame[:3, 3])
        size = np.linalg.norm(inside)
        if size > 0:
            directions.append(inside / size)
    if len(directions) < 2 * len(FINGERS):
        return None
    mean = np.mean(directions, axis=0)
    if not np.linalg.norm(mean) > 0:
        return None
    mean /= np.linalg.norm(mean)
    return mean if (np.array(directions) @ mean).min() > np.cos(np.radians(limits.BONE_AXIS_MAX_DEG)) else None


def _in_frame(frame: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A vector of the world in a joint's frame. ValueError for a frame that is flat."""
    linear = frame[:3, :3]
    if not abs(np.linalg.det(linear)) > 0:
        raise ValueError("a bone whose transform is flat")
    return np.linalg.solve(linear, vector)
