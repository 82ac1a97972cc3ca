# SPDX-License-Identifier: GPL-3.0-or-later
"""The card of an avatar: whose hand, under which license, from when, how good. Does not use bpy.

Made of what `jghand info` says, which checks every value of the file; texts in it are somebody else's.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core import limits
from ..errors import JGHandFailure


@dataclass(frozen=True)
class Card:
    """name · license · learned_from: which pictures, "" when nothing was learned · written: date of the file, "" of a
    shipped one · accuracy: in words · gaussians · learned: whether its colors change with the pose."""

    name: str
    license: str
    learned_from: str
    written: str
    accuracy: str
    gaussians: int
    learned: bool

    def lines(self) -> list[tuple[str, str]]:
        """For a panel: what, and its value."""
        rows = [
            ("Name", self.name),
            ("Learned From", self.learned_from or "nothing: it is painted"),
            ("License", self.license or "not said"),
            ("Written", self.written),
            ("PSNR", self.accuracy),
            ("Splats", f"{self.gaussians}"),
        ]
        return [(name, value) for name, value in rows if value]


def read_card(path: Path) -> Card:
    """The card from the JSON that `jghand info --json` wrote. JGHandFailure: bad_avatar."""
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        if facts.get("kind") != "avatar":
            raise ValueError(f"it is a {str(facts.get('kind'))[:40]}")
        return card_of(facts)
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise JGHandFailure("bad_avatar", f"{path}: {str(error)[:200]}") from error


def card_of(facts: Mapping[str, Any]) -> Card:
    """The card of what `jghand info` says; ValueError, TypeError, KeyError or AttributeError for something else."""
    source = facts.get("learnt_from") or {}
    learned_from = f"{source['pictures']} pictures of {source['capture']}" if source else ""
    learned = facts.get("learnt") or {}
    return Card(
        name=_text(facts["name"]),
        license=_text(facts.get("licence", "")),
        learned_from=_text(learned_from),
        written=_text(facts.get("written", "")),
        accuracy=_text(learned.get("psnr_db", "")),
        gaussians=int(facts["gaussians"]),
        learned=bool(learned),
    )


def _text(value: Any) -> str:
    return " ".join(str(value).split())[: limits.CARD_TEXT_MAX]
