# SPDX-License-Identifier: GPL-3.0-or-later
"""The world of a scene as light: read from its nodes, or measured by a light probe where these do not tell, or where
objects around the hands shine, too.

    reading = world_of(depsgraph, place_of(depsgraph, hands))    anywhere, also while drawing and rendering
    update(depsgraph, reading.place)                             where that is stale; on the main thread, in no handler

Pictures are averaged once and kept; what was measured is kept until something else is.
"""

from __future__ import annotations

import threading
from collections import Counter, OrderedDict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import bpy
import numpy as np

from .. import versions
from ..core import worlds
from ..core.pacing import digest
from ..core.view import linear_of
from ..core.worlds import Sun, WorldLight
from ..errors import JGHandFailure
from ..hand import armature
from . import lamps, probe
from .world_nodes import Shine, Unread, shine_of, shows_cameras_more, values_of, values_of_tree

# worlds whose light is kept, pictures as they were read and lights as they were measured: some MB each
KEPT = 8
# color spaces whose bytes are taken as they are
_LINEAR_BYTES = ("Non-Color", "Raw", "Linear", "Linear Rec.709")
_SKIES_WITH_SUN = ("NISHITA", "SINGLE_SCATTERING", "MULTIPLE_SCATTERING")
_ALL = SimpleNamespace(diffuse=True)

_pictures: OrderedDict[str, np.ndarray] = OrderedDict()
# pictures as worlds have them, multiplied and in the colors of the engine
_products: OrderedDict[str, np.ndarray] = OrderedDict()
_measured: OrderedDict[str, WorldLight] = OrderedDict()
# session_uid of images, and _AROUND for all else around hands -> how often that was changed
_changes: Counter[int] = Counter()
_AROUND = -1
# what stood around hands last, by session_uid of scenes and names of view layers
_stood: dict[tuple[int, str], str] = {}
# light is measured at the middle of the hands, anew where they left such a part of space
CELL_M = 0.05
Place = tuple[int, int, int]
# objects that light may come from, or be stopped by
SURFACES = {"MESH", "CURVE", "SURFACE", "FONT", "META", "CURVES", "POINTCLOUD", "VOLUME"}


class Reading(NamedTuple):
    """light: None for a black world. failures: what the panel says. stale: the name of what `update` has to measure,
    "" for nothing; until then `light` is what was measured last. place: as of `place_of`. for_cameras: whether the
    world is black to hands alone."""

    light: WorldLight | None
    failures: tuple[JGHandFailure, ...] = ()
    stale: str = ""
    place: Place | None = None
    for_cameras: bool = False


def place_of(depsgraph: bpy.types.Depsgraph, hands: Sequence[bpy.types.Object]) -> Place | None:
    """The cell of space in which light is measured for hands, where their scene wants what is around them."""
    if not depsgraph.scene.jghand.use_surroundings or not hands:
        return None
    places = np.array([hand.evaluated_get(depsgraph).matrix_world.translation for hand in hands])
    x, y, z = np.rint(places.mean(0) * depsgraph.scene.unit_settings.scale_length / CELL_M).astype(int).tolist()
    return x, y, z


def world_of(depsgraph: bpy.types.Depsgraph, place: Place | None = None) -> Reading:
    """How the world of a scene lights matt surfaces, as it is evaluated; at a place, with what is around it."""
    world = world_in(depsgraph.scene_eval, depsgraph.view_layer_eval)
    if place is not None:
        tree = world and versions.world_tree(world)
        parts = [*values_of_tree(tree)] if tree else [repr(world and world.color[:])]
        found = _found("around", [*parts, repr((_changes, place)), _known_standing(depsgraph)])
        # until then the world alone
        return found._replace(place=place, light=found.light if found.light is not None else world_of(depsgraph).light)
    # where Cycles is disabled there is no Ray Visibility
    if world is None or not getattr(world, "cycles_visibility", _ALL).diffuse:
        return Reading(None, for_cameras=world is not None and world.cycles_visibility.camera)
    try:
        shine = shine_of(world)
        if shine.source is None:
            light = _of_color(shine.even)
            return Reading(light, for_cameras=light is None and shows_cameras_more(world))
        if isinstance(shine.source, bpy.types.Image):
            return Reading(_of_picture(shine))
        return _of_sky(shine)
    except Unread:
        painted = {image: count for image, count in _changes.items() if image != _AROUND}
        return _found("nodes", [*values_of_tree(world.node_tree), repr(painted)])
    except JGHandFailure as failure:
        return Reading(None, (failure,))


def update(depsgraph: bpy.types.Depsgraph, place: Place | None = None) -> bool:
    """Measures the world of a scene where that is stale; says whether anything is new.

    Takes from a tenth of a second to some. Raises JGHandFailure (no_cycles, world_bake).
    """
    name = world_of(depsgraph, place).stale
    if not name:
        return False
    scene, layer = depsgraph.scene, depsgraph.view_layer
    try:
        evaluated = world_in(depsgraph.scene_eval, depsgraph.view_layer_eval)
        shine = shine_of(evaluated) if evaluated is not None else Shine()
    except Unread:
        shine = Shine()
    sky = shine.source if isinstance(shine.source, bpy.types.Node) else None
    sun = _sun_of(sky) if sky is not None else None
    if place is not None:
        at = np.array(place) * CELL_M / scene.unit_settings.scale_length
        found = _standing(layer)
        lamps_there = tuple(thing for thing in found if thing.type == "LIGHT")
        things = tuple(thing for thing in found if thing.type != "LIGHT")
        around = probe.Around(tuple(at.tolist()), things, lamps_there)
        turned = sun and Sun(shine.turn.T @ sun.towards, sun.angle_rad)
        light = probe.measure(scene, world_in(scene, layer), turned, around)
    elif sky is not None:
        light = probe.measure_sky(scene, sky, sun)
    else:
        light = probe.measure(scene, world_in(scene, layer))
    suns = tuple({**sun, "rgb": _rec709(np.array(sun["rgb"])).tolist()} for sun in light.suns)
    _keep(_measured, name, replace(light, radiance=_rec709(light.radiance), suns=suns))
    return True


def notice(depsgraph: bpy.types.Depsgraph) -> None:
    """Something was changed in Blender: pictures may be painted, and what is around hands may shine otherwise."""
    for change in depsgraph.updates:
        thing, is_other = change.id, change.is_updated_transform or change.is_updated_geometry
        if isinstance(thing, bpy.types.Image):
            _changes[thing.session_uid] += 1
        elif isinstance(thing, bpy.types.Material | bpy.types.Light) or (
            is_other and isinstance(thing, bpy.types.Object) and (_is_around(thing) or thing.type == "LIGHT")
        ):
            _changes[_AROUND] += 1


def forget() -> None:
    for kept in (_pictures, _products, _measured, _changes, _stood):
        kept.clear()


def world_in(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bpy.types.World | None:
    """That of a view layer."""
    return getattr(layer, "world_override", None) or scene.world


def _standing(layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    """What is rendered of what is around hands, and lamps."""
    found = armature.rendered_at_any_frame(layer, lambda thing: thing.type == "LIGHT" or _is_around(thing))
    return [thing for thing in found if not thing.hide_render]


def _known_standing(depsgraph: bpy.types.Depsgraph) -> str:
    """The same as text, with their places; on the thread of a render as it was last, for the artist may delete some."""
    scene, layer = depsgraph.scene, depsgraph.view_layer
    key = scene.session_uid, layer.name
    if threading.current_thread() is threading.main_thread():
        parts = [(thing.name_full, thing.session_uid, *map(tuple, thing.matrix_world)) for thing in _standing(layer)]
        _stood[key] = digest([repr(parts)])
    return _stood.get(key, "")


def _is_around(thing: bpy.types.Object) -> bool:
    """Whether an object is rendered and a surface, or brings some but no lamps that are sent as lamps, nor hands."""
    if thing.hide_render:
        return False
    inside = thing.instance_collection if thing.instance_type == "COLLECTION" else None
    if inside is not None:
        return not any(each.type in ("LIGHT", "ARMATURE") for each in inside.all_objects)
    return is_surface(thing)


def is_surface(thing: bpy.types.Object) -> bool:
    """Whether an object may shine, throw light back or take it, and is no stand-in of a hand."""
    return thing.type in SURFACES and armature.STAND_IN not in thing


# ---- read ------------------------------------------------------------------------------------------------------------


def _of_color(rgb: np.ndarray) -> WorldLight | None:
    return worlds.even(_rec709(rgb)) if (rgb > 0).any() else None


def _of_picture(shine: Shine) -> WorldLight:
    image = shine.source
    parts = [image.session_uid, image.filepath, image.size[:], image.colorspace_settings.name, image.source]
    parts += [image.generated_type, image.generated_color[:], image.is_dirty, _changes[image.session_uid]]
    name = digest([repr(parts), _space()])
    picture = _pictures.get(name)
    picture = _keep(_pictures, name, _read(image) if picture is None else picture)
    key = digest([name, repr([shine.gain.tolist(), shine.even.tolist()])])
    radiance = _products.get(key)
    if radiance is None:
        light = picture * shine.gain.astype(np.float32) + shine.even.astype(np.float32)
        radiance = _keep(_products, key, _rec709(light))
    return WorldLight(radiance, shine.turn, key=key)


def _read(image: bpy.types.Image) -> np.ndarray:
    """(H, W, 3) scene-linear, averaged. Raises Unread where only Blender knows its colors, JGHandFailure
    (no_world_image)."""
    space, (width, height), channels = image.colorspace_settings.name, image.size, image.channels
    if image.source not in ("FILE", "GENERATED"):
        raise Unread
    if not width * height:
        raise JGHandFailure("no_world_image", image.filepath)
    if channels < 3:
        raise Unread
    is_encoded = not image.is_float and space not in _LINEAR_BYTES
    if is_encoded and (space != "sRGB" or not _is_rec709()):
        raise Unread
    values = np.empty(width * height * channels, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(height, width, channels)[::-1, :, :3]
    if is_encoded:
        values = linear_of(values)
    return worlds.averaged(np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0))


# ---- measured --------------------------------------------------------------------------------------------------------


def _of_sky(shine: Shine) -> Reading:
    """A sky is measured as it is, and turned and multiplied afterwards."""
    reading = _found("sky", values_of(shine.source))
    if reading.light is None:
        return reading
    light, gain = reading.light, shine.gain
    turned = worlds.in_joints(shine.turn.T)
    suns = tuple(
        {**sun, "rgb": (gain * sun["rgb"]).tolist(), "place_m": (turned @ sun["place_m"]).tolist()}
        for sun in light.suns
    )
    key = digest([light.key, repr([gain.tolist(), shine.even.tolist()])])
    radiance = np.maximum(light.radiance * gain + shine.even, 0).astype(np.float32)
    return reading._replace(light=WorldLight(radiance, shine.turn, suns, key))


def _sun_of(sky: Any) -> Sun | None:
    """The disc of a Sky Texture node; azimuths go from +y to +x."""
    if sky.sky_type not in _SKIES_WITH_SUN or not sky.sun_disc:
        return None
    height, turn = sky.sun_elevation, sky.sun_rotation
    towards = np.cos(height) * np.sin(turn), np.cos(height) * np.cos(turn), np.sin(height)
    return Sun(np.array(towards), sky.sun_size)


def _found(kind: str, parts: Iterable[str]) -> Reading:
    """What was measured of such parts; until then what was measured last of this kind: a sky is brighter by itself than
    as its world has it."""
    name = f"{kind} {digest([*parts, _space()])}"
    if name in _measured:
        _measured.move_to_end(name)
        return Reading(_measured[name])
    last = next((light for known, light in reversed(_measured.items()) if known.startswith(kind)), None)
    return Reading(last, (JGHandFailure("world_not_measured"),), name)


def _keep(kept: OrderedDict[str, Any], name: str, value: Any) -> Any:
    kept[name] = value
    kept.move_to_end(name)
    while len(kept) > KEPT:
        kept.popitem(last=False)
    return value


# ---- colors ----------------------------------------------------------------------------------------------------------


def rec709_from_scene() -> np.ndarray:
    """(3, 3) from the working space of the file."""
    return np.stack([lamps.rec709(axis) for axis in np.eye(3)], 1)


def _space() -> str:
    return repr(rec709_from_scene().round(6).tolist())


def _is_rec709() -> bool:
    return bool(np.allclose(rec709_from_scene(), np.eye(3), atol=1e-4))


def _rec709(values: np.ndarray) -> np.ndarray:
    """Scene-linear colors of any shape, as Rec.709 without negative parts."""
    turned = values if _is_rec709() else values @ rec709_from_scene().T
    return np.maximum(turned, 0).astype(np.float32)


# ---- the HDRI of Material Preview, in a 3D view that does not show the world of the scene ----------------------------
# How it lies was found in a window (run, 5.2.2): at rotation 0 as an environment texture, a positive rotation turns its
# light clockwise as seen from above, and without World Space Lighting it turns with the view, forward for +y.

# pictures of HDRIs by their paths, None for one that Blender cannot read; some MB each
_hdris: dict[str, np.ndarray | None] = {}
# the one that a view waits for
_wanted = ""


def hdri_light(space: bpy.types.SpaceView3D) -> WorldLight | None:
    """The light of a view's HDRI; None where it has none that can be read, and until `read_hdri` has read it."""
    global _wanted
    shading = space.shading
    path = shading.selected_studio_light.path if shading.selected_studio_light is not None else ""
    if path not in _hdris:
        _wanted = path
        return None
    if _hdris[path] is None:
        return None
    cosine, sine = np.cos(shading.studiolight_rotate_z), np.sin(shading.studiolight_rotate_z)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    if not shading.use_studiolight_view_rotation:
        right, up, back = np.array(space.region_3d.view_matrix)[:3, :3]
        turn = turn @ np.stack([right, -back, up])
    return replace(_light(path, shading.studiolight_intensity), env_from_blender=turn)


@lru_cache(maxsize=4)
def _light(path: str, intensity: float) -> WorldLight:
    picture = _hdris[path]
    assert picture is not None  # `hdri_light` has checked it
    return WorldLight(picture * np.float32(intensity), key=digest([path, repr(intensity)]))


def read_hdri() -> bool:
    """For the timer: reads the HDRI that a view waits for; says whether there was one."""
    global _wanted
    path, _wanted = _wanted, ""
    if not path:
        return False
    image = None
    try:
        image = bpy.data.images.load(path)
        _hdris[path] = _rec709(_read(image))
    except (RuntimeError, JGHandFailure, Unread):  # no such file, or none that can be read
        _hdris[path] = None
    finally:
        if image is not None:
            bpy.data.images.remove(image)
    return True
