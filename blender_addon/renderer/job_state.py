# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of a job: the states it goes through and what moves it from one to the next. Pure: no process, no
clock, no bpy.

    running -> done | failed
    running -> pausing -> paused        a training that was stopped can go on from its checkpoint
    pausing -> failed                   nothing says that its checkpoint was written
    running -> cancelling -> canceled
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from ..core import limits
from ..core.panel_text import Translate, duration
from ..errors import BAD_INPUT, INTERRUPTED, JGHandFailure, kind_of_exit


class Phase(Enum):
    """Where a job stands."""

    RUNNING = "running"
    PAUSING = "pausing"
    CANCELLING = "cancelling"
    DONE = "done"
    PAUSED = "paused"
    CANCELLED = "canceled"
    FAILED = "failed"

    @property
    def is_over(self) -> bool:
        """Whether its process has ended."""
        return self in (Phase.DONE, Phase.PAUSED, Phase.CANCELLED, Phase.FAILED)


@dataclass(frozen=True)
class JobState:
    """phase · text: what it does now · done, total: of the present step, total 0 while unknown · eta_s: seconds left,
    None while unknown · notes: the last things that it said happened · failure: why it failed."""

    phase: Phase = Phase.RUNNING
    text: str = "Starting"
    done: float = 0.0
    total: float = 0.0
    eta_s: float | None = None
    notes: tuple[str, ...] = ()
    failure: JGHandFailure | None = None

    @property
    def fraction(self) -> float | None:
        """0..1, None while unknown."""
        return min(max(self.done / self.total, 0.0), 1.0) if self.total > 0 else None

    def sentence(self, translate: Translate = str) -> str:
        """One line for a panel: the step, the count, and the time that is left."""
        if self.phase is Phase.FAILED and self.failure is not None:
            return translate(self.failure.advice.sentence)
        if self.phase is not Phase.RUNNING:
            return translate(_WORDS[self.phase])
        text = translate(self.text)
        # the text of a training counts its steps itself
        if self.total > 0 and " of " not in self.text:
            template = translate("{text} {done} of {total}")
            text = template.format(text=text, done=round(self.done), total=round(self.total))
        if self.eta_s is not None and self.done < self.total and " left" not in self.text:
            text = translate("{text} · {time} left").format(text=text, time=duration(self.eta_s))
        return text


_WORDS = {
    Phase.PAUSING: "Pausing",
    Phase.CANCELLING: "Cancelling",
    Phase.DONE: "Done",
    Phase.PAUSED: "Paused",
    Phase.CANCELLED: "Canceled",
    Phase.FAILED: "Failed",
}


def parse_line(line: str) -> dict[str, Any] | None:
    """What a line of the engine's standard error says (`jghand … --progress-json`); None for any other line."""
    if not line.startswith("{"):
        return None
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) and isinstance(content.get("jghand"), str) else None


def heard(state: JobState, content: Mapping[str, Any]) -> JobState:
    """The state after a line that `parse_line` understood. What makes no sense in it is left out."""
    kind, text = content["jghand"], str(content.get("text", ""))[: limits.JOB_TEXT_MAX]
    if kind in ("progress", "training"):
        total = _number(content.get("total")) or 0.0
        return replace(
            state, text=text, done=_number(content.get("done")) or 0.0, total=total, eta_s=_number(content.get("eta_s"))
        )
    if kind == "note":
        return replace(state, notes=(*state.notes, text)[-limits.JOB_NOTES :])
    return state


def asked_to_stop(state: JobState, *, pause: bool) -> JobState:
    """The state after somebody asked a job to pause or to end. A canceled job is not paused any more."""
    if state.phase.is_over or (pause and state.phase is Phase.CANCELLING):
        return state
    return replace(state, phase=Phase.PAUSING if pause else Phase.CANCELLING)


def ended(state: JobState, exit_code: int, error: Mapping[str, Any] | None, log: str, *, can_pause: bool) -> JobState:
    """The state after the process has ended. error: its last line about one; log: what else it printed last."""
    if exit_code == 0:
        return replace(state, phase=Phase.DONE, eta_s=None)
    if state.phase is Phase.CANCELLING:
        return replace(state, phase=Phase.CANCELLED, eta_s=None)
    if exit_code == INTERRUPTED:
        return replace(state, phase=Phase.PAUSED if can_pause else Phase.CANCELLED, eta_s=None)
    return replace(state, phase=Phase.FAILED, eta_s=None, failure=failure_of(exit_code, error, log))


def failed(state: JobState, failure: JGHandFailure) -> JobState:
    """The state after something failed on this side."""
    return replace(state, phase=Phase.FAILED, eta_s=None, failure=failure)


def failure_of(exit_code: int, error: Mapping[str, Any] | None, log: str) -> JGHandFailure:
    """Why a process ended: what it said itself, else what its exit code tells."""
    if error is not None:
        return JGHandFailure(str(error.get("kind")), str(error.get("text", "")), log=log)
    last = "\n".join(log.splitlines()[-limits.DETAIL_LINES :])
    if "No module named" in log and "jghand_engine" in log:
        return JGHandFailure("no_engine", last, log=log)
    if exit_code == BAD_INPUT:
        # a mistake in the arguments: an engine that does not know what this extension asks for
        return JGHandFailure("protocol", last, log=log)
    kind = kind_of_exit(exit_code)
    return JGHandFailure(kind, f"exit code {exit_code}\n{last}".strip() if kind == "crashed" else last, log=log)


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None
