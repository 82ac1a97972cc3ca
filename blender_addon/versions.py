# SPDX-License-Identifier: GPL-3.0-or-later
"""What differs between Blender versions. Features are looked for; version numbers are never compared."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
from bpy_extras import anim_utils


def new_action(
    owner: bpy.types.ID, name: str, *, replaces: Callable[[str], bool] = lambda _path: False
) -> bpy.types.Action:
    """A fresh action with a slot for `owner`, made its active one.

    It goes on with all that the action before it animates of `owner`, whole curves with their modifiers, but for those
    whose data path it `replaces`. The action before it stays in the file, also when that is saved.
    """
    animation = owner.animation_data or owner.animation_data_create()
    before, old_slot = animation.action, animation.action_slot
    if before is None or old_slot is None:
        action = bpy.data.actions.new(name)
        slot = action.slots.new(owner.id_type, owner.name)
    else:
        action = before.copy()
        action.name = name
        for other in [other for other in action.slots if other.handle != old_slot.handle]:
            action.slots.remove(other)
        slot = action.slots[0]
        bag = anim_utils.action_get_channelbag_for_slot(action, slot)
        for curve in list(bag.fcurves) if bag else ():
            if replaces(curve.data_path):
                bag.fcurves.remove(curve)
    if before is not None and before.library is None:
        before.use_fake_user = True
    animation.action = action
    animation.action_slot = slot
    return action


def new_fcurve(owner: bpy.types.ID, data_path: str, index: int, group: str) -> bpy.types.FCurve:
    """A curve in the action of `owner` made by `new_action`, in the named group."""
    animation = owner.animation_data
    if hasattr(anim_utils, "action_ensure_channelbag_for_slot"):
        bag = anim_utils.action_ensure_channelbag_for_slot(animation.action, animation.action_slot)
        curve = bag.fcurves.new(data_path, index=index)
    else:  # 4.5
        curve = animation.action.fcurve_ensure_for_datablock(owner, data_path, index=index)
    bag = anim_utils.action_get_channelbag_for_slot(animation.action, animation.action_slot)
    curve.group = bag.groups.get(group) or bag.groups.new(group)
    return curve


def fcurves(owner: bpy.types.ID) -> list[Any]:
    animation = owner.animation_data
    if animation is None or animation.action is None:
        return []
    bag = anim_utils.action_get_channelbag_for_slot(animation.action, animation.action_slot)
    return list(bag.fcurves) if bag else []


def selected_bones(thing: bpy.types.Object) -> set[str]:
    """Names of the selected bones of an armature's object that can be seen."""
    return {bone.name for bone in visible_bones(thing) if _selectable(bone).select}


def select_bones(thing: bpy.types.Object) -> None:
    """Selects all bones that can be seen, where none is: Blender's timeline shows the keys of selected bones only."""
    if not selected_bones(thing):
        for bone in visible_bones(thing):
            _selectable(bone).select = True


def _selectable(bone: bpy.types.PoseBone) -> Any:
    """What of a bone is selected, and hidden: each object's own from 5.0 on."""
    return bone if hasattr(bone, "select") else bone.bone


def visible_bones(thing: bpy.types.Object) -> list[bpy.types.PoseBone]:
    """The bones of an armature's object that are not hidden, nor all collections that they are in."""
    return [
        bone
        for bone in thing.pose.bones
        if not _selectable(bone).hide
        and (not bone.bone.collections or any(one.is_visible_effectively for one in bone.bone.collections))
    ]


def use_eevee(scene: bpy.types.Scene) -> None:
    """Its name changed in 5.0."""
    try:
        scene.render.engine = "BLENDER_EEVEE"
    except TypeError:
        scene.render.engine = "BLENDER_EEVEE_NEXT"


def has_usd() -> bool:
    """Whether this Blender was built with USD; some Linux distributions leave it out."""
    return bool(getattr(bpy.app.build_options, "usd", False))


def write_png(settings: bpy.types.ImageFormatSettings) -> None:
    """Makes a scene write PNG; where it does already, its depth, colors and compression stay."""
    if hasattr(settings, "media_type"):  # 5.0 and later; which formats there are depends on it
        settings.media_type = "IMAGE"
    if settings.file_format != "PNG":
        settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGBA", "8"


def literal_path(path: Path) -> str:
    """A path for a scene's output, where braces may be templates (5.0 and later)."""
    text = str(path)
    filepath = bpy.types.RenderSettings.bl_rna.properties["filepath"]
    if not getattr(filepath, "is_path_supports_templates", False):
        return text
    return text.replace("{", "{{").replace("}", "}}")


def path_options() -> set[str]:
    """Options of a property that is a path and may begin with `//`; 4.5 takes that for granted where it knows no
    option for it."""
    known = "is_path_supports_blend_relative" in bpy.types.StringProperty.bl_rna.properties
    return {"PATH_SUPPORTS_BLEND_RELATIVE"} if known else set()


# from 5.0 on the compositor's nodes are a group that scenes may share, and nodes of worlds and materials are used
# wherever they are: asking `use_nodes` warns there
_HAS_GROUPS = "compositing_node_group" in bpy.types.Scene.bl_rna.properties


def compositor_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    """The compositor's nodes of a scene; None while it has none."""
    if _HAS_GROUPS:
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def ensure_compositor_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """The same, made where there is none."""
    tree = compositor_tree(scene)
    if tree is None and _HAS_GROUPS:
        tree = scene.compositing_node_group = bpy.data.node_groups.new(scene.name, "CompositorNodeTree")
    elif tree is None:
        scene.use_nodes = True
        tree = scene.node_tree
    return tree


def own_compositor_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """The compositor's nodes of a scene that has some, made its own where copies of the scene share them."""
    tree: bpy.types.NodeTree = compositor_tree(scene)
    if _HAS_GROUPS and tree.users > 1:
        tree = scene.compositing_node_group = tree.copy()
    return tree


def remove_compositor_tree(scene: bpy.types.Scene) -> None:
    tree = take_compositor_tree_away(scene)
    if not _HAS_GROUPS:
        scene.use_nodes = False
    elif tree is not None and not tree.users:
        bpy.data.node_groups.remove(tree)


def take_compositor_tree_away(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    """Leaves a scene without compositor's nodes, and returns those that it had; in 4.5 they are a part of the scene and
    stay."""
    if not _HAS_GROUPS:
        return None
    tree, scene.compositing_node_group = scene.compositing_node_group, None
    return tree


def empty_compositor(scene: bpy.types.Scene) -> None:
    """Leaves a scene without compositor's nodes; those that it shares with another stay there."""
    take_compositor_tree_away(scene)
    if not _HAS_GROUPS and scene.node_tree is not None:
        scene.node_tree.nodes.clear()


def compositor_output(tree: bpy.types.NodeTree) -> bpy.types.Node:
    """The node whose first input is the finished picture, made where there is none."""
    if not _HAS_GROUPS:
        found = [node for node in tree.nodes if node.bl_idname == "CompositorNodeComposite"]
        return next((node for node in found if node.mute is False), None) or tree.nodes.new("CompositorNodeComposite")
    found = [node for node in tree.nodes if node.bl_idname == "NodeGroupOutput"]
    output = next((node for node in found if node.is_active_output), None) or tree.nodes.new("NodeGroupOutput")
    if not any(item.item_type == "SOCKET" and item.in_out == "OUTPUT" for item in tree.interface.items_tree):
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    return output


def combine_soft_edges(combine: bpy.types.Node) -> None:
    """Makes a Z Combine node mix what is half transparent, and leave its edges as they are."""
    if hasattr(combine, "use_alpha"):  # 4.5
        combine.use_alpha, combine.use_antialias_z = True, False
    else:
        combine.inputs["Use Alpha"].default_value, combine.inputs["Anti-Alias"].default_value = True, False


def world_tree(world: bpy.types.World | bpy.types.Material) -> bpy.types.NodeTree | None:
    """The nodes of a world, or material, that are used; None where it has only a color."""
    return world.node_tree if _HAS_GROUPS or world.use_nodes else None


def light_tree(light: bpy.types.Light) -> bpy.types.NodeTree | None:
    """The nodes of a light that are used; None where it has none."""
    # since 5.2 nodes are used wherever they are; asking `use_nodes` warns there
    always = getattr(bpy.types.Light.bl_rna.properties["use_nodes"], "is_deprecated", False)
    return light.node_tree if always or light.use_nodes else None


def ensure_tree(owner: bpy.types.World | bpy.types.Material) -> bpy.types.NodeTree:
    if owner.node_tree is None:  # 4.5
        owner.use_nodes = True
    return owner.node_tree


def make_straight(convert: bpy.types.Node) -> None:
    if hasattr(convert, "mapping"):  # 4.5
        convert.mapping = "PREMUL_TO_STRAIGHT"
    else:
        convert.inputs["Type"].default_value = "To Straight"
