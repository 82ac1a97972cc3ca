"""The one module that extension and engine share. The extension's build copies it here; a checkout has it there."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jghand_engine.service import protocol
else:
    try:
        from . import protocol
    except ImportError:
        from jghand_engine.service import protocol

__all__ = ["protocol"]
