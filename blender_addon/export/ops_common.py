# SPDX-License-Identifier: GPL-3.0-or-later
"""What exports, bakes and trainings share: first the hands are recorded in turns, then a job works beside Blender.

While the job works Blender stays free; Esc in the window where it was started cancels it, as with Blender's own jobs,
and so does the panel's button. Without a window, or from a script that asks for it, the operator waits for the job.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..core import limits
from ..errors import JGHandFailure
from ..hand import armature
from ..ops import CANCELLED, DONE, ERROR, INFO, InTurns, missing, seen_frames, sentence_of
from ..renderer import job_watch, runtime
from ..renderer.job_state import Phase
from ..renderer.jobs import Job, JobSpec
from ..ui import redraw
from . import record
from .recording import Recording, check_place, with_file_name


class StartsJob(InTurns):
    """An operator that records hands and then starts a job. `job(context, recordings)` says which, None for none;
    `done(context)` is called after it succeeded, and returns a sentence."""

    wait: bpy.props.BoolProperty(
        name="Wait",
        description="Return when the job has ended, not when it has started; always so without a window",
        default=False,
        options={"SKIP_SAVE", "HIDDEN"},
    )  # type: ignore[valid-type]

    working = "Reading the animation"
    key = job_watch.OUTPUT
    # whether the operator stays until the job has ended, so that Esc ends it: not for hours
    watched = True
    _job: Job | None = None

    def recorded_hands(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """The objects whose hands are recorded; none where a job needs no motion."""
        return hands_to_write(context)

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> JobSpec | None:
        """The job."""
        raise NotImplementedError

    def done(self, _context: bpy.types.Context) -> str:
        """What is told, and done, when the job has succeeded."""
        return ""

    def prepare(self, _context: bpy.types.Context) -> None:
        """What can be refused before anything is done. JGHandFailure."""

    def steps(self, context: bpy.types.Context) -> Iterator[float]:
        """A step per frame."""
        refuse_second(self.key)
        self.prepare(context)
        self._recordings: list[Recording] = []
        things = self.recorded_hands(context)
        if things:
            yield from record.record_steps(context, things, frames_to_write(context), self._recordings)

    def finished(self, context: bpy.types.Context) -> None:
        spec = self.job(context, self._recordings)
        if spec is None:
            self.tell(self.done(context))
            return
        self._job = runtime.jobs().start(self.key, spec)
        job_watch.start()

    def run(self, context: bpy.types.Context) -> None:
        super().run(context)
        if self._job is not None and (self.wait or not job_watch.timers_fire()):
            self._job.wait(limits.JOB_WAIT_S)
            self._end(context, self._job)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """First the turns, which nothing may disturb; then a look at the job now and then."""
        if self._job is None:
            result = super().modal(context, event)
            if self._job is None or result != DONE or not self.watched:
                return result
            self._timer = context.window_manager.event_timer_add(limits.JOB_LOOK_S, window=context.window)
            return {"RUNNING_MODAL"}
        # the Esc that ends playback is playback's
        if event.type == "ESC" and event.value == "PRESS" and not context.screen.is_animation_playing:
            self._job.cancel()
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        runtime.jobs().tick()
        context.workspace.status_text_set(
            rpt_("{title}: {sentence}  ·  Esc cancels").format(
                title=rpt_(self._job.spec.title), sentence=self._job.state.sentence(rpt_)
            )
        )
        redraw()
        if not self._job.is_over:
            return {"PASS_THROUGH"}
        self.cancel(context)
        try:
            self._end(context, self._job)
        except JGHandFailure as failure:
            self.report(ERROR, sentence_of(failure))
            return CANCELLED
        return DONE

    def _end(self, context: bpy.types.Context, job: Job) -> None:
        if job.state.phase is Phase.DONE:
            self.tell(self.done(context))
        elif job.state.phase is Phase.FAILED and job.state.failure is not None:
            raise job.state.failure
        else:
            self.report(INFO, rpt_("Canceled"))


def hands_to_write(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The hands that the scene's settings choose, by name."""
    layer = context.view_layer
    if context.scene.jghand.output.hands == "all":
        return armature.hands_at_any_frame(layer)
    chosen = {thing for thing in (context.object, *layer.objects.selected) if thing is not None}
    return sorted(filter(armature.is_any_hand, chosen), key=lambda thing: thing.name)


def frames_to_write(context: bpy.types.Context) -> range:
    """The frames that the scene's settings choose."""
    settings = context.scene.jghand.output
    if settings.use_scene_range:
        return seen_frames(context.scene)
    return range(settings.frame_start, settings.frame_end + 1)


def poll_hands_to_write(operator: type, context: bpy.types.Context) -> bool:
    """Whether there is something to write."""
    if not hands_to_write(context):
        if context.scene.jghand.output.hands == "all":
            return missing(operator, "There is no hand in this view layer that is rendered")
        return missing(operator, "Select a hand, or choose All")
    if not frames_to_write(context):
        return missing(operator, "The last frame comes before the first")
    return poll_job(operator, job_watch.OUTPUT)


def poll_job(operator: type, key: str) -> bool:
    """Whether no job of a kind runs."""
    job = runtime.jobs().get(key)
    if job is not None and not job.is_over:
        return missing(operator, "This is running already: wait until it has ended, or cancel it")
    return True


def refuse_second(key: str) -> None:
    """JGHandFailure (job_running) while a job of that kind runs: said before minutes of recording."""
    job = runtime.jobs().get(key)
    if job is not None and not job.is_over:
        raise JGHandFailure("job_running", job.spec.title)


def place(context: bpy.types.Context, text: str) -> Path:
    """A folder or a file as the settings name it. JGHandFailure: no_place."""
    check_place(text, saved=bool(context.blend_data.filepath))
    return Path(bpy.path.abspath(with_file_name(text, context.blend_data.filepath))).absolute()
