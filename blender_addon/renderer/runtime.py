# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension keeps beside Blender's data: its link to the engine, its jobs, the newest receipts of pictures,
and where the training tools are.

The link is made on first use and ended with the extension or with Blender (`atexit`); opening another file ends
neither it nor a job. Everything else that belongs to a hand lives on the hand's object.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib.util
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from .. import clock, folders, versions
from ..errors import JGHandFailure
from ..preferences import preferences
from ..ui import PANELS, redraw
from . import install_tools
from .jobs import JOB_LOOK_S, Job, JobSpec, JobTable
from .link import EngineLink
from .process import CARRIED, engine_command, engine_program

# kinds of pictures whose receipts are kept
VIEWPORT, RENDER = "viewport", "render"
# keys of jobs
BAKE, EXPORT, CAPTURE, TRAINING = "bake", "export", "capture", "training"
IMPORT, OWN, TOOLS = "import", "own", "tools"
TOOLS_PACKAGES = (
    *("torch", "numpy", "scipy", "trimesh", "safetensors", "pillow", "tyro", "rich", "usd-core"),
    *("mediapipe", "imageio-ffmpeg"),
)
_CHECKOUT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class RenderNote:
    # None when the frame is there
    failure: JGHandFailure | None
    reports: Sequence[Mapping[str, Any]] = ()
    # Blender's evaluation and the reading of hands and camera; the engine and the way there and back
    evaluate_ms: float = 0.0
    request_ms: float = 0.0


# set by Ctrl-C in a batch run: the picture that is rendered is not wanted any more
render_canceled = threading.Event()
_link: EngineLink | None = None
_lock = threading.Lock()  # a render thread may want the link while the main thread makes it
# the receipts of the newest picture of each kind (VIEWPORT, RENDER): one of a reply's `reports`, as it came
reports: dict[str, Mapping[str, Any]] = {}
# how the newest rendered frame went, for batch runs: Blender itself says no more than that it failed; None before one
render_note: RenderNote | None = None
jobs = JobTable()


# ---- the link --------------------------------------------------------------------------------------------------------


def link() -> EngineLink:
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


def offers_graphics_card() -> bool:
    """Whether the engine has the package by which a graphics card draws, as far as is known before it runs."""
    handshake = {} if _link is None else _link.status.handshake
    return not handshake or "gpu" in handshake.get("capabilities", ())


def look_again() -> None:
    """The engine may be another one from now on: what runs, or failed, is started anew."""
    if _link is not None and _link.status.state != "stopped":
        _link.restart()


def command() -> Sequence[str]:
    """How to start the engine, as preferences and environment say now.

    JGHandFailure: no_python, no_named_python, no_interpreter.
    """
    chosen = preferences()
    on_gpu = chosen is not None and chosen.render_device == "GPU"
    return engine_command(_chosen_python(), checkout=_CHECKOUT, on_gpu=on_gpu)


def program(*, learns: bool = False, usd: bool = False) -> Sequence[str]:
    """The words before a verb of the engine's command line, for jobs. learns: one that has PyTorch; usd: one that
    writes stages, for which Blender's Python has Blender's USD.

    JGHandFailure: no_python, no_named_python, no_interpreter, no_tools, no_usd.
    """
    tools = None
    if learns and tools_state() == "ready":
        tools = install_tools.interpreter(tools_folder())
    words = engine_program(_chosen_python(), checkout=_CHECKOUT, tools=tools, learns=learns)
    if usd and words[0] == sys.executable and not versions.has_usd() and importlib.util.find_spec("pxr") is None:
        raise JGHandFailure("no_usd")
    return words


def _chosen_python() -> str | None:
    chosen = preferences()
    return chosen.engine_python or None if chosen is not None else None


# ---- jobs ------------------------------------------------------------------------------------------------------------


def start_job(key: str, spec: JobSpec) -> Job:
    """Starts a job, which the timer looks after. JGHandFailure (job_running) while the one of that key runs."""
    job = jobs.start(key, spec)
    watch_jobs()
    return job


def timers_fire() -> bool:
    """Whether the timer looks after jobs: without a window timers never fire, and who starts a job waits for it."""
    return not bpy.app.background


def watch_jobs() -> None:
    """Begins to look after the jobs, unless it does already."""
    if timers_fire() and not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=JOB_LOOK_S, persistent=True)


@clock.guarded(JOB_LOOK_S)
def _tick() -> float | None:
    """The timer; None when nothing runs any more."""
    if jobs.tick():
        redraw(*PANELS)
    return JOB_LOOK_S if jobs.running else None


# ---- the training tools ----------------------------------------------------------------------------------------------


def tools_folder() -> Path:
    """Where the tools are, or will be. JGHandFailure: cannot_write."""
    return folders.user_folder("tools", make=False)


def tools_state() -> str:
    """ "missing", "broken" (half-made, or of another version of the extension) or "ready"."""
    folder = tools_folder()
    if not folder.is_dir():
        return "missing"
    with contextlib.suppress(OSError):
        wanted = install_tools.fingerprint(tools_sources()[1], list(TOOLS_PACKAGES))
        whole = (folder / install_tools.READY).read_text("utf-8") == wanted
        if whole and install_tools.interpreter(folder).is_file():
            return "ready"
    return "broken"


def is_online() -> bool:
    return bpy.app.online_access


def tools_sources() -> tuple[Path, Path]:
    """The folder with the engine's package, and the file of versions: in the zip, or in a checkout."""
    if (CARRIED / "common").is_dir():
        return CARRIED / "common", CARRIED / "constraints.txt"
    return _CHECKOUT, _CHECKOUT / "constraints" / "engine.txt"


# ---- the end ---------------------------------------------------------------------------------------------------------


def register() -> None:
    """Makes sure that the engine ends with Blender, whichever way that ends."""
    atexit.register(_end)


def unregister() -> None:
    atexit.unregister(_end)
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    _end()


def _end() -> None:
    use_link(None)
    jobs.close()
    reports.clear()
