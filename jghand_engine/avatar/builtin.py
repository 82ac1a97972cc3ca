"""The avatars that JGHand ships, so that a newcomer needs no download: a painted one, one learned from pictures, and
other persons' hands that were made from it."""

from __future__ import annotations

import functools
import hashlib
from importlib.resources import as_file, files
from importlib.resources.abc import Traversable
from pathlib import Path

from jghand_engine.avatar import BUILTIN, PAINTED, SHIPPED
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.file import load_avatar
from jghand_engine.files import read_bytes
from jghand_engine.hand.joints import Handedness

ASSETS = files("jghand_engine") / "assets"


def load_avatar_called(name: str) -> HandAvatar:
    """A right hand: that of a file, or a shipped one by its name. InputError for a file that is none."""
    return _load_right(name) if name in SHIPPED else load_avatar(name)


def avatar_sha256(name: str) -> str:
    """Of the file that `load_avatar_called` reads. InputError when it cannot be read."""
    content = _asset(name).read_bytes() if name in SHIPPED else read_bytes(Path(name))
    return hashlib.sha256(content).hexdigest()


def load_builtin(*, handedness: Handedness) -> HandAvatar:
    """The avatar learned from a path-traced capture (scripts/train_builtin.py), driven by joints of the named hand. A
    damaged installation raises InputError.

    It is read once; everybody gets the same arrays and changes none of them.
    """
    return _load_right(BUILTIN).for_hand(handedness)


def load_painted(*, handedness: Handedness) -> HandAvatar:
    """The painted avatar (jghand_engine/assets/README.md), which nothing was learned for; as above."""
    return _load_right(PAINTED).for_hand(handedness)


@functools.cache
def _load_right(name: str) -> HandAvatar:
    with as_file(_asset(name)) as path:
        return load_avatar(path)


def _asset(name: str) -> Traversable:
    return ASSETS / f"{name}_right.jghand" if name in (BUILTIN, PAINTED) else ASSETS / "hands" / f"{name}.jghand"
