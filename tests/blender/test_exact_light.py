"""Exact Light: the light on hands in a render is what Cycles finds in their scene.

The figures of docs/LIGHT.md are printed by

    python -m pytest -s tests/blender/test_exact_light.py -k stand_in
"""

import subprocess
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

import bpy
import numpy as np
import pytest
import test_scene_light
from bpy_extras.object_utils import world_to_camera_view
from hands import stand_ins_of
from test_render_engine import layers
from test_scene_light import even_world
from test_worlds import wall

from blender_addon import clock, versions
from blender_addon.core import posing
from blender_addon.core.stand_in import points_on, surface_at
from blender_addon.core.view import LIGHT_FROM_WORLD, SceneLight
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, stand_ins
from blender_addon.hand.avatar_files import MEAN_ALBEDO
from blender_addon.render import camera, exact_light, handover, probe, samples

pytestmark = pytest.mark.usefixtures("linked_extension")
# a hand, a camera and a lamp in a black world
scene, real_engine = test_scene_light.scene, test_scene_light.real_engine


# ---- like a mesh in its place ----------------------------------------------------------------------------------------


def of_soft_light_and_a_red_wall(scene: bpy.types.Scene) -> None:
    """A wide lamp above, and a red wall beside the hand that throws its light back."""
    lamp = scene.objects["Lamp"]
    lamp.data = bpy.data.lights.new("Lamp", "AREA")
    lamp.data.size, lamp.data.energy, lamp.location = 0.4, 6.0, (0.25, 0.1, 0.5)
    lamp.rotation_euler = (0.0, 0.45, 0.0)
    wall([(-0.1, -0.2, -0.2), (-0.1, 0.4, -0.2), (-0.1, 0.4, 0.3), (-0.1, -0.2, 0.3)], (0.8, 0.05, 0.03))


def of_a_window_with_blinds(scene: bpy.types.Scene) -> None:
    """A sun past slats, and a little of the sky."""
    lamp = scene.objects["Lamp"]
    lamp.data = bpy.data.lights.new("Lamp", "SUN")
    lamp.data.energy, lamp.data.angle, lamp.rotation_euler = 3.0, 0.02, (0.5, 0.3, 0.0)
    scene.world = even_world((0.1, 0.14, 0.2))
    for place in np.arange(-0.3, 0.4, 0.04):
        wall(
            [(-0.4, place, 0.15), (0.4, place, 0.15), (0.4, place + 0.02, 0.15), (-0.4, place + 0.02, 0.15)], (0.6,) * 3
        )


def of_a_mesh_that_shines(scene: bpy.types.Scene) -> None:
    """A bright panel near the fingers; no lamp at all."""
    scene.objects["Lamp"].hide_render = True
    scene.world = even_world((0.02, 0.02, 0.03))
    wall([(0.14, 0.0, 0.0), (0.14, 0.2, 0.0), (0.14, 0.2, 0.12), (0.14, 0.0, 0.12)], (1.0, 0.8, 0.5), 8.0)


def lit_pictures(scene: bpy.types.Scene, folder: Path) -> dict[str, np.ndarray]:
    """(H, W, 4) scene-linear: the mesh by Cycles, the hand by the engine's own light, and the hand by Exact Light."""
    stand_ins.update()
    mesh = stand_ins_of(next(thing for thing in scene.objects if thing.type == "ARMATURE"))[0]
    tree = versions.ensure_tree(mesh.data.materials[0])
    tree.nodes.clear()
    matt, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    matt.inputs["Color"].default_value = (*MEAN_ALBEDO, 1.0)
    tree.links.new(matt.outputs[0], output.inputs["Surface"])
    for thing in scene.objects:
        thing.visible_camera = thing == mesh
    pictures = {}
    for name, engine, exact in (("mesh", "CYCLES", False), ("own", "JGHAND", False), ("exact", "JGHAND", True)):
        scene.render.engine, scene.jghand.use_exact_light = engine, exact
        if engine == "CYCLES":
            scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.seed = 128, False, 1
            scene.cycles.sample_clamp_indirect = 0.0
        passes = layers(scene, folder)
        pictures[name] = np.stack([passes[f"Combined.{channel}"] for channel in "RGBA"], -1)
    return pictures


def beyond_the_wrist(scene: bpy.types.Scene, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) which pixels lie a fifth of the way to the middle knuckle or more in front of the wrist."""
    hand = next(thing for thing in scene.objects if thing.type == "ARMATURE")
    places = (hand.matrix_world @ hand.pose.bones[name].head for name in ("wrist", "middle1"))
    ends = np.array([world_to_camera_view(scene, scene.camera, place)[:2] for place in places])
    wrist, knuckle = ends * [1, -1] * shape[::-1] + [0, shape[0]]
    rows, columns = np.indices(shape) + 0.5
    way = knuckle - wrist
    return ((columns - wrist[0]) * way[0] + (rows - wrist[1]) * way[1]) / (way @ way) > 0.2


def difference(picture: np.ndarray, true: np.ndarray) -> float:
    """Mean difference of the colors where both cover the pixel, over the mean of the true ones; without the wrist, at
    which the hand fades and lets its inner side be seen."""
    both = (picture[..., 3] > 0.99) & (true[..., 3] > 0.99) & beyond_the_wrist(bpy.context.scene, true.shape[:2])
    return float(np.abs(picture - true)[both][:, :3].mean() / true[both][:, :3].mean())


@pytest.fixture(scope="module")
def plain_hand(engine_python, tmp_path_factory) -> str:
    file = tmp_path_factory.mktemp("avatar") / "plain.jghand"
    writer = Path(__file__).with_name("write_plain_hand.py")
    subprocess.run([engine_python, "-I", str(writer), str(file), *map(str, MEAN_ALBEDO)], check=True)
    return str(file)


@pytest.mark.parametrize(
    ("made", "part", "most"),
    [
        (of_soft_light_and_a_red_wall, 0.5, 0.05),
        (of_a_window_with_blinds, 0.65, 0.09),
        (of_a_mesh_that_shines, 0.15, 0.11),
    ],
    ids=["red wall", "blinds", "panel"],
)
def test_a_matt_hand_is_lit_as_its_stand_in_is_by_cycles(
    scene, real_engine, plain_hand, tmp_path, made: Callable[[bpy.types.Scene], None], part: float, most: float
):
    """Within so much of the mean color, and such a part of what lamps and world alone are off by: observed 0.034, 0.072
    and 0.106."""
    made(scene)
    next(thing for thing in scene.objects if thing.type == "ARMATURE").jghand.avatar = plain_hand
    camera.set_picture_size(scene.render, 96, 64)
    pictures = lit_pictures(scene, tmp_path)
    own, exact = (difference(pictures[name], pictures["mesh"]) for name in ("own", "exact"))
    print(f"{made.__name__}: {own:.3f} by lamps and world, {exact:.3f} by Exact Light")
    assert exact < min(most, part * own)


# ---- what is baked ---------------------------------------------------------------------------------------------------


@pytest.fixture
def few_points(monkeypatch) -> int:
    """So many points of each hand: all of them are alike."""
    monkeypatch.setattr(exact_light, "FINE_POINTS", 400)
    return 400


def baked(scene: bpy.types.Scene) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each hand the normals of its points and the light along these, (400, 3), in the axes of the lamps."""
    graph = bpy.context.evaluated_depsgraph_get()
    hands = samples.hands_at(graph)
    fields = exact_light._bake(scene, graph.view_layer, hands)
    exact_light.clear()
    found = []
    for hand, field in zip(hands, fields, strict=True):
        joints = hand.joints_world_m @ LIGHT_FROM_WORLD[:3, :3].T
        _, normals = points_on(surface_at(joints, hand.handedness), len(field))
        found.append((normals, field[:, 0] + np.einsum("na,nac->nc", normals, field[:, 1:])))
    return found


def sun(scene: bpy.types.Scene) -> bpy.types.Object:
    """From straight above, Blender's +z, 1 W/m2."""
    lamp = scene.objects["Lamp"]
    lamp.data = bpy.data.lights.new("Sun", "SUN")
    lamp.data.energy, lamp.data.angle = 1.0, 0.0
    return lamp


def test_every_hand_gets_its_own_light(scene, few_points):
    """Left ones, mirrored ones and instances too, in any unit: under a sun each shows the cosine of its normals."""
    sun(scene)
    right = scene.objects[0]
    left = armature.build_armature(bpy.context, "left", posing.rest_joints_m("left"), "left")
    mirrored = right.copy()
    mirrored.scale.x = -1
    collection = bpy.data.collections.new("hand")
    collection.objects.link(right)
    scene.collection.objects.unlink(right)
    instance = bpy.data.objects.new("instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", collection
    for place, thing in enumerate((left, mirrored, instance)):
        if thing.name not in scene.collection.objects:
            scene.collection.objects.link(thing)
        thing.location.x, thing.rotation_euler.y = 0.3 * place, 0.4 * place
    found = baked(scene)
    assert len(found) == 3
    for normals, light in found:
        up = normals[:, 1]
        assert np.median(np.abs(light[up > 0.5] - up[up > 0.5, None])) < 0.05
        assert np.median(light[up < -0.3]) < 0.05


def test_lamps_light_hands_as_their_light_linking_says(scene, few_points):
    lamp, hand = sun(scene), next(thing for thing in scene.objects if thing.type == "ARMATURE")
    linked = bpy.data.collections.new("linked")
    linked.objects.link(hand)
    lamp.light_linking.receiver_collection = linked
    found = []
    for state in ("INCLUDE", "EXCLUDE"):
        linked.collection_objects[0].light_linking.link_state = state
        found.append(baked(scene)[0][1].max())
    assert found[0] > 0.9
    assert found[1] < 0.05
    assert len(linked.objects) == 1
    other = hand.copy()
    scene.collection.objects.link(other)
    other.location.x = 0.3
    in_order = sorted((hand, other), key=lambda each: each.name)
    for state in ("INCLUDE", "EXCLUDE"):
        linked.collection_objects[0].light_linking.link_state = state
        is_lit = [light.max() > 0.9 for _, light in baked(scene)]
        assert is_lit == [(each is hand) == (state == "INCLUDE") for each in in_order]


def test_hands_shade_each_other_as_light_linking_says(scene, few_points):
    """The upper one of two takes the sun from the lower one, or lets it pass."""
    lamp, lower = sun(scene), next(thing for thing in scene.objects if thing.type == "ARMATURE")
    upper = lower.copy()
    scene.collection.objects.link(upper)
    lower.location.z, lower.name, upper.name = -0.1, "lower", "upper"
    linked = bpy.data.collections.new("linked")
    for hand in (lower, upper):
        linked.objects.link(hand)
    lamp.light_linking.blocker_collection = linked
    found = []
    for state in ("INCLUDE", "EXCLUDE"):
        for how in linked.collection_objects:
            how.light_linking.link_state = state
        normals, light = baked(scene)[0]
        found.append(np.median(light[normals[:, 1] > 0.7]))
    assert found[0] < 0.1
    assert found[1] > 0.7
    assert len(linked.objects) == 2


def test_baking_leaves_the_file_as_it_was(scene, few_points):
    kinds = ("scenes", "worlds", "objects", "collections", "meshes", "materials", "lights", "node_groups")
    chosen = scene.objects[0]
    bpy.context.view_layer.update()
    bpy.context.view_layer.objects.active = chosen
    chosen.select_set(True)

    def state() -> object:
        things = {kind: sorted(thing.name for thing in getattr(bpy.data, kind)) for kind in kinds}
        places = [(thing.name, *map(tuple, thing.matrix_world), len(thing.users_scene)) for thing in scene.objects]
        return things, places, bpy.context.view_layer.objects.active, bpy.context.selected_objects, scene.frame_current

    before = state()
    baked(scene)
    assert state() == before
    assert scene.render.engine == "JGHAND"


def test_a_file_that_is_saved_while_hands_are_baked_has_nothing_of_the_bake(scene, few_points, tmp_path):
    """And an artist's things of the same name stay."""
    kinds = ("scenes", "objects", "collections", "meshes", "materials")
    linked = bpy.data.collections.new("linked")
    linked.objects.link(next(thing for thing in scene.objects if thing.type == "ARMATURE"))
    scene.objects["Lamp"].light_linking.receiver_collection = linked
    scene.collection.objects.link(bpy.data.objects.new(probe.NAME, None))

    def names() -> dict[str, list[str]]:
        return {kind: sorted(thing.name for thing in getattr(bpy.data, kind)) for kind in kinds}

    stand_ins.update()
    graph, before = bpy.context.evaluated_depsgraph_get(), names()
    exact_light._bake(scene, graph.view_layer, samples.hands_at(graph))
    assert len(bpy.data.scenes) == 2
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"), copy=True)
    assert len(bpy.data.scenes) == 2
    with bpy.data.libraries.load(str(tmp_path / "saved.blend")) as (saved, _):
        assert {kind: sorted(getattr(saved, kind)) for kind in kinds} == before
    exact_light.clear()
    assert names() == before


# ---- when it is baked ------------------------------------------------------------------------------------------------


def test_a_frame_that_was_not_baked_fails_and_says_so(scene, tmp_path, monkeypatch):
    scene.jghand.use_exact_light = True
    scene.render.filepath = str(tmp_path / "picture.png")
    monkeypatch.setattr(exact_light, "prepare", lambda _: None)
    with pytest.raises(RuntimeError, match="exact light of this frame was not baked"):
        bpy.ops.render.render(write_still=True)
    assert not (tmp_path / "picture.png").exists()


@pytest.mark.parametrize("error", [JGHandFailure("world_bake", "no memory"), ValueError("no memory")])
def test_a_bake_that_fails_says_why_and_nothing_of_the_world(scene, tmp_path, monkeypatch, capfd, error):
    def fail(*_: object) -> None:
        raise error

    scene.jghand.use_exact_light = True
    scene.render.filepath = str(tmp_path / "picture.png")
    monkeypatch.setattr(exact_light.probe, "bake", fail)
    with pytest.raises(RuntimeError, match=r"exact light of this frame was not baked.*no memory"):
        bpy.ops.render.render(write_still=True)


def in_a_collection_of_its_own(scene: bpy.types.Scene, **hidden: bool) -> bpy.types.Object:
    """Another hand, in a collection that is hidden."""
    hand = next(thing for thing in scene.objects if thing.type == "ARMATURE").copy()
    unseen = bpy.data.collections.new("unseen")
    for name, value in hidden.items():
        setattr(unseen, name, value)
    scene.collection.children.link(unseen)
    unseen.objects.link(hand)
    return hand


def test_without_a_window_a_hand_that_renders_lack_is_not_baked(scene, real_engine, tmp_path):
    """The frame would fail: what was baked is not of its hands."""
    in_a_collection_of_its_own(scene, hide_render=True)
    scene.jghand.use_exact_light = True
    scene.render.filepath = str(tmp_path / "picture.png")
    bpy.ops.render.render(write_still=True)
    assert (tmp_path / "picture.png").exists()


def test_without_a_window_a_hand_that_viewports_lack_is_named(scene, few_points, tmp_path):
    hand = in_a_collection_of_its_own(scene, hide_viewport=True)
    scene.jghand.use_exact_light = True
    scene.render.filepath = str(tmp_path / "picture.png")
    with pytest.raises(RuntimeError, match=f"disabled in viewports.*{hand.name}"):
        bpy.ops.render.render(write_still=True)


def test_a_window_bakes_on_the_main_thread_and_tidies_up_after_the_render(scene, few_points, monkeypatch):
    """The thread of the render waits; what was made stays for as long as it renders, and is used again."""
    scene.jghand.use_exact_light = True
    graph = bpy.context.evaluated_depsgraph_get()
    hands, found = samples.hands_at(graph), []
    monkeypatch.setattr(clock, "runs", lambda: True)
    is_rendering = True
    monkeypatch.setattr(handover, "is_blender_busy", lambda: is_rendering)
    before = len(bpy.data.objects)
    for _ in range(2):
        ask = partial(exact_light.with_baked, SceneLight(), graph, hands, lambda: False)
        waits = threading.Thread(target=lambda ask=ask: found.append(ask()))
        waits.start()
        while waits.is_alive():
            exact_light.tend()
            waits.join(0.01)
        made = len(bpy.data.objects) - before
        assert made == 2
    np.testing.assert_array_equal(found[0].baked, found[1].baked)
    exact_light.tend()
    assert len(bpy.data.objects) - before == made
    is_rendering = False
    exact_light.tend()
    assert len(bpy.data.objects) == before


def test_a_render_that_is_canceled_does_not_wait(scene, monkeypatch):
    scene.jghand.use_exact_light = True
    graph = bpy.context.evaluated_depsgraph_get()
    monkeypatch.setattr(clock, "runs", lambda: True)
    failures = []

    def render() -> None:
        with pytest.raises(JGHandFailure) as caught:
            exact_light.with_baked(SceneLight(), graph, samples.hands_at(graph), lambda: True)
        failures.append(caught.value.kind)

    waits = threading.Thread(target=render)
    waits.start()
    waits.join(10)
    assert failures == ["canceled"]
    objects = len(bpy.data.objects)
    exact_light.tend()
    assert len(bpy.data.objects) == objects
