"""Whether the pictures that an avatar is measured on were held out when it was learned: what it says of them itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.captures.captures import Capture
from jghand_engine.captures.picture_digest import picture_digest
from jghand_engine.captures.splits import Split

ALL_LEARNED = "all of these pictures were learned from"
NOT_KNOWN = "whether they were held out is not known"


@dataclass(frozen=True)
class HeldOut:
    """split: as it was for this avatar; its origin says what is not certain · warning: a sentence for the user, empty
    when the avatar was learned from split.train and nothing else of the capture."""

    split: Split
    warning: str = ""


def held_out(avatar: HandAvatar, capture: Capture, split: Split) -> HeldOut:
    """split: of the pictures of `capture`, as a training with the same choice of pictures would have it."""
    if avatar.learned is None:
        return HeldOut(split)
    told = avatar.info.learned_from
    if told is None:
        return _not_known(split, "The avatar does not say which pictures it was learned from")
    if told.digest == picture_digest(split.train):
        return HeldOut(split)
    if told.digest in (picture_digest(split.all_learned().train), picture_digest(capture.samples)):
        warning = f"The avatar was learned from all pictures of {capture.name}: its figures say nothing of new ones."
        return HeldOut(replace(split.all_learned(), origin=ALL_LEARNED), warning)
    came = f"{told.pictures} pictures of {told.capture} ({told.split})"
    return _not_known(split, f"The avatar was learned from {came}, which is another choice than the one here")


def _not_known(split: Split, why: str) -> HeldOut:
    warning = f"{why}: whether the pictures it is measured on were among them is not known."
    return HeldOut(replace(split, origin=f"{split.origin}; {NOT_KNOWN}"), warning)
