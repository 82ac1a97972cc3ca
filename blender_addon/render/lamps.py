# SPDX-License-Identifier: GPL-3.0-or-later
"""The lamps that light hands, read as Blender evaluated them for a render or a 3D view, those of instances too.

Renders read them each time. Views keep what they read until Blender tells of an edit that can change it: moving a hand
or the view does not. How Cycles and EEVEE take each setting is measured in tests/blender/test_lamps.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import bpy
import numpy as np
from mathutils import Color

from ..core import lamps, pacing
from ..core.joints import LEFT, RIGHT
from ..core.view import EVERYTHING, Picked, is_picked
from ..hand import armature, seen_hands
from . import composite, world_nodes

# settings of views that choose lamps
_SHADING = ("type", "use_scene_lights", "use_scene_lights_render")
# (view layer, view, its settings, hands) -> what was read for it
_kept: dict[tuple[object, ...], SceneLamps] = {}


@dataclass(frozen=True)
class SceneLamps:
    """lamps: as the engine reads them · warnings: sentences about what of Blender's lights is not honored"""

    lamps: tuple[dict[str, Any], ...] = ()
    warnings: tuple[str, ...] = ()

    @cached_property
    def key(self) -> str:
        return pacing.digest([repr(self.lamps)])


def in_view(
    depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None, hands: Sequence[bpy.types.Object]
) -> SceneLamps:
    """The lamps of `lamps_of` in a 3D view, or for a render (None) of what views show, kept between two looks."""
    view: list[object] = [depsgraph.scene.session_uid, depsgraph.view_layer.name, depsgraph.scene.render.engine]
    if space is not None:
        local = space.local_view.as_pointer() if space.local_view is not None else 0
        view += [space.as_pointer(), local, space.show_object_viewport_light, space.use_local_collections]
        view += [getattr(space.shading, name) for name in _SHADING]
    # light linking calls them by their names, and those that they instance
    called = (armature.name_in_files(hand) for thing in hands for hand in (thing, *seen_hands.hands_below(thing)))
    key = (*view, *called)
    if key not in _kept:
        _kept[key] = lamps_of(depsgraph, hands, space)
    return _kept[key]


def notice(depsgraph: bpy.types.Depsgraph) -> None:
    """Something was changed in Blender, or another frame is evaluated: where that can have changed lamps, they are read
    anew."""
    if _kept and any(_may_light(update.id) for update in depsgraph.updates):
        forget()


def forget() -> None:
    _kept.clear()


def _may_light(thing: bpy.types.ID) -> bool:
    if not isinstance(thing, bpy.types.Object):
        return isinstance(thing, bpy.types.Scene | bpy.types.Collection | bpy.types.Light)
    return thing.type == "LIGHT" or thing.is_instancer or any(each.type == "NODES" for each in thing.modifiers)


def uses_scene_lights(space: bpy.types.SpaceView3D | None) -> bool:
    """Whether the lamps of the scene light a 3D view, or a render (None); Solid has a light of its own."""
    if space is None:
        return True
    if space.shading.type == "RENDERED":
        return space.shading.use_scene_lights_render
    return space.shading.type == "MATERIAL" and space.shading.use_scene_lights


def lamps_of(
    depsgraph: bpy.types.Depsgraph, hands: Sequence[bpy.types.Object], space: bpy.types.SpaceView3D | None = None
) -> SceneLamps:
    found: list[dict[str, Any]] = []
    warnings: dict[str, None] = {}  # each once, in their order
    if uses_scene_lights(space):
        scene = depsgraph.scene_eval
        eevee, unit_m = _is_eevee(scene, space), scene.unit_settings.scale_length
        places_m = [np.array(hand.matrix_world.translation) * unit_m for hand in hands] or [np.zeros(3)]
        lit_m: list[np.ndarray] = []  # of each lamp, the place of a hand that it lights
        counts = np.zeros(len(places_m), int)
        for thing, matrix in _placed(depsgraph, space):
            receivers = thing.light_linking.receiver_collection
            lit = [number for number in range(len(places_m)) if lights_any(receivers, hands[number : number + 1])]
            if not lit:
                continue
            lights = lamps.lamps_of(_read(thing, matrix, hands, eevee=eevee), unit_m)
            found += lights
            lit_m += [places_m[lit[0]]] * len(lights)
            counts[lit] += len(lights)
            warnings.update(dict.fromkeys(_warnings(thing, hands, eevee=eevee)))
        if counts.max() > lamps.LAMPS_LIT:
            text = f"{counts.max()} lamps: the {lamps.LAMPS_LIT} brightest light each hand; hide some of them"
            warnings[text] = None
        found = lamps.brightest(found, lit_m)
    return SceneLamps(tuple(found), tuple(warnings))


def _is_eevee(scene: bpy.types.Scene, space: bpy.types.SpaceView3D | None) -> bool:
    """Whether lamps are to be taken as EEVEE does, and not as Cycles: hands stand in the picture of one of them."""
    if space is not None and space.shading.type == "MATERIAL":
        return True
    return (scene.get(composite.OWNER) or scene).render.engine.startswith("BLENDER_EEVEE")


def _placed(
    depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None
) -> Iterator[tuple[bpy.types.Object, np.ndarray]]:
    """Every lamp that is seen, evaluated, and its place: (4, 4). Of an instance nothing is there after its turn."""
    for each in depsgraph.object_instances:
        thing = each.object
        if thing.type != "LIGHT":
            continue
        if not thing.hide_render if space is None else thing.visible_in_viewport_get(space):
            yield thing, np.array(each.matrix_world)


def _read(
    thing: bpy.types.Object, matrix: np.ndarray, hands: Sequence[bpy.types.Object], *, eevee: bool
) -> lamps.BlenderLight:
    light: Any = thing.data
    color = np.array(light.color)
    if getattr(light, "use_temperature", False):
        color *= light.temperature_color
    power = light.energy
    if not eevee:
        color *= world_nodes.of_light(light)[0]
        if light.type == "AREA" and getattr(getattr(light, "cycles", None), "is_portal", False):
            power = 0.0  # it only guides the world's light
    size_x = getattr(light, "size", 0.0)
    shape = getattr(light, "shape", "SQUARE")
    linking = thing.light_linking
    return lamps.BlenderLight(
        kind=light.type,
        matrix=matrix,
        power=power,
        color=rec709(color),
        exposure=getattr(light, "exposure", 0.0),
        is_normalized=getattr(light, "normalize", True),
        radius=getattr(light, "shadow_soft_size", 0.0),
        is_soft=getattr(light, "use_soft_falloff", True),
        angle=getattr(light, "angle", 0.0),
        cone=getattr(light, "spot_size", np.pi),
        blend=getattr(light, "spot_blend", 0.0),
        size=(size_x, light.size_y if shape in ("RECTANGLE", "ELLIPSE") else size_x),
        is_ellipse=shape in ("DISK", "ELLIPSE"),
        spread=np.pi if eevee else getattr(light, "spread", np.pi),
        has_shadow=light.use_shadow and lights_any(linking.blocker_collection, hands),
        matt=thing.visible_diffuse * (light.diffuse_factor if eevee else 1.0),
        gloss=thing.visible_glossy * (light.specular_factor if eevee else 1.0),
        blockers=picked_by(linking.blocker_collection),
        receivers=picked_by(linking.receiver_collection),
    )


def rec709(color: np.ndarray) -> np.ndarray:
    """(3,) of the file's working space -> linear Rec.709."""
    return np.array(Color(color).from_scene_linear_to_rec709_linear())


def _warnings(thing: bpy.types.Object, hands: Sequence[bpy.types.Object], *, eevee: bool) -> Iterator[str]:
    light: Any = thing.data
    name = thing.name
    if light.energy < 0:
        yield f"{name}: negative power does not darken hands; hide it from them by light linking"
    if eevee and light.use_custom_distance and light.type != "SUN":
        yield f'{name}: "Custom Distance" does not end its light on hands; lower its power'
    unread = "" if eevee else world_nodes.of_light(light)[1]
    if unread:
        yield f'{name}: "{unread}" of its nodes is left out on hands; give its Emission plain values'
    blockers = thing.light_linking.blocker_collection
    if light.use_shadow and not lights_any(blockers, hands):
        yield f"{name}: nothing shades hands, as its shadow linking leaves them out; link them too"


# ---- light linking ---------------------------------------------------------------------------------------------------


def lights_any(linked: bpy.types.Collection | None, hands: Sequence[bpy.types.Object]) -> bool:
    """Whether any of the hands is a receiver, or a blocker, of a light's collection of those."""
    picked = picked_by(linked)
    return not hands or any(is_picked(called, picked) for thing in hands for called in _called(thing))


def _called(thing: bpy.types.Object) -> Iterator[frozenset[tuple[str, ...]]]:
    """What light linking may call each hand that an object is, or instances."""
    for hand in (thing, *seen_hands.hands_below(thing)):
        yield from (armature.called(hand, side, thing) for side in (RIGHT, LEFT))


def picked_by(linked: bpy.types.Collection | None) -> Picked:
    """What a light's collection picks, or leaves out: an empty one has everything. Objects count before collections;
    who is excluded is out, and so is whoever is not among those who are included."""
    if linked is None:
        return EVERYTHING
    states: dict[tuple[str, ...], str] = {}
    for child, how in zip(linked.children, linked.collection_children, strict=True):
        for thing in child.all_objects:
            states[armature.name_in_links(thing)] = how.light_linking.link_state
    for thing, how in zip(linked.objects, linked.collection_objects, strict=True):
        states[armature.name_in_links(thing)] = how.light_linking.link_state
    named = "INCLUDE" if "INCLUDE" in states.values() else "EXCLUDE"
    names = sorted(name for name, state in states.items() if state == named)
    return (tuple(names), named == "INCLUDE") if names else EVERYTHING
