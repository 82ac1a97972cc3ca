"""What every layer of a stage says about where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jghand_engine import __version__
from jghand_engine.avatar.avatar import AvatarInfo

CREATOR = "JGHand"


def provenance(info: AvatarInfo, stamp: Mapping[str, str]) -> dict[str, Any]:
    """customLayerData of every layer: who wrote it, of what, under which license. stamp: what it was made from."""
    learned_from = info.learned_from
    about = {**stamp, "avatar": info.name, "template": info.template, "licence": info.license}
    if learned_from is not None:
        about |= {
            "learnt_from": learned_from.capture,
            "learned_from_pictures": learned_from.pictures,
            "learned_from_digest": learned_from.digest,
        }
    return {"creator": f"{CREATOR} {__version__}", "jghand": about}
