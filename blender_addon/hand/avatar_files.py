# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the files of avatars changed: for views and panels, which are drawn again and again and wait for no disk."""

from __future__ import annotations

from ..core.file_stamps import FileStamps
from ..core.view import SHIPPED_AVATARS, avatar_stamp

_stamps = FileStamps(avatar_stamp)


def stamp(avatar: str, *, fresh: bool = False) -> str:
    """Changes within a second or two after the file of an avatar did; "" for those that the engine brings. fresh: as it
    is now, where its disk answers at once."""
    return "" if avatar in SHIPPED_AVATARS else _stamps.get(avatar, fresh=fresh)


def register() -> None:
    """Nothing is looked at before a view or a panel asks."""


def unregister() -> None:
    """Forgets everything."""
    _stamps.clear()
