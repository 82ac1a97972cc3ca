# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes: every frame of a hand on disk, so that it plays without the engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from .. import folders, ui, versions
from ..errors import JGHandFailure
from ..hand.seen_hands import avatar_of
from ..ops import REGISTERED, UNDOABLE, Reporting, missing, wait_cursor
from ..renderer import engine_words, runtime
from ..renderer.engine_words import UsdChoices
from ..renderer.jobs import JobSpec
from . import bake_folders, baked_points, bakes, ops_common, record
from .ops_common import StartsJob, place, poll_hands_to_write
from .recording import Recording, file_names


@dataclass(frozen=True)
class NewBake:
    """A bake that is being made. uid: session_uid of its object, which may be gone when it is finished · own: the id
    of the object's bakes · owner: what its stamp says · generation: its folder · recordings: of its one or two hands"""

    uid: int
    own: str
    owner: str
    generation: Path
    recordings: tuple[Recording, ...]


class Bake(StartsJob, bpy.types.Operator):
    """Operator: every frame to disk, so that it plays without the engine."""

    bl_idname = "jghand.bake"
    bl_label = "Bake"
    bl_description = (
        "Write every frame of the range to disk, so that it plays without the renderer: as USD points, or as splats "
        "where this Blender draws them. An earlier bake stays until this one is finished. Esc cancels"
    )
    # the scene is changed when the job has ended, whoever notices that: the step for undo is made there
    bl_options = REGISTERED

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return poll_hands_to_write(cls, context)

    def prepare(self, context: bpy.types.Context) -> None:
        place(context, context.scene.jghand.output.bake_folder)
        runtime.program()

    def recorded_hands(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        things = ops_common.hands_to_write(context)
        self._uids = [thing.session_uid for thing in things]
        return things

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> JobSpec:
        self._folder = place(context, context.scene.jghand.output.bake_folder)
        things = things_of(context, self._uids)
        names = file_names([thing.name for thing in things])
        made: list[NewBake] = []
        clean = partial(_clean, made)
        try:
            for (thing, own), name in zip(_by_object(things, recordings, context), names, strict=True):
                made.append(_new_bake(context, thing, own, self._folder / name))
            commands = [words for bake in made for words in _commands(context, bake)]
        except JGHandFailure:
            clean()
            raise
        finish = partial(_finish, made)
        return JobSpec(
            "bake", "Baking", commands[0], self._folder, on_done=finish, more=tuple(commands[1:]), on_over=clean
        )

    def done(self, _context: bpy.types.Context) -> str:
        return rpt_("Baked into {folder}.").format(folder=self._folder)


class PlayBake(Reporting, bpy.types.Operator):
    """Operator: the bake of the active hand as an object."""

    bl_idname = "jghand.play_bake"
    bl_label = "Play Bake"
    bl_description = (
        "Bring the bake of this hand into the scene as an object that plays with neither renderer nor extension, "
        "and stop drawing the hand itself in the viewport"
    )
    bl_options = UNDOABLE

    accept_stale: bpy.props.BoolProperty(
        name="Play Anyway",
        description="Play a bake of another pose, avatar or renderer too",
        default=False,
        options={"SKIP_SAVE"},
    )  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll_baked(cls, context)

    def run(self, context: bpy.types.Context) -> None:
        thing = context.object
        folder = bake_folders.bake_folder(thing)
        hands = bakes.read_bake(folder)
        reasons = stale_now(context, thing, hands, folder)
        if reasons and not self.accept_stale:
            raise JGHandFailure("stale_bake", f"{thing.name}: {', '.join(map(rpt_, reasons))}")
        with wait_cursor(context):  # Blender's own import cannot be cut into turns
            baked_points.stop(context, folder)
            _play_all(context, folder)
        thing.jghand.show_in_viewport = False
        if reasons:
            said = ", ".join(map(rpt_, reasons))
            self.warn(rpt_("The bake is played as it is, but {reasons}.").format(reasons=said))
        else:
            self.tell(rpt_("{name} plays from {folder}.").format(name=thing.name, folder=folder))


class CheckBake(StartsJob, bpy.types.Operator):
    """Operator: whether a bake is still of what the scene has, on every frame."""

    bl_idname = "jghand.check_bake"
    bl_label = "Check Bake"
    bl_description = "Go through all frames and compare this hand with its bake: pose, avatar, frames and renderer"
    bl_options = REGISTERED

    working = "Comparing with the bake"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _poll_baked(cls, context)

    def recorded_hands(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        return [context.object]

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> None:
        folder = bake_folders.bake_folder(context.object)
        found = {hand.handedness: hand for hand in bakes.read_bake(folder)}
        reasons = []
        for recording in recordings:
            hand = found.get(recording.handedness)
            if hand is None:
                reasons.append("a hand is not in it")
            else:
                reasons += bakes.stale_reasons(hand, recording=recording, engine_version=engine_version())
        if reasons:
            raise JGHandFailure("stale_bake", ", ".join(map(rpt_, dict.fromkeys(reasons))))

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
        baked_points.stop(context, bake_folders.bake_folder(thing))
        thing.jghand.bake = ""
        thing.jghand.show_in_viewport = True


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


def _new_bake(
    context: bpy.types.Context, thing: bpy.types.Object, recordings: list[Recording], wanted: Path
) -> NewBake:
    """Makes the folder of a bake; the scene is not changed before the bake is finished."""
    own = bake_folders.own_id(thing)
    owner = bake_folders.owner_text(own, wanted.parent)
    generation = bakes.new_generation(bakes.hand_folder(wanted.parent, wanted.name, owner))
    return NewBake(thing.session_uid, own, owner, generation, tuple(recordings))


def _commands(context: bpy.types.Context, bake: NewBake) -> list[tuple[str, ...]]:
    """Writes the motions of a bake, and says what the engine is asked for."""
    shown = "splats" if versions.has_native_splats() else "points"
    choices = UsdChoices(shown, "constant", "srgb", context.scene.jghand.output.bake_width_factor)
    commands = []
    for recording in bake.recordings:
        motion, figures = (bake.generation / f"{recording.name}{suffix}" for suffix in (".npz", ".json"))
        recording.save(motion)
        commands.append(engine_words.export_usd(recording, motion, bake.generation, figures, choices))
    return [(*runtime.program(), *words) for words in commands]


def _finish(made: Sequence[NewBake]) -> None:
    """The engine has succeeded: bakes become finished ones, hands and players go over to them, the earlier ones are
    removed. Whoever looks after the job calls this, perhaps while another file is open: then no hand is touched."""
    for bake in made:
        bakes.write_stamp(bake.generation, bake.recordings, bake.owner)
    with ui.one_step("Bake") as context:
        for bake in made:
            thing = next((thing for thing in bpy.data.objects if thing.session_uid == bake.uid), None)
            if thing is not None and thing.is_editable:
                _switch(context, thing, bake)


def _switch(context: bpy.types.Context, thing: bpy.types.Object, bake: NewBake) -> None:
    before = bake_folders.bake_folder(thing) if thing.jghand.bake else None
    thing.jghand.bake_id = bake.own
    thing.jghand.bake = folders.beside_the_file(context, bake.generation)
    if before is None or before == bake.generation:
        return
    # what plays the bake before is shown the new one
    if baked_points.stop(context, before):
        _play_all(context, bake.generation)
    bakes.remove(before, bake_folders.owner_text(bake.own, before.parent.parent))


def _clean(made: Sequence[NewBake]) -> None:
    for bake in made:
        bakes.remove_unfinished(bake.generation)


def _play_all(context: bpy.types.Context, folder: Path) -> None:
    """Plays all hands of a bake; what was active and selected stays so."""
    layer = context.view_layer.objects
    active, selected = layer.active, list(layer.selected)
    for hand in bakes.read_bake(folder):
        baked_points.play(context, hand, folder).select_set(False)
    for thing in selected:
        thing.select_set(True)
    layer.active = active


def _by_object(
    things: list[bpy.types.Object], recordings: list[Recording], context: bpy.types.Context
) -> list[tuple[bpy.types.Object, list[Recording]]]:
    """The recordings of each object: a foreign rig may be two hands."""
    left = iter(recordings)
    counts = [len(record.joints_now(context, thing)) for thing in things]
    return [(thing, [next(left) for _ in range(count)]) for thing, count in zip(things, counts, strict=True)]


def _poll_baked(operator: type, context: bpy.types.Context) -> bool:
    thing = context.object
    if thing is None or not thing.jghand.bake:
        return missing(operator, "Select a hand that was baked")
    return True


CLASSES = (Bake, PlayBake, CheckBake, ClearBake)
