# SPDX-License-Identifier: GPL-3.0-or-later
"""The modules that extension and engine share. The extension's build copies them here; a checkout has them there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

# the file decides, not whether its import works: a broken copy must not be taken for a missing one
if TYPE_CHECKING or not Path(__file__).with_name("protocol.py").is_file():
    from jghand_engine.motion import conventions
    from jghand_engine.service import protocol
else:
    from . import conventions, protocol

__all__ = ["conventions", "protocol"]
