# SPDX-License-Identifier: GPL-3.0-or-later
"""What the link gives back: answers to requests, progress, the state of the engine. Does not use bpy."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ..core.wire import protocol
from ..errors import JGHandFailure

Arrays = Mapping[str, protocol.Array]
# failures of a picture that say nothing about it: somebody gave it up
GIVEN_UP = frozenset({"canceled", "stopped"})


@dataclass(frozen=True)
class Status:
    """state: "stopped", "starting", "ready", "slow", "stopping" or "failed"; since_s: for how many seconds (0 for one
    that was never started); failure: why it failed; handshake: what the engine said of itself, empty before it did;
    busy: whether it works on something; doing: what of it takes long, if it says so."""

    state: str
    since_s: float
    failure: JGHandFailure | None = None
    handshake: Mapping[str, Any] = field(default_factory=dict)
    busy: bool = False
    doing: str = ""


@dataclass(frozen=True)
class Answer:
    """To the request with this tag: the engine's message, or a failure."""

    tag: Hashable
    message: protocol.Message | None
    failure: JGHandFailure | None = None
    round_trip_ms: float = 0.0

    def fails_as(self, other: Answer | None) -> bool:
        """Whether the other one says that the same request failed for the same reason."""
        if other is None or self.tag != other.tag or self.failure is None or other.failure is None:
            return False
        return (self.failure.kind, self.failure.detail) == (other.failure.kind, other.failure.detail)


@dataclass(frozen=True)
class Progress:
    """fraction: 0 to 1, None where it is not known; eta_s: seconds left, None where they are not known."""

    fraction: float | None
    text: str = ""
    eta_s: float | None = None

    @classmethod
    def of(cls, header: Mapping[str, Any]) -> Progress:
        """As the engine says it; what is no number is not known."""
        fraction, text = _number(header.get("fraction")), header.get("text")
        part = None if fraction is None else min(max(fraction, 0.0), 1.0)
        return cls(part, text if isinstance(text, str) else "", _number(header.get("eta_s")))


def told(error: Any, log: str = "") -> JGHandFailure:
    """The failure that the engine reports; its own sentence is the detail. log: what it printed last."""
    if not isinstance(error, dict):
        return JGHandFailure("broken_stream", "an error without a description", log=log)
    detail = "\n".join(str(error[key]) for key in ("sentence", "detail") if error.get(key))
    return JGHandFailure(str(error.get("kind")), detail, log=log)


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
