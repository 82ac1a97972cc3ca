# SPDX-License-Identifier: GPL-3.0-or-later
"""An engine for a run that does one thing after the other: started, asked, ended. Does not use bpy.

The link (link.py) does the work. An engine that did not answer in time is ended, since the run ends with it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from . import limits
from .link import Arrays, EngineLink
from .messages import JGHandFailure
from .wire import protocol


class EngineClient:
    """A running engine. `with EngineClient.start(command) as engine: engine.request({...})`."""

    def __init__(self, link: EngineLink) -> None:
        """link: one whose engine is ready."""
        self._link = link
        self.handshake: Mapping[str, Any] = link.status.handshake

    @classmethod
    def start(
        cls,
        command: Sequence[str],
        *,
        environment: Mapping[str, str] = os.environ,
    ) -> EngineClient:
        """Starts the engine and greets it; JGHandFailure says why that failed, and nothing is left running."""
        link = EngineLink(lambda: command, environment=environment)
        try:
            link.start()
            link.wait_until_ready()
        except BaseException:
            link.close()
            raise
        return cls(link)

    @property
    def alive(self) -> bool:
        """True while the engine can be asked."""
        return self._link.status.state in ("ready", "slow")

    @property
    def log(self) -> str:
        """The last lines that the engine printed."""
        return self._link.log

    def request(
        self, header: Mapping[str, Any], arrays: Arrays | None = None, *, timeout_s: float = limits.REQUEST_S
    ) -> protocol.Message:
        """Sends a request and waits for its reply.

        Raises JGHandFailure: bad_input for what cannot be sent, the engine's own kind when it answers with an error
        (it lives on in both cases), else crashed, killed, out_of_memory, hung or broken_stream (it is ended).
        """
        if not self.alive:
            raise JGHandFailure("crashed", "the engine is not running")
        try:
            return self._link.request(header, arrays, timeout_s=timeout_s)
        except JGHandFailure as failure:
            if failure.kind == "hung":
                self._link.close()
            raise

    def close(self) -> None:
        """Ends the engine. May be called twice."""
        self._link.close()

    def __enter__(self) -> EngineClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
