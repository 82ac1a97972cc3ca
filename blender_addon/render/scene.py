# SPDX-License-Identifier: GPL-3.0-or-later
"""The opened file: its cameras, what its settings do to pictures, and whether Blender evaluated it truly."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import bpy

from ..errors import JGHandFailure
from ..hand import armature


def open_file(path: Path, *, allow_scripts: bool) -> bpy.types.Scene:
    """Opens a .blend file; returns its scene. Raises JGHandFailure: bad_file, scripts_blocked."""
    if not path.is_file():
        raise JGHandFailure("bad_file", f"{path} does not exist")
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False, use_scripts=allow_scripts)
    except RuntimeError as error:
        raise JGHandFailure("bad_file", f"{path}: {error}") from error
    check_scripts()
    return bpy.context.scene


def chosen_cameras(scene: bpy.types.Scene, names: Sequence[str], frame: int) -> list[bpy.types.Object]:
    """The cameras of these names, without names the scene's own, or that of its markers at the first frame of a render.

    A name that no camera has may be several, separated by commas. Raises JGHandFailure: not_a_camera, no_camera.
    """
    if not names:
        eye = scene.camera or _marked_camera(scene, frame)
        if eye is None:
            raise JGHandFailure("no_camera")
        return [eye]
    known = [thing.name for thing in scene.objects if thing.type == "CAMERA"]
    parts = [[name] if name in known else name.split(",") for name in names]
    wanted = list(dict.fromkeys(itertools.chain.from_iterable(parts)))
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise JGHandFailure("not_a_camera", f"{', '.join(unknown)}; the scene has {', '.join(known) or 'none'}")
    return [scene.objects[name] for name in wanted]


def _marked_camera(scene: bpy.types.Scene, frame: int) -> bpy.types.Object | None:
    """The camera that markers choose: of the last one up to a frame, before all of them of the first, as Blender's."""
    marked = sorted((each for each in scene.timeline_markers if each.camera is not None), key=lambda each: each.frame)
    before = [each for each in marked if each.frame <= frame]
    return next((each.camera for each in (*before[-1:], *marked[:1])), None)


def notes_on(scene: bpy.types.Scene) -> list[str]:
    """One sentence for every setting of the scene that makes its pictures other than those of the engine."""
    view = scene.view_settings
    if view.view_transform != "Standard":
        return [f"The view transform is {view.view_transform}: colors differ from the capture; Standard keeps them."]
    return []


def instanced_hands(things: Iterable[bpy.types.Object]) -> list[str]:
    """The hands that only show as instances of a collection, which are not rendered: "hand, in its instance"."""
    return [
        f"{hand.name}, in the instance {thing.name}"
        for thing in things
        if thing.instance_type == "COLLECTION" and thing.instance_collection
        for hand in thing.instance_collection.all_objects
        if armature.is_any_hand(hand)
    ]


def evaluated_at(scene: bpy.types.Scene, frame: float, things: Iterable[bpy.types.Object]) -> bpy.types.Depsgraph:
    """What Blender evaluated at a frame, when it evaluated `things` truly.

    A driver that Blender may not or cannot run leaves its channel as it was, with no more than a line in the log.
    Raises JGHandFailure: scripts_blocked, broken_driver.
    """
    depsgraph = armature.at_frame(scene, frame)
    check_scripts()
    parts = [part for thing in things for part in armature.parts_of(thing)]
    broken = [description for part in parts for description in _broken_drivers(part)]
    if broken:
        raise JGHandFailure("broken_driver", f"frame {frame:g}: {'; '.join(broken)}")
    return depsgraph


def check_drivers(things: Iterable[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> None:
    """Whether the drivers of hands and cameras work where they were evaluated. Raises JGHandFailure: scripts_blocked,
    broken_driver.

    Of a file whose scripts are blocked, only the drivers that are needed matter, and those of them that are Python.
    """
    parts = [part.evaluated_get(depsgraph) for thing in things for part in armature.parts_of(thing)]
    if bpy.app.autoexec_fail and any(_has_scripts(part) for part in parts):
        raise JGHandFailure("scripts_blocked", bpy.app.autoexec_fail_message)
    broken = [description for part in parts for description in _broken_drivers(part)]
    if broken:
        raise JGHandFailure("broken_driver", "; ".join(broken))


def _has_scripts(thing: bpy.types.Object) -> bool:
    """Whether an object or its data has drivers that only Python can compute."""
    return any(
        curve.driver.type == "SCRIPTED" and not curve.driver.is_simple_expression and not curve.mute
        for owner in ((thing, thing.data) if thing.data else (thing,))
        for curve in (owner.animation_data.drivers if owner.animation_data else ())
    )


def check_scripts() -> None:
    """JGHandFailure (scripts_blocked) when Blender met Python in the file that it may not run."""
    if bpy.app.autoexec_fail:
        raise JGHandFailure("scripts_blocked", bpy.app.autoexec_fail_message)


def _broken_drivers(thing: bpy.types.Object) -> Iterator[str]:
    """The drivers of an object and of its data that are switched on and do not work."""
    for owner in (thing, thing.data) if thing.data else (thing,):
        for curve in owner.animation_data.drivers if owner.animation_data else ():
            if not (curve.mute or curve.driver.is_valid):
                yield f"{thing.name}: {curve.data_path} = {curve.driver.expression}"
