# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes: the folder of a hand's bake, what it was made from, whether that is still so, and the object that plays it.

NAME.usda and its layers    plays wherever USD is read, no engine and no extension needed
NAME.npz                    the joints, to compare with and to export from again
bake.json                   the stamp, written last: a folder without it holds no finished bake

The object that plays is a point cloud whose cache modifier reads the USD file, with a material of Blender's own nodes.
Points are balls, so edges are harder than those of splats.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import bpy
import numpy as np

from .. import folders, versions
from ..core.files import write_whole
from ..core.view import HandInSpace
from ..errors import JGHandFailure
from ..hand import sources
from ..hand.motion_files import MotionFile, read_motion
from ..hand.seen_hands import avatar_of
from .recording import NO_FOREARM, Recording, avatar_digest

STAMP = "bake.json"
_FORMAT, _VERSION = "jghand bake", 1
_KINDS = {"str": str, "int": int, "float": float}
# custom property of a playing object: the folder of its bake, relative where the bake's settings are so
BAKE_PROPERTY = "jghand_bake"
MATERIAL, LIT_MATERIAL = "JGHand Points", "JGHand Lit Points"
# prims of the stage that are drawn: what the variants hold
_PATHS = "/Hand/Points,/Hand/Splats"
# a joint that is further from where it was baked has moved: above Blender's rounding, below what is seen, meters
_MOVED_M = 2e-5
# ... and so has a forearm whose quaternion has less of this in common with that of the bake: 0.16 degrees
_SAME_TURN = 1 - 1e-6
# what Solid mode shows of baked points, linear: skin
_SOLID_RGBA = (0.55, 0.30, 0.20, 1.0)


@dataclass(frozen=True)
class BakedHand:
    # stem of its files
    name: str
    handedness: str
    # what `avatar_digest` said
    avatar: str
    # of the scene
    first_frame: int
    frames: int
    fps: float

    @property
    def last_frame(self) -> int:
        """Of the scene."""
        return self.first_frame + self.frames - 1

    def stage(self, folder: Path) -> Path:
        return folder / f"{self.name}.usda"


# ---- the folder ------------------------------------------------------------------------------------------------------


def folder_of(thing: bpy.types.Object) -> Path:
    return Path(folders.absolute(thing, "bake")).absolute()


def put_in_place(made: Path, folder: Path, recordings: Sequence[Recording]) -> None:
    """Finishes a bake: what the engine made of the recordings is moved into the folder, over the bake before.

    The stamp goes first and comes last: who is killed half-way leaves no bake instead of a mixture. Where a file cannot
    be moved, as on Windows one that another program reads, all others go back.
    JGHandFailure: cannot_write, disk_full.
    """
    hands = [
        BakedHand(
            name=recording.name,
            handedness=recording.handedness,
            avatar=avatar_digest(recording.avatar, forearm=recording.forearm),
            first_frame=recording.first_frame,
            frames=len(recording.joints_m),
            fps=recording.fps,
        )
        for recording in recordings
    ]
    content = {"format": _FORMAT, "version": _VERSION, "hands": [asdict(hand) for hand in hands]}
    write_whole(made / STAMP, json.dumps(content, indent=1).encode())
    aside = folder.with_name(f".{folder.name}.before")
    names = sorted((path.name for path in made.iterdir()), key=lambda name: name == STAMP)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        aside.mkdir(exist_ok=True)
        old = [(folder / name, aside / name) for name in reversed(names) if (folder / name).exists()]
        _move_all([*old, *((made / name, folder / name) for name in names)])
    except OSError as error:
        with contextlib.suppress(OSError):  # it is not empty: what could not go back stays there
            aside.rmdir()
        raise JGHandFailure("cannot_write", f"{error.filename}: {error.strerror or error}") from error
    shutil.rmtree(aside, ignore_errors=True)


def _move_all(moves: Sequence[tuple[Path, Path]]) -> None:
    """Moves files, in this order; where one cannot be moved, those before it go back. OSError."""
    for done, (source, target) in enumerate(moves):
        try:
            os.replace(source, target)
        except OSError:
            for before, now in reversed(moves[:done]):
                os.replace(now, before)
            raise


def read_bake(folder: Path) -> list[BakedHand]:
    """The hands of a finished bake. JGHandFailure (no_bake): there is none, or its files are not all there."""
    try:
        content = json.loads((folder / STAMP).read_text(encoding="utf-8"))
        if content["format"] != _FORMAT or content["version"] != _VERSION:
            raise ValueError(f"format {content['format']!r}, version {content['version']!r}")
        hands = [
            BakedHand(**{field.name: _KINDS[str(field.type)](entry[field.name]) for field in fields(BakedHand)})
            for entry in content["hands"]
        ]
    except OSError as error:
        raise JGHandFailure("no_bake", f"{folder}: {error.strerror or error}") from error
    except (ValueError, TypeError, KeyError) as error:
        raise JGHandFailure("no_bake", f"{folder / STAMP}: {str(error)[:200]}") from error
    if not hands:
        raise JGHandFailure("no_bake", f"{folder / STAMP}: no hand")
    for hand in hands:
        # the stem becomes a path: it never leaves the folder
        if not hand.name.isidentifier() or not hand.stage(folder).is_file():
            raise JGHandFailure("no_bake", f"{hand.stage(folder)} is not there")
    return hands


# ---- whether it is what the scene has --------------------------------------------------------------------------------


def stale_now(thing: bpy.types.Object, depsgraph: bpy.types.Depsgraph, hands: Sequence[BakedHand]) -> list[str]:
    """Why the bake of a hand does not show the frame that is evaluated; [] when nothing speaks against it.

    Only this frame: to go through all would take the time of a bake. JGHandFailure: no_bake, bad_motion.
    """
    folder, frame = folder_of(thing), depsgraph.scene.frame_current_final
    now = {hand.handedness: hand for hand in sources.read_hands(thing, depsgraph)}
    avatar = avatar_digest(avatar_of(thing), forearm=thing.jghand.forearm)
    reasons = []
    for hand in hands:
        if avatar != hand.avatar:
            is_same = avatar.removesuffix(NO_FOREARM) == hand.avatar.removesuffix(NO_FOREARM)
            reasons.append("Forearm was switched" if is_same else "the avatar is another one")
        if hand.handedness in now and _moved_at(hand, folder, frame, now[hand.handedness]):
            reasons.append("the hand moves in another way")
    return list(dict.fromkeys(reasons))


def _moved_at(hand: BakedHand, folder: Path, frame: float, now: HandInSpace) -> bool:
    """Whether the hand is elsewhere now, at this frame, than in the bake.

    False where the bake has no such frame, and between frames.
    """
    place = round(frame) - hand.first_frame
    if frame != round(frame) or not 0 <= place < hand.frames:
        return False
    motion = folder / f"{hand.name}.npz"
    try:
        baked = _motion(motion, motion.stat().st_mtime_ns)
    except OSError as error:
        raise JGHandFailure("no_bake", f"{motion}: {error.strerror or error}") from error
    turned = False
    if baked.forearm is not None:  # without, neither bone nor avatar had a forearm
        here = np.array((1.0, 0.0, 0.0, 0.0)) if now.forearm_turn is None else now.forearm_turn
        # a quaternion and its negative are the same turn
        turned = abs(here @ baked.forearm[place]) < _SAME_TURN
    return bool(turned or np.abs(baked.joints_m[place] - now.joints_world_m).max() > _MOVED_M)


@functools.lru_cache(maxsize=8)
def _motion(motion: Path, _changed_ns: int) -> MotionFile:
    """The motion of a bake, read once: a panel compares with it whenever it is drawn."""
    return read_motion(motion)


# ---- the object that plays -------------------------------------------------------------------------------------------


def play(context: bpy.types.Context, folder: Path, released: Sequence[tuple[str, bpy.types.Object]] = ()) -> None:
    """Brings all hands of a bake into the scene, as objects that play; what was active and selected stays so.

    released: what `release` returned. Each plays the hand of its name again, or the one hand where it was the one;
    else it goes. JGHandFailure: no_usd, no_bake.
    """
    if not versions.has_usd():
        raise JGHandFailure("no_usd")
    layer = context.view_layer.objects
    active, selected = layer.active, list(layer.selected)
    hands, names = read_bake(folder), {name for name, _ in released}
    renamed = len(hands) == len(names) == 1
    for hand in hands:
        cloud = _play_hand(context, hand, folder)
        cloud.select_set(False)
        again = [thing for name, thing in released if renamed or name == hand.name]
        for thing in again:
            _take_over(thing, cloud)
        if again:
            bpy.data.objects.remove(cloud)
    known = names if renamed else {hand.name for hand in hands}
    gone = [thing for name, thing in released if name not in known]
    for thing in (each for each in selected if each not in gone):
        thing.select_set(True)
    layer.active = None if active in gone else active
    _remove(gone)


def _take_over(thing: bpy.types.Object, cloud: bpy.types.Object) -> None:
    """Has a released object play what a new one does, with its own materials."""
    before, thing[BAKE_PROPERTY] = thing.data, cloud[BAKE_PROPERTY]
    for own, new in zip(_caches(thing), _caches(cloud), strict=False):
        own.cache_file, own.object_path = new.cache_file, new.object_path
    cloud.data.materials.clear()
    for material in before.materials:
        cloud.data.materials.append(material)
    thing.data, name = cloud.data, before.name
    if not before.users:
        bpy.data.batch_remove([before])
        thing.data.name = name


def _play_hand(context: bpy.types.Context, hand: BakedHand, folder: Path) -> bpy.types.Object:
    before = set(bpy.data.objects)
    try:
        bpy.ops.wm.usd_import(
            filepath=str(hand.stage(folder)), prim_path_mask=_PATHS, set_frame_range=False, relative_path=True
        )
    except RuntimeError as error:
        raise JGHandFailure("no_bake", f"{hand.stage(folder)}: {error}") from error
    added = [thing for thing in bpy.data.objects if thing not in before]
    clouds = [thing for thing in added if thing.type == "POINTCLOUD"]
    if not clouds:
        for thing in added:
            bpy.data.objects.remove(thing)
        raise JGHandFailure("no_usd", "its import brought no points")
    cloud = clouds[0]
    cloud.name = cloud.data.name = f"{hand.name} baked"
    cloud[BAKE_PROPERTY] = folders.beside_the_file(context, folder)
    unit_m = context.scene.unit_settings.scale_length
    cloud.scale = [size / unit_m for size in cloud.scale]
    if not cloud.data.materials:
        cloud.data.materials.append(points_material())
    return cloud


def release(context: bpy.types.Context, folder: Path) -> list[tuple[str, bpy.types.Object]]:
    """Has what plays a bake let go of its files, and returns it, each with the name of its hand: USD keeps a file that
    is open as it was read, and a new bake would not be seen. `play` lets these objects play again, with all that an
    artist did to them."""
    released = []
    for thing in playing(context.scene, folder):
        name = ""
        for modifier in _caches(thing):
            name = Path(modifier.cache_file.filepath).stem if modifier.cache_file is not None else name
            modifier.cache_file = None
        released.append((name, thing))
    unused = [cache for cache in bpy.data.cache_files if not cache.users]
    inside = [each for each in unused if folder in Path(bpy.path.abspath(each.filepath, library=each.library)).parents]
    bpy.data.batch_remove(inside)
    if released:
        context.view_layer.update()
    return released


def stop(context: bpy.types.Context, folder: Path) -> None:
    _remove([thing for _, thing in release(context, folder)])


def _remove(things: Sequence[bpy.types.Object]) -> None:
    """Takes objects that played out of the file, and their points."""
    for thing in things:
        cloud = thing.data
        bpy.data.objects.remove(thing)
        if not cloud.users:
            bpy.data.batch_remove([cloud])


def _caches(thing: bpy.types.Object) -> list[bpy.types.Modifier]:
    return [modifier for modifier in thing.modifiers if modifier.type == "MESH_SEQUENCE_CACHE"]


def playing(scene: bpy.types.Scene, folder: Path) -> list[bpy.types.Object]:
    wanted = folder.resolve()
    return [
        thing
        for thing in scene.objects
        if BAKE_PROPERTY in thing
        and Path(bpy.path.abspath(str(thing[BAKE_PROPERTY]), library=thing.library)).resolve() == wanted
    ]


def points_material(*, lit: bool = False) -> bpy.types.Material:
    """Shows the colors of the points as they are: no light falls on them, as on a photograph. lit: it does, and the
    colors are their albedo."""
    name = LIT_MATERIAL if lit else MATERIAL
    known = bpy.data.materials.get(name)
    if known is not None and known.library is None:
        return known
    material = bpy.data.materials.new(name)
    material.diffuse_color = _SOLID_RGBA  # Solid mode knows no colors of points
    tree = versions.ensure_tree(material)
    tree.nodes.clear()
    surface = tree.nodes.new("ShaderNodeBsdfPrincipled" if lit else "ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    read = [("displayColor", "Color", "Base Color" if lit else "Color")]
    read += [("roughness", "Fac", "Roughness"), ("ior", "Fac", "IOR")] if lit else []
    for row, (attribute, result, wanted) in enumerate(read):
        reader = tree.nodes.new("ShaderNodeAttribute")
        reader.attribute_name, reader.location = attribute, (-300, -200 * row)
        tree.links.new(reader.outputs[result], surface.inputs[wanted])
    tree.links.new(surface.outputs[0], output.inputs["Surface"])
    return material
