# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension keeps beside Blender's data: its link to the engine, its jobs, the newest receipts of pictures.

The link is made on first use, ended with the extension, with Blender (`atexit`), or by the user; opening another file
does not end it. Everything else that belongs to a hand lives on the hand's object.
"""

from __future__ import annotations

import atexit
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core import limits
from ..errors import JGHandFailure
from ..preferences import preferences
from .engine_command import engine_command, engine_program
from .jobs import JobTable
from .link import EngineLink


@dataclass(frozen=True)
class RenderNote:
    """How the newest rendered frame went. failure: None when it is there; evaluate_ms: Blender's evaluation and the
    reading of hands and camera; request_ms: the engine and the way there and back"""

    failure: JGHandFailure | None
    reports: Sequence[Mapping[str, Any]] = ()
    evaluate_ms: float = 0.0
    request_ms: float = 0.0


# kinds of pictures whose receipts are kept
VIEWPORT, RENDER = "viewport", "render"

_CHECKOUT = Path(__file__).resolve().parents[2]

_link: EngineLink | None = None
_lock = threading.Lock()  # a render thread may want the link while the main thread makes it
_reports: dict[str, Mapping[str, Any]] = {}
_render_note: RenderNote | None = None
_render_timeout_s: float | None = None
_render_given_up = False
_jobs = JobTable()


def link() -> EngineLink:
    """The link to the engine, not started yet when it is new."""
    global _link
    with _lock:
        if _link is None:
            _link = EngineLink(command)
        return _link


def use_link(other: EngineLink | None) -> None:
    """Puts another link in place, after ending the one before (for tests: one to a stand-in)."""
    global _link
    with _lock:
        before, _link = _link, other
    if before is not None and before is not other:
        before.close()


def set_report(kind: str, report: Mapping[str, Any]) -> None:
    """Keeps the receipt of the newest picture of a kind (VIEWPORT, RENDER): one of a reply's `reports`, as it came.

    From any thread; the panel reads it when it is drawn.
    """
    _reports[kind] = report


def last_report(kind: str) -> Mapping[str, Any] | None:
    """The receipt of the newest picture of a kind; None before the first."""
    return _reports.get(kind)


def note_render(note: RenderNote | None) -> None:
    """Keeps how a rendered frame went, for batch runs: Blender itself says no more than that it failed."""
    global _render_note
    _render_note = note


def last_render() -> RenderNote | None:
    """How the newest rendered frame went; None when none was since `note_render(None)`."""
    return _render_note


def use_render_timeout(seconds: float | None) -> None:
    """How long a rendered frame may take, whatever the preferences say; None: what they say."""
    global _render_timeout_s
    _render_timeout_s = seconds


def render_timeout_s() -> float:
    """How long a rendered frame may take."""
    chosen = preferences()
    return _render_timeout_s or (chosen.render_timeout_s if chosen is not None else limits.REQUEST_S)


def give_up_render(given_up: bool) -> None:
    """Whether the picture that is rendered is not wanted any more: for batch runs, which Ctrl-C ends. An exception
    would be lost in Blender, which writes an empty picture then."""
    global _render_given_up
    _render_given_up = given_up


def render_given_up() -> bool:
    """Whether it was given up."""
    return _render_given_up


def command() -> Sequence[str]:
    """How to start the engine, as preferences and environment say now. JGHandFailure: no_interpreter."""
    return engine_command(_chosen_python(), checkout=_CHECKOUT)


def program(*, learns: bool = False) -> Sequence[str]:
    """The words before a verb of the engine's command line, for jobs. learns: one that has PyTorch.

    JGHandFailure: no_interpreter, no_tools.
    """
    from .install import tools_python  # here: its operators need this module

    return engine_program(_chosen_python(), checkout=_CHECKOUT, tools=tools_python() if learns else None, learns=learns)


def look_again() -> None:
    """The engine may be another one from now on: what runs, or failed, is started anew."""
    if _link is not None and _link.status.state != "stopped":
        _link.restart()


def jobs() -> JobTable:
    """The jobs of this Blender: exports, captures, trainings."""
    return _jobs


def _chosen_python() -> str | None:
    chosen = preferences()
    return chosen.engine_python or None if chosen is not None else None


def register() -> None:
    """Makes sure that the engine ends with Blender, whichever way that ends."""
    atexit.register(_end)


def unregister() -> None:
    """Ends the engine."""
    atexit.unregister(_end)
    _end()


def _end() -> None:
    use_link(None)
    _jobs.close()
    _reports.clear()
