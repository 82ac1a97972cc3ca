"""`jghand serve`: the engine as a process for Blender."""

from __future__ import annotations

from dataclasses import dataclass

from jghand_engine.errors import InputError

DESCRIPTION = """The engine as a process. Blender starts it; people have no need to.

A line with a token comes in on standard input, a line with the port goes out on standard output."""


@dataclass(frozen=True)
class Serve:
    stdio_handshake: bool = False
    """Exchange token and port over standard input and output (the only way there is)."""

    def run(self) -> int:
        if not self.stdio_handshake:
            raise InputError("serve", wanted="--stdio-handshake", came="nothing", remedy="Blender starts it like that.")
        from jghand_engine.service.hands import EngineHands
        from jghand_engine.service.server import serve

        return serve(EngineHands())
