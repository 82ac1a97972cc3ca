"""The avatars that JGHand ships, so that a newcomer needs no download: a painted one, and one learnt from pictures."""

from __future__ import annotations

import functools
from importlib.resources import as_file, files
from importlib.resources.abc import Traversable

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.file import load_avatar
from jghand_engine.hand.joints import Handedness

ASSETS = files("jghand_engine") / "assets"
ASSET = ASSETS / "builtin_right.jghand"
TRAINED_ASSET = ASSETS / "trained_right.jghand"


def load_builtin(*, handedness: Handedness) -> HandAvatar:
    """The painted avatar, driven by joints of the named hand. A damaged installation raises InputError.

    It is read once; everybody gets the same tensors and changes none of them.
    """
    return _load_right(ASSET).for_hand(handedness)


def load_trained(*, handedness: Handedness) -> HandAvatar:
    """The avatar learnt from a path-traced capture of a photographic skin (scripts/train_builtin.py); as above."""
    return _load_right(TRAINED_ASSET).for_hand(handedness)


@functools.cache
def _load_right(asset: Traversable) -> HandAvatar:
    with as_file(asset) as path:
        return load_avatar(path)
