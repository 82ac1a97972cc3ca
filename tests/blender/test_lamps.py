"""Blender's lights are lamps of the same light: Cycles lights a white card as the engine says of what is read."""

import json
import math
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Quaternion, Vector
from test_limits import material

from blender_addon.core.view import Moment, Pinhole, picture_request
from blender_addon.hand import armature, seen_hands
from blender_addon.render import lamps, scene_light
from blender_addon.viewport import handlers

ONE_PERCENT = 0.01
FACING = (0.0, 0.0, 1.0)
ASIDE = (math.sin(math.pi / 6), 0.0, math.cos(math.pi / 6))


def make_card() -> bpy.types.Object:
    """A camera that sees nothing but a white card, which faces up at the origin."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
    scene.cycles.samples, scene.cycles.max_bounces = 64, 0
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.render.resolution_x = scene.render.resolution_y = 6
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    mesh = bpy.data.meshes.new("card")
    mesh.from_pydata([(-0.01, -0.01, 0), (0.01, -0.01, 0), (0.01, 0.01, 0), (-0.01, 0.01, 0)], [], [(0, 1, 2, 3)])
    white = bpy.data.materials.new("white")
    if white.node_tree is None:  # 4.5
        white.use_nodes = True
    nodes = white.node_tree.nodes
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    white.node_tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    mesh.materials.append(white)
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale, camera.clip_start = "ORTHO", 0.002, 0.001
    for name, data in (("card", mesh), ("camera", camera)):
        scene.collection.objects.link(bpy.data.objects.new(name, data))
    scene.camera = scene.objects["camera"]
    scene.camera.location.z = 0.05
    return scene.objects["card"]


def clear_lights() -> None:
    """Leaves nothing but the card and its camera."""
    for thing in [thing for thing in bpy.data.objects if thing.name not in ("card", "camera")]:
        bpy.data.objects.remove(thing)
    for collection in list(bpy.data.collections):
        bpy.data.collections.remove(collection)
    bpy.context.scene.unit_settings.scale_length = 1.0


def add_light(kind, place=FACING, aim=(0, 0, 0), scale=(1, 1, 1), turn=None, **settings) -> bpy.types.Object:
    data = bpy.data.lights.new(kind, kind)
    for name, value in settings.items():
        setattr(data, name, value)
    thing = bpy.data.objects.new("lamp", data)
    towards: Quaternion = (Vector(aim) - Vector(place)).to_track_quat("-Z", "Y")
    thing.matrix_world = Matrix.LocRotScale(Vector(place), turn or towards, Vector(scale))
    bpy.context.scene.collection.objects.link(thing)
    return thing


def pictured(folder: Path) -> np.ndarray:
    """(H, W, 4) of the card, as Cycles renders it."""
    scene = bpy.context.scene
    scene.render.filepath = str(folder / "card.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.reshape(image.pixels[:], (image.size[1], image.size[0], 4))
    bpy.data.images.remove(image)
    return pixels


def measured(folder: Path) -> np.ndarray:
    """(3,) irradiance of the card, as Cycles has it, W/m2."""
    return math.pi * pictured(folder)[..., :3].reshape(-1, 3).mean(0)


def read(*hands: bpy.types.Object) -> lamps.SceneLamps:
    bpy.context.view_layer.update()
    return lamps.lamps_of(bpy.context.evaluated_depsgraph_get(), hands)


# ---- each setting of a light, in Cycles and in the engine ------------------------------------------------------------


def emission(thing: bpy.types.Object) -> bpy.types.Node:
    if thing.data.node_tree is None:  # before 5.2
        thing.data.use_nodes = True
    return thing.data.node_tree.nodes["Emission"]


def with_nodes(thing: bpy.types.Object) -> None:
    node = emission(thing)
    node.inputs["Color"].default_value, node.inputs["Strength"].default_value = (1, 0.5, 0.25, 1), 3


def with_linked_values(thing: bpy.types.Object) -> None:
    node, tree = emission(thing), thing.data.node_tree
    for name, kind, value in (("Color", "ShaderNodeRGB", (0.2, 1, 0.5, 1)), ("Strength", "ShaderNodeValue", 2)):
        source = tree.nodes.new(kind)
        source.outputs[0].default_value = value
        tree.links.new(source.outputs[0], node.inputs[name])


def with_sums(thing: bpy.types.Object) -> None:
    node, tree = emission(thing), thing.data.node_tree
    value, product = tree.nodes.new("ShaderNodeValue"), tree.nodes.new("ShaderNodeMath")
    value.outputs[0].default_value = 1.5
    product.operation, product.inputs[1].default_value = "MULTIPLY", 4
    tree.links.new(value.outputs[0], product.inputs[0])
    tree.links.new(product.outputs[0], node.inputs["Strength"])


def without_output(thing: bpy.types.Object) -> None:
    emission(thing)
    thing.data.node_tree.links.clear()


def in_instance(thing: bpy.types.Object) -> None:
    scene, collection = bpy.context.scene, bpy.data.collections.new("inside")
    scene.collection.objects.unlink(thing)
    collection.objects.link(thing)
    collection.instance_offset = (0.5, 0, 1)
    placed = bpy.data.objects.new("placed", None)
    placed.instance_type, placed.instance_collection = "COLLECTION", collection
    placed.location, placed.scale = (1, 0, 2), (2, 2, 2)
    scene.collection.objects.link(placed)


def in_stretched_parent(thing: bpy.types.Object) -> None:
    parent = bpy.data.objects.new("parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.scale, thing.parent = (3, 1, 1), parent


def in_centimeters(_thing: bpy.types.Object) -> None:
    bpy.context.scene.unit_settings.scale_length = 0.01


def hidden(thing: bpy.types.Object) -> None:
    thing.hide_render = True


def without_diffuse(thing: bpy.types.Object) -> None:
    thing.visible_diffuse = False


# name -> kind, settings and place of a light, and what is done to it
Row = tuple[str, dict, Callable[[bpy.types.Object], None] | None]
POINT = {"energy": 10.0, "shadow_soft_size": 0.01}
SPOT = {"energy": 10.0, "spot_size": 1.0, "spot_blend": 0.6, "shadow_soft_size": 0.0005}
AREA = {"energy": 10.0, "shape": "SQUARE", "size": 0.1}
NEAR = {"place": (0, 0, 0.5), "shadow_soft_size": 0.2}


def off_axis(angle: float) -> dict:
    return {**SPOT, "aim": (0, math.tan(angle), 0)}


LIGHTS: dict[str, Row] = {
    "sun": ("SUN", {"energy": 2.0, "angle": 0.01}, None),
    "sun from aside": ("SUN", {"energy": 2.0, "angle": 0.2, "place": ASIDE}, None),
    "sun, not normalized": ("SUN", {"energy": 2.0, "angle": 0.2, "normalize": False}, None),
    "sun without a size, not normalized": ("SUN", {"energy": 2.0, "angle": 0.0, "normalize": False}, None),
    "sun, scaled": ("SUN", {"energy": 2.0, "angle": 0.1, "scale": (1, 2, 3)}, None),
    "sun, mirrored": ("SUN", {"energy": 2.0, "scale": (1, 1, -1)}, None),
    "sun in centimeters": ("SUN", {"energy": 2.0}, in_centimeters),
    "point": ("POINT", POINT, None),
    "point from aside": ("POINT", {**POINT, "place": ASIDE}, None),
    "point, large and near": ("POINT", {**POINT, **NEAR}, None),
    "point, hard falloff": ("POINT", {**POINT, **NEAR, "use_soft_falloff": False}, None),
    "point, not normalized": ("POINT", {**POINT, **NEAR, "normalize": False}, None),
    "point without a size, not normalized": ("POINT", {**POINT, "shadow_soft_size": 0, "normalize": False}, None),
    "point, scaled": ("POINT", {**POINT, **NEAR, "scale": (3, 1, 2)}, None),
    "point, exposure": ("POINT", {**POINT, "exposure": 1.5}, None),
    "point, temperature": ("POINT", {**POINT, "use_temperature": True, "temperature": 3000.0}, None),
    "point, temperature and color": (
        *("POINT", {**POINT, "use_temperature": True, "temperature": 3000.0, "color": (1, 0.5, 0.25)}, None),
    ),
    "point in centimeters": ("POINT", {**POINT, **NEAR}, in_centimeters),
    "point in an instance": ("POINT", POINT, in_instance),
    "point of no power": ("POINT", {**POINT, "energy": 0.0}, None),
    "point, hidden": ("POINT", POINT, hidden),
    "point without diffuse": ("POINT", POINT, without_diffuse),
    "spot": ("SPOT", SPOT, None),
    "spot near its edge": ("SPOT", off_axis(0.35), None),
    "spot at half of its fade": ("SPOT", off_axis(0.42), None),
    "spot almost outside": ("SPOT", off_axis(0.48), None),
    "spot outside": ("SPOT", off_axis(0.53), None),
    "spot, scaled evenly": ("SPOT", {**off_axis(0.42), "scale": (2, 2, 2)}, None),
    "spot, long: within": ("SPOT", {**off_axis(0.1), "scale": (1, 1, 2)}, None),
    "spot, long: outside": ("SPOT", {**off_axis(0.3), "scale": (1, 1, 2)}, None),
    "spot, wide": ("SPOT", {**off_axis(0.6), "scale": (2, 2, 1)}, None),
    "spot, mirrored": ("SPOT", {**off_axis(0.42), "scale": (-1, 1, 1)}, None),
    "spot, turned away by its scale": ("SPOT", {**SPOT, "scale": (1, 1, -1)}, None),
    "spot, scaled to nothing": ("SPOT", {**SPOT, "scale": (0, 1, 1)}, None),
    "spot, large and near": ("SPOT", {**SPOT, **NEAR, "spot_blend": 0.1}, None),
    "area": ("AREA", AREA, None),
    "area, rectangle": ("AREA", {**AREA, "shape": "RECTANGLE", "size": 0.8, "size_y": 0.3}, None),
    "area, disk": ("AREA", {**AREA, "shape": "DISK", "size": 0.6}, None),
    "area, ellipse": ("AREA", {**AREA, "shape": "ELLIPSE", "size": 0.3, "size_y": 0.2}, None),
    "area, scaled": ("AREA", {**AREA, "scale": (3, 2, 5)}, None),
    "area, mirrored": ("AREA", {**AREA, "scale": (-1, 1, 1)}, None),
    "area, turned away by its scale": ("AREA", {**AREA, "scale": (1, 1, -1)}, None),
    "area without a size": ("AREA", {**AREA, "shape": "RECTANGLE", "size_y": 0.0}, None),
    "area, not normalized": ("AREA", {**AREA, "scale": (3, 2, 1), "normalize": False}, None),
    "area from aside": ("AREA", {**AREA, "place": ASIDE}, None),
    "area from aside, facing down": ("AREA", {**AREA, "place": ASIDE, "turn": Quaternion()}, None),
    "area, narrow, off its axis": ("AREA", {**AREA, "size": 0.001, "spread": 1.0, "aim": (0, math.tan(0.25), 0)}, None),
    "area, narrow": ("AREA", {**AREA, "size": 0.001, "spread": 1.0}, None),
    "area in centimeters": ("AREA", {**AREA, "size": 0.3}, in_centimeters),
    "area in a stretched parent": ("AREA", {**AREA, "turn": Quaternion()}, in_stretched_parent),
    "nodes": ("POINT", POINT, with_nodes),
    "nodes with linked values": ("POINT", POINT, with_linked_values),
    "nodes with sums": ("POINT", POINT, with_sums),
    "nodes without output": ("POINT", POINT, without_output),
}  # fmt: skip


@pytest.fixture(scope="module")
def irradiances(engine_python, tmp_path_factory) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What Cycles measures of each light, and what the engine says of the lamps that were read."""
    folder = tmp_path_factory.mktemp("lamps")
    found, said = [], []
    make_card()
    for kind, settings, prepare in LIGHTS.values():
        clear_lights()
        thing = add_light(kind, **settings)
        if prepare is not None:
            prepare(thing)
        found.append(measured(folder))
        said.append([lamp for lamp in read().lamps if lamp.get("on_matt", True)])
    script = Path(__file__).with_name("lamps_on_card.py")
    answer = subprocess.run(
        [engine_python, str(script)], input=json.dumps(said), capture_output=True, text=True, check=True
    )
    return dict(zip(LIGHTS, zip(found, np.array(json.loads(answer.stdout)), strict=True), strict=True))


@pytest.mark.parametrize("name", LIGHTS)
def test_a_card_is_lit_by_the_engine_as_by_cycles(irradiances, name):
    cycles, engine = irradiances[name]
    np.testing.assert_allclose(engine, cycles, rtol=ONE_PERCENT, atol=1e-6)


# ---- which lamps light hands -----------------------------------------------------------------------------------------


def linked_to(thing: bpy.types.Object, *states: tuple[bpy.types.ID, str]) -> bpy.types.Collection:
    """Makes a collection the receivers of a light: objects and collections with the state of each."""
    linked = thing.light_linking.receiver_collection = bpy.data.collections.new("receivers")
    for each, state in states:
        is_object = isinstance(each, bpy.types.Object)
        (linked.objects if is_object else linked.children).link(each)
        (linked.collection_objects if is_object else linked.collection_children)[-1].light_linking.link_state = state
    return linked


@pytest.fixture
def card() -> bpy.types.Object:
    return make_card()


def test_light_linking_leaves_out_whom_it_leaves_out_in_cycles(card, tmp_path):
    thing = add_light("POINT", **POINT)
    camera = bpy.context.scene.camera
    group, outer = bpy.data.collections.new("group"), bpy.data.collections.new("outer")
    group.objects.link(card)
    outer.children.link(group)
    lit = []
    for states in (
        *([], [(card, "INCLUDE")], [(camera, "INCLUDE")], [(card, "EXCLUDE")], [(camera, "EXCLUDE")]),
        *([(camera, "INCLUDE"), (card, "EXCLUDE")], [(outer, "INCLUDE")], [(outer, "EXCLUDE")]),
        *([(card, "INCLUDE"), (group, "EXCLUDE")], [(card, "EXCLUDE"), (group, "INCLUDE")]),
    ):
        linked_to(thing, *states)
        lit.append(bool(read(card).lamps))
        assert lit[-1] == (measured(tmp_path).max() > 0), states
    assert lit == [True, True, False, False, True, False, True, False, True, False]


def test_a_light_lights_those_hands_that_its_light_linking_picks_by_themselves_or_by_their_stand_ins(extension):
    for _ in range(3):
        bpy.ops.jghand.add_hand()
    hands = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
    stand_in_of = {thing.parent: thing for thing in bpy.data.objects if armature.STAND_IN in thing}
    collection, empty = bpy.data.collections.new("hand"), bpy.data.objects.new("instance", None)
    collection.objects.link(hands[2])
    bpy.context.scene.collection.objects.unlink(hands[2])
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    bpy.context.scene.collection.objects.link(empty)
    thing, view = add_light("POINT", **POINT), Pinhole(16, 16, 20, 20, 8, 8, np.eye(4))
    for states, lit in (
        ([(stand_in_of[hands[0]], "INCLUDE")], [0]),
        ([(stand_in_of[hands[0]], "EXCLUDE")], [1, 2]),
        ([(hands[1], "INCLUDE"), (empty, "INCLUDE")], [1, 2]),
        ([(collection, "INCLUDE")], [2]),
        ([(stand_in_of[hands[2]], "EXCLUDE"), (hands[0], "EXCLUDE")], [1]),
        ([], None),
    ):
        linked_to(thing, *states)
        bpy.context.view_layer.update()
        depsgraph = bpy.context.evaluated_depsgraph_get()
        seen = [hand for each in (*hands[:2], empty) for hand in seen_hands.read([each], depsgraph)[0]]
        light = scene_light.SceneLight(read(*hands[:2], empty).lamps)
        header, _ = picture_request([Moment(view, seen)], preset="draft", outputs=["rgba_f32"], light=light)
        assert header["light"]["lamps"][0].get("hands") == lit, states
    linked_to(thing, (hands[0], "EXCLUDE"), (hands[1], "EXCLUDE"))
    assert len(read(empty).lamps) == 1
    assert not read(*hands[:2]).lamps


def test_a_hand_of_an_instance_is_lit_by_the_name_that_it_has(extension, space):
    bpy.ops.jghand.add_hand()
    hand, collection = bpy.context.object, bpy.data.collections.new("hand")
    collection.objects.link(hand)
    instance = bpy.data.objects.new("instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", collection
    bpy.context.scene.collection.objects.link(instance)
    linked_to(add_light("POINT", **POINT), (hand, "INCLUDE"))
    for name in ("one", "another"):
        hand.name = name
        bpy.context.view_layer.update()
        (lamp,) = lamps.in_view(bpy.context.evaluated_depsgraph_get(), space, [instance]).lamps
        assert lamp["receivers"] == (((name, ""),), True)


def test_hands_do_not_shade_themselves_from_lamps_whose_shadows_they_do_not_throw(card):
    thing = add_light("POINT", **POINT)
    assert read(card).lamps[0]["has_shadow"]
    thing.data.use_shadow = False
    assert not read(card).lamps[0]["has_shadow"]
    thing.data.use_shadow = True
    blockers = thing.light_linking.blocker_collection = bpy.data.collections.new("blockers")
    found = read(card)
    assert found.lamps[0]["has_shadow"]
    assert not found.warnings
    blockers.objects.link(bpy.context.scene.camera)
    found = read(card)
    assert not found.lamps[0]["has_shadow"]
    assert found.warnings == (
        f"{thing.name}: nothing shades hands, as its shadow linking leaves them out; link them too",
    )
    blockers.collection_objects[0].light_linking.link_state = "EXCLUDE"
    found = read(card)
    assert found.lamps[0]["has_shadow"]
    assert not found.warnings


def test_ray_visibility_chooses_what_skin_takes_of_a_lamp(card):
    thing = add_light("POINT", **POINT)
    thing.visible_glossy = False
    (lamp,) = read(card).lamps
    assert lamp["on_gloss"] is False
    thing.visible_diffuse = False
    assert not read(card).lamps


def test_a_portal_lights_nothing_itself(card):
    thing = add_light("AREA", **AREA)
    thing.data.cycles.is_portal = True
    assert not read(card).lamps


@pytest.mark.parametrize("shader", ["ShaderNodeBsdfDiffuse", "ShaderNodeBsdfGlossy"])
def test_cycles_knows_neither_factors_nor_custom_distance(card, tmp_path, shader):
    thing = add_light("POINT", **POINT)
    card.data.materials[0] = material(shader)
    before, physical = measured(tmp_path), read(card)
    assert before.max() > 0
    light = thing.data
    light.diffuse_factor, light.specular_factor, light.use_custom_distance, light.cutoff_distance = 0.25, 0.5, True, 0.1
    np.testing.assert_array_equal(measured(tmp_path), before)
    assert read(card) == physical


def test_eevee_has_factors_and_neither_nodes_nor_spread(card):
    """As measured in EEVEE 5.0.1."""
    thing = add_light("AREA", **AREA, spread=1.0, diffuse_factor=0.5, specular_factor=2.0)
    emission(thing).inputs["Strength"].default_value = 3
    (physical,) = read(card).lamps
    bpy.context.scene.render.engine = "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"
    matt, gloss = read(card).lamps
    assert (matt["on_gloss"], gloss["on_matt"]) == (False, False)
    np.testing.assert_allclose(6 * np.array(matt["rgb"]), physical["rgb"])
    np.testing.assert_allclose(1.5 * np.array(gloss["rgb"]), physical["rgb"])
    assert physical["spread_rad"] == 1.0
    assert matt["spread_rad"] == pytest.approx(math.pi)
    thing.data.use_custom_distance = True
    (warning,) = read(card).warnings
    assert "Custom Distance" in warning


def test_what_cannot_be_read_of_a_light_says_so(card):
    thing = add_light("POINT", **POINT)
    node, tree = emission(thing), thing.data.node_tree
    node.inputs["Strength"].default_value = 2
    for kind, name in (("ShaderNodeTexNoise", "Noise Texture"), ("ShaderNodeTexImage", "Image Texture")):
        tree.links.new(tree.nodes.new(kind).outputs["Color"], node.inputs["Color"])
        found = read(card)
        assert found.warnings == (f'lamp: "{name}" of its nodes is left out on hands; give its Emission plain values',)
        np.testing.assert_allclose(found.lamps[0]["rgb"], 2 * 10 / (4 * math.pi), rtol=1e-4)
    tree.links.remove(node.inputs["Color"].links[0])
    times = tree.nodes.new("ShaderNodeMath")
    times.operation = "MULTIPLY"
    tree.links.new(tree.nodes.new("ShaderNodeTexIES").outputs[0], times.inputs[0])
    tree.links.new(times.outputs[0], node.inputs["Strength"])
    (warning,) = read(card).warnings
    assert '"IES Texture" of its nodes' in warning
    tree.links.new(tree.nodes.new("ShaderNodeLightPath").outputs["Is Diffuse Ray"], node.inputs["Strength"])
    assert '"Light Path" of its nodes' in read(card).warnings[0]
    thing.data.energy = -1
    found = read(card)
    assert not found.lamps
    assert "negative" in found.warnings[0]


def test_more_lamps_than_light_a_hand_are_the_brightest_and_say_so(card):
    data = add_light("POINT", **POINT).data
    for place in range(300):
        thing = bpy.data.objects.new("lamp", data)
        thing.location.x = 2 + place
        bpy.context.scene.collection.objects.link(thing)
        if place == 31:
            assert read(card).warnings == ("33 lamps: the 32 brightest light each hand; hide some of them",)
    found = read(card)
    assert max(lamp["place_m"][0] for lamp in found.lamps) < len(found.lamps) + 2 < 256
    assert found.warnings == ("301 lamps: the 32 brightest light each hand; hide some of them",)


def test_lamps_are_counted_and_ranked_on_the_hand_that_they_light(card):
    """Two things a kilometer from each other, each with 32 lamps of its own; then one has 250 more."""
    far = bpy.data.objects.new("far", None)
    far.location.x = 1000
    bpy.context.scene.collection.objects.link(far)
    for _ in range(32):
        linked_to(add_light("POINT", **POINT), (card, "INCLUDE"))
        beside = add_light("POINT", **POINT)
        beside.location.x += 1000
        linked_to(beside, (far, "INCLUDE"))
    bpy.context.view_layer.update()
    assert not read(card, far).warnings
    data = bpy.data.lights.new("lamp", "POINT")
    data.energy = POINT["energy"]
    for place in range(250):
        thing = bpy.data.objects.new("lamp", data)
        thing.location.x = 20 + place
        linked_to(thing, (card, "INCLUDE"))
        bpy.context.scene.collection.objects.link(thing)
    bpy.context.view_layer.update()
    found = read(card, far)
    assert found.warnings == ("282 lamps: the 32 brightest light each hand; hide some of them",)
    assert sum(lamp["place_m"][0] > 900 for lamp in found.lamps) == 32


@pytest.mark.skipif(not hasattr(bpy.data, "colorspace"), reason="one working space alone")
def test_colors_are_rec709_whatever_the_working_space(card):
    add_light("POINT", **POINT, color=(1, 0.5, 0.25))
    before = np.array(read(card).lamps[0]["rgb"])
    bpy.ops.wm.set_working_color_space(working_space="ACEScg")
    np.testing.assert_allclose(read(card).lamps[0]["rgb"], before, rtol=1e-3)


def test_a_render_has_the_lamps_that_blender_renders(card):
    """What is hidden in views alone lights it, and what is hidden in renders does not."""

    class Engine(bpy.types.RenderEngine):
        bl_idname = bl_label = "LAMPS"

        def render(self, depsgraph):
            seen.append(lamps.lamps_of(depsgraph, [depsgraph.objects["card"]]))

    seen: list[lamps.SceneLamps] = []
    lights = {name: add_light("SUN", energy=1 + place) for place, name in enumerate(("a", "b", "c", "d"))}
    lights["a"].hide_viewport = lights["b"].hide_render = True
    linked_to(lights["c"], (bpy.context.scene.camera, "INCLUDE"))
    linked_to(lights["d"], (card, "INCLUDE"))
    bpy.utils.register_class(Engine)
    try:
        bpy.context.scene.render.engine = "LAMPS"
        bpy.ops.render.render()
    finally:
        bpy.utils.unregister_class(Engine)
    assert sorted(round(lamp["rgb"][0], 3) for lamp in seen[0].lamps) == [1, 4]


# ---- views -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def space(card) -> Iterator[bpy.types.SpaceView3D]:
    """A 3D view in Material Preview with the lights of the scene; the extension follows edits and frames."""
    found = [area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"]
    found[0].shading.type, found[0].shading.use_scene_lights = "MATERIAL", True
    edits, frames = bpy.app.handlers.depsgraph_update_post, bpy.app.handlers.frame_change_post
    edits.append(handlers.on_change)
    frames.append(handlers.on_frame_change)
    lamps.forget()
    yield found[0]
    edits.remove(handlers.on_change)
    frames.remove(handlers.on_frame_change)


def in_view(space: bpy.types.SpaceView3D) -> lamps.SceneLamps:
    bpy.context.view_layer.update()
    return lamps.in_view(bpy.context.evaluated_depsgraph_get(), space, [bpy.data.objects["card"]])


def test_a_view_has_the_lights_of_the_scene_where_it_shows_them(space):
    thing = add_light("SUN", energy=1.0)
    assert len(in_view(space).lamps) == 1
    space.show_object_viewport_light = False
    assert not in_view(space).lamps
    space.show_object_viewport_light = True
    thing.hide_render = True
    assert len(in_view(space).lamps) == 1
    thing.hide_set(True)
    assert not in_view(space).lamps
    thing.hide_set(False)
    for shading in ("SOLID", "MATERIAL", "RENDERED"):
        space.shading.type = shading
        for chosen in (True, False):
            space.shading.use_scene_lights = space.shading.use_scene_lights_render = chosen
            assert lamps.uses_scene_lights(space) == bool(in_view(space).lamps) == (chosen and shading != "SOLID")
    assert lamps.uses_scene_lights(None)


def test_edits_of_lamps_reach_a_view_and_other_edits_read_none(space, card, monkeypatch):
    scene = bpy.context.scene
    thing, parent = add_light("POINT", **POINT), bpy.data.objects.new("parent", None)
    scene.collection.objects.link(parent)
    thing.parent = parent
    keys = [in_view(space).key]

    def is_new(edit: Callable[[], object]) -> bool:
        edit()
        keys.append(in_view(space).key)
        return keys[-1] not in keys[:-1]

    def key_power() -> None:
        thing.data.keyframe_insert("energy", frame=1)
        thing.data.energy = 50
        thing.data.keyframe_insert("energy", frame=9)

    assert is_new(lambda: setattr(thing.location, "x", 1))
    assert is_new(lambda: setattr(parent.location, "x", 1))
    assert is_new(lambda: setattr(thing.data, "energy", 3))
    assert is_new(lambda: setattr(emission(thing).inputs["Strength"], "default_value", 2)) is False  # EEVEE has none
    assert is_new(lambda: in_instance(thing))
    assert is_new(lambda: setattr(scene.objects["placed"].location, "x", 5))
    key_power()
    assert is_new(lambda: scene.frame_set(5))
    monkeypatch.setattr(lamps, "lamps_of", None)
    card.location.x = 1
    assert in_view(space).key == keys[-1]
