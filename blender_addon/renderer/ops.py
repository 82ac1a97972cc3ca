# SPDX-License-Identifier: GPL-3.0-or-later
"""The renderer by hand: start it again, see what it printed; jobs, and the training tools.

The training tools are PyTorch and what else training, tracking and captures need, in an environment below the
extension's user folder. One button installs them, finishes a half-made environment and brings an older one up to date.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import bpy

from ..errors import ADVICE, JGHandFailure
from ..ops import CANCELLED, DONE, ERROR, PLUMBING, REGISTERED, Reporting, missing, sentence_of
from ..ui import PANELS, areas, popup_text, redraw
from . import runtime
from .jobs import JobSpec

_INSTALL = Path(__file__).resolve().with_name("install_tools.py")
LOG_NAME = "JGHand Renderer Log"


class RestartEngine(bpy.types.Operator):
    bl_idname = "jghand.restart_engine"
    bl_label = "Restart Renderer"
    bl_description = "End the renderer, whatever it is doing, and start it again. It also starts with the first image"
    bl_options = PLUMBING

    def execute(self, context: bpy.types.Context) -> set[str]:
        runtime.link().restart()
        redraw(*PANELS)
        if not bpy.app.background:
            return DONE
        try:  # without a window to show how it goes, when it is ready or failed
            runtime.link().wait_until_ready()
        except JGHandFailure as failure:
            self.report(ERROR, popup_text(sentence_of(failure)))
            return CANCELLED
        return DONE


class ShowLog(Reporting, bpy.types.Operator):
    bl_idname = "jghand.show_log"
    bl_label = "Show Log"
    bl_description = "Open what the renderer, or a job, printed last in the Text Editor"
    bl_options = REGISTERED

    # of a job; "" for the renderer
    key: bpy.props.StringProperty(options={"SKIP_SAVE", "HIDDEN"})

    def run(self, context: bpy.types.Context) -> None:
        if not self.key:
            _show_text(context, LOG_NAME, runtime.link().log or "The renderer has printed nothing yet")
            return
        job = runtime.jobs.get(self.key)
        if job is None:
            raise JGHandFailure("bad_input", "no such job was started")
        lines = [" ".join(job.spec.command), "", job.log]
        if job.state.failure is not None:
            lines[1:1] = ["", str(job.state.failure)]
        _show_text(context, f"JGHand {self.key}.log", "\n".join(lines))


def _show_text(context: bpy.types.Context, name: str, content: str) -> None:
    """Puts it into the text of that name, one of this file, and shows that where there is a window."""
    text = next((old for old in bpy.data.texts if old.name == name and old.library is None), None)
    text = text or bpy.data.texts.new(name)
    text.clear()
    text.write(content)
    if bpy.app.background or context.window is None:
        return
    area = next((area for _, area in areas("TEXT_EDITOR")), None)
    if area is None:
        bpy.ops.wm.window_new()
        area = context.window_manager.windows[-1].screen.areas[0]
        area.type = "TEXT_EDITOR"
    area.spaces.active.text = text


class InstallTools(Reporting, bpy.types.Operator):
    bl_idname = "jghand.install_tools"
    bl_label = "Install Training Tools"
    bl_description = "Download PyTorch and what else training and video tracking need, about 1 GB or more"
    bl_options = PLUMBING

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        if not _tools_are_free(cls):
            return False
        if not runtime.is_online():
            return missing(cls, ADVICE["offline"].remedy)
        return True

    def run(self, _context: bpy.types.Context) -> None:
        engine, constraints = runtime.tools_sources()
        words = ("--engine", str(engine), "--constraints", str(constraints), *runtime.TOOLS_PACKAGES)
        command = (sys.executable, "-I", str(_INSTALL), str(runtime.tools_folder()), *words)
        runtime.start_job(runtime.TOOLS, JobSpec("Installing the training tools", command))
        self.tell("Installing the training tools")


class RemoveTools(Reporting, bpy.types.Operator):
    bl_idname = "jghand.remove_tools"
    bl_label = "Remove Training Tools"
    bl_description = "Delete the training tools from this computer. Avatars and trainings stay"
    bl_options = PLUMBING

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        if not _tools_are_free(cls):
            return False
        return runtime.tools_state() != "missing" or missing(cls, "There are no training tools here")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(self, event)

    def run(self, _context: bpy.types.Context) -> None:
        try:
            shutil.rmtree(runtime.tools_folder())
        except OSError as error:
            raise JGHandFailure("cannot_write", f"{error.filename}: {error.strerror or error}") from error


def _tools_are_free(operator: type) -> bool:
    """Whether the training tools may be changed: a training would lose its program, and hours of work."""
    if runtime.jobs.runs(runtime.TOOLS):
        return missing(operator, "The training tools are being installed")
    if any(map(runtime.jobs.runs, (runtime.TRAINING, runtime.CAPTURE, runtime.IMPORT, runtime.OWN))):
        return missing(operator, "The training tools are in use: wait until the job has ended, or cancel it")
    return True


class CancelJob(Reporting, bpy.types.Operator):
    bl_idname = "jghand.cancel_job"
    bl_label = "Cancel"
    bl_description = (
        "Stop this job. A training writes a checkpoint first, images and exported files that are finished stay, and "
        "a bake that is not finished is removed"
    )
    bl_options = PLUMBING

    key: bpy.props.StringProperty(options={"SKIP_SAVE", "HIDDEN"})

    def run(self, _context: bpy.types.Context) -> None:
        job = runtime.jobs.get(self.key)
        if job is not None:
            job.cancel()
            runtime.watch_jobs()


CLASSES = (RestartEngine, ShowLog, InstallTools, RemoveTools, CancelJob)
