"""What every layer of a stage says about where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jghand_engine import __version__
from jghand_engine.avatar.avatar import AvatarInfo

CREATOR = "JGHand"


def provenance(info: AvatarInfo, stamp: Mapping[str, str]) -> dict[str, Any]:
    """customLayerData of every layer: who wrote it, of what, under which licence. stamp: what it was made from."""
    learnt_from = info.learnt_from
    about = {**stamp, "avatar": info.name, "template": info.template, "licence": info.licence}
    if learnt_from is not None:
        about |= {
            "learnt_from": learnt_from.capture,
            "learnt_from_pictures": learnt_from.pictures,
            "learnt_from_digest": learnt_from.digest,
        }
    return {"creator": f"{CREATOR} {__version__}", "jghand": about}
