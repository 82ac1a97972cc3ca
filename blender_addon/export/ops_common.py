# SPDX-License-Identifier: GPL-3.0-or-later
"""What exports, bakes and trainings share: first the hands are recorded in turns, then a job works beside Blender.

While the job works Blender stays free; Esc in the window where it was started cancels it, as with Blender's own jobs,
and so does the panel's button. Without a window, or from a script, the operator waits for the job.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path

import bpy
import numpy as np

from .. import ui
from ..core.view import HandInSpace
from ..errors import ADVICE, JGHandFailure
from ..hand import armature, avatar_files, sources
from ..hand.seen_hands import avatar_of
from ..ops import DONE, InTurns, chosen_hands, followed, missing, seen_frames
from ..renderer import runtime
from ..renderer.jobs import JobSpec
from .recording import Recording, file_names


class StartsJob(InTurns):
    """An operator that records hands and then starts a job. `job(context, recordings)` says which, None for none;
    `done(context)` is called after it succeeded, and returns a sentence; `overwritten(context)` says what a click is
    asked about first."""

    confirmed: bpy.props.BoolProperty(
        name="Confirmed",
        description="What is overwritten was asked about",
        options={"SKIP_SAVE", "HIDDEN"},
    )

    working = "Reading the animation"
    # what stands on the button that overwrites
    overwrite = "Overwrite"
    key: str
    # keys of jobs that it does not run beside
    never_beside: tuple[str, ...] = ()
    # whether the operator stays until the job has ended, so that Esc ends it: not for hours
    watched = True
    _is_done = False

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        jobs = map(runtime.jobs.get, (cls.key, *cls.never_beside))
        running = next((job for job in jobs if job is not None and not job.is_over), None)
        if running is None:
            return True
        return missing(cls, f"{running.spec.title} is running already: wait until it has ended, or cancel it")

    def recorded_hands(self, _context: bpy.types.Context) -> list[bpy.types.Object]:
        """The objects whose hands are recorded; none where a job needs no motion."""
        return []

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> JobSpec | None:
        raise NotImplementedError

    def done(self, _context: bpy.types.Context) -> str:
        return ""

    def prepare(self, _context: bpy.types.Context) -> None:
        """What can be refused before anything is done. JGHandFailure."""

    def overwritten(self, _context: bpy.types.Context) -> str:
        """A sentence about what would be overwritten; "" for nothing. JGHandFailure: said after the click."""
        return ""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        lost = ""
        if not self.confirmed and not bpy.app.background:
            with contextlib.suppress(JGHandFailure):
                lost = self.overwritten(context)
        if not lost:
            return super().invoke(context, event)
        self.confirmed = True
        options = {"title": f"{self.overwrite}?", "message": lost, "icon": "WARNING"}
        return context.window_manager.invoke_confirm(self, event, confirm_text=self.overwrite, **options)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """All of it; of a click that was asked about, in turns, which Blender's dialog alone would not do."""
        if self.confirmed and context.window is not None and not bpy.app.background:
            self.begin_anew(**self.as_keywords())
            return DONE
        return super().execute(context)

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        """A step per frame; then the job is looked at, unless it takes hours."""
        for key in (self.key, *self.never_beside):  # before minutes of recording
            runtime.jobs.refuse_second(key)
        self.prepare(context)
        recordings: list[Recording] = []
        things = self.recorded_hands(context)
        if things:
            yield from record_steps(context, things, frames_to_write(context), recordings)
        spec = self.job(context, recordings)
        self._is_done = spec is None
        if spec is None:
            return
        job = runtime.start_job(self.key, spec)
        if not self.watched and runtime.timers_fire():
            return
        self.working, self._started = spec.title, time.monotonic()
        try:
            yield from followed(job)
        except JGHandFailure:  # Esc; when the window is closed, or another file is opened, it goes on
            job.cancel()
            raise
        self._is_done = True

    def finished(self, context: bpy.types.Context) -> None:
        if self._is_done:
            self.tell(self.done(context))


# ---- what is recorded ------------------------------------------------------------------------------------------------


def hands_to_write(context: bpy.types.Context) -> list[bpy.types.Object]:
    if context.scene.jghand.output.hands == "all":
        return armature.hands_at_any_frame(context.view_layer)
    return sorted(chosen_hands(context, armature.is_any_hand), key=lambda thing: thing.name)


def frames_to_write(context: bpy.types.Context) -> range:
    settings = context.scene.jghand.output
    if settings.use_scene_range:
        return seen_frames(context.scene)
    return range(settings.frame_start, settings.frame_end + 1)


def record_steps(
    context: bpy.types.Context, things: Sequence[bpy.types.Object], frames: range, into: list[Recording]
) -> Iterator[float]:
    """Goes through the frames and yields the part that is done; at the end one recording per hand is in `into`.

    things: objects that are hands, a foreign rig counts up to two. The scene's frame is put back at the end, also when
    this is closed half-way. JGHandFailure: no_hand, what `sources.read_hands` raises, and
    mirrored where a hand becomes the other one on the way.
    """
    if not things or not len(frames):
        raise JGHandFailure("no_hand")
    now = context.scene
    before = now.frame_current, now.frame_subframe
    read: list[list[HandInSpace]] = []
    named: list[tuple[bpy.types.Object, str, str]] = []
    try:
        for place, frame in enumerate(frames):
            depsgraph = armature.at_frame(now, frame)
            hands = [hand for thing in things for hand in sources.read_hands(thing, depsgraph)]
            named = named or named_hands(context, things)
            turned = [name for hand, (_, side, name) in zip(hands, named, strict=True) if hand.handedness != side]
            if turned:
                raise JGHandFailure("mirrored", f"frame {frame}: {', '.join(turned)}")
            read.append(hands)
            yield (place + 1) / len(frames)
    finally:
        now.frame_set(before[0], subframe=before[1])
    fps = now.render.fps / now.render.fps_base
    for place, (thing, handedness, name) in enumerate(named):
        moments = [hands[place] for hands in read]
        joints_m = np.stack([hand.joints_world_m for hand in moments])
        avatar = avatar_of(thing)
        turns = [hand.forearm_turn for hand in moments if hand.forearm_turn is not None]
        known = len(turns) == len(read) and (avatar_files.has_forearm(avatar) or armature.has_forearm_bone(thing))
        turned = np.stack(turns) if known else None
        of_hand = thing.name, thing.jghand.forearm, turned
        into.append(Recording(name, handedness, avatar, joints_m, frames[0], fps, *of_hand))


def named_hands(
    context: bpy.types.Context, things: Sequence[bpy.types.Object]
) -> list[tuple[bpy.types.Object, str, str]]:
    """The hands of these objects, a foreign rig up to two: (object, handedness, stem of its files)."""
    depsgraph = context.evaluated_depsgraph_get()
    found = [(thing, hand.handedness) for thing in things for hand in sources.read_hands(thing, depsgraph)]
    owners = [thing for thing, _ in found]
    names = file_names([f"{thing.name}_{side}" if owners.count(thing) > 1 else thing.name for thing, side in found])
    return [(thing, side, name) for (thing, side), name in zip(found, names, strict=True)]


# ---- what can be refused ---------------------------------------------------------------------------------------------


def poll_hands_to_write(operator: type, context: bpy.types.Context) -> bool:
    if not hands_to_write(context):
        if context.scene.jghand.output.hands == "all":
            return missing(operator, "There is no hand in this view layer that is rendered")
        return missing(operator, "Select a hand, or choose All")
    if not frames_to_write(context):
        return missing(operator, "The last frame comes before the first")
    return True


def poll_usd(operator: type, context: bpy.types.Context) -> bool:
    return not ui.kept(context, lacks_usd) or missing(operator, ADVICE["no_usd"].sentence)


def lacks_usd(_context: bpy.types.Context) -> bool:
    """Whether no stages can be written; what else may be missing is said when the button is pressed."""
    try:
        runtime.program(usd=True)
    except JGHandFailure as failure:
        return failure.kind == "no_usd"
    return False


def place(context: bpy.types.Context, text: str) -> Path:
    """A folder or a file as the settings name it, with the stem of the opened file for its `{blend_name}`: files of one
    folder share their settings' defaults, and must not write over each other. JGHandFailure: no_place."""
    blend = context.blend_data.filepath
    if not text.strip():
        raise JGHandFailure("no_place", "no folder is chosen")
    if text.startswith("//") and not blend:
        raise JGHandFailure("no_place", "the folder is beside the file, and that was never saved")
    return Path(bpy.path.abspath(text.replace("{blend_name}", Path(blend).stem or "untitled"))).absolute()
