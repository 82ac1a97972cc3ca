"""The avatar that JGHand ships: painted, not trained, so that a newcomer needs no download."""

from __future__ import annotations

import functools
from importlib.resources import as_file, files

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.file import load_avatar
from jghand_engine.hand.joints import Handedness

ASSET = files("jghand_engine") / "assets" / "builtin_right.jghand"


def load_builtin(*, handedness: Handedness) -> HandAvatar:
    """The built-in avatar, driven by joints of the named hand. A damaged installation raises InputError.

    It is read once; everybody gets the same tensors and changes none of them.
    """
    return _load_right().for_hand(handedness)


@functools.cache
def _load_right() -> HandAvatar:
    with as_file(ASSET) as path:
        return load_avatar(path)
