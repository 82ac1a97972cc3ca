"""Texts that an avatar's description may hold."""

from __future__ import annotations

import unicodedata

from jghand_engine.limits import AVATAR_TEXT_MAX


def as_text(value: str) -> str:
    """`value` as `is_text` wants it: without what cannot be shown, and cut off."""
    return "".join(letter for letter in value if is_text(letter))[:AVATAR_TEXT_MAX]


def is_text(value: object) -> bool:
    """Whether `value` is a text that can be shown in a line and encoded: no control characters, no surrogates."""
    return (
        isinstance(value, str)
        and len(value) <= AVATAR_TEXT_MAX
        and not any(unicodedata.category(letter) in ("Cc", "Cs", "Zl", "Zp") for letter in value)
    )
