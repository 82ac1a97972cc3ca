"""Avatars of hands. Users give these names instead of a file for those that JGHand ships."""

from importlib.resources import files

BUILTIN = "builtin"
PAINTED = "painted"
# beside them the hands of other persons that lie in the assets: as many as an installation carries
_HANDS = files("jghand_engine") / "assets" / "hands"
SHIPPED = (
    BUILTIN,
    PAINTED,
    *sorted(file.name.removesuffix(".jghand") for file in _HANDS.iterdir() if file.name.endswith(".jghand")),
)
