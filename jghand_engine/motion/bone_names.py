"""Which nodes of somebody else's skeleton, or which named points, are the 21 joints of a hand: found by name alone.

Names are compared without case and separators, and after any prefix (`mixamorig:`, `DEF-`, `J_Bip_`). Templates:
see `conventions`, which has those that the extension knows too. The others are here: joints of the WebXR Hand Input
Module and of OpenXR's XR_EXT_hand_tracking; names of the rigs of SMPL-X, Daz Genesis, 3ds Max Biped and SOMA; keypoints
of COCO-WholeBody, which RTMPose has. A joint is where a bone begins.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import FINGERS, STANDARD_NAMES, Handedness
from jghand_engine.motion import conventions
from jghand_engine.motion.conventions import ENGLISH, NEEDED, TIPS, Convention, NameIndex, indexed, numbered, sets_among

# bones of wrist and fingers, of 16, from which names count as a hand that lacks some
BONES_RECOGNIZED_MIN = 8


def _with_ext(*words: str) -> tuple[tuple[str, ...], ...]:
    return tuple((word, f"{word}_ext") for word in words)


CONVENTIONS = (
    *conventions.CONVENTIONS,
    Convention(
        "WebXR",
        wrist=("wrist",),
        fingers=FINGERS,
        bones=tuple((f"{{finger}}_finger_phalanx_{joint}",) for joint in ("proximal", "intermediate", "distal")),
        thumb=(("thumb_metacarpal",), ("thumb_phalanx_proximal",), ("thumb_phalanx_distal",)),
        tips=("{finger}_finger_tip", "{finger}_finger_phalanx_tip", "{finger}_tip"),
    ),
    Convention(
        "OpenXR",
        wrist=("wrist", "wrist_ext"),
        fingers=("thumb", "index", "middle", "ring", "little"),
        bones=_with_ext("{finger}_proximal", "{finger}_intermediate", "{finger}_distal"),
        thumb=_with_ext("thumb_metacarpal", "thumb_proximal", "thumb_distal"),
        tips=("{finger}_tip", "{finger}_tip_ext"),
    ),
    Convention(
        "SMPL-X",
        wrist=("{side}_wrist",),
        fingers=FINGERS,
        bones=numbered("{side}_{finger}#"),
        tips=("{side}_{finger}",),
    ),
    Convention(
        "Daz Genesis",
        wrist=("{s}Hand",),
        fingers=("Thumb", "Index", "Mid", "Ring", "Pinky"),
        bones=numbered("{s}{finger}#"),
    ),
    Convention(
        "3ds Max Biped",
        wrist=("{s} Hand",),
        fingers=("0", "1", "2", "3", "4"),
        bones=(("{s} Finger{finger}",), ("{s} Finger{finger}1",), ("{s} Finger{finger}2",)),
        tips=("{s} Finger{finger}Nub",),
    ),
    Convention(
        "RTMPose",
        wrist=("hand_root",),
        bones=numbered("{finger}#"),
        tips=("{finger}4",),
        fingers=("thumb", "forefinger", "middle_finger", "ring_finger", "pinky_finger"),
    ),
    # whose first finger bones are the metacarpals
    Convention(
        "SOMA",
        wrist=("{side}Hand",),
        fingers=ENGLISH,
        bones=numbered("{side}Hand{finger}#", start=2),
        thumb=numbered("{side}Hand{finger}#"),
        tips=("{side}Hand{finger}End",),
        with_tips=True,
    ),
)


@dataclass(frozen=True)
class NamedHand:
    """A hand among names.

    bones:      for each of the 21 joints, standard order, the place of its name, None for a tip that has none
    convention: the title of what was recognized
    part:       what tells it from others of the same side
    """

    handedness: Handedness | None
    bones: tuple[int | None, ...]
    convention: str
    part: str

    @property
    def found(self) -> tuple[int, int]:
        """How many of wrist and finger bones there are, and how many tips."""
        needed, tips = (sum(self.bones[place] is not None for place in places) for places in (NEEDED, TIPS))
        return needed, tips


@dataclass(frozen=True)
class BoneMap:
    """A map made by hand. bones: names by joint, for the 16 joints of wrist and fingers and any tips ·
    handedness: None where it does not say."""

    bones: Mapping[str, str]
    handedness: Handedness | None = None

    def hand_among(self, names: Sequence[str]) -> NamedHand | None:
        """The hand, None where no name is among `names`. InputError when only some are."""
        places = {name: place for place, name in enumerate(names)}
        bones = tuple(places.get(self.bones.get(joint, "")) for joint in STANDARD_NAMES)
        if not any(bone is not None for bone in bones):
            return None
        absent = [
            f"{self.bones.get(STANDARD_NAMES[place], 'no name')} ({STANDARD_NAMES[place]})"
            for place in NEEDED
            if bones[place] is None
        ]
        if absent:
            raise InputError("map of bones", wanted="names of bones of the file", came=", ".join(absent)[:300])
        return NamedHand(self.handedness, bones, "the map", "")


def bone_map(content: Any) -> BoneMap:
    """A map from JSON: {"wrist": "hand.R", …}, or as Blender's bone map writes it: {"handedness": "right", "joints":
    {"wrist": ["hand.R", "head"], "index4": ["f_index.03.R", "tail"], …}}, whose tails are tips without a bone.

    ValueError for anything else.
    """
    joints = content.get("joints", content) if isinstance(content, Mapping) else None
    if not isinstance(joints, Mapping) or not set(map(str, joints)) <= {*STANDARD_NAMES, "handedness"}:
        raise ValueError(f"names of bones by joint wanted: {', '.join(STANDARD_NAMES[:6])}, …")
    bones: dict[str, str] = {}
    for joint, bone in joints.items():
        name, end = bone if isinstance(bone, list) and len(bone) == 2 else (bone, "head")
        if joint != "handedness" and end == "head":
            bones[str(joint)] = str(name)
    side = content.get("handedness")
    return BoneMap(bones, None if side is None else Handedness(side))


def hands_among(names: Sequence[str], chosen: BoneMap | None = None) -> tuple[list[NamedHand], list[str]]:
    """The hands whose wrist and finger bones are all among `names`, the surest of each set of bones, and sentences
    about hands that lack some. chosen: the only one that counts."""
    if chosen is not None:
        hand = chosen.hand_among(names)
        return ([] if hand is None else [hand]), []
    index, places = indexed(names), {name: place for place, name in reversed([*enumerate(names)])}
    found: list[NamedHand] = []
    for convention in CONVENTIONS:
        for handedness in Handedness if convention.says_side else (None,):
            found += _of_convention(convention, handedness, index, places)
    whole, lacking = [], []
    for handedness in (*Handedness, None):
        of_side = [hand for hand in found if hand.handedness == handedness]
        best = max((hand.found for hand in of_side), default=(0, 0))
        if best[0] < BONES_RECOGNIZED_MIN:
            continue
        unique: dict[tuple[int | None, ...], NamedHand] = {}
        for hand in of_side:
            if hand.found == best:
                unique.setdefault(hand.bones, hand)
        for hand in unique.values():
            missing = [STANDARD_NAMES[place] for place in NEEDED if hand.bones[place] is None]
            if missing:
                side = "" if hand.handedness is None else f"{hand.handedness} "
                shown = ", ".join(missing[:6]) + (", …" if len(missing) > 6 else "")
                lacking.append(f"The {side}hand, whose bones look like {hand.convention}, lacks {shown}.")
            else:
                whole.append(hand)
    # a set without a side may be the very bones that another convention knows the side of
    sided = {hand.bones for hand in whole if hand.handedness is not None}
    return [hand for hand in whole if hand.handedness is not None or hand.bones not in sided], lacking


def side_of(text: str) -> Handedness | None:
    """The hand that a name speaks of as a word of its own: `right_hand`, `RightHand`, `hand_l`; None for neither or
    both."""
    words = set(re.findall(r"[a-z]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", text).casefold()))
    says_right, says_left = bool(words & {"right", "r", "rhand"}), bool(words & {"left", "l", "lhand"})
    if says_right == says_left:
        return None
    return Handedness.RIGHT if says_right else Handedness.LEFT


def _of_convention(
    convention: Convention, handedness: Handedness | None, index: NameIndex, places: Mapping[str, int]
) -> list[NamedHand]:
    hands = []
    for one in sets_among(index, convention, handedness or Handedness.RIGHT):
        side = handedness if handedness is not None else _side_of_prefix(one.prefix)
        part = " ".join(text for text in (convention.title, one.prefix, one.suffix) if text)
        bones = tuple(places[names[0]] if names else None for names in one.bones)
        hands.append(NamedHand(side, bones, convention.title, part))
    return hands


def _side_of_prefix(prefix: str) -> Handedness | None:
    """What stands, without separators, before a name that has no side itself: `righthand`, `r`, `xrhandjointleft`."""
    names = {side: side.value in prefix or prefix in (side.value[0], f"{side.value[0]}hand") for side in Handedness}
    chosen = [side for side, is_named in names.items() if is_named]
    return chosen[0] if len(chosen) == 1 else None
