"""The one module that extension and engine share. The extension's build copies it here; a checkout has it there."""

from __future__ import annotations

try:
    from . import protocol  # pyright: ignore[reportAttributeAccessIssue]
except ImportError:
    from jghand_engine.service import protocol

__all__ = ["protocol"]
