"""How other people name the bones of a hand, one table per convention, and the sets of such bones among names.

Names here are templates: `{side}` is right or left, `{s}` is r or l, `{finger}` the convention's word for a finger.
They are compared without regard to case and separators, after any prefix (`mixamorig:`, `DEF-`, `J_Bip_`), so that only
what tells conventions apart matters: the words, their order and the zeros of the numbers.

Sources
    rigify     `rigify/metarigs/human.py` of the Rigify that comes with Blender (hand.L, palm.01.L, f_index.01.L,
               thumb.01.L); its generator adds DEF-, ORG- and MCH-. Palm bones are not joints of ours.
    mixamo     skeletons that Mixamo downloads hold (mixamorig:RightHandThumb1 to 4, mixamorig9: and so on where several
               were loaded); the same words in HumanIK and in MPFB's `rigs/standard/rig.mixamo*.json`.
    vrm1, vrm0 vrm-c/vrm-specification, VRMC_vrm-1.0/humanoid.md (ThumbMetacarpal, ThumbProximal, ThumbDistal) and 0.0
               (ThumbProximal, ThumbIntermediate, ThumbDistal): **the same word names another bone**. The form
               `index_proximal.R` is what saturday06/VRM-Addon-for-Blender gives its own armature.
    vroid      the same add-on, `human_bone_mapper/vroid_mapping.py` (J_Bip_R_Index1, and symmetrised Index1_R).
    makehuman  MPFB's `rigs/standard/rig.default.json`, `human_bone_mapper/mpfb_mapping.py` (wrist.R, finger1-1.R for
               the thumb to finger5-3.R; metacarpal1.R to 4 are not joints of ours).
    unreal     Epic's mannequins (hand_r, thumb_01_r, index_01_r; UE5 adds index_metacarpal_r), MPFB's game engine rig.
    auto_rig_pro  remap presets of its users, e.g. thumb1.l, c_thumb2.l, c_thumb3.l, index1.l, c_index2.l: the first
               bone deforms and has a control c_index1.l beside it, the others are their own controls;
               c_index1_base.l is the metacarpal.
    mediapipe  the landmark names of MediaPipe Hands (WRIST, THUMB_CMC, INDEX_FINGER_MCP), as FreeMoCap's empties have
               them with right_hand_ before.
    jghand     hand/joints.py.

Standard library only: the extension for Blender imports this very file.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

FINGERS = ("thumb", "index", "middle", "ring", "pinky")
# what exporters and importers add to the last bone of a chain for its tip
TIP_ENDINGS = ("_end", "_tip", "_nub")
# places of the tips in the standard order, and of the joints that need a bone of their own
TIPS = (4, 8, 12, 16, 20)
NEEDED = tuple(place for place in range(21) if place not in TIPS)
_COPY = re.compile(r"[._]\d{3,}$")


@dataclass(frozen=True)
class Convention:
    """Templates of one way to name a hand.

    title:     what people are told
    wrist:     alternatives, the best first
    fingers:   its words, thumb first
    bones:     three tuples of alternatives, from the knuckle outwards
    thumb:     the same for a thumb that is named otherwise
    tips:      alternatives for a bone that begins at the finger's tip
    prefixes:  which of several sets of the same bones to take, the best first
    with_tips: names that only count with all five tips, because they mean other bones without
    """

    title: str
    wrist: tuple[str, ...]
    fingers: tuple[str, ...]
    bones: tuple[tuple[str, ...], ...]
    thumb: tuple[tuple[str, ...], ...] = ()
    tips: tuple[str, ...] = ()
    prefixes: tuple[str, ...] = ()
    with_tips: bool = False

    @property
    def says_side(self) -> bool:
        """Whether its names tell a right hand from a left one."""
        return any("{s" in template for template in self.wrist)

    def names(self, handedness: str) -> tuple[tuple[str, ...], ...]:
        """For each of the 21 joints, standard order, the names that a bone there may have, the best first."""
        result = [self._filled(self.wrist, "", handedness)]
        for finger, word in zip(FINGERS, self.fingers, strict=True):
            bones = self.thumb if finger == "thumb" and self.thumb else self.bones
            tips = tuple(last + ending for last in bones[-1] for ending in TIP_ENDINGS)
            result += [self._filled(alternatives, word, handedness) for alternatives in (*bones, (*self.tips, *tips))]
        return tuple(result)

    def _filled(self, templates: tuple[str, ...], finger: str, handedness: str) -> tuple[str, ...]:
        side = handedness.capitalize()
        return tuple(template.format(side=side, s=side[0], finger=finger) for template in templates)


ENGLISH = ("Thumb", "Index", "Middle", "Ring", "Pinky")
_LITTLE = ("Thumb", "Index", "Middle", "Ring", "Little")


def numbered(*templates: str, start: int = 1) -> tuple[tuple[str, ...], ...]:
    """Three tuples of alternatives from templates with a `#` for the bone's number."""
    numbers = range(start, start + 3)
    return tuple(tuple(template.replace("#", str(number)) for template in templates) for number in numbers)


def _phalanges(*words: str) -> tuple[tuple[str, ...], ...]:
    return tuple((f"{{side}}{{finger}}{word}", f"{{finger}}_{word}.{{s}}") for word in words)


# the order decides which name is shown where two conventions find the very same bones
CONVENTIONS = (
    Convention("JGHand", wrist=("wrist",), fingers=FINGERS, bones=numbered("{finger}#"), tips=("{finger}4",)),
    Convention(
        "Rigify",
        wrist=("hand.{s}",),
        fingers=("thumb", "f_index", "f_middle", "f_ring", "f_pinky"),
        bones=numbered("{finger}.0#.{s}"),
        prefixes=("def", "org", "", "mch"),
    ),
    Convention(
        "Mixamo",
        wrist=("{side}Hand",),
        fingers=ENGLISH,
        bones=numbered("{side}Hand{finger}#"),
        tips=("{side}Hand{finger}4",),
    ),
    Convention(
        "VRM 1",
        wrist=("{side}Hand", "hand.{s}"),
        fingers=_LITTLE,
        bones=_phalanges("Proximal", "Intermediate", "Distal"),
        thumb=_phalanges("Metacarpal", "Proximal", "Distal"),
    ),
    Convention(
        "VRM 0",
        wrist=("{side}Hand", "hand.{s}"),
        fingers=_LITTLE,
        bones=_phalanges("Proximal", "Intermediate", "Distal"),
    ),
    Convention(
        "VRoid", wrist=("{s}_Hand", "Hand_{s}"), fingers=_LITTLE, bones=numbered("{s}_{finger}#", "{finger}#_{s}")
    ),
    Convention(
        "MakeHuman, MPFB",
        wrist=("wrist.{s}",),
        fingers=("finger1", "finger2", "finger3", "finger4", "finger5"),
        bones=numbered("{finger}-#.{s}"),
    ),
    Convention(
        "Unreal mannequin",
        wrist=("hand_{s}",),
        fingers=FINGERS,
        bones=numbered("{finger}_0#_{s}"),
        tips=("{finger}_04_{s}",),
    ),
    Convention(
        "Auto-Rig Pro",
        wrist=("hand.{s}",),
        fingers=FINGERS,
        bones=(
            ("{finger}1.{s}", "c_{finger}1.{s}"),
            ("c_{finger}2.{s}", "{finger}2.{s}"),
            ("c_{finger}3.{s}", "{finger}3.{s}"),
        ),
        prefixes=("", "c"),
    ),
    Convention(
        "MediaPipe",
        wrist=("wrist",),
        fingers=FINGERS,
        bones=tuple((f"{{finger}}_finger_{joint}", f"{{finger}}_{joint}") for joint in ("mcp", "pip", "dip")),
        thumb=(("thumb_cmc",), ("thumb_mcp",), ("thumb_ip",)),
        tips=("{finger}_finger_tip", "{finger}_tip"),
    ),
)


@dataclass(frozen=True)
class NamedSet:
    """Bones of one convention that have a prefix and the suffix of a copy in common.

    bones: for each of the 21 joints, standard order, the names of the best alternative that is there: several where
           they differ in case and separators alone
    also:  prefixes of sets as good as this one, which the convention ranks below it
    """

    prefix: str
    suffix: str
    bones: tuple[tuple[str, ...], ...]
    also: tuple[str, ...] = ()

    @property
    def found(self) -> tuple[int, int]:
        """How many of wrist and finger bones there are, and how many tips."""
        needed, tips = (sum(bool(self.bones[place]) for place in places) for places in (NEEDED, TIPS))
        return needed, tips


# by the suffix of their copies (`.001`: another set of the same bones), names by what is compared of them
NameIndex = dict[str, dict[str, list[str]]]


def indexed(names: Iterable[str]) -> NameIndex:
    """Names as `sets_among` wants them."""
    index: NameIndex = {}
    for name in dict.fromkeys(names):
        copy = _COPY.search(name)
        suffix = copy.group() if copy and not name[: copy.start()].isdigit() else ""
        index.setdefault(suffix, {}).setdefault(_key(name[: len(name) - len(suffix)]), []).append(name)
    return index


def sets_among(index: NameIndex, convention: Convention, handedness: str) -> list[NamedSet]:
    """The sets that show any bone of a convention; of those that it ranks (DEF- before ORG-) the best that finds the
    most. Names without a side need the wrist among them: "index1" alone also ends the names of other conventions."""
    keys = [[_key(name) for name in names] for names in convention.names(handedness)]
    result = []
    for suffix, known in sorted(index.items()):
        prefixes = {
            name[: -len(key)] for place in NEEDED for key in keys[place] for name in known if name.endswith(key)
        }
        sets = {
            prefix: NamedSet(prefix, suffix, tuple(_best(names, known, prefix) for names in keys))
            for prefix in sorted(prefixes)
        }
        if not convention.says_side:
            sets = {prefix: one for prefix, one in sets.items() if one.bones[0]}
        if convention.with_tips:
            sets = {prefix: one for prefix, one in sets.items() if one.found[1] == len(TIPS)}
        ranked = [sets.pop(prefix) for prefix in convention.prefixes if prefix in sets]
        most = max((one.found for one in ranked), default=None)
        best = [one for one in ranked if one.found == most]
        result += [*sets.values(), *(replace(one, also=tuple(each.prefix for each in best[1:])) for one in best[:1])]
    return result


def _best(keys: list[str], known: dict[str, list[str]], prefix: str) -> tuple[str, ...]:
    return next((tuple(known[prefix + key]) for key in keys if prefix + key in known), ())


def _key(name: str) -> str:
    """A name without case and separators."""
    return "".join(letter for letter in name.casefold() if letter.isalnum())
