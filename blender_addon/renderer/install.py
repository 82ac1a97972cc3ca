# SPDX-License-Identifier: GPL-3.0-or-later
"""The training tools: PyTorch and what else training, tracking and captures need, in an environment below the
extension's user folder. One button installs them, finishes a half-made environment and brings an older one up to date.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.app.translations import pgettext_rpt as rpt_

from .. import folders
from ..errors import JGHandFailure
from ..ops import PLUMBING, Reporting, missing
from . import job_watch, runtime
from .engine_command import CARRIED
from .install_tools import READY, fingerprint, interpreter
from .jobs import JobSpec

KEY = "tools"
PACKAGES = (
    *("torch", "numpy", "scipy", "trimesh", "safetensors", "pillow", "tyro", "rich", "usd-core"),
    *("mediapipe", "imageio-ffmpeg"),
)
_SCRIPT = Path(__file__).resolve().with_name("install_tools.py")
_CHECKOUT = _SCRIPT.parents[2]


def tools_folder() -> Path:
    """Where the tools are, or will be. JGHandFailure: cannot_write."""
    return folders.user_folder("tools", make=False)


def state() -> str:
    """ "missing", "broken" (half-made, or of another version of the extension) or "ready"."""
    folder = tools_folder()
    if not folder.is_dir():
        return "missing"
    with contextlib.suppress(OSError):
        whole = (folder / READY).read_text("utf-8") == fingerprint(_sources()[1], list(PACKAGES))
        if whole and interpreter(folder).is_file():
            return "ready"
    return "broken"


def tools_python() -> Path | None:
    """The interpreter of the tools; None where they are not whole."""
    return interpreter(tools_folder()) if state() == "ready" else None


def is_online() -> bool:
    """Whether Blender may go online."""
    return bpy.app.online_access


def _sources() -> tuple[Path, Path]:
    """The folder with the engine's package, and the file of versions: in the zip, or in a checkout."""
    if (CARRIED / "common").is_dir():
        return CARRIED / "common", CARRIED / "constraints.txt"
    return _CHECKOUT, _CHECKOUT / "constraints" / "engine.txt"


class InstallTools(Reporting, bpy.types.Operator):
    """Operator: installs or mends the training tools, as a job."""

    bl_idname = "jghand.install_tools"
    bl_label = "Install Training Tools"
    bl_description = "Download PyTorch and what else training and video tracking need, about 1 GB or more"
    bl_options = PLUMBING

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        job = runtime.jobs().get(KEY)
        if job is not None and not job.is_over:
            return missing(cls, "The training tools are being installed")
        if not is_online():
            return missing(cls, 'Switch "Allow Online Access" on in the preferences, under System')
        return True

    def run(self, _context: bpy.types.Context) -> None:
        engine, constraints = _sources()
        words = (str(tools_folder()), "--engine", str(engine), "--constraints", str(constraints), *PACKAGES)
        command = (sys.executable, "-I", str(_SCRIPT), *words)
        runtime.jobs().start(KEY, JobSpec("tools", "Installing the training tools", command, tools_folder()))
        job_watch.start()
        self.tell(rpt_("Installing the training tools"))


class RemoveTools(Reporting, bpy.types.Operator):
    """Operator: deletes the training tools."""

    bl_idname = "jghand.remove_tools"
    bl_label = "Remove Training Tools"
    bl_description = "Delete the training tools from this computer. Avatars and trainings stay"
    bl_options = PLUMBING

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        job = runtime.jobs().get(KEY)
        if job is not None and not job.is_over:
            return missing(cls, "The training tools are being installed")
        return state() != "missing" or missing(cls, "There are no training tools here")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(self, event)

    def run(self, _context: bpy.types.Context) -> None:
        try:
            shutil.rmtree(tools_folder())
        except OSError as error:
            raise JGHandFailure("cannot_write", f"{error.filename}: {error.strerror or error}") from error


_STATES = {
    "missing": "Training and video tracking need PyTorch, which is not installed",
    "broken": "The training tools are incomplete or of another version: install them again",
    "ready": "The training tools are installed",
}


def draw_tools(layout: bpy.types.UILayout) -> None:
    """What there is, and what can be done about it."""
    job = runtime.jobs().get(KEY)
    box = layout.box().column()
    if job is not None and not job.is_over:
        row = box.row(align=True)
        row.label(text=job.state.sentence(iface_), icon="IMPORT", translate=False)
        row.operator("jghand.cancel_job", text="", icon="X").key = KEY
        return
    now = state()
    box.label(text=_STATES[now], icon="CHECKMARK" if now == "ready" else "ERROR" if now == "broken" else "INFO")
    if job is not None and job.state.failure is not None:
        box.label(text=job.state.failure.detail.splitlines()[-1] if job.state.failure.detail else "", translate=False)
        box.operator("jghand.show_job_log", text="Show Log", icon="TEXT").key = KEY
    row = box.row(align=True)
    if now != "ready":
        row.operator(InstallTools.bl_idname, icon="IMPORT")
    if now != "missing":
        row.operator(RemoveTools.bl_idname, icon="TRASH")


CLASSES = (InstallTools, RemoveTools)
