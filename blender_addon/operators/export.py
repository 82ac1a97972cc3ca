# SPDX-License-Identifier: GPL-3.0-or-later
"""Exports and bakes: what the hands do, as files that need no Blender, no engine, or neither."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from .. import runtime
from ..bridge import baked_points, cache_player, job_watch, record, usd_hook, versions
from ..bridge.classes import register_classes, unregister_classes
from ..bridge.seen_hands import avatar_of
from ..core import bakes, engine_words, splat_cache
from ..core.engine_words import UsdChoices
from ..core.jobs import JobSpec
from ..core.messages import JGHandFailure
from ..core.recording import Recording, file_names
from . import output_common
from .common import PLUMBING, REGISTERED, UNDOABLE, Reporting, missing
from .output_common import StartsJob, place, poll_hands, scratch


class Export(StartsJob, bpy.types.Operator):
    """Operator: USD, PLY or motion files."""

    bl_idname = "jghand.export"
    bl_label = "Export"
    bl_description = "Write what the hands do over the range of frames into the folder. Esc cancels"
    bl_options = REGISTERED

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return poll_hands(cls, context)

    @classmethod
    def description(cls, context: bpy.types.Context, _properties: bpy.types.OperatorProperties) -> str:
        """The tooltip names the format."""
        texts = {
            "usd": "Write an animated OpenUSD stage per hand into the folder. Esc cancels",
            "ply": "Write a splat file per hand and frame into the folder. Esc cancels",
            "motion": "Write a motion file per hand into the folder: no engine is needed",
        }
        return texts[context.scene.jghand.output.format]

    def prepare(self, context: bpy.types.Context) -> None:
        place(context, context.scene.jghand.output.folder)
        if context.scene.jghand.output.format != "motion":
            runtime.program()

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> JobSpec | None:
        settings = context.scene.jghand.output
        folder = place(context, settings.folder)
        self._count = len(recordings)
        if settings.format == "motion":
            for recording in recordings:
                recording.save(folder / f"{recording.name}.npz")
            return None
        commands = []
        for number, recording in enumerate(recordings):
            motion, figures = scratch(f"export_{number}.npz"), scratch(f"export_{number}.json")
            recording.save(motion)
            if settings.format == "ply":
                words = engine_words.export_ply(recording, motion, folder, figures, settings.axes)
            else:
                words = engine_words.export_usd(recording, motion, folder, figures, _choices(context))
            commands.append((*runtime.program(), *words))
        title = "Exporting PLY" if settings.format == "ply" else "Exporting USD"
        return JobSpec("export", title, commands[0], folder, more=tuple(commands[1:]))

    def done(self, context: bpy.types.Context) -> str:
        folder = place(context, context.scene.jghand.output.folder)
        return rpt_("Exported {count} hands to {folder}.").format(count=self._count, folder=folder)


class Bake(StartsJob, bpy.types.Operator):
    """Operator: every frame to disk, so that it plays without the engine."""

    bl_idname = "jghand.bake"
    bl_label = "Bake"
    bl_description = (
        "Write every frame of the range to disk, so that it plays without the engine: as USD points, or as splats "
        "where this Blender draws them. Esc cancels"
    )
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return poll_hands(cls, context)

    def prepare(self, context: bpy.types.Context) -> None:
        place(context, context.scene.jghand.output.bake_folder)
        runtime.program()

    def recorded_hands(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        things = output_common.hands_to_write(context)
        self._uids = [thing.session_uid for thing in things]
        return things

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> JobSpec:
        folder = place(context, context.scene.jghand.output.bake_folder)
        things = things_of(context, self._uids)
        commands = []
        stamped = []
        shown = "splats" if versions.has_native_splats() else "points"
        settings = context.scene.jghand.output
        choices = UsdChoices(shown, "constant", "srgb", settings.width_factor)
        names = file_names([thing.name for thing in things])
        for (thing, own), name in zip(_by_object(things, recordings, context), names, strict=True):
            target = folder / name
            bakes.unstamp(target)
            for recording in own:
                motion, figures = target / f"{recording.name}.npz", target / f"{recording.name}.json"
                recording.save(motion)
                words = engine_words.export_usd(recording, motion, target, figures, choices)
                commands.append((*runtime.program(), *words))
                splat_cache.clear(target, recording.name)
                if settings.use_cache or not versions.has_usd():
                    out = splat_cache.cache_folder(target, recording.name)
                    words = engine_words.export_cache(recording, motion, out, scratch("cache.json"))
                    commands.append((*runtime.program(), *words))
            stamped.append((target, own))
            thing.jghand.bake = _beside_the_file(context, target)
        finish = partial(_stamp_all, stamped)
        self._folder, self._targets = folder, [target for target, _ in stamped]
        return JobSpec("bake", "Baking", commands[0], folder, on_done=finish, more=tuple(commands[1:]))

    def done(self, context: bpy.types.Context) -> str:
        for target in self._targets:
            # what plays the bake before is shown the new one
            if baked_points.stop(context, target):
                _play_all(context, target)
        return rpt_("Baked into {folder}.").format(folder=self._folder)


class PlayBake(Reporting, bpy.types.Operator):
    """Operator: the bake of the active hand as an object."""

    bl_idname = "jghand.play_bake"
    bl_label = "Play Bake"
    bl_description = (
        "Bring the bake of this hand into the scene as an object that plays with neither engine nor extension, "
        "and stop drawing the hand itself in the viewport"
    )
    bl_options = UNDOABLE

    accept_stale: bpy.props.BoolProperty(
        name="As It Is",
        description="Play a bake of another pose, avatar or engine too",
        default=False,
        options={"SKIP_SAVE"},
    )  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll_baked(cls, context)

    def run(self, context: bpy.types.Context) -> None:
        thing = context.object
        folder = bake_folder(thing)
        hands = bakes.read_bake(folder)
        reasons = stale_now(context, thing, hands, folder)
        if reasons and not self.accept_stale:
            raise JGHandFailure("stale_bake", f"{thing.name}: {', '.join(reasons)}")
        baked_points.stop(context, folder)
        _play_all(context, folder)
        thing.jghand.show_in_viewport = False
        if reasons:
            self.warn(rpt_("The bake is played as it is, but {reasons}.").format(reasons=", ".join(reasons)))
        else:
            self.tell(rpt_("{name} plays from {folder}.").format(name=thing.name, folder=folder))


class CheckBake(StartsJob, bpy.types.Operator):
    """Operator: whether a bake is still of what the scene has, on every frame."""

    bl_idname = "jghand.check_bake"
    bl_label = "Check Bake"
    bl_description = "Go through all frames and compare this hand with its bake: pose, avatar, frames and engine"
    bl_options = REGISTERED

    working = "Comparing with the bake"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll_baked(cls, context)

    def recorded_hands(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        return [context.object]

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> None:
        folder = bake_folder(context.object)
        found = {hand.handedness: hand for hand in bakes.read_bake(folder)}
        reasons = []
        for recording in recordings:
            hand = found.get(recording.handedness)
            if hand is None:
                reasons.append("a hand is not in it")
            else:
                reasons += bakes.stale_reasons(hand, recording=recording, engine_version=engine_version())
        if reasons:
            raise JGHandFailure("stale_bake", ", ".join(dict.fromkeys(reasons)))

    def done(self, context: bpy.types.Context) -> str:
        return rpt_("The bake of {name} is what the scene has.").format(name=context.object.name)


class ClearBake(Reporting, bpy.types.Operator):
    """Operator: the hand is live again."""

    bl_idname = "jghand.clear_bake"
    bl_label = "Clear Bake"
    bl_description = (
        "Draw this hand itself again, take its playing bake out of the scene and forget the bake. "
        "Its files stay on the disk"
    )
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll_baked(cls, context)

    def run(self, context: bpy.types.Context) -> None:
        thing = context.object
        baked_points.stop(context, bake_folder(thing))
        thing.jghand.bake = ""
        thing.jghand.show_in_viewport = True


class ExportSceneUsd(Reporting, bpy.types.Operator):
    """Operator: Blender's own USD export, with the baked splats in it."""

    bl_idname = "jghand.export_scene_usd"
    bl_label = "Export Scene as USD"
    bl_description = "Write the whole scene with Blender's own USD export; hands that are baked are in it as splats"
    bl_options = REGISTERED

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    filter_glob: bpy.props.StringProperty(default="*.usd;*.usda;*.usdc;*.usdz", options={"HIDDEN"})  # type: ignore[valid-type]

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        if not versions.has_usd():
            return missing(cls, "This Blender was built without USD")
        if not getattr(usd_hook.JGHandUsdHook, "is_registered", False):
            return missing(cls, "This Blender's USD cannot be reached from Python, so splats cannot be added")
        return True

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        self.filepath = self.filepath or bpy.path.ensure_ext(context.blend_data.filepath or "scene", ".usdc")
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def run(self, _context: bpy.types.Context) -> None:
        path = Path(bpy.path.abspath(self.filepath))
        try:
            bpy.ops.wm.usd_export(filepath=str(path), export_animation=True)
        except RuntimeError as error:
            raise JGHandFailure("cannot_write", f"{path}: {error}") from error
        left_out = [note for note in usd_hook.notes if "left out" in note]
        if left_out:
            self.warn(*usd_hook.notes)
        else:
            self.tell(rpt_("Wrote {path}.").format(path=path), *usd_hook.notes)


class CancelJob(Reporting, bpy.types.Operator):
    """Operator: the button beside a job's progress."""

    bl_idname = "jghand.cancel_job"
    bl_label = "Cancel"
    bl_description = "Stop this job. What it has finished stays; a training first writes a checkpoint"
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
        text = bpy.data.texts.new(f"JGHand {self.key}.log")
        text.write("\n".join(lines))
        self.tell(rpt_("The log is the text {name}.").format(name=text.name))


def engine_version() -> str | None:
    """The version of the engine that runs, None while that is not known."""
    handshake = runtime.link().status.handshake
    return str(handshake.get("engine_version")) if handshake else None


def stale_now(
    context: bpy.types.Context, thing: bpy.types.Object, hands: list[bakes.BakedHand], folder: Path
) -> list[str]:
    """Why a bake does not show the hand of the shown frame; [] when nothing speaks against it."""
    now = record.joints_now(context, thing)
    reasons = []
    for hand in hands:
        reasons += bakes.stale_reasons(hand, avatar=avatar_of(thing), engine_version=engine_version())
        joints_m = now.get(hand.handedness)
        if joints_m is not None and bakes.moved_at(hand, folder, context.scene.frame_current_final, joints_m):
            reasons.append("the hand moves in another way")
    return list(dict.fromkeys(reasons))


def things_of(context: bpy.types.Context, uids: list[int]) -> list[bpy.types.Object]:
    """Objects by their session_uid: references do not outlive what happens between two events."""
    by_uid = {thing.session_uid: thing for thing in context.scene.objects}
    if any(uid not in by_uid for uid in uids):
        raise JGHandFailure("no_hand", "it was deleted meanwhile")
    return [by_uid[uid] for uid in uids]


def _play_all(context: bpy.types.Context, folder: Path) -> None:
    """Plays all hands of a bake; what was active and selected stays so."""
    layer = context.view_layer.objects
    active, selected = layer.active, list(layer.selected)
    for hand in bakes.read_bake(folder):
        if versions.has_usd():
            baked_points.play(context, hand, folder).select_set(False)
        else:
            cache_player.play(context, hand, folder, width=context.scene.jghand.output.width_factor)
    for thing in selected:
        thing.select_set(True)
    layer.active = active


def _choices(context: bpy.types.Context) -> UsdChoices:
    settings = context.scene.jghand.output
    return UsdChoices(settings.variant, settings.sizes, settings.radiance, settings.width_factor)


def _by_object(
    things: list[bpy.types.Object], recordings: list[Recording], context: bpy.types.Context
) -> list[tuple[bpy.types.Object, list[Recording]]]:
    """The recordings of each object: a foreign rig may be two hands."""
    left = iter(recordings)
    counts = [len(record.joints_now(context, thing)) for thing in things]
    return [(thing, [next(left) for _ in range(count)]) for thing, count in zip(things, counts, strict=True)]


def _stamp_all(stamped: list[tuple[Path, list[Recording]]]) -> None:
    for folder, recordings in stamped:
        bakes.write_stamp(folder, recordings)


def _beside_the_file(context: bpy.types.Context, folder: Path) -> str:
    """A folder relative to the file where it can be, so that both can be given away together."""
    if context.blend_data.filepath and context.scene.jghand.output.bake_folder.startswith("//"):
        return bpy.path.relpath(str(folder))
    return str(folder)


def bake_folder(thing: bpy.types.Object) -> Path:
    """The folder of a hand's bake."""
    return Path(bpy.path.abspath(thing.jghand.bake, library=thing.library)).absolute()


def _poll_baked(operator: type, context: bpy.types.Context) -> bool:
    thing = context.object
    if thing is None or not thing.jghand.bake:
        return missing(operator, "Select a hand that was baked")
    return True


_CLASSES = (Export, Bake, PlayBake, CheckBake, ClearBake, ExportSceneUsd, CancelJob, ShowJobLog)


def register() -> None:
    """Adds the operators."""
    register_classes(_CLASSES)


def unregister() -> None:
    """Takes them away."""
    unregister_classes(_CLASSES)
