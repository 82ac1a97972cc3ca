# SPDX-License-Identifier: GPL-3.0-or-later
"""What nodes of worlds and lights shine with, where that can be told without rendering them: one color, and a picture
or a sky that is turned and multiplied. What can not be told is `Unread`: of worlds a light probe measures it.

Nodes are read as diffuse rays find them, so that a world which shows cameras something else lights as it does.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from operator import add, mul, sub
from typing import Any

import bpy
import mathutils
import numpy as np

from .. import versions

BLACK = np.zeros(3)
# outputs of Light Path for a ray that left matt skin; others are not told
_DIFFUSE_RAY = {
    **dict.fromkeys(("Is Diffuse Ray", "Is Reflection Ray"), 1.0),
    **dict.fromkeys(("Is Camera Ray", "Is Shadow Ray", "Is Glossy Ray", "Is Singular Ray"), 0.0),
    **dict.fromkeys(("Is Transmission Ray", "Is Volume Scatter Ray"), 0.0),
}
# of a Mix node, which has inputs for every type of value
_MIX_COLORS = ("A_Color", "B_Color")
_SUMS = {"ADD": add, "SUBTRACT": sub, "MULTIPLY": mul, "MAXIMUM": max, "MINIMUM": min}
# how deep a node's own values are nested: those of a color ramp, and of a curve
_VALUES_DEPTH = 3


class Unread(Exception):  # noqa: N818 - no error: there is another way
    """These nodes have to be measured: the one of this name, where it is one."""


@dataclass(frozen=True)
class Shine:
    """Radiance, scene-linear: even + gain * source.

    source: an Image or a Sky Texture node, None for nothing; turn: (3, 3) rotation from Blender's axes to its own
    """

    even: np.ndarray = field(default_factory=lambda: BLACK)
    gain: np.ndarray = field(default_factory=lambda: BLACK)
    source: Any = None
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))

    def times(self, factor: np.ndarray | float) -> Shine:
        gain = self.gain * factor
        return replace(self, even=self.even * factor, gain=gain, source=self.source if gain.any() else None)

    def plus(self, other: Shine) -> Shine:
        if self.source is not None and other.source is not None:
            raise Unread
        whole = self if other.source is None else other
        return replace(whole, even=self.even + other.even)


def shine_of(world: bpy.types.World) -> Shine:
    """What an evaluated world shines with; Unread where its nodes have to be measured."""
    tree = versions.world_tree(world)
    if tree is None:
        return Shine(np.array(world.color[:]))
    output = tree.get_output_node("CYCLES")
    if output is None:
        return Shine()
    if _source(output.inputs["Volume"]) is not None:
        raise Unread
    return _shader(output.inputs["Surface"])


def shows_cameras_more(world: bpy.types.World) -> bool:
    tree = versions.world_tree(world)
    return tree is not None and any(link.from_socket.name == "Is Camera Ray" for link in tree.links)


def of_light(light: bpy.types.Light) -> tuple[np.ndarray, str]:
    """(3,) what a light's nodes multiply it with, where that is one color; and the name of a node that does not tell,
    whose part is 1 then, or ""."""
    tree = versions.light_tree(light)
    if tree is None:
        return np.ones(3), ""
    output = tree.get_output_node("CYCLES")
    link = next((link for link in output.inputs["Surface"].links if not link.is_muted), None) if output else None
    if link is None or link.from_node.mute:
        return BLACK, ""
    node = link.from_node
    # of rays to lamps Cycles tells nothing: not even those from matt skin are Diffuse Rays (run, 5.0.1, 5.2.3)
    path = next((each for each in tree.nodes if each.type == "LIGHT_PATH"), None)
    if node.type != "EMISSION" or path is not None:
        return np.ones(3), (path or node).name
    product, unread = np.ones(3), ""
    for name, told in (("Color", _even), ("Strength", _value)):
        try:
            product = product * told(node.inputs[name])
        except Unread as found:
            unread = str(found) or node.inputs[name].links[0].from_node.name
    return product, unread


def _even(socket: bpy.types.NodeSocket) -> np.ndarray:
    shine = _color(socket)
    if shine.source is not None:
        raise Unread
    return shine.even


def _source(socket: bpy.types.NodeSocket) -> bpy.types.NodeSocket | None:
    """The output that an input takes its value from, past reroutes; None where it has a value of its own."""
    while socket.is_linked:
        link = socket.links[0]
        if link.is_muted or not link.is_valid:
            return None
        if link.from_node.mute:
            raise Unread
        if link.from_node.type != "REROUTE":
            return link.from_socket
        socket = link.from_node.inputs[0]
    return None


def _shader(socket: bpy.types.NodeSocket) -> Shine:
    source = _source(socket)
    if source is None:
        return Shine()
    node = source.node
    if node.type == "BACKGROUND":
        return _color(node.inputs["Color"]).times(_value(node.inputs["Strength"]))
    if node.type == "ADD_SHADER":
        return _shader(node.inputs[0]).plus(_shader(node.inputs[1]))
    if node.type == "MIX_SHADER":
        return _mixed(min(max(_value(node.inputs[0]), 0.0), 1.0), lambda: _shader(node.inputs[1]),
                      lambda: _shader(node.inputs[2]))  # fmt: skip
    raise Unread


def _mixed(factor: float, first: Any, second: Any) -> Shine:
    """Of two that are read only where they count."""
    if factor in (0.0, 1.0):
        return second() if factor else first()
    return first().times(1 - factor).plus(second().times(factor))


def _color(socket: bpy.types.NodeSocket) -> Shine:
    source = _source(socket)
    if source is None:
        return Shine(np.array(socket.default_value[:3]))
    node = source.node
    if node.type == "RGB":
        return Shine(np.array(source.default_value[:3]))
    if node.type == "TEX_ENVIRONMENT" and node.projection == "EQUIRECTANGULAR" and node.image is not None:
        return Shine(gain=np.ones(3), source=node.image, turn=_turn(node.inputs["Vector"]))
    if node.type == "TEX_SKY":
        vector = node.inputs.get("Vector")  # skies with a sun have none since 5.0
        return Shine(gain=np.ones(3), source=node, turn=_turn(vector) if vector else np.eye(3))
    if node.type == "MIX" and node.data_type == "RGBA" and not node.clamp_result:
        first, second = (next(each for each in node.inputs if each.identifier == name) for name in _MIX_COLORS)
        factor = _value(node.inputs[0])
        factor = min(max(factor, 0.0), 1.0) if node.clamp_factor else factor
        if node.blend_type == "MIX":
            return _mixed(factor, lambda: _color(first), lambda: _color(second))
        if node.blend_type in ("MULTIPLY", "ADD"):
            one, other = _color(first), _color(second)
            if node.blend_type == "ADD":
                return one.plus(other.times(factor))
            if other.source is None:
                return one.times(1 - factor + factor * other.even)
            if one.source is None:
                return Shine(one.even * (1 - factor)).plus(other.times(factor * one.even))
    raise Unread(node.name)


def _value(socket: bpy.types.NodeSocket) -> float:
    source = _source(socket)
    if source is None:
        return float(socket.default_value)
    node = source.node
    if node.type == "VALUE":
        return float(source.default_value)
    if node.type == "LIGHT_PATH" and source.name in _DIFFUSE_RAY:
        return _DIFFUSE_RAY[source.name]
    if node.type == "MATH" and node.operation in _SUMS:
        result = _SUMS[node.operation](_value(node.inputs[0]), _value(node.inputs[1]))
        return min(max(result, 0.0), 1.0) if node.use_clamp else result
    raise Unread(node.name)


def _vector(socket: bpy.types.NodeSocket) -> np.ndarray:
    source = _source(socket)
    if source is None:
        return np.array(socket.default_value[:])
    if source.node.type == "COMBXYZ":
        return np.array([_value(each) for each in source.node.inputs])
    raise Unread


def _turn(socket: bpy.types.NodeSocket) -> np.ndarray:
    """(3, 3) rotation from Blender's axes to where a texture is looked up."""
    source = _source(socket)
    if source is None:
        return np.eye(3)
    node = source.node
    if node.type == "TEX_COORD" and (source.name == "Generated" or (source.name == "Object" and node.object is None)):
        return np.eye(3)
    if node.type != "MAPPING" or not node.inputs["Vector"].is_linked:
        raise Unread
    scale = _vector(node.inputs["Scale"])
    has_place = node.vector_type in ("POINT", "TEXTURE") and _vector(node.inputs["Location"]).any()
    # of a direction only the size may change
    if has_place or scale[0] <= 0 or not np.allclose(scale, scale[0], rtol=1e-6):
        raise Unread
    turn = np.array(mathutils.Euler(_vector(node.inputs["Rotation"]).tolist()).to_matrix())
    return (turn.T if node.vector_type == "TEXTURE" else turn) @ _turn(node.inputs["Vector"])


# ---- whether anything changed ----------------------------------------------------------------------------------------


def values_of(node: bpy.types.Node) -> Iterator[str]:
    """Everything that a node can shine with, as text: other text, other light."""
    yield f"{node.name} {node.bl_idname} {node.mute}"
    for socket in (*node.inputs, *node.outputs):
        value = getattr(socket, "default_value", None)
        yield f"{socket.identifier} {value if isinstance(value, float | int | str | None) else value[:]}"
    yield from _values(node, {*bpy.types.Node.bl_rna.properties.keys()}, _VALUES_DEPTH)


def _values(struct: Any, without: set[str], depth: int) -> Iterator[str]:
    for known in struct.bl_rna.properties:
        name, value = known.identifier, getattr(struct, known.identifier)
        if name in without or value is None:
            continue
        if isinstance(value, bpy.types.NodeTree):
            yield from values_of_tree(value)
        elif isinstance(value, bpy.types.ID):
            # an evaluated data-block has no session_uid
            yield f"{name} {value.name_full}"
            if isinstance(value, bpy.types.Object):  # whose place counts
                yield repr([*map(tuple, value.matrix_world)])
        elif known.type not in ("COLLECTION", "POINTER"):
            yield f"{name} {value[:] if getattr(known, 'is_array', False) else value}"
        elif depth:
            for each in value if known.type == "COLLECTION" else (value,):
                yield from _values(each, {"rna_type"}, depth - 1)


def values_of_tree(tree: bpy.types.NodeTree) -> Iterator[str]:
    """The same of nodes and of how they are linked."""
    for node in tree.nodes:
        yield from values_of(node)
    for link in tree.links:
        ends = link.from_node.name, link.from_socket.identifier, link.to_node.name, link.to_socket.identifier
        yield f"{ends} {link.is_muted}"
