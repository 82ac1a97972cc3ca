# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion files as keys of a hand, chosen or dropped into the viewport. The engine reads those of other programs."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from .. import ops as common
from ..core import limits
from ..core.aside import aside
from ..core.joints import LEFT, RIGHT
from ..errors import JGHandFailure
from ..renderer import runtime
from . import armature
from .motion_conversion import (
    FOREIGN_SUFFIXES,
    ORDERS,
    OWN_SUFFIXES,
    WANTS_HAND,
    ConversionChoices,
    read_converted,
    words,
)
from .motion_files import MotionFile, read_motion
from .ops_import import KeysFile

# Blender's own importers take glTF and USD that are dropped
DROPPED_SUFFIXES = (*OWN_SUFFIXES, ".npy", ".bvh")
_TARGETS = (
    ("AUTO", "Active or New", "The active hand, where it is of the motion's side; else a new one", "NONE", 0),
    ("ACTIVE", "Active Hand", "The active hand only", "NONE", 1),
    ("NEW", "New Hand", "A new hand with the bone lengths of the motion", "NONE", 2),
)

_HANDS = (
    ("AUTO", "From File", "Where the file names none or both, the one that fits the active hand", "NONE", 0),
    ("right", "Right", "The right hand of the file", "NONE", 1),
    ("left", "Left", "The left hand of the file", "NONE", 2),
)
_UNITS = (
    ("AUTO", "Automatic", "As the file says, else recognized by the size of the hand", "NONE", 0),
    ("m", "Meters", "The file's unit", "NONE", 1),
    ("cm", "Centimeters", "The file's unit", "NONE", 2),
    ("mm", "Millimeters", "The file's unit", "NONE", 3),
)


_ORDERS = (
    ("AUTO", "Automatic", "As the file says, else recognized by the bones", "NONE", 0),
    *(
        (name, label, "Order in which the file lists the joints", "NONE", n)
        for n, (name, label) in enumerate(ORDERS, 1)
    ),
)

_UPS = (
    ("AUTO", "Automatic", "As the file or its format says", "NONE", 0),
    ("y", "Y", "The file has y up", "NONE", 1),
    ("z", "Z", "The file has z up", "NONE", 2),
)
_LABELS = (
    ("AUTO", "Automatic", "As is usual for the detector; where fingers bend, they show it", "NONE", 0),
    ("true", "True", "A right hand is labeled right", "NONE", 1),
    ("mirrored", "Mirrored", "A right hand is labeled left, as in a mirror", "NONE", 2),
)

# options that go to the engine; where one of them is chosen, it reads jghand's own files too
_OF_OTHERS = (
    *("hand", "unit", "order", "fps", "hand_length", "part", "up", "labels", "bones"),
    *("mirror", "in_place"),
)


class ImportMotion(KeysFile, bpy.types.Operator):
    """Operator: a motion file onto a hand."""

    bl_idname = "jghand.import_motion"
    bl_label = "Import Motion"
    bl_description = (
        "Key a motion on the active hand or on a new one: JGHand's own files, BVH, USD, and joints of OpenPose, "
        "MediaPipe, FreeMoCap and headsets. The action before it stays in the file. Esc cancels"
    )

    working = "Importing the motion"
    verb = "import_motion"
    choices = ("target", "first_frame", "use_scene_range", *_OF_OTHERS)
    headings = MappingProxyType({_OF_OTHERS[0]: "Files of Other Programs"})

    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*{suffix}" for suffix in (*OWN_SUFFIXES, *FOREIGN_SUFFIXES)), options={"HIDDEN"}
    )  # type: ignore[valid-type]
    target: bpy.props.EnumProperty(name="Target", description="Which hand takes it", items=_TARGETS)  # type: ignore[valid-type]
    use_scene_range: bpy.props.BoolProperty(
        name="Set Scene Range",
        description="Make the scene's frame range that of the motion",
        default=False,
    )  # type: ignore[valid-type]

    hand: bpy.props.EnumProperty(name="Hand", description="Which hand of the file", items=_HANDS)  # type: ignore[valid-type]
    unit: bpy.props.EnumProperty(name="Unit", description="Length unit of the file", items=_UNITS)  # type: ignore[valid-type]
    order: bpy.props.EnumProperty(name="Order", description="Order of the joints in the file", items=_ORDERS)  # type: ignore[valid-type]
    fps: bpy.props.FloatProperty(
        name="Frame Rate",
        description="Frames per second of the file; 0: as it says, else 30",
        min=0.0,
        max=limits.FPS_MAX,
        soft_max=240.0,
        precision=2,
    )  # type: ignore[valid-type]
    part: bpy.props.StringProperty(
        name="Part", description="Which of several skeletons, animations or people: a part of its name"
    )  # type: ignore[valid-type]
    up: bpy.props.EnumProperty(name="Up", description="The axis that points up in the file", items=_UPS)  # type: ignore[valid-type]
    labels: bpy.props.EnumProperty(
        name="Labels", description="Whether a detector's Left and Right are true", items=_LABELS
    )  # type: ignore[valid-type]
    bones: bpy.props.StringProperty(
        name="Bone Names",
        description="A JSON file with the names of a rig's bones by joint, for names that are not recognized",
        subtype="FILE_PATH",
    )  # type: ignore[valid-type]
    mirror: bpy.props.BoolProperty(name="Mirror", description="Make it the motion of the other hand")  # type: ignore[valid-type]
    in_place: bpy.props.BoolProperty(
        name="In Place", description="Keep the wrist where it first is: the hand turns and moves on the spot"
    )  # type: ignore[valid-type]

    def steps(self, context: bpy.types.Context) -> Iterator[float]:
        """The file is read in a thread, or by the engine, then curve by curve is keyed."""
        path = Path(bpy.path.abspath(self.filepath))
        choices = _choices(self)
        started = 0.0 if _is_plain(path, choices) else limits.CONVERSION_PART
        content = yield from self._content(context, path, choices)
        yield from self.keying(context, [(content, path.stem)], started)

    def hand_for(self, context: bpy.types.Context, content: MotionFile) -> bpy.types.Object | None:
        """As `target` says."""
        if self.target == "AUTO":
            return super().hand_for(context, content)
        active = common.active_hand(context)
        if self.target == "ACTIVE" and active is None:
            raise JGHandFailure("not_a_hand", rpt_("no hand is active"))
        return active if self.target == "ACTIVE" else None

    def _content(
        self, context: bpy.types.Context, path: Path, choices: ConversionChoices
    ) -> Generator[float, None, MotionFile]:
        """The motion of a file. One that is not as jghand writes it goes through the engine, where there is one, and so
        does one that shall become something else than it is."""
        if _is_plain(path, choices):
            try:
                return (yield from aside(partial(read_motion, path)))
            except JGHandFailure as failure:
                if failure.kind != "bad_motion" or not path.is_file() or not _has_engine():
                    raise
        return (yield from self._converted(context, path, choices))

    def _converted(
        self, context: bpy.types.Context, path: Path, choices: ConversionChoices
    ) -> Generator[float, None, MotionFile]:
        """The engine's conversion."""
        try:
            return (yield from self._asked_of_engine(path, choices))
        except JGHandFailure as failure:
            active = common.active_hand(context)
            if failure.kind != "bad_motion" or WANTS_HAND not in failure.detail or active is None:
                raise
        # a file that shows both hands, or says nothing of its one: that which becomes one of the active hand's side
        side = armature.handedness_of(active)
        if choices.mirror:
            side = LEFT if side == RIGHT else RIGHT
        again = replace(choices, hand=side)
        return (yield from self._asked_of_engine(path, again))

    def _asked_of_engine(self, path: Path, choices: ConversionChoices) -> Generator[float, None, MotionFile]:
        """The engine's conversion with these choices. JGHandFailure (bad_motion) where the file is refused."""
        try:
            return (
                yield from self.made_by_engine(
                    lambda folder: words(path, folder, choices), read_converted, limits.CONVERSION_PART
                )
            )
        except JGHandFailure as failure:
            if failure.kind != "bad_input":
                raise
            raise JGHandFailure("bad_motion", failure.detail, log=failure.log) from failure


def _is_plain(path: Path, choices: ConversionChoices) -> bool:
    """Whether a file is to be taken as it is, and may be one of jghand's own."""
    return path.suffix.lower() in OWN_SUFFIXES and choices == ConversionChoices()


def _choices(chosen: ImportMotion) -> ConversionChoices:
    """What was chosen beside the files."""
    return ConversionChoices(
        hand=_said(chosen.hand),
        unit=_said(chosen.unit),
        order=_said(chosen.order),
        fps=chosen.fps,
        hand_length_mm=chosen.hand_length,
        part=chosen.part,
        in_place=chosen.in_place,
        up=_said(chosen.up),
        labels=_said(chosen.labels),
        bones=bpy.path.abspath(chosen.bones),
        mirror=chosen.mirror,
    )


def _said(choice: str) -> str:
    """A choice in the engine's words, "" where the file says it."""
    return "" if choice == "AUTO" else choice


def _has_engine() -> bool:
    try:
        return bool(runtime.program())
    except JGHandFailure:
        return False


class MotionDrop(bpy.types.FileHandler):
    """Motion files dropped into the viewport."""

    bl_idname = "JGHAND_FH_motion"
    bl_label = "JGHand motion"
    bl_import_operator = "jghand.import_motion"
    bl_file_extensions = ";".join(DROPPED_SUFFIXES)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Where it may be dropped."""
        return context.area is not None and context.area.type == "VIEW_3D"


CLASSES = (ImportMotion, MotionDrop)


def _import_menu(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    """In Blender's own File > Import."""
    self.layout.operator("jghand.import_motion", text="JGHand Motion (.npz, .json, .csv, .bvh, .usd, …)")


def register() -> None:
    """Adds Import Motion to Blender's File > Import."""
    bpy.types.TOPBAR_MT_file_import.append(_import_menu)


def unregister() -> None:
    """Takes it away."""
    bpy.types.TOPBAR_MT_file_import.remove(_import_menu)
