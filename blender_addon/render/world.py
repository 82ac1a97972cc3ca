# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies behind the hands where the film is not transparent."""

from __future__ import annotations

import bpy

from .. import versions


def background(world: bpy.types.World | None) -> tuple[float, float, float]:
    """The world's color, scene-linear: that of its background node, with the strength, where the node has one color;
    else the color that the viewport shows. Black without a world."""
    if world is None:
        return (0.0, 0.0, 0.0)
    node = _background_node(world)
    if node is None or any(socket.is_linked for socket in node.inputs if socket.enabled):
        return tuple(world.color)
    strength = node.inputs["Strength"].default_value
    red, green, blue, _ = node.inputs["Color"].default_value
    return (strength * red, strength * green, strength * blue)


def _background_node(world: bpy.types.World) -> bpy.types.Node | None:
    """The background that goes straight into the output that is used."""
    tree = versions.world_tree(world)
    output = tree.get_output_node("ALL") if tree is not None else None
    if output is None or not output.inputs["Surface"].links:
        return None
    node = output.inputs["Surface"].links[0].from_node
    return node if node.type == "BACKGROUND" else None
