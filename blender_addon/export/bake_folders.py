# SPDX-License-Identifier: GPL-3.0-or-later
"""Which bake belongs to which hand, in this file and beside the bakes of others."""

from __future__ import annotations

import uuid
from pathlib import Path

import bpy

from .. import folders
from . import bakes, owners


def own_id(thing: bpy.types.Object) -> str:
    """What tells a hand's bakes from those of other hands: the one it has, or a new one, also for a copy of a hand."""
    own = thing.jghand.bake_id
    shared = any(other != thing and other.jghand.bake_id == own for other in bpy.data.objects)
    return uuid.uuid4().hex if shared or not own else own


def owner_text(own: str, parent: Path) -> str:
    """The owner of a bake: hand and file, which may be a copy of another file. parent: of the hand's folder."""
    return owners.owner_in(parent, own)


def bake_folder(thing: bpy.types.Object) -> Path:
    """The folder of a hand's bake."""
    folder = Path(folders.absolute(thing, "bake")).absolute()
    return bakes.newest(folder, owner_text(thing.jghand.bake_id, folder.parent.parent))
