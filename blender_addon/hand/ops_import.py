# SPDX-License-Identifier: GPL-3.0-or-later
"""What Import Motion and Track Video share: a file is chosen, the engine reads it as a job, then hands are keyed in
turns. While the engine works Blender stays free; given up at any time, nothing is changed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy_extras.io_utils import ImportHelper

from .. import folders
from .. import ops as common
from ..core.aside import part_of
from ..errors import JGHandFailure
from ..export.ops_common import refuse_second
from ..ops import CANCELLED, UNDOABLE_IMPORT, Elsewhere, InTurns, missing
from ..renderer import job_watch, runtime
from ..renderer.jobs import JobSpec
from . import armature, controls, motion
from .motion_files import MotionFile

_Result = TypeVar("_Result")


class KeysFile(InTurns, ImportHelper):
    """An operator that makes keys of a file. `verb`: its name among Blender's operators · `choices`: its properties
    beside the files · `headings`: what stands above some of them · `learns`: whether
    the engine needs PyTorch for it."""

    bl_options = UNDOABLE_IMPORT
    verb = ""
    learns = False
    choices: tuple[str, ...] = ()
    headings: Mapping[str, str] = MappingProxyType({})
    # whether the file browser calls `execute`
    _asked = False

    filename_ext = ""
    # not remembered: a file that is named when the operator is called was dropped, or is a script's, and is taken
    # without asking; so is whatever was chosen in the file browser
    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    chosen: bpy.props.BoolProperty(options={"SKIP_SAVE", "HIDDEN"})  # type: ignore[valid-type]
    hand_length: bpy.props.FloatProperty(
        name="Hand Length",
        description="From the wrist to the middle finger's tip; 0: as in the file, or of a video the avatar's",
        min=0.0,
        soft_max=250.0,
        precision=0,
        subtype="DISTANCE_CAMERA",  # Blender's word for millimeters, whatever the scene's unit is
    )  # type: ignore[valid-type]
    first_frame: bpy.props.IntProperty(name="First Frame", description="Where the motion begins", default=1)  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene is None or not context.scene.is_editable:
            return missing(cls, "This scene is linked from another file")
        return True

    def hand_for(self, context: bpy.types.Context, content: MotionFile) -> bpy.types.Object | None:
        """The hand that takes a motion: the active one, where it is of the motion's side; None for a new one."""
        active = common.active_hand(context)
        fits = active is not None and active.is_editable and armature.handedness_of(active) == content.handedness
        return active if fits else None

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
        values = {name: getattr(self, name) for name in ("filepath", *self.choices)}
        getattr(bpy.ops.jghand, self.verb)("INVOKE_DEFAULT", chosen=True, **values)
        return CANCELLED

    def draw(self, _context: bpy.types.Context) -> None:
        """The options beside the files."""
        column = self.layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        for name in self.choices:
            if name in self.headings:
                column.separator()
                column.label(text=self.headings[name])
            column.prop(self, name)

    def made_by_engine(
        self, words: Callable[[Path], Sequence[str]], read: Callable[[Path], _Result], part: float
    ) -> Generator[float, None, _Result]:
        """What `read` finds in a folder, after the engine has done there what `words` of the folder say; `part` of the
        whole work. Closed half-way, the engine is asked to end and leaves nothing. JGHandFailure: why it failed."""
        refuse_second(job_watch.IMPORT)
        program, folder = runtime.program(learns=self.learns), folders.job_folder()
        results: list[_Result] = []
        spec = JobSpec(
            "import",
            self.working,
            (*program, *words(folder)),
            folder,
            on_done=lambda: results.append(read(folder)),
            on_over=lambda: folders.remove_job_folder(folder),
        )
        job = runtime.jobs().start(job_watch.IMPORT, spec)
        job_watch.start()
        try:
            while not job.is_over:
                yield Elsewhere(part * (job.state.fraction or 0.0))
                job.tick()
        finally:
            if not job.is_over:
                job.cancel()
                if not job_watch.timers_fire():
                    job.kill()
        if job.state.failure is not None:
            raise job.state.failure
        if not results:
            raise JGHandFailure("canceled")
        return results[0]

    def keying(
        self, context: bpy.types.Context, contents: Sequence[tuple[MotionFile, str]], started: float
    ) -> Generator[float, None, None]:
        """Keys motions, each with its name, and tells what was done. started: the part of the work that is done before.
        Closed half-way, or where one of them fails, none is keyed."""
        common.object_mode(context)
        wanted = [motion.WantedMotion(content, name, self.hand_for(context, content)) for content, name in contents]
        controlled = [one.hand for one in wanted if one.hand is not None and controls.has_controls(one.hand)]
        with contextlib.ExitStack() as off:
            for hand in controlled:
                off.enter_context(_controls_off(hand))
            steps = motion.import_all_steps(context, wanted, first_frame=self.first_frame)
            done = yield from part_of(steps, started, 1.0 - started)
        for one, made in zip(wanted, done, strict=True):
            if one.hand is None:
                common.link_to_active_collection(context, made.hand)
            common.make_active(context, made.hand)
        for hand in controlled:
            controls.reset_controls(hand)
            controls.mute_controls(hand, False)
            controls.use_joint_limits(hand, False)
        self._tell(context, wanted, done, controlled=bool(controlled))

    def _tell(
        self,
        context: bpy.types.Context,
        wanted: Sequence[motion.WantedMotion],
        done: Sequence[motion.ImportedMotion],
        *,
        controlled: bool,
    ) -> None:
        """What was keyed; the scene's range follows where that is wanted."""
        scene = context.scene
        scene_fps = scene.render.fps / scene.render.fps_base
        lines, lasts = [], [self.first_frame]
        for one, made in zip(wanted, done, strict=True):
            frames = len(one.motion.joints_m)
            lasts.append(self.first_frame + round((frames - 1) * scene_fps / one.motion.fps))
            lines.append(
                rpt_("{count} frames from {first} to {last} on {name}.").format(
                    count=frames, first=self.first_frame, last=lasts[-1], name=made.hand.name
                )
            )
        if self.use_scene_range:
            scene.frame_start, scene.frame_end = self.first_frame, max(lasts)
        if controlled:
            lines.append(rpt_("Finger controls are neutral and joint limits off, so that the motion is kept exactly."))
        notes = list(dict.fromkeys(note for made in done for note in made.notes))
        if notes:
            self.warn(*lines, *notes)
        else:
            self.tell(*lines)


@contextlib.contextmanager
def _controls_off(hand: bpy.types.Object) -> Iterator[None]:
    """Without the control layer keys alone move the bones; what else moves them still refuses a motion."""
    rules = {rule: rule.mute for rule in controls.rules_of(hand)}
    controls.mute_controls(hand, True)
    try:
        yield
    finally:
        for rule, muted in rules.items():
            rule.mute = muted
