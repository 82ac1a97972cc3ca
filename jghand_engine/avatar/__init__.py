"""Avatars of hands. Users give these names instead of a file for those that JGHand ships."""

BUILTIN = "builtin"
PAINTED = "painted"
SHIPPED = (BUILTIN, PAINTED)
