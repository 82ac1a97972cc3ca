# SPDX-License-Identifier: GPL-3.0-or-later
"""Exports, and bakes: what the hands do, as files that need no Blender, no engine, or neither."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bpy

from .. import folders, ui
from ..errors import JGHandFailure
from ..ops import REGISTERED, Reporting, missing, wait_cursor
from ..render import scene_light
from ..renderer import runtime
from ..renderer.jobs import JobSpec
from . import bakes, ops_common
from .ops_common import StartsJob, place, poll_hands_to_write, poll_usd
from .recording import Recording, file_names, usd_options

# what an export of a format and name is known by
_FILES = {"usd": "{name}.usda", "motion": "{name}.npz", "ply": "{name}.*.ply"}


class Export(StartsJob, bpy.types.Operator):
    bl_idname = "jghand.export"
    bl_label = "Export"
    bl_description = "Write what the hands do over the range of frames into the folder. Esc cancels"
    bl_options = REGISTERED

    key, never_beside = runtime.EXPORT, (runtime.BAKE,)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        writes_usd = context.scene.jghand.output.format == "usd"
        return (
            poll_hands_to_write(cls, context) and super().poll(context) and (not writes_usd or poll_usd(cls, context))
        )

    @classmethod
    def description(cls, context: bpy.types.Context, _properties: bpy.types.OperatorProperties) -> str:
        texts = {
            "usd": "Write an animated OpenUSD stage per hand into the folder. Esc cancels",
            "ply": "Write a splat file per hand and frame into the folder. Esc cancels",
            "motion": "Write a motion file per hand into the folder: no renderer is needed",
        }
        return texts[context.scene.jghand.output.format]

    def recorded_hands(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        return ops_common.hands_to_write(context)

    def prepare(self, context: bpy.types.Context) -> None:
        place(context, context.scene.jghand.output.folder)
        kind = context.scene.jghand.output.format
        if kind != "motion":
            runtime.program(usd=kind == "usd")

    def overwritten(self, context: bpy.types.Context) -> str:
        settings = context.scene.jghand.output
        folder = place(context, settings.folder)
        names = [name for *_, name in ops_common.named_hands(context, self.recorded_hands(context))]
        there = [name for name in names if any(folder.glob(_FILES[settings.format].format(name=name)))]
        return f"{folder} has exports of {', '.join(there)}" if there else ""

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> JobSpec | None:
        settings = context.scene.jghand.output
        folder = place(context, settings.folder)
        self._names = list(dict.fromkeys(recording.source for recording in recordings))
        if settings.format == "motion":
            for recording in recordings:
                recording.save(folder / f"{recording.name}.npz")
            return None
        if settings.format == "ply":
            title, options = "Exporting PLY", ["--axes", settings.axes]
            options += ["--surfels", str(settings.surfel_count)] if settings.use_surfels else []
        else:
            title = "Exporting USD"
            options = usd_options(settings.variant, settings.width_factor, settings.radiance)
        scratch = folders.job_folder()
        try:
            if settings.format == "ply" and scene_light.is_chosen(context.scene):
                light = scratch / "light.json"
                scene_light.save(context.evaluated_depsgraph_get(), light)
                options += ["--light", str(light)]
            commands = [
                (*runtime.program(), *recording.export_words(settings.format, scratch, folder, *options))
                for recording in recordings
            ]
        except Exception:  # there is no job that would do it
            shutil.rmtree(scratch, ignore_errors=True)
            raise
        return JobSpec(title, commands[0], folder, more=tuple(commands[1:]), scratch=(scratch,))

    def done(self, context: bpy.types.Context) -> str:
        folder = place(context, context.scene.jghand.output.folder)
        return f"Exported {', '.join(self._names)} to {folder}."


# ---- bakes -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _NewBake:
    # session_uid of its object, which may be gone when it is finished
    uid: int
    # where the engine writes it, and where it goes when it is finished
    made: Path
    folder: Path
    # of the object's one or two hands
    recordings: tuple[Recording, ...]


class Bake(StartsJob, bpy.types.Operator):
    bl_idname = "jghand.bake"
    bl_label = "Bake"
    bl_description = (
        "Write every frame of the range to disk, so that it plays without the renderer, as USD points. An earlier bake "
        "stays until this one is finished. Esc cancels"
    )
    # the scene is changed when the job has ended, whoever notices that: the step for undo is made there
    bl_options = REGISTERED

    key, never_beside = runtime.BAKE, (runtime.EXPORT,)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return poll_hands_to_write(cls, context) and super().poll(context) and poll_usd(cls, context)

    def prepare(self, context: bpy.types.Context) -> None:
        place(context, context.scene.jghand.output.bake_folder)
        runtime.program(usd=True)

    def overwritten(self, context: bpy.types.Context) -> str:
        things = ops_common.hands_to_write(context)
        there = [str(folder) for folder in _bake_folders(context, things) if (folder / bakes.STAMP).is_file()]
        return f"There is a bake in {', '.join(there)}" if there else ""

    def recorded_hands(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        things = ops_common.hands_to_write(context)
        self._uids = [thing.session_uid for thing in things]
        return things

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> JobSpec:
        settings = context.scene.jghand.output
        self._folder = place(context, settings.bake_folder)
        things = _things_of(context, self._uids)
        # not by names: a linked hand may have the name of one of this file
        owners = [owner for owner, *_ in ops_common.named_hands(context, things)]
        options = usd_options("points", settings.bake_width_factor)
        made: list[_NewBake] = []
        try:
            for thing, folder in zip(things, _bake_folders(context, things), strict=True):
                own = tuple(each for owner, each in zip(owners, recordings, strict=True) if owner == thing)
                made.append(_NewBake(thing.session_uid, _folder_beside(folder), folder, own))
            commands = [
                (*runtime.program(), *recording.export_words("usd", bake.made, bake.made, *options))
                for bake in made
                for recording in bake.recordings
            ]
        except JGHandFailure:
            for bake in made:
                shutil.rmtree(bake.made, ignore_errors=True)
            raise
        finish, scratch = partial(_finish, made), tuple(bake.made for bake in made)
        return JobSpec("Baking", commands[0], self._folder, on_done=finish, more=tuple(commands[1:]), scratch=scratch)

    def done(self, _context: bpy.types.Context) -> str:
        return f"Baked into {self._folder}."


def _bake_folders(context: bpy.types.Context, things: Sequence[bpy.types.Object]) -> list[Path]:
    """The folder of each hand's bake. JGHandFailure: no_place."""
    parent = place(context, context.scene.jghand.output.bake_folder)
    return [parent / name for name in file_names([thing.name for thing in things])]


def _folder_beside(folder: Path) -> Path:
    """A folder in which a bake is made, on the same disk: what lies in `folder` stays until it is finished. What was
    left there by one that was killed goes."""
    made = folder.with_name(f".{folder.name}.new")
    try:
        shutil.rmtree(made, ignore_errors=True)
        made.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise JGHandFailure("cannot_write", f"{made}: {error.strerror or error}") from error
    return made


def _things_of(context: bpy.types.Context, uids: list[int]) -> list[bpy.types.Object]:
    """Objects by their session_uid: references do not outlive what happens between two events."""
    by_uid = {thing.session_uid: thing for thing in context.scene.objects}
    if any(uid not in by_uid for uid in uids):
        raise JGHandFailure("no_hand", "it was deleted meanwhile")
    return [by_uid[uid] for uid in uids]


def _finish(made: Sequence[_NewBake]) -> None:
    """The engine has succeeded: the new bakes replace the earlier ones, and what plays plays them. Whoever looks after
    the job calls this, perhaps while another file is open: then no hand is touched."""
    with ui.one_step("Bake") as context:
        for bake in made:
            thing = next((thing for thing in bpy.data.objects if thing.session_uid == bake.uid), None)
            has_bake = thing is not None and bool(thing.jghand.bake)
            before = {bake.folder, bakes.folder_of(thing)} if has_bake else {bake.folder}
            played = {folder: things for folder in before if (things := bakes.release(context, folder))}
            try:
                bakes.put_in_place(bake.made, bake.folder, bake.recordings)
            except JGHandFailure:
                for folder, things in played.items():
                    with contextlib.suppress(JGHandFailure):  # no half of a bake plays
                        bakes.play(context, folder, things)
                raise
            if thing is not None and thing.is_editable:
                thing.jghand.bake = folders.beside_the_file(context, bake.folder)
            if played:
                bakes.play(context, bake.folder, [each for things in played.values() for each in things])


def _poll_baked(operator: type, context: bpy.types.Context) -> bool:
    thing = context.object
    return (thing is not None and bool(thing.jghand.bake)) or missing(operator, "Select a hand that was baked")


class PlayBake(Reporting, bpy.types.Operator):
    bl_idname = "jghand.play_bake"
    bl_label = "Play Bake"
    bl_description = (
        "Bring the bake of this hand into the scene as an object that plays with neither renderer nor extension, "
        "and stop drawing the hand itself in the viewport"
    )

    poll = classmethod(_poll_baked)

    def run(self, context: bpy.types.Context) -> None:
        thing = context.object
        folder = bakes.folder_of(thing)
        reasons = bakes.stale_now(thing, context.evaluated_depsgraph_get(), bakes.read_bake(folder))
        with wait_cursor(context):  # Blender's own import cannot be cut into turns
            bakes.stop(context, folder)
            bakes.play(context, folder)
        thing.jghand.show_in_viewport = False
        if reasons:
            self.warn(f"An old bake plays: {', '.join(reasons)}. Bake again to play what the scene has.")
        else:
            self.tell(f"{thing.name} plays from {folder}.")


class ClearBake(Reporting, bpy.types.Operator):
    bl_idname = "jghand.clear_bake"
    bl_label = "Clear Bake"
    bl_description = (
        "Draw this hand itself again, take its playing bake out of the scene and forget the bake. "
        "Its files stay on the disk"
    )

    poll = classmethod(_poll_baked)

    def run(self, context: bpy.types.Context) -> None:
        thing = context.object
        bakes.stop(context, bakes.folder_of(thing))
        thing.jghand.bake = ""
        thing.jghand.show_in_viewport = True


CLASSES = (Export, Bake, PlayBake, ClearBake)
