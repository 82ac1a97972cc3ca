# SPDX-License-Identifier: GPL-3.0-or-later
"""The one thing that the extension keeps beside Blender's data: its link to the engine.

Made on first use, ended with the extension, with Blender (`atexit`), or by the user; opening another file does not end
it. Everything else that belongs to a hand lives on the hand's object.
"""

from __future__ import annotations

import atexit
from collections.abc import Sequence
from pathlib import Path

from .core.engine_command import engine_command
from .core.link import EngineLink
from .preferences import preferences

_link: EngineLink | None = None


def link() -> EngineLink:
    """The link to the engine, not started yet when it is new."""
    global _link
    if _link is None:
        _link = EngineLink(command)
    return _link


def use_link(other: EngineLink | None) -> None:
    """Puts another link in place, after ending the one before (for tests: one to a stand-in)."""
    global _link
    if _link is not None and _link is not other:
        _link.close()
    _link = other


def command() -> Sequence[str]:
    """How to start the engine, as preferences, environment and PATH say now. JGHandFailure: no_interpreter."""
    chosen = preferences()
    return engine_command(
        chosen.engine_python or None if chosen is not None else None,
        checkout=Path(__file__).resolve().parent.parent,
    )


def register() -> None:
    """Makes sure that the engine ends with Blender, whichever way that ends."""
    atexit.register(_end)


def unregister() -> None:
    """Ends the engine."""
    atexit.unregister(_end)
    _end()


def _end() -> None:
    use_link(None)
