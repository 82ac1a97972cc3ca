"""The edge of a finger's shadow on skin is as wide as Cycles has it: the engine's soft capsule before lamps of several
sizes."""

import json
import subprocess
from pathlib import Path

import bpy
import numpy as np
import pytest
from test_lamps import add_light, make_card, pictured, read

from blender_addon.core.view import LIGHT_FROM_WORLD

# a finger, and how high its axis is above the skin, meters
RADIUS_M, HEIGHT_M, HALF_LENGTH_M = 0.0075, 0.03, 0.06
MM = 1e-3
# what is seen across it, and how many points of that
SEEN_M, POINTS = 0.06, 240
PLACE = (0.0, 0.0, 0.5)
LIGHTS = {
    "sharp point": ("POINT", {"energy": 10.0, "shadow_soft_size": 0.002}),
    "point": ("POINT", {"energy": 10.0, "shadow_soft_size": 0.03}),
    "wide point": ("POINT", {"energy": 10.0, "shadow_soft_size": 0.08}),
    "wider than the finger": ("POINT", {"energy": 10.0, "shadow_soft_size": 0.2}),
    "sun": ("SUN", {"energy": 3.0, "angle": 0.1}),
    "wide sun": ("SUN", {"energy": 3.0, "angle": 0.3}),
    "disk": ("AREA", {"energy": 3.0, "shape": "DISK", "size": 0.1}),
}


def make_finger() -> bpy.types.Object:
    """A capsule along y above the card of `make_card`, which the camera does not see."""
    card = make_card()
    scene, camera = bpy.context.scene, bpy.context.scene.camera
    card.scale = (10, 10, 1)
    camera.data.ortho_scale, camera.location.z = SEEN_M, 0.2
    scene.render.resolution_x, scene.render.resolution_y, scene.cycles.samples = POINTS, 4, 64
    angles, heights = np.linspace(0, 2 * np.pi, 48, endpoint=False), np.linspace(0, np.pi / 2, 8)
    rings = [(s * (HALF_LENGTH_M + RADIUS_M * np.sin(h)), RADIUS_M * np.cos(h)) for s in (-1, 1) for h in heights[::s]]
    places = [(r * np.cos(a), y, HEIGHT_M + r * np.sin(a)) for y, r in rings for a in angles]
    corners = np.arange(48 * len(rings)).reshape(-1, 48)
    around = np.roll(corners, -1, axis=1)
    faces = np.stack([corners[:-1], around[:-1], around[1:], corners[1:]], -1).reshape(-1, 4)
    mesh = bpy.data.meshes.new("finger")
    mesh.from_pydata(places, [], faces.tolist())
    finger = bpy.data.objects.new("finger", mesh)
    finger.visible_camera = False
    return finger


def rows(folder: Path) -> np.ndarray:
    """(POINTS,) how bright the card is across the finger."""
    return pictured(folder)[:, :, 0].mean(0)


@pytest.fixture(scope="module")
def edges(engine_python, tmp_path_factory) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """(POINTS,) the part of each light that Cycles and the engine let past the finger."""
    folder, finger = tmp_path_factory.mktemp("shadows"), make_finger()
    found, lamps = [], []
    for kind, settings in LIGHTS.values():
        for thing in [thing for thing in bpy.data.objects if thing.type == "LIGHT"]:
            bpy.data.objects.remove(thing)
        add_light(kind, PLACE, **settings)
        bright = rows(folder)
        bpy.context.scene.collection.objects.link(finger)
        found.append(rows(folder) / bright)
        lamps.append(read().lamps[0])
        bpy.context.scene.collection.objects.unlink(finger)
    across = (np.arange(POINTS) + 0.5) / POINTS * SEEN_M - SEEN_M / 2
    turn = LIGHT_FROM_WORLD[:3, :3]
    points = np.stack([across, 0 * across, 0 * across], -1) @ turn.T
    start, end = (np.array([0.0, side * HALF_LENGTH_M, HEIGHT_M]) @ turn.T for side in (-1, 1))
    asked = {"points_m": points.tolist(), "start_m": start.tolist(), "end_m": end.tolist(), "radius_m": RADIUS_M}
    script = Path(__file__).with_name("capsule_shadow.py")
    asked = json.dumps({**asked, "lamps": lamps})
    answer = subprocess.run([engine_python, str(script)], input=asked, capture_output=True, text=True, check=True)
    return dict(zip(LIGHTS, zip(found, np.array(json.loads(answer.stdout)), strict=True), strict=True))


def width_m(left: np.ndarray) -> float:
    """From a tenth to nine tenths of the way from the darkest point to full light, meters; mean of both sides."""
    across = (np.arange(POINTS) + 0.5) / POINTS * SEEN_M
    middle = POINTS // 2
    part = (left - left.min()) / (1 - left.min())
    sides = []
    for side in (slice(middle, None), slice(middle - 1, None, -1)):
        rising = np.maximum.accumulate(part[side])
        low, high = np.interp([0.1, 0.9], rising, np.abs(across[side] - across[middle]))
        sides.append(high - low)
    return float(np.mean(sides))


@pytest.mark.parametrize("name", LIGHTS)
def test_the_edge_of_a_fingers_shadow_is_as_wide_as_in_cycles(edges, name):
    """Or up to 1.1 mm wider: flesh of the engine is soft by 0.12 of its radius to either side, so that edges between
    Gaussians do not jag. That is a third of an edge of 3 mm, and a twentieth of one that is as wide as a finger."""
    cycles, engine = map(width_m, edges[name])
    assert -0.1 * MM < engine - cycles < 1.1 * MM


@pytest.mark.parametrize("name", LIGHTS)
def test_a_finger_takes_as_much_light_as_in_cycles(edges, name):
    """In all, across its shadow; how dark that is in its middle differs where a lamp is seen on both sides of it."""
    cycles, engine = edges[name]
    assert np.isclose((1 - engine).sum(), (1 - cycles).sum(), rtol=0.01)
    assert abs(engine.min() - cycles.min()) < (0.15 if name == "wider than the finger" else 0.001)
