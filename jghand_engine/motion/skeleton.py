"""The hands in a skeleton that moves: bones are found by name, joints are where bones begin, by forward kinematics.

A rig often ends at the last bone of a finger and says nothing of the tip. Then the tip is put where the bone leads:
along the axis on which all other bones of the hand lie in their own frames, where there is one (Blender's rigs: +y),
else straight on from the bone before it at rest; with the usual proportion of the last phalanx (TIP_RATIOS).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from jghand_engine.hand.joints import FINGERS, JOINT_COUNT
from jghand_engine.hand.orders import JointOrder
from jghand_engine.motion.bone_names import TIPS, BoneMap, NamedHand, hands_among
from jghand_engine.motion.content import HandTrack

# length of a finger's last bone, skin included, over that of the bone before it, thumb to little finger: lengths of
# phalanges and of the pulp of Buryanov and Kotiuk, Proportions of Hand Segments (2010)
TIP_RATIOS = (0.80, 0.88, 0.81, 0.83, 1.09)
# how far the bones of a hand may lie from one axis of their joints, degrees, for it to be the rig's bone axis
BONE_AXIS_MAX_DEG = 12.0
# frames whose bones are turned into joints at once: 60 bones of 4096 frames have 30 MB
FRAMES_AT_ONCE = 4096


@dataclass(frozen=True)
class Skeleton:
    """A skeleton of a file.

    names:       of its joints
    rest:        (N, 4, 4) world transforms at rest, unit of the file
    frame_count: of its animation
    world:       (joints, first, last) -> (last - first, len(joints), 4, 4) world transforms in frames first to last - 1
    ends:        for some joints the end of their bone in their own frame, where the file says it
    """

    names: Sequence[str]
    rest: np.ndarray
    frame_count: int
    world: Callable[[list[int], int, int], np.ndarray]
    ends: Mapping[int, np.ndarray] = field(default_factory=dict)


def hand_tracks(skeleton: Skeleton, part: str, bones: BoneMap | None = None) -> tuple[list[HandTrack], list[str]]:
    """The hands of a skeleton, which people call `part`, over all its frames; and sentences about hands that lack
    bones. [] when there are none. bones: a map made by hand."""
    hands, lacking = hands_among(skeleton.names, bones)
    tracks = []
    for hand in hands:
        tips, made = _tips(skeleton, hand)
        name = " ".join(word for word in (part, hand.part) if word)
        side = "hand" if hand.handedness is None else f"{hand.handedness} hand"
        notes = [f"Its {side} was recognized by bones named as {hand.convention} names them."] if bones is None else []
        if made:
            notes.append(
                f"The {side} has no tips of {', '.join(made)}: they were put where the last bones lead, with usual "
                "proportions."
            )
        joints = _joints(skeleton, hand, tips)
        tracks.append(HandTrack(joints, hand.handedness, JointOrder.STANDARD, name, notes=tuple(notes)))
    return tracks, lacking if hands else [" ".join([*lacking, "Name its bones with --bones."])]


def _joints(skeleton: Skeleton, hand: NamedHand, tips: dict[int, tuple[int, np.ndarray]]) -> np.ndarray:
    wanted = [tips[place][0] if bone is None else bone for place, bone in enumerate(hand.bones)]
    joints = np.empty((skeleton.frame_count, JOINT_COUNT, 3))
    for first in range(0, skeleton.frame_count, FRAMES_AT_ONCE):
        last = min(first + FRAMES_AT_ONCE, skeleton.frame_count)
        world = skeleton.world(wanted, first, last)
        joints[first:last] = world[..., :3, 3]
        for place, (_, offset) in tips.items():
            joints[first:last, place] += world[:, place, :3, :3] @ offset
    return joints


def _tips(skeleton: Skeleton, hand: NamedHand) -> tuple[dict[int, tuple[int, np.ndarray]], list[str]]:
    """For the tips that have no bone of their own, by their places, the last bone and where it ends in its own frame;
    and the fingers whose tips the file does not say."""
    tips, made = {}, []
    axis = _bone_axis(skeleton, hand)
    for finger, place in enumerate(TIPS):
        last, before = hand.bones[place - 1], hand.bones[place - 2]
        if hand.bones[place] is not None or last is None or before is None:
            continue
        end = skeleton.ends.get(last)
        if end is not None and np.linalg.norm(end) > 0:
            tips[place] = (last, end)
            continue
        made.append(FINGERS[finger])
        rest = skeleton.rest[last]
        bone = rest[:3, 3] - skeleton.rest[before][:3, 3]
        along = _in_frame(rest, bone) if axis is None else axis
        # scales of the rig are in `along` already, so that the length is that of the world
        world_length = np.linalg.norm(rest[:3, :3] @ along)
        tips[place] = (last, along * (TIP_RATIOS[finger] * np.linalg.norm(bone) / max(world_length, 1e-300)))
    return tips, made


def _bone_axis(skeleton: Skeleton, hand: NamedHand) -> np.ndarray | None:
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
    mean = np.sum(directions, axis=0)
    if len(directions) < 2 * len(FINGERS) or not np.linalg.norm(mean) > 0:
        return None
    mean /= np.linalg.norm(mean)
    return mean if (np.array(directions) @ mean).min() > np.cos(np.radians(BONE_AXIS_MAX_DEG)) else None


def _in_frame(frame: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A vector of the world in a joint's frame. ValueError for a frame that is flat."""
    if not abs(np.linalg.det(frame[:3, :3])) > 0:
        raise ValueError("a bone whose transform is flat")
    return np.linalg.solve(frame[:3, :3], vector)
