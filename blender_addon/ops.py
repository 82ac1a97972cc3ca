# SPDX-License-Identifier: GPL-3.0-or-later
"""What operators share: a failure becomes a report, a poll says what is missing, long work goes on in turns."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import bpy
from bpy_extras.io_utils import ImportHelper

from . import ui
from .core.panel_text import duration, in_blenders_words
from .errors import JGHandFailure
from .hand import armature, controls
from .renderer.jobs import JOB_LOOK_S, Job, Phase

# one turn of work on Blender's main thread, between two of which Blender draws and hears Esc (which is to be answered
# within 0.2 s); how often the status bar is drawn anew, which draws the whole window; the time between turns
WORK_TURN_S, WORK_TELL_S, WORK_REST_S = 0.1, 0.25, 0.005
# how long it is slept between two looks at work elsewhere, without a window
ASIDE_LOOK_S = 0.02

DONE, CANCELLED = {"FINISHED"}, {"CANCELLED"}
# what operators are registered as: changing data, importing, changing nothing that undo knows, plumbing of panels
UNDOABLE, UNDOABLE_IMPORT = {"REGISTER", "UNDO"}, {"REGISTER", "UNDO", "PRESET"}
REGISTERED, PLUMBING, UNDOABLE_PLUMBING = {"REGISTER"}, {"INTERNAL"}, {"REGISTER", "UNDO", "INTERNAL"}
INFO, WARNING, ERROR = {"INFO"}, {"WARNING"}, {"ERROR"}


def sentence_of(failure: JGHandFailure) -> str:
    """What a report says: the sentence, the remedy, the small print."""
    advice = failure.advice
    text = f"{advice.sentence}. {advice.remedy}"
    detail = in_blenders_words(failure.detail)
    return f"{text} ({detail})" if detail else text


class Reporting:
    """An operator whose `run(context)` may raise JGHandFailure: it becomes an error report, and nothing is undone that
    was not done. `run` returns nothing; a sentence it wants to tell goes through `tell` or `warn`."""

    # Blender's, of the operator that this is mixed into
    bl_idname: str
    bl_options = UNDOABLE
    report: Callable[[set[str], str], None]
    as_keywords: Callable[[], dict[str, Any]]

    def run(self, context: bpy.types.Context) -> None:
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            self.run(context)
        except JGHandFailure as failure:
            self.report(ERROR, ui.popup_text(sentence_of(failure)))
            return CANCELLED
        ui.redraw()
        return DONE

    def tell(self, *sentences: str, doubts: Sequence[str] = ()) -> None:
        """One report of all that was done, none of nothing. doubts: what an artist should look at"""
        text = " ".join(sentence for sentence in (*sentences, *doubts) if sentence)
        if text:
            self.report(WARNING if doubts else INFO, text)

    def warn(self, *sentences: str) -> None:
        self.tell(doubts=sentences)


class Elsewhere(float):
    """The part that is done of work which goes on in another process: as long as a generator of `InTurns` yields this,
    it holds nothing of Blender's, and the artist goes on with other things."""


def followed(job: Job) -> Generator[Elsewhere, None, None]:
    """Looks at a job, once a step, until it is done. JGHandFailure: why it failed, canceled."""
    while not job.is_over:
        yield Elsewhere(job.state.fraction or 0.0)
        job.tick()
    if job.state.failure is not None:
        raise job.state.failure
    if job.state.phase is not Phase.DONE:
        raise JGHandFailure("canceled")


class InTurns(Reporting):
    """An operator whose `steps(context)` is a generator of the part that is done, 0 to 1. In a window it works a turn
    at a time: the status bar says how far it is, and Esc ends it; else it works through. Meanwhile Blender takes no
    other input, but for times in which the work is `Elsewhere`.

    `finished(context)` is called at the end. What `steps` holds open it must put back when it is closed half-way; Esc
    raises JGHandFailure (canceled) in it.
    """

    working = ""
    _steps: Generator[float, None, None] | None = None
    _timer: bpy.types.Timer | None = None
    _is_elsewhere = False
    _started = _told = 0.0

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        raise NotImplementedError

    def run(self, context: bpy.types.Context) -> None:
        for part in self.steps(context):
            if isinstance(part, Elsewhere):
                time.sleep(ASIDE_LOOK_S)
        self.finished(context)

    def finished(self, _context: bpy.types.Context) -> None:
        """What is left to do, or to tell, at the end."""

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if bpy.app.background or context.window is None:
            return self.execute(context)
        self._steps, self._started = self.steps(context), time.monotonic()
        self._tick_every(context, WORK_REST_S)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def begin_anew(self, **values: Any) -> None:
        """Another one of this operator, in turns: the dialog that called `execute` would not hear of these."""
        # not self.bl_idname, which is JGHAND_OT_…
        getattr(bpy.ops.jghand, type(self).bl_idname.partition(".")[2])("INVOKE_DEFAULT", **values)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """One turn; everything else waits, so that nothing changes under it, unless the work is elsewhere."""
        goes_on = {"PASS_THROUGH"} if self._is_elsewhere else {"RUNNING_MODAL"}
        is_ended = event.type == "ESC"
        if self._is_elsewhere:  # an Esc may be meant for playback
            is_ended &= event.value == "PRESS" and not context.screen.is_animation_playing
        if not is_ended and (event.type != "TIMER" or (self._is_elsewhere and _something_is_dragged(context))):
            return goes_on
        try:
            if is_ended and self._steps is not None:
                self._steps.throw(JGHandFailure("canceled"))
            part = self._turn()
            if part is None:
                self.finished(context)
        except JGHandFailure as failure:
            self.cancel(context)
            self.report(INFO if failure.kind == "canceled" else ERROR, ui.popup_text(sentence_of(failure)))
            return CANCELLED
        except BaseException:
            self.cancel(context)
            raise
        if part is None:
            self.cancel(context)
            ui.redraw()
            return DONE
        if isinstance(part, Elsewhere) != self._is_elsewhere:
            self._is_elsewhere = not self._is_elsewhere
            self._tick_every(context, JOB_LOOK_S if self._is_elsewhere else WORK_REST_S)
        if time.monotonic() - self._told > WORK_TELL_S:
            context.workspace.status_text_set(self._progress(part))
            self._told = time.monotonic()
        return goes_on

    def cancel(self, context: bpy.types.Context) -> None:
        """Ends the turns, at the end and half-way; Blender calls it too, when a window closes."""
        self._tick_every(context, None)
        if self._steps is not None:
            self._steps.close()
            self._steps = None
        context.workspace.status_text_set(None)

    def _tick_every(self, context: bpy.types.Context, seconds: float | None) -> None:
        """How often a turn comes; None: no more."""
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if seconds is not None:
            self._timer = context.window_manager.event_timer_add(seconds, window=context.window)

    def _turn(self) -> float | None:
        """The part that is done after one turn; None at the end. What is elsewhere is looked at once."""
        ends = time.monotonic() + WORK_TURN_S
        part: float | None = 0.0
        while self._steps is not None and time.monotonic() < ends:
            part = next(self._steps, None)
            if part is None or isinstance(part, Elsewhere):
                break
        return part

    def _progress(self, part: float) -> str:
        if part <= 0.0:  # nothing to foretell from yet
            return f"{self.working}  ·  Esc cancels"
        left_s = (time.monotonic() - self._started) * (1.0 - part) / max(part, 1e-3)
        return f"{self.working}  {round(100 * part)}%  ·  {duration(left_s)} left  ·  Esc cancels"


class FromFile(InTurns, ImportHelper):
    """An operator that asks for a file, with its properties `choices` beside it and `headings` above some of them. A
    file that is named when it is called was dropped, or is a script's, and is taken without asking."""

    choices: tuple[str, ...] = ()
    headings: Mapping[str, str] = MappingProxyType({})
    # whether the file browser calls `execute`
    _asked = False

    filename_ext = ""
    # not remembered: a file that is named, also by the file browser, is taken
    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    chosen: bpy.props.BoolProperty(options={"SKIP_SAVE", "HIDDEN"})
    hand_length: bpy.props.FloatProperty(
        name="Hand Length",
        description="Wrist to tip of the middle finger; 0: the file's; of a film the avatar's, or the built-in hand's",
        min=0.0,
        soft_max=250.0,
        precision=0,
        subtype="DISTANCE_CAMERA",  # Blender's word for millimeters, whatever the scene's unit is
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Asks for a file, unless one is named."""
        if self.chosen or (self.filepath and Path(self.filepath).is_file()):
            return super().invoke(context, event)
        self._asked = True
        return ImportHelper.invoke(self, context, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """All at once; after the file browser, which forgets an operator that is not done, another one in turns."""
        if not self._asked or context.window is None:
            return super().execute(context)
        self._asked = False
        self.begin_anew(chosen=True, **{name: getattr(self, name) for name in ("filepath", *self.choices)})
        return CANCELLED

    def draw(self, _context: bpy.types.Context) -> None:
        """The options beside the files."""
        column = ui.settings(self.layout)
        for name in self.choices:
            if name in self.headings:
                column.separator()
                column.label(text=self.headings[name])
            column.prop(self, name)


def _something_is_dragged(context: bpy.types.Context) -> bool:
    """Whether the artist moves something right now: nothing may be changed under that."""
    running = [one for operator in context.window.modal_operators for one in (operator, *operator.macros)]
    return any(one.bl_idname.startswith("TRANSFORM_OT_") for one in running)


@contextlib.contextmanager
def wait_cursor(context: bpy.types.Context) -> Iterator[None]:
    """The pointer that says wait, for what cannot be cut into turns."""
    window = None if bpy.app.background else context.window
    if window is not None:
        window.cursor_modal_set("WAIT")
    try:
        yield
    finally:
        if window is not None:
            window.cursor_modal_restore()


def missing(operator: type, sentence: str) -> bool:
    """For `poll`: says what is missing; False."""
    operator.poll_message_set(sentence)
    return False


def active_hand(context: bpy.types.Context) -> bpy.types.Object | None:
    thing = context.object
    return thing if thing is not None and armature.is_hand(thing) else None


def chosen_hands(
    context: bpy.types.Context, wanted: Callable[[bpy.types.Object], bool] = armature.is_hand
) -> list[bpy.types.Object]:
    """The active one first, then those that are selected."""
    things = dict.fromkeys((context.object, *context.view_layer.objects.selected))
    return [thing for thing in things if thing is not None and wanted(thing)]


def poll_hand(operator: type, context: bpy.types.Context) -> bool:
    """Whether a hand of ours is active and may be changed."""
    hand = active_hand(context)
    return poll_change(operator, context, hand) if hand is not None else missing(operator, "Select a JGHand armature")


def poll_change(operator: type, context: bpy.types.Context, thing: bpy.types.Object) -> bool:
    """Whether an object may be changed."""
    if context.mode == "EDIT_ARMATURE":
        return missing(operator, "Leave edit mode first")
    if not thing.is_editable:
        return missing(operator, f"{thing.name} is linked from another file: make it local, or an override, first")
    return True


def poll_scene(operator: type, context: bpy.types.Context) -> bool:
    """Whether anything may be added."""
    if context.scene is None or not context.scene.is_editable:
        return missing(operator, "This scene is linked from another file")
    return True


def poll_hands(operator: type, context: bpy.types.Context) -> bool:
    if not poll_hand(operator, context):
        return False
    linked = next((hand for hand in chosen_hands(context) if not hand.is_editable), None)
    if linked is not None:
        text = f"{linked.name} is linked from another file: make it local, or an override, first, or do not select it"
        return missing(operator, text)
    return True


def poll_bones(operator: type, context: bpy.types.Context) -> bool:
    """The same, where bones or constraints are added or removed."""
    if not poll_hands(operator, context):
        return False
    other = next((hand for hand in chosen_hands(context) if not controls.bones_are_own(hand)), None)
    if other is not None:
        text = f"The bones of {other.name} are another file's, in an override too: make object and armature local first"
        return missing(operator, text)
    return True


def poll_controls(operator: type, context: bpy.types.Context) -> bool:
    return poll_hand(operator, context) and (
        controls.has_controls(active_hand(context)) or missing(operator, 'Press "Add Finger Controls" first')
    )


def seen_frames(scene: bpy.types.Scene) -> range:
    """The frames that are played: the preview range where there is one."""
    if scene.use_preview_range:
        return range(scene.frame_preview_start, scene.frame_preview_end + 1)
    return range(scene.frame_start, scene.frame_end + 1)


def keys_itself(context: bpy.types.Context) -> bool:
    return context.scene.tool_settings.use_keyframe_insert_auto


def make_active(context: bpy.types.Context, thing: bpy.types.Object) -> None:
    for other in list(context.view_layer.objects.selected):
        other.select_set(False)
    thing.select_set(True)
    context.view_layer.objects.active = thing


def object_mode(context: bpy.types.Context) -> None:
    if context.mode != "OBJECT" and context.view_layer.objects.active is not None:
        bpy.ops.object.mode_set(mode="OBJECT")


def link_to_active_collection(context: bpy.types.Context, thing: bpy.types.Object) -> None:
    layer = context.view_layer.active_layer_collection
    if not layer.is_visible or layer.collection in thing.users_collection:
        return
    for collection in list(thing.users_collection):
        collection.objects.unlink(thing)
    layer.collection.objects.link(thing)
