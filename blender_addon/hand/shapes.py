# SPDX-License-Identifier: GPL-3.0-or-later
"""What the finger controls look like: wires around a finger, a tip, and the hand. In no scene, shared by all hands."""

from __future__ import annotations

import bpy
import numpy as np

from ..core import limits

# Blender's bone color sets
PALETTES = {"hand": "THEME04", "finger": "THEME09", "tip": "THEME01"}
_NAMES = {kind: f"JGHand {kind} control" for kind in PALETTES}
_CORNERS = 32


def shape(kind: str) -> bpy.types.Object:
    """The object drawn for a control of a kind, "hand", "finger" or "tip", meters; made when there is none."""
    known = bpy.data.objects.get(_NAMES[kind])
    if known is not None and known.type == "MESH" and known.library is None:
        return known
    mesh = bpy.data.meshes.new(_NAMES[kind])
    points, edges = _wires(kind)
    mesh.from_pydata(points, edges, [])
    return bpy.data.objects.new(_NAMES[kind], mesh)


def _wires(kind: str) -> tuple[list[tuple[float, float, float]], list[tuple[int, int]]]:
    if kind == "finger":  # a ring that the finger goes through
        return _rings([((1, 0, 0), (0, 0, 1))], limits.FINGER_SHAPE_M)
    if kind == "tip":
        axes = np.eye(3)
        return _rings([(axes[0], axes[1]), (axes[1], axes[2]), (axes[2], axes[0])], limits.TIP_SHAPE_M)
    # a bracelet around the palm, flat as the palm is, half way to the knuckles
    wide, deep, along = limits.HAND_SHAPE_M
    points, edges = _rings([((wide, 0, 0), (0, 0, deep))], 1.0)
    return [(x, y + along, z) for x, y, z in points], edges


def _rings(planes: list, radius: float) -> tuple[list[tuple[float, float, float]], list[tuple[int, int]]]:
    """Circles with these pairs of axes."""
    angle = np.linspace(0, 2 * np.pi, _CORNERS, endpoint=False)
    points, edges = [], []
    for first, second in planes:
        start = len(points)
        ring = radius * (np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second))
        points += [tuple(map(float, point)) for point in ring]
        edges += [(start + at, start + (at + 1) % _CORNERS) for at in range(_CORNERS)]
    return points, edges
