"""The names of the avatars that JGHand ships, which users give instead of a file. Imports nothing."""

BUILTIN = "builtin"
PAINTED = "painted"
SHIPPED = (BUILTIN, PAINTED)
