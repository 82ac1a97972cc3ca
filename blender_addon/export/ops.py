# SPDX-License-Identifier: GPL-3.0-or-later
"""Exports: what the hands do, as files that need no Blender, no engine, or neither."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from .. import folders, versions
from ..errors import JGHandFailure
from ..ops import PLUMBING, REGISTERED, Reporting, missing, wait_cursor
from ..renderer import engine_words, job_watch, runtime
from ..renderer.engine_words import UsdChoices
from ..renderer.jobs import JobSpec
from . import bakes, export_stamp, owners, record, usd_hook
from .ops_common import StartsJob, place, poll_hands_to_write
from .recording import Recording, remove_beyond


class Export(StartsJob, bpy.types.Operator):
    """Operator: USD, PLY or motion files."""

    bl_idname = "jghand.export"
    bl_label = "Export"
    bl_description = "Write what the hands do over the range of frames into the folder. Esc cancels"
    bl_options = REGISTERED

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return poll_hands_to_write(cls, context)

    @classmethod
    def description(cls, context: bpy.types.Context, _properties: bpy.types.OperatorProperties) -> str:
        """The tooltip names the format."""
        texts = {
            "usd": "Write an animated OpenUSD stage per hand into the folder. Esc cancels",
            "ply": "Write a splat file per hand and frame into the folder. Esc cancels",
            "motion": "Write a motion file per hand into the folder: no renderer is needed",
        }
        return texts[context.scene.jghand.output.format]

    def prepare(self, context: bpy.types.Context) -> None:
        folder, kind = place(context, context.scene.jghand.output.folder), context.scene.jghand.output.format
        if not context.scene.jghand.output.replace_others:  # said before minutes of recording
            for thing, _, name in record.named_hands(context, self.recorded_hands(context)):
                export_stamp.check(folder, name, kind, owners.owner_in(folder, thing.name))
        if context.scene.jghand.output.format != "motion":
            runtime.program()

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> JobSpec | None:
        settings = context.scene.jghand.output
        folder = place(context, settings.folder)
        self._names = list(dict.fromkeys(recording.source for recording in recordings))
        for recording in recordings:
            owner = owners.owner_in(folder, recording.source)
            if not settings.replace_others:
                export_stamp.check(folder, recording.name, settings.format, owner)
            export_stamp.claim(folder, recording.name, settings.format, owner)
        if settings.format == "motion":
            for recording in recordings:
                recording.save(folder / f"{recording.name}.npz")
            return None
        commands = []
        scratch = folders.job_folder()
        for recording in recordings:
            motion, figures = (scratch / f"{recording.name}{suffix}" for suffix in (".npz", ".json"))
            recording.save(motion)
            if settings.format == "ply":
                words = engine_words.export_ply(recording, motion, folder, figures, settings.axes)
            else:
                words = engine_words.export_usd(recording, motion, folder, figures, _choices(context))
            commands.append((*runtime.program(), *words))
        title = "Exporting PLY" if settings.format == "ply" else "Exporting USD"
        return JobSpec(
            "export",
            title,
            commands[0],
            folder,
            on_done=partial(_check, recordings, scratch, folder if settings.format == "ply" else None),
            more=tuple(commands[1:]),
            on_over=partial(folders.remove_job_folder, scratch),
        )

    def done(self, context: bpy.types.Context) -> str:
        folder = place(context, context.scene.jghand.output.folder)
        return rpt_("Exported {names} to {folder}.").format(names=", ".join(self._names), folder=folder)


class ExportSceneUsd(Reporting, bpy.types.Operator):
    """Operator: Blender's own USD export, with the baked splats in it."""

    bl_idname = "jghand.export_scene_usd"
    bl_label = "Export Scene as USD"
    bl_description = "Write the whole scene with Blender's own USD export; hands that are baked are in it as splats"
    bl_options = REGISTERED

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    # Blender's file browser asks before it overwrites
    check_existing: bpy.props.BoolProperty(default=True, options={"HIDDEN"})  # type: ignore[valid-type]
    filter_glob: bpy.props.StringProperty(default="*.usd;*.usda;*.usdc;*.usdz", options={"HIDDEN"})  # type: ignore[valid-type]

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        if not versions.has_usd():
            return missing(cls, "This Blender was built without USD")
        if not getattr(usd_hook.JGHandUsdHook, "is_registered", False):
            return missing(cls, "This Blender's USD cannot be reached from Python, so splats cannot be added")
        return True

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        self.filepath = self.filepath or str(Path(context.blend_data.filepath or "scene").with_suffix(".usdc"))
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def run(self, context: bpy.types.Context) -> None:
        path = Path(bpy.path.abspath(self.filepath))
        try:
            with (
                wait_cursor(context),
                usd_hook.told_by_us(),
            ):  # Blender's own export cannot be cut into turns, nor ended
                bpy.ops.wm.usd_export(filepath=str(path), export_animation=True)
        except RuntimeError as error:
            raise JGHandFailure("cannot_write", f"{path}: {error}") from error
        if usd_hook.left_out():
            self.warn(*usd_hook.notes)
        else:
            self.tell(rpt_("Wrote {path}.").format(path=path), *usd_hook.notes)


class CancelJob(Reporting, bpy.types.Operator):
    """Operator: the button beside a job's progress."""

    bl_idname = "jghand.cancel_job"
    bl_label = "Cancel"
    bl_description = (
        "Stop this job. A training writes a checkpoint first, images and exported files that are finished stay, and "
        "a bake that is not finished is removed"
    )
    bl_options = PLUMBING

    key: bpy.props.StringProperty(options={"SKIP_SAVE", "HIDDEN"})  # type: ignore[valid-type]

    def run(self, _context: bpy.types.Context) -> None:
        job = runtime.jobs().get(self.key)
        if job is not None:
            job.cancel()
            job_watch.start()


class ShowJobLog(Reporting, bpy.types.Operator):
    """Operator: what a job printed."""

    bl_idname = "jghand.show_job_log"
    bl_label = "Show Log"
    bl_description = "Put what this job printed last into a text of the Text Editor"
    bl_options = REGISTERED

    key: bpy.props.StringProperty(options={"SKIP_SAVE", "HIDDEN"})  # type: ignore[valid-type]

    def run(self, _context: bpy.types.Context) -> None:
        job = runtime.jobs().get(self.key)
        if job is None:
            raise JGHandFailure("bad_input", "no such job was started")
        lines = [" ".join(job.spec.command), "", job.log]
        if job.state.failure is not None:
            lines[1:1] = ["", str(job.state.failure)]
        name = f"JGHand {self.key}.log"
        text = next((old for old in bpy.data.texts if old.name == name and old.library is None), None)
        text = text or bpy.data.texts.new(name)
        text.clear()
        text.write("\n".join(lines))
        self.tell(rpt_("The log is the text {name}.").format(name=text.name))


def _check(recordings: list[Recording], scratch: Path, numbered: Path | None) -> None:
    """The engine has succeeded: it did what it was asked for. numbered: the folder of a sequence, in which no frames of
    a longer one are left."""
    for recording in recordings:
        bakes.check_made(scratch / f"{recording.name}.json", recording)
        if numbered is not None:
            remove_beyond(numbered, recording.name, recording.frames)


def _choices(context: bpy.types.Context) -> UsdChoices:
    settings = context.scene.jghand.output
    return UsdChoices(settings.variant, settings.sizes, settings.radiance, settings.width_factor)


CLASSES = (Export, ExportSceneUsd, CancelJob, ShowJobLog)
