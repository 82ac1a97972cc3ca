# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in the picture of Cycles or EEVEE: a second scene with the hands, rendered by JGHand, combined by depth.

One scene has one engine, so the hands get a scene of their own, which shares objects and camera with the first. The
compositor of the first takes, per pixel, what is nearer. Nodes that are there already stay: ours go between the last of
them and the output. What is ours carries a mark, so that it can be brought up to date and taken away again.
Source: BLENDER 8.4.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy

from .. import versions
from ..errors import JGHandFailure
from ..hand import armature, seen_hands
from . import ENGINE, worlds
from .scene_shadows import SOLID

# custom properties of the first scene: the scene of its hands, whether its compositor is ours, whether it composited
# and locked Blender's interface before, the nodes of its own that were switched off then, and the engine that it was
# given in place of ours; of the view layer that is combined: whether it had its depth before. A copy of the scene has
# them too, so that the scene of the hands says whose it is; it, and nodes, say that they are ours
HANDS_SCENE, OWN_TREE, HAD_DEPTH = "jghand_hands_scene", "jghand_own_compositor", "jghand_had_depth"
HAD_COMPOSITING, ASIDE = "jghand_had_compositing", "jghand_compositor_aside"
HAD_LOCK, GIVEN_ENGINE = "jghand_had_lock_interface", "jghand_given_engine"
OWNER = "jghand_combined_scene"
MARK = "jghand_combination"
# what the scene of the hands has as the first one has it
_SCENE = ("frame_start", "frame_end", "frame_step", "camera", "world")
_RENDER = (
    *("resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y", "fps", "fps_base"),
    *("use_border", "use_crop_to_border", "border_min_x", "border_max_x", "border_min_y", "border_max_y"),
    *("use_motion_blur", "motion_blur_shutter", "motion_blur_position", "frame_map_old", "frame_map_new"),
)
_HANDS = ("light", "use_surroundings", "use_exact_light", "render_preset", "motion_samples")
# what Blender takes from the first scene by itself when it renders both
_FOLLOWS = ("frame_start", "frame_end", "frame_step", "resolution_x", "resolution_y", "resolution_percentage")
_GAP_PX = 250
# nodes of a compositor in which nobody has worked, beside ours
_BARE = {"NodeGroupOutput", "CompositorNodeComposite", "CompositorNodeRLayers"}


def hands_scene_of(scene: bpy.types.Scene) -> bpy.types.Scene | None:
    """The scene with the hands of a combined one; None for a copy of one: it has our nodes, and no hands of its own."""
    hands = scene.get(HANDS_SCENE)
    return hands if isinstance(hands, bpy.types.Scene) and hands.get(OWNER) == scene else None


def has_combination(scene: bpy.types.Scene) -> bool:
    """Whether a scene is combined, or a copy of one that is."""
    return HANDS_SCENE in scene


def out_of_date(scene: bpy.types.Scene) -> list[str]:
    """In which the hands of a combined scene differ from it, in words: its picture is not what it seems to be."""
    ours, layer = hands_scene_of(scene), _combined_layer(scene)
    if ours is None or layer is None:
        return []
    wanted, there = _things(scene, layer), set(ours.collection.objects)
    missing = [thing for thing in wanted if thing not in there]
    found = [f"{thing.name} is missing" for thing in missing if not worlds.is_surface(thing)]
    shading = sum(map(worlds.is_surface, missing))
    if shading:
        found.append(f"{shading} things that may light or shade hands are missing")
    unneeded = len(there.difference(wanted))
    if unneeded:
        found.append(f"{unneeded} objects are no longer needed")
    found += [
        f"{of.bl_rna.properties[name].name} differs"
        for owner, of, names in _shared(scene, ours)
        for name in names
        if name not in _FOLLOWS and getattr(owner, name) != getattr(of, name)
    ]
    return found


def is_hands_scene(scene: bpy.types.Scene) -> bool:
    return MARK in scene


def combine(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bpy.types.Scene:
    """Sets everything up, or brings it up to date. Returns the scene of the hands.

    layer: the view layer that is combined with. Raises JGHandFailure: no_hand, no_camera.
    """
    if not seen_hands.sources_at_any_frame(layer):
        raise JGHandFailure("no_hand", scene.name)
    if scene.camera is None:
        raise JGHandFailure("no_camera")
    ours = hands_scene_of(scene)
    if ours is None:
        ours = bpy.data.scenes.new(f"{scene.name} Hands")
        ours[MARK], ours[OWNER] = True, scene
        _forget_nodes(scene)  # of the scene that this is a copy of
        scene[HANDS_SCENE] = ours
    if _combined_layer(scene) != layer:
        _forget_nodes(scene)
        _give_depth_back(scene)
        layer[HAD_DEPTH] = layer.use_pass_z
    _share(scene, ours, layer)
    layer.use_pass_z = True
    if HAD_COMPOSITING not in scene:
        _begin_compositing(scene)
        scene[HAD_LOCK] = scene.render.use_lock_interface
    scene.render.use_compositing = scene.render.use_lock_interface = True
    had_tree = versions.compositor_tree(scene) is not None
    tree = versions.ensure_compositor_tree(scene)
    if not had_tree:
        scene[OWN_TREE] = True
    if not _nodes(tree):
        _insert(tree, scene, layer, ours)
    return ours


def remove(scene: bpy.types.Scene) -> None:
    """Takes away what `combine` made, nothing else; of a copy of a combined scene what it has of that."""
    _forget_nodes(scene)
    tree = versions.compositor_tree(scene)
    if scene.get(OWN_TREE) and tree is not None:
        if all(node.bl_idname in _BARE for node in tree.nodes):
            versions.remove_compositor_tree(scene)
        elif scene.get(ASIDE) is not None:
            tree.use_fake_user = True  # somebody worked in it; the scene gets its earlier one back
    if scene.get(ASIDE) is not None:
        scene.compositing_node_group = scene[ASIDE]
    scene.render.use_compositing = bool(scene.get(HAD_COMPOSITING, scene.render.use_compositing))
    ours = hands_scene_of(scene)
    if ours is not None:
        bpy.data.scenes.remove(ours)
    _give_depth_back(scene)
    scene.render.use_lock_interface = bool(scene.get(HAD_LOCK, scene.render.use_lock_interface))
    if scene.get(GIVEN_ENGINE) == scene.render.engine:
        scene.render.engine = ENGINE
    _forget_marks(scene)


def forget(copy: bpy.types.Scene) -> None:
    """Leaves a copy of a scene without nodes in its compositor, and without what it has of a combination."""
    versions.empty_compositor(copy)
    for layer in copy.view_layers:
        layer.pop(HAD_DEPTH, None)
    _forget_marks(copy)


def _forget_marks(scene: bpy.types.Scene) -> None:
    for name in (HANDS_SCENE, OWN_TREE, HAD_COMPOSITING, ASIDE, HAD_LOCK, GIVEN_ENGINE):
        scene.pop(name, None)


def _combined_layer(scene: bpy.types.Scene) -> bpy.types.ViewLayer | None:
    return next((layer for layer in scene.view_layers if HAD_DEPTH in layer), None)


def _begin_compositing(scene: bpy.types.Scene) -> None:
    """Remembers how it was. Nodes of a scene that does not composite are not to begin with it: they are put aside."""
    scene[HAD_COMPOSITING] = scene.render.use_compositing
    if not scene.render.use_compositing:
        aside = versions.take_compositor_tree_away(scene)
        if aside is not None:
            scene[ASIDE] = aside


def _give_depth_back(scene: bpy.types.Scene) -> None:
    layer = _combined_layer(scene)
    if layer is not None:
        layer.use_pass_z = bool(layer[HAD_DEPTH])
        del layer[HAD_DEPTH]


def _forget_nodes(scene: bpy.types.Scene) -> None:
    """Takes our nodes out of a scene's compositor; one that a copy of the scene shares stays as it is there."""
    tree = versions.compositor_tree(scene)
    if tree is not None and _nodes(tree):
        _take_out(versions.own_compositor_tree(scene))


def _share(scene: bpy.types.Scene, ours: bpy.types.Scene, layer: bpy.types.ViewLayer) -> None:
    """Makes the scene of the hands show what the first one does, from the same side, in the same time."""
    for owner, of, names in _shared(scene, ours):
        for name in names:
            setattr(owner, name, getattr(of, name))
    ours.unit_settings.scale_length = scene.unit_settings.scale_length
    _copy_curve(scene.render.motion_blur_shutter_curve, ours.render.motion_blur_shutter_curve)
    ours.render.engine, ours.render.film_transparent = ENGINE, True
    ours.view_layers[0].use_pass_z = True
    wanted, there = _things(scene, layer), set(ours.collection.objects)
    for thing in there.difference(wanted):
        ours.collection.objects.unlink(thing)
    for thing in wanted:
        if thing not in there:  # not by its name: linked objects may have the same
            ours.collection.objects.link(thing)
    ours.timeline_markers.clear()
    for marker in scene.timeline_markers:
        if marker.camera is not None:
            ours.timeline_markers.new(marker.name, frame=marker.frame).camera = marker.camera


def _shared(scene: bpy.types.Scene, ours: bpy.types.Scene) -> Iterator[tuple[Any, Any, tuple[str, ...]]]:
    """What the scene of the hands has as the first one has it: (its owner there, here, names)."""
    yield ours, scene, _SCENE
    yield ours.render, scene.render, _RENDER
    yield ours.jghand, scene.jghand, _HANDS


def _things(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    """The objects of the scene of the hands: hands, what moves them, cameras, the lamps that light them, and what may
    stand in that light."""
    cameras = [marker.camera for marker in scene.timeline_markers]
    parts = [part for hand in seen_hands.sources_at_any_frame(layer) for part in armature.parts_of(hand)]
    known: seen_hands.Known = {}
    is_lit, settings = scene.jghand.light == "SCENE", scene.jghand
    throws_back = settings.use_surroundings or settings.use_exact_light

    def of_light(thing: bpy.types.Object) -> bool:
        if thing.type == "LIGHT" or not is_lit:
            return thing.type == "LIGHT"
        # what throws back counts also where it throws no shadow
        return worlds.is_surface(thing) and (throws_back or (thing.type in SOLID and thing.visible_shadow))

    lights = armature.rendered_at_any_frame(layer, lambda thing: seen_hands.shows(thing, of_light, known))
    return [thing for thing in dict.fromkeys((*parts, scene.camera, *cameras, *lights)) if thing is not None]


def _copy_curve(source: bpy.types.CurveMapping, target: bpy.types.CurveMapping) -> None:
    wanted, points = source.curves[0].points, target.curves[0].points
    while len(points) > len(wanted):
        points.remove(points[len(points) - 2])  # the ends stay
    while len(points) < len(wanted):
        points.new(0.5, 0.5)
    for point, place in zip(points, wanted, strict=True):
        point.location, point.handle_type = place.location, place.handle_type
    target.update()


# ---- nodes ----------------------------------------------------------------------------------------------------------


def _nodes(tree: bpy.types.NodeTree) -> list[bpy.types.Node]:
    return [node for node in tree.nodes if node.get(MARK)]


def _insert(
    tree: bpy.types.NodeTree, scene: bpy.types.Scene, layer: bpy.types.ViewLayer, ours: bpy.types.Scene
) -> None:
    """Combines what goes into the output with the hands, by depth. Sockets are taken by their place: names change."""
    output = versions.compositor_output(tree)
    before = output.inputs[0].links[0].from_socket if output.inputs[0].links else None
    here = _layer_node(tree, scene, layer) or _new_node(tree, "CompositorNodeRLayers", output, (-3, 0))
    if here.get(MARK):
        here.scene, here.layer = scene, layer.name
    theirs = _new_node(tree, "CompositorNodeRLayers", output, (-3, -2))
    theirs.scene, theirs.layer = ours, ours.view_layers[0].name
    nearer = _new_node(tree, "CompositorNodeZcombine", output, (-1, 0))
    versions.combine_soft_edges(nearer)
    pictures = (before or here.outputs["Image"], theirs.outputs["Image"])
    for place, (picture, depth) in enumerate(
        zip(pictures, (here.outputs["Depth"], theirs.outputs["Depth"]), strict=True)
    ):
        # Z Combine multiplies the nearer picture by its alpha, as if it were straight: soft edges would become dark
        straight = _new_node(tree, "CompositorNodePremulKey", output, (-2, -2 * place))
        versions.make_straight(straight)
        tree.links.new(picture, straight.inputs[0])
        tree.links.new(straight.outputs[0], nearer.inputs[2 * place])
        tree.links.new(depth, nearer.inputs[2 * place + 1])
    tree.links.new(nearer.outputs[0], output.inputs[0])


def _take_out(tree: bpy.types.NodeTree) -> None:
    for node in _nodes(tree):
        if node.bl_idname == "CompositorNodeZcombine" and node.inputs[0].links:
            source = node.inputs[0].links[0].from_socket
            if source.node.get(MARK) and source.node.inputs and source.node.inputs[0].links:  # what makes it straight
                source = source.node.inputs[0].links[0].from_socket
            for target in [link.to_socket for link in node.outputs[0].links]:
                if not source.node.get(MARK):
                    tree.links.new(source, target)
    for node in _nodes(tree):
        tree.nodes.remove(node)


def _layer_node(tree: bpy.types.NodeTree, scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bpy.types.Node | None:
    return next(
        (
            node
            for node in tree.nodes
            if node.bl_idname == "CompositorNodeRLayers" and node.scene == scene and node.layer == layer.name
        ),
        None,
    )


def _new_node(tree: bpy.types.NodeTree, kind: str, beside: bpy.types.Node, place: tuple[int, int]) -> Any:
    """A node of ours, so many gaps beside another."""
    node = tree.nodes.new(kind)
    node[MARK] = True
    x, y = beside.location
    if place[0] == -1:  # room for it between the output and what is before it
        beside.location.x = x + _GAP_PX
        x += _GAP_PX
    node.location = (x + place[0] * _GAP_PX, y + place[1] * _GAP_PX)
    return node
