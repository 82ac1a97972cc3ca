# SPDX-License-Identifier: GPL-3.0-or-later
"""Stand-ins: the meshes that throw the shadows of hands on the scene, in Cycles and EEVEE.

A hand is a picture of the engine's; what Blender's render engines trace is a mesh in its place that no camera sees: a
child of the hand, with an Armature modifier, in the collections of the hand. It is made from what the hand is and
can be made again at any time, so one function brings all of them up to date: `update`. Who adds a hand calls it; in a
window the timer does after whatever else can change one (duplicating, appending, undo, renaming, editing bones);
without a window it is done when a file was opened and when a render begins.

Views show it in Material Preview and Rendered alone, where it does not show: elsewhere it is disabled, so that nothing
snaps to it, picks it, counts or exports it. Where one view needs it, it has no opacity in Solid, and cannot be picked.
Source: BLENDER 8.4.
"""

from __future__ import annotations

import hashlib
import time
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent
from mathutils import Color

from .. import clock, ui, versions
from ..core.bone_maps import BoneMap
from ..core.joints import FOREARM, KNUCKLES, NAMES
from ..core.stand_in import knuckle_ways, surface_at, with_forearm_bone
from ..errors import JGHandFailure
from ..render import ENGINE, composite
from . import armature, avatar_files, sources
from .seen_hands import avatar_of

# custom properties: of a stand-in, which hand of its parent's it is; of its mesh, what that was made from, and its
# color, which the material reads; of a scene that is rendered without stand-ins
MARK, MADE_FROM, ALBEDO, WITHOUT = (
    armature.STAND_IN,
    "jghand_made_from",
    "jghand_albedo",
    "jghand_without_stand_ins",
)
MATERIAL = "JGHand Stand-In"
# counts up when other vertices, weights or keys are made of the same hand, so that saved files get them
_MAKING = b"3"
# of a surface that mirrors like skin
_ROUGHNESS, _SPECULAR = 0.5, 0.25
# base color, linear, of a material that does not read its mesh's yet: in older files that of every hand
_BASE_RGBA = np.array([0.50, 0.33, 0.25, 1.0], np.float32)
# no color in Solid shading; only its color type *Single* shows it
_INVISIBLE = (1.0, 1.0, 1.0, 0.0)
# smallest weight that moves a vertex by more than a hundredth of a millimeter
_WEIGHT_MIN = 1e-4
# so far a knuckle takes the palm along, in units of the armature: as far as Blender lets a shape key go
_KEY_MAX = 10.0
# seconds without a change after which stand-ins are looked at: nothing while somebody drags
_REST_S = 0.3
# shadings in which something is traced
_TRACED = {"MATERIAL", "RENDERED"}

# a hand: its side, (21, 3) joints at rest in the armature's space and unit, the bone that moves what hangs on each,
# behind them that of the forearm, where it has one, and (5, 3, 3) the axes of the knuckles' bones, in rows, where the
# knuckles of a palm that arches are moved by the bones' locations: on our own armatures
_Shape = tuple[str, np.ndarray, list[str], np.ndarray | None]

# the stand-ins that the last update left, as `bpy.data.objects` finds them, and their session_uid
_there: list[tuple[tuple[str, str | None], int]] = []
# when something was changed last that can concern a hand, on the clock of time.monotonic(); None: nothing since
_changed_s: float | None = None


def update() -> None:
    """Gives each hand of the file the stand-in that it should have as it is now, and takes away what no hand has. Of a
    hand in Edit Mode, or that cannot be read, it stays as it is: the artist may have set things on it."""
    global _changed_s, _there
    _changed_s = None
    left = {}
    for thing in [thing for thing in bpy.data.objects if MARK in thing]:
        key = (thing.parent, thing[MARK])
        if key in left and _is_own(thing):
            _remove(thing)
        else:
            left[key] = thing
    for hand in [thing for thing in bpy.data.objects if armature.is_any_hand(thing)]:
        shapes = _shapes(hand)
        if shapes is None:
            left = {key: thing for key, thing in left.items() if key[0] != hand}
            continue
        for shape in shapes:
            _renew(hand, left.pop((hand, shape[0]), None), shape)
    for thing in left.values():
        if _is_own(thing):
            _remove(thing)
    _there = [
        ((thing.name, thing.library and thing.library.filepath), thing.session_uid)
        for thing in bpy.data.objects
        if MARK in thing
    ]


def notice(depsgraph: bpy.types.Depsgraph) -> None:
    """Something was changed in Blender: where that can concern a hand, `tend` brings its stand-in up to date."""
    for update in depsgraph.updates:
        thing = update.id
        if isinstance(thing, bpy.types.Scene | bpy.types.Collection | bpy.types.Armature) or (
            isinstance(thing, bpy.types.Object) and (MARK in thing or armature.is_any_hand(thing))
        ):
            expect()
            return


def expect() -> None:
    """Has `tend` look at everything, once nothing changes any more."""
    global _changed_s
    _changed_s = time.monotonic()
    clock.hasten(_REST_S)


def tend() -> None:
    """For the timer: brings up to date what was changed, and shows stand-ins to those views alone that trace them."""
    if _changed_s is not None and time.monotonic() - _changed_s >= _REST_S:
        update()
    show(any(area.spaces.active.shading.type in _TRACED for _, area in ui.areas()))


def show(traced: bool) -> None:
    """Shows the stand-ins of the last update to views that trace, those of hands that are seen; or to none."""
    seen = bpy.context.view_layer
    for key, uid in _there:
        thing = bpy.data.objects.get(key)
        if thing is not None and thing.session_uid == uid:
            hand = thing.parent
            hidden = not traced or hand is None or hand.hide_viewport or hand.hide_get(view_layer=seen)
            if thing.hide_viewport != hidden:
                thing.hide_viewport = hidden


def _shapes(hand: bpy.types.Object) -> list[_Shape] | None:
    """The hands of an armature that throw shadows; None: not to be told now."""
    if not hand.jghand.cast_shadow or hand.type != "ARMATURE" or not _homes(hand):
        return []
    if hand.mode == "EDIT":
        return None
    try:
        if armature.is_hand(hand):
            bones = [*NAMES, *[FOREARM] * armature.has_forearm_bone(hand)]
            rest = armature.rest_matrices_of(hand)
            ways = np.swapaxes(rest[KNUCKLES, :3, :3], -1, -2)
            return [(armature.handedness_of(hand), rest[:, :3, 3], bones, ways)]
        return [_mapped(bone_map, hand.data.bones) for bone_map in sources.stored_maps(hand)]
    except JGHandFailure:
        return None  # a hand that cannot be read is not drawn either, and the panel says why


def _mapped(bone_map: BoneMap, of_rig: bpy.types.ArmatureBones) -> _Shape:
    """The hand of a bone map. Raises JGHandFailure as `sources.whole_sources`."""
    found = sources.whole_sources(bone_map, of_rig)
    bones = [of_rig[source.bone] for source in found]
    ends = [
        bone.head_local if source.end == "head" else bone.tail_local for bone, source in zip(bones, found, strict=True)
    ]
    return bone_map.handedness, np.array(ends, np.float64), [bone.name for bone in bones], None


def _homes(hand: bpy.types.Object) -> list[bpy.types.Collection]:
    """Where a hand's stand-in belongs: the collections of the hand in this file."""
    apart = {scene.collection for scene in bpy.data.scenes if composite.is_hands_scene(scene)}
    return [home for home in hand.users_collection if home.library is None and home not in apart]


def _renew(hand: bpy.types.Object, thing: bpy.types.Object | None, shape: _Shape) -> None:
    if thing is not None and not _is_own(thing):
        return
    try:
        avatar = avatar_of(hand)
        forearm, color = hand.jghand.forearm and avatar_files.has_forearm(avatar), skin_rgb(avatar)
        made_from = _digest(shape, forearm, color)
        before = thing.data if thing is not None else None
        mesh = before if before is not None and _fits(before, hand, made_from) else _mesh(hand, shape, forearm, before)
    except JGHandFailure:  # joints that no hand has at rest: not to be told now
        return
    mine: bpy.types.Object = _new(hand, shape[0], mesh) if thing is None else thing
    if mine.data != mesh:  # what is written tells Blender of a change, also the same again
        mine.data = mesh
        _drop(before)
    mesh[MADE_FROM], mesh[ALBEDO] = made_from, color
    name = f"{hand.name} Shadow"
    if not mine.name.startswith(name):
        mine.name = name
    homes, there = _homes(hand), mine.users_collection
    for home in homes:
        if home not in there:
            home.objects.link(mine)
    for home in there:
        if home not in homes:
            home.objects.unlink(mine)


def _is_own(thing: bpy.types.Object) -> bool:
    """Whether a stand-in is of the opened file; one that came from another with its hand stays as it is there."""
    return thing.library is None and thing.override_library is None


def _new(hand: bpy.types.Object, side: str, mesh: bpy.types.Mesh) -> bpy.types.Object:
    thing = bpy.data.objects.new(f"{hand.name} Shadow", mesh)
    thing[MARK] = side
    thing.parent = hand
    modifier = thing.modifiers.new("Armature", "ARMATURE")
    modifier.object = hand
    thing.visible_camera = False
    thing.hide_select = thing.hide_viewport = True
    thing.color = _INVISIBLE
    if hasattr(thing, "hide_surface_pick"):  # from 5.0
        thing.hide_surface_pick = True
    _add_driver(thing, hand)
    return thing


def _add_driver(thing: bpy.types.Object, hand: bpy.types.Object) -> None:
    """A hand that is not rendered, be it animated so, throws no shadow; nor does any where a scene says `WITHOUT`."""
    driver = thing.driver_add("hide_render").driver
    driver.type = "MAX"
    target = driver.variables.new().targets[0]
    target.id, target.data_path = hand, "hide_render"
    without = driver.variables.new()
    without.type = "CONTEXT_PROP"
    target = without.targets[0]
    target.context_property, target.data_path = "ACTIVE_SCENE", f'["{WITHOUT}"]'
    target.use_fallback_value, target.fallback_value = True, 0.0


def skin_rgb(avatar: str) -> tuple[float, float, float]:
    """Skin as the scene's light sees it: the mean albedo of an avatar, in the file's working space."""
    red, green, blue = Color(avatar_files.albedo_of(avatar)).from_rec709_linear_to_scene_linear()
    return red, green, blue


def _digest(shape: _Shape, forearm: bool, color: tuple[float, float, float]) -> str:
    """Of what a stand-in's mesh is made from."""
    side, joints, bones, ways = shape
    numbers = _MAKING + np.round([*joints, color], 7).tobytes() + (b"" if ways is None else np.round(ways, 7).tobytes())
    return hashlib.sha256(numbers + "\n".join((side, *bones)).encode() + b"forearm" * forearm).hexdigest()


def _fits(mesh: bpy.types.Mesh, hand: bpy.types.Object, made_from: str) -> bool:
    """Whether a mesh is still the one for a hand, and moves with that one: duplicates begin with that of the first."""
    keys = mesh.shape_keys
    driven = keys.animation_data.drivers if keys is not None and keys.animation_data is not None else ()
    return mesh.get(MADE_FROM) == made_from and all(
        target.id == hand for curve in driven for variable in curve.driver.variables for target in variable.targets
    )


def _mesh(hand: bpy.types.Object, shape: _Shape, forearm: bool, before: bpy.types.Mesh | None) -> bpy.types.Mesh:
    """The surface of a hand, with a group for each bone, and the materials of the mesh before, which an artist may have
    chosen. JGHandFailure: bad_joints."""
    side, joints, bones, ways = shape
    surface = surface_at(joints, side, forearm=forearm)
    has_bone = forearm and len(bones) > len(NAMES)
    every = with_forearm_bone(surface.weights, side) if has_bone else surface.weights
    mesh = bpy.data.meshes.new(MATERIAL)
    mesh.from_pydata(surface.vertices, [], surface.faces)
    mesh.shade_smooth()
    own = _material()
    for material in [own] if before is None else before.materials:
        mesh.materials.append(material)
    carrier = bpy.data.objects.new(MATERIAL, mesh)  # groups and keys are a mesh's, and only objects make them
    for place, bone in enumerate(bones[: every.shape[1]]):
        group = carrier.vertex_groups.get(bone) or carrier.vertex_groups.new(name=bone)
        weights = every[:, place]
        for vertex in np.flatnonzero(weights > _WEIGHT_MIN).tolist():
            group.add([vertex], float(weights[vertex]), "ADD")
    if ways is not None:
        by_knuckles = knuckle_ways(joints, side, ways, forearm=forearm)
        if has_bone:  # what that holds no knuckle moves
            by_knuckles *= 1 - every[:, -1:]
        _add_palm(carrier, hand, surface.vertices, by_knuckles)
    bpy.data.objects.remove(carrier)
    return mesh


def _add_palm(carrier: bpy.types.Object, hand: bpy.types.Object, vertices: np.ndarray, ways: np.ndarray) -> None:
    """Shape keys by which the palm's skin follows the knuckles as the engine's does (5, 3, V, 3): a bone that is moved
    takes along what hangs on itself alone. Drivers without Python read the places of the bones."""
    carrier.shape_key_add(name="Basis")
    for knuckle, of_knuckle in zip(KNUCKLES, ways, strict=True):
        for axis, way in zip("XYZ", of_knuckle, strict=True):
            key = carrier.shape_key_add(name=f"{NAMES[knuckle]} {axis}", from_mix=False)
            key.data.foreach_set("co", (vertices + way).astype(np.float32).ravel())
            key.slider_min, key.slider_max = -_KEY_MAX, _KEY_MAX
            driver = key.driver_add("value").driver
            driver.type = "SUM"
            variable = driver.variables.new()
            variable.type = "TRANSFORMS"
            target = variable.targets[0]
            target.id, target.bone_target = hand, NAMES[knuckle]
            target.transform_type, target.transform_space = f"LOC_{axis}", "LOCAL_SPACE"


def _material() -> bpy.types.Material:
    """What stand-ins have at first: its color is the mesh's, unless an artist gave it another one."""
    material: Any = bpy.data.materials.get(MATERIAL)
    if material is None or material.library is not None:
        material = bpy.data.materials.new(MATERIAL)
        material.diffuse_color = _INVISIBLE
        for skin in _skins(versions.ensure_tree(material)):
            skin.inputs["Base Color"].default_value = _BASE_RGBA
            skin.inputs["Roughness"].default_value = _ROUGHNESS
            skin.inputs["Specular IOR Level"].default_value = _SPECULAR
    for skin in () if material.node_tree is None else _skins(material.node_tree):
        base, tree = skin.inputs["Base Color"], skin.id_data
        if not base.is_linked and np.array_equal(base.default_value, _BASE_RGBA):
            color = tree.nodes.new("ShaderNodeAttribute")
            color.attribute_type, color.attribute_name = "OBJECT", ALBEDO
            tree.links.new(color.outputs["Color"], base)
    return material


def _skins(tree: bpy.types.NodeTree) -> list[Any]:
    return [node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"]


def _remove(thing: bpy.types.Object) -> None:
    mesh = thing.data
    bpy.data.objects.remove(thing)
    _drop(mesh)


def _drop(mesh: bpy.types.Mesh) -> None:
    if mesh.users == 0:
        bpy.data.meshes.remove(mesh)


class GltfHook:
    """What Blender's glTF exporter asks: it writes hidden objects, too."""

    def gather_tree_filter_tag_hook(self, tree: Any, _settings: Any) -> None:
        for node in tree.nodes.values():
            if node.blender_object is not None and MARK in node.blender_object:
                node.keep_tag = False


@persistent
def on_load(*_: Any) -> None:
    update()
    show(traced=False)


@persistent
def before_undo(*_: Any) -> None:
    """What the timer made is in no step of undo. A step takes over what it does not change, such as a collection or an
    object, with its pointers: to what it does not know, which it frees (a crash: run, 5.2.2). So stand-ins go before,
    and `tend` makes those anew that the step has not."""
    for thing in [thing for thing in bpy.data.objects if MARK in thing and _is_own(thing)]:
        if thing.parent is None or thing.parent.mode != "EDIT":
            _remove(thing)


@persistent
def on_render(scene: bpy.types.Scene, *_: Any) -> None:
    """A render begins where no timer runs: a script may have added hands."""
    if bpy.app.background and scene.render.engine != ENGINE and WITHOUT not in scene:
        update()
        for layer in scene.view_layers:  # a render that meets new objects ends Blender (run, 5.2.3)
            layer.update()


# of what is opened and rendered; without the extension stand-ins stay, and work
APP_HANDLERS = (("load_post", on_load), ("render_init", on_render))
