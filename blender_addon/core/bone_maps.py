# SPDX-License-Identifier: GPL-3.0-or-later
"""Which bones of somebody else's rig are the 21 joints, found from their names alone.

A joint is the head of a bone; a finger's tip is the head of a tip bone or, where the rig has none, the tail of the last
bone. Nothing is guessed silently: what is missing is listed, and where several answers are possible they are told.
Order of the bones, and bones that are no part of a hand, play no role. Source: BLENDER 6; the names
and where they come from are in `conventions`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ..errors import JGHandFailure
from . import conventions
from .joints import FINGERS, HANDEDNESSES, NAMES, OTHER, TIPS

# so many of the 16 joints other than tips must have a bone before a convention counts as recognized: a wrist and one
# finger. Fewer are chance hits (a lone "wrist" empty)
RECOGNIZED_MIN = 4

HEAD, TAIL = "head", "tail"
ENDS = (HEAD, TAIL)


@dataclass(frozen=True)
class JointSource:
    """Where a joint is read: a bone's name (or an object's) and which end of it, "head" or "tail"."""

    bone: str
    end: str = HEAD


@dataclass(frozen=True)
class BoneMap:
    """21 sources in the standard order, None where there is none, with sentences about them.

    convention: the title of what was recognized, "" for a map made by hand · missing: one sentence for everything that
    has no bone or more than one · notes: what is worth knowing and no obstacle.
    """

    handedness: str
    sources: tuple[JointSource | None, ...]
    convention: str = ""
    missing: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        return all(source is not None for source in self.sources)

    def as_json(self) -> str:
        """For a property of the armature: {"handedness": …, "joints": {"wrist": ["hand.R", "head"], …}}."""
        joints = {
            name: [source.bone, source.end]
            for name, source in zip(NAMES, self.sources, strict=True)
            if source is not None
        }
        return json.dumps({"handedness": self.handedness, "joints": joints}, ensure_ascii=False)


@dataclass(frozen=True)
class Recognition:
    """What the names of a rig say about one hand.

    candidates: the possible maps, one when there is no doubt, none when nothing was recognized · sentences: what to
    tell, in the order to tell it.
    """

    handedness: str
    candidates: tuple[BoneMap, ...]
    sentences: tuple[str, ...]

    @property
    def bone_map(self) -> BoneMap | None:
        """The map when there is exactly one answer; it may miss joints. None when somebody has to choose."""
        return self.candidates[0] if len(self.candidates) == 1 else None


def recognize(names: Iterable[str], handedness: str, *, tails: bool = True) -> Recognition:
    """Looks for the 21 joints of one hand among bone names.

    tails: whether the tip of a finger may be the tail of its last bone; objects have no tail.
    """
    index = conventions.indexed(sorted(names))
    found = [
        _candidate(convention, bones, handedness, tails=tails)
        for convention in conventions.CONVENTIONS
        for bones in conventions.sets_among(index, convention, handedness)
        if convention.says_side or _may_be(bones.prefix, handedness)
    ]
    best = max((score for _, score in found), default=0)
    if best < RECOGNIZED_MIN:
        known = ", ".join(convention.title for convention in conventions.CONVENTIONS)
        return Recognition(
            handedness,
            (),
            (f"No bones of a {handedness} hand were recognized. Known names: {known}. Choose the bones by hand.",),
        )
    unique: dict[tuple[JointSource | None, ...], BoneMap] = {}
    for bone_map, score in found:
        if score == best:
            unique.setdefault(bone_map.sources, bone_map)
    maps = tuple(unique.values())
    if len(maps) == 1:
        only = maps[0]
        return Recognition(handedness, maps, (f"Recognized: {only.convention}.", *only.missing, *only.notes))
    return Recognition(handedness, maps, (_doubt(maps, handedness),))


def from_json(text: str) -> BoneMap:
    """The map that `as_json` wrote; JGHandFailure (bad_bone_map) for anything else."""
    try:
        content = json.loads(text)
        handedness, joints = content["handedness"], content["joints"]
        sources = {name: JointSource(str(bone), str(end)) for name, (bone, end) in joints.items()}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise JGHandFailure("bad_bone_map", f"not readable: {error}") from error
    if handedness not in HANDEDNESSES:
        raise JGHandFailure("bad_bone_map", f"handedness {handedness!r}, wanted {' or '.join(HANDEDNESSES)}")
    unknown = [name for name in sources if name not in NAMES]
    if unknown:
        raise JGHandFailure("bad_bone_map", f"no joints of a hand: {', '.join(unknown)}")
    wrong = [name for name, source in sources.items() if source.end not in ENDS]
    if wrong:
        raise JGHandFailure("bad_bone_map", f"neither head nor tail: {', '.join(wrong)}")
    return by_hand(handedness, [sources.get(name) for name in NAMES])


def by_hand(handedness: str, sources: Sequence[JointSource | None]) -> BoneMap:
    """A map from 21 sources, standard order."""
    missing = tuple(f"{name} has no bone." for name, source in zip(NAMES, sources, strict=True) if source is None)
    return BoneMap(handedness, tuple(sources), missing=missing)


def _candidate(
    convention: conventions.Convention, bones: conventions.NamedSet, handedness: str, *, tails: bool
) -> tuple[BoneMap, int]:
    """What a set of names means, and how many of the joints that count it has."""
    sources: list[JointSource | None] = []
    missing, from_tails, notes = [], [], []
    for place, (joint, names) in enumerate(zip(NAMES, bones.bones, strict=True)):
        source = JointSource(names[0]) if len(names) == 1 else None
        last = sources[place - 1] if place in TIPS else None
        if len(names) > 1:
            missing.append(f"{joint} may be {' or '.join(names)}: choose one.")
        elif source is None and place in TIPS and tails:
            source = JointSource(last.bone, TAIL) if last is not None else None
            if source is not None:
                from_tails.append(joint)
            else:
                missing.append(f"{joint} has no bone: neither a tip bone nor a last bone with a tail.")
        elif source is None:
            missing.append(f"{joint} has no bone: looked for {convention.names(handedness)[place][0]}.")
        sources.append(source)
    if from_tails:
        fingers = [finger for finger in FINGERS if f"{finger}4" in from_tails]
        notes.append(f"No tip bones: the tips of {', '.join(fingers)} are the tails of the last bones.")
    if bones.also:
        also = ", ".join(f"{prefix.upper()}-" if prefix else "plain" for prefix in bones.also)
        used = f"those with {bones.prefix.upper()}- are used"
        notes.append(f"The rig has these bones several times ({also} too): {used}.")
    bone_map = BoneMap(handedness, tuple(sources), convention.title, tuple(missing), tuple(notes))
    return bone_map, sum(sources[place] is not None for place in conventions.NEEDED)


def _may_be(prefix: str, handedness: str) -> bool:
    """Whether what stands before a name without a side does not say that it is the other hand."""
    other = OTHER[handedness]
    return other not in prefix and prefix != other[0]


def _doubt(maps: tuple[BoneMap, ...], handedness: str) -> str:
    shown = []
    for bone_map in maps:
        first = next(source.bone for source in bone_map.sources if source is not None)
        shown.append(f"{bone_map.convention} ({first})")
    differing = [name for place, name in enumerate(NAMES) if len({bone_map.sources[place] for bone_map in maps}) > 1]
    return (
        f"Several sets of bones may be the {handedness} hand: {'; '.join(shown)}. "
        f"They differ in {', '.join(differing)}."
    )
