"""The stamp of a training: what decides what is learned, as JSON. A checkpoint only goes on under an equal one."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from jghand_engine.captures.picture_digest import picture_names
from jghand_engine.captures.sample import Sample

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def stamp_of(options: DataclassInstance, pictures: Sequence[Sample]) -> dict[str, Any]:
    """Options (dataclasses of plain values) and which pictures are learned from, wherever their folder lies now."""
    lines = picture_names(pictures)
    digest = hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]
    # as it will be read back: tuples become lists, enumerations their text
    return json.loads(json.dumps({"pictures": len(lines), "which pictures": digest, "options": asdict(options)}))
