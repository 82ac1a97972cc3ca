"""`jghand serve`: the renderer as a process, for Blender."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from jghand_engine.cli.options import BackendName
from jghand_engine.errors import InputError

DESCRIPTION = """The engine as a process. Blender starts it; people have no need to.

A line with a token comes in on standard input, a line with the port goes out on standard output."""


@dataclass(frozen=True)
class Serve:
    backend: BackendName = "auto"
    """What draws, as of `jghand render`."""

    def run(self) -> int:
        if sys.stdin is not None and sys.stdin.isatty():
            raise InputError("serve", wanted="a token from the program that starts it", came="a terminal")
        from jghand_engine.service.hands import HandImages
        from jghand_engine.service.server import serve

        return serve(HandImages(self.backend))
