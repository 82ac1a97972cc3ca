"""Worlds as light: what is read from their nodes, or measured, lights a white card as Cycles does."""

import math
from collections.abc import Callable
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from blender_addon import versions
from blender_addon.core import worlds as pictures
from blender_addon.core.view import LIGHT_FROM_WORLD
from blender_addon.render import worlds
from blender_addon.viewport import handlers
from jghand_engine.avatar.scene_light import World, harmonics
from jghand_engine.avatar.world_suns import take_suns

SAMPLES = 512
# evenly, so that no card is in the way of another
NORMALS = pictures._evenly(60)
TO_JOINTS = LIGHT_FROM_WORLD[:3, :3]
# a cosine whose corner is hardly rounded
HARD = np.full(3, 1e-3)


@pytest.fixture(autouse=True)
def fresh(extension):
    """Nothing is known of worlds."""
    worlds.forget()
    world = extension.scene.world = bpy.data.worlds.new("World")
    if world.node_tree is None:  # 4.5
        world.use_nodes = True


def nodes() -> bpy.types.NodeTree:
    return bpy.context.scene.world.node_tree


def background() -> bpy.types.Node:
    return nodes().nodes["Background"]


def new(kind: str, into: bpy.types.NodeSocket | None = None, **values) -> bpy.types.Node:
    """A node with properties and, by the names of its inputs, values; linked into a socket."""
    node = nodes().nodes.new(f"ShaderNode{kind}")
    for name, value in values.items():
        if name in node.bl_rna.properties:
            setattr(node, name, value)
        else:
            node.inputs[name].default_value = value
    if into is not None:
        nodes().links.new(node.outputs[0], into)
    return node


def smooth(rows: int = 64) -> np.ndarray:
    """(rows, 2 rows, 4) of few waves, other ones for each color, top row first."""
    up = np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)[:, None]
    around = np.pi * (1 - (np.arange(2 * rows) + 0.5) / rows)[None, :]
    x, y, z = np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up) + 0 * around
    picture = np.stack([0.5 + 0.4 * x, 0.4 + 0.3 * y * z, 0.3 + 0.2 * z - 0.1 * x * y, np.ones_like(x)], -1)
    return picture.astype(np.float32)


def with_sun(rows: int = 256) -> np.ndarray:
    """The same with a sun of three pixels that gives half of the light."""
    picture = smooth(rows)
    picture[rows // 4, rows // 2 : rows // 2 + 3, :3] = (9000, 8000, 7000)
    return picture


def image(picture: np.ndarray, *, is_float: bool = True, space: str = "") -> bpy.types.Image:
    rows, columns = picture.shape[:2]
    made = bpy.data.images.new("Environment", columns, rows, float_buffer=is_float)
    if space:
        made.colorspace_settings.name = space
    made.pixels.foreach_set(np.ascontiguousarray(picture[::-1], np.float32).ravel())
    made.update()
    return made


def reading(place: worlds.Place | None = None) -> worlds.Reading:
    graph = bpy.context.evaluated_depsgraph_get()
    graph.update()
    return worlds.world_of(graph, place)


def update(place: worlds.Place | None = None) -> bool:
    graph = bpy.context.evaluated_depsgraph_get()
    graph.update()
    return worlds.update(graph, place)


def engine_world(light: pictures.WorldLight) -> World:
    return World(light.radiance, np.array(light.record["env_from_world"]))


def irradiance(light: pictures.WorldLight) -> np.ndarray:
    """(60, 3) W/m2 of each normal, by what the engine gets: every pixel and the suns beside them."""
    direction, power = (values.reshape(-1, 3) for values in engine_world(light).samples)
    normals = NORMALS @ TO_JOINTS.T
    lit = np.maximum(normals @ direction.T, 0) @ power
    for sun in light.suns:
        lit = lit + np.maximum(normals @ sun["place_m"], 0)[:, None] * sun["rgb"]
    return lit


def irradiance_by_cycles() -> np.ndarray:
    """(60, 3) W/m2 of small white cards in the scene's own world, where its lamps do not light them directly."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", SAMPLES
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.render.bake.target, scene.render.bake.use_pass_color = "VERTEX_COLORS", False
    # Cycles would make a finer map of what is bright, which takes longer than all else
    scene.world.cycles.sampling_method, scene.world.cycles.sample_map_resolution = "MANUAL", 128
    side = np.cross(NORMALS, np.roll(NORMALS, 1, axis=1))
    side *= 1e-2 / np.linalg.norm(side, axis=1, keepdims=True)
    corners = np.stack([side, np.cross(NORMALS, side), -side], 1)
    mesh = bpy.data.meshes.new("cards")
    points = 0.02 * (NORMALS[:, None] + corners).reshape(-1, 3)
    mesh.from_pydata(points.tolist(), [], np.arange(180).reshape(-1, 3).tolist())
    mesh.color_attributes.active_color = mesh.color_attributes.new("light", "FLOAT_COLOR", "POINT")
    mesh.materials.append(bpy.data.materials.new("white"))
    cards = bpy.data.objects.new("cards", mesh)
    scene.collection.objects.link(cards)
    others = bpy.data.collections.new("others")
    others.objects.link(cards)
    others.collection_objects[0].light_linking.link_state = "EXCLUDE"
    for lamp in [thing for thing in scene.objects if thing.type == "LIGHT"]:
        lamp.light_linking.receiver_collection = others
    bpy.context.view_layer.objects.active = cards
    cards.select_set(True)
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"})
    values = np.empty(720, np.float32)
    mesh.color_attributes["light"].data.foreach_get("color", values)
    bpy.data.objects.remove(cards)
    return math.pi * values.reshape(-1, 3, 4)[..., :3].mean(1)


def errors(light: pictures.WorldLight, true: np.ndarray) -> tuple[float, float]:
    """rms and worst normal, parts of the mean."""
    error = (irradiance(light) - true) / true.mean()
    return float(np.sqrt((error**2).mean())), float(np.abs(error).max())


# ---- what nodes say --------------------------------------------------------------------------------------------------


def test_one_color_lights_exactly():
    background().inputs["Color"].default_value = (0.2, 0.5, 1.0, 1.0)
    background().inputs["Strength"].default_value = 2.0
    light = reading().light
    assert errors(light, np.tile(np.pi * np.array([0.4, 1.0, 2.0]), (60, 1)))[1] < 2e-3
    assert errors(light, irradiance_by_cycles())[1] < 0.01
    through_terms = harmonics(NORMALS) @ engine_world(light).terms.irradiance(HARD)
    np.testing.assert_allclose(through_terms, np.tile(np.pi * np.array([0.4, 1.0, 2.0]), (60, 1)), rtol=0.01)


def of_picture() -> None:
    new("TexEnvironment", background().inputs["Color"], image=image(smooth()))


def of_turned_picture() -> None:
    background().inputs["Strength"].default_value = 2.0
    mix = new("Mix", background().inputs["Color"], data_type="RGBA", blend_type="MULTIPLY")
    nodes().links.new(mix.outputs[2], background().inputs["Color"])
    mix.inputs[0].default_value, mix.inputs[7].default_value = 0.75, (1.0, 0.5, 0.2, 1.0)
    picture = new("TexEnvironment", mix.inputs[6], image=image(smooth()))
    turn = new("Mapping", picture.inputs["Vector"], Rotation=(0.3, 0.5, 0.7), Scale=(2, 2, 2))
    back = new("Mapping", turn.inputs["Vector"], vector_type="TEXTURE", Rotation=(1.0, 0.2, -0.4))
    nodes().links.new(new("TexCoord").outputs["Generated"], back.inputs["Vector"])


def of_bytes() -> None:
    new("TexEnvironment", background().inputs["Color"], image=image(smooth(), is_float=False))


def of_linear_bytes() -> None:
    new("TexEnvironment", background().inputs["Color"], image=image(smooth(), is_float=False, space="Non-Color"))


def of_what_cameras_do_not_see() -> None:
    """The picture lights; cameras see one color, over which the other half of the light is added."""
    output = nodes().nodes["World Output"].inputs["Surface"]
    new("TexEnvironment", background().inputs["Color"], image=image(smooth()))
    mix, seen = new("MixShader"), new("Background", Color=(9, 9, 9, 1))
    nodes().links.new(new("LightPath").outputs["Is Camera Ray"], mix.inputs[0])
    nodes().links.new(background().outputs[0], mix.inputs[1])
    nodes().links.new(seen.outputs[0], mix.inputs[2])
    both = new("AddShader", output)
    nodes().links.new(mix.outputs[0], both.inputs[0])
    nodes().links.new(new("Background", Color=(0.1, 0.2, 0.3, 1)).outputs[0], both.inputs[1])


def of_a_large_picture_with_a_sun() -> None:
    new("TexEnvironment", background().inputs["Color"], image=image(with_sun(400)))


@pytest.mark.parametrize(
    "made", [of_picture, of_turned_picture, of_bytes, of_linear_bytes, of_what_cameras_do_not_see]
)  # fmt: skip
def test_pictures_light_as_in_cycles(made: Callable[[], None]):
    made()
    found = reading()
    assert (found.failures, found.stale) == ((), "")
    assert errors(found.light, irradiance_by_cycles())[1] < 0.01


def test_a_large_picture_with_a_sun_lights_as_all_of_its_pixels():
    of_a_large_picture_with_a_sun()
    light = reading().light
    assert light.radiance.shape == (256, 512, 3)
    whole = pictures.WorldLight(with_sun(400)[..., :3])
    assert errors(light, irradiance(whole))[1] < 0.002


def test_the_engine_finds_the_sun_of_a_picture_where_blender_has_it():
    of_a_large_picture_with_a_sun()
    background().inputs["Strength"].default_value = 2.0
    _, (sun,) = take_suns(engine_world(reading().light))
    up, around = np.pi * (0.5 - 100.5 / 400), np.pi * (1 - 201.5 / 400)
    towards = TO_JOINTS @ [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)]
    assert np.dot(sun.place_m, towards) / np.linalg.norm(sun.place_m) > np.cos(np.radians(0.3))


def test_a_world_that_gives_no_light_is_none(context):
    background().inputs["Strength"].default_value = 0.0
    assert reading() == worlds.Reading(None)
    background().inputs["Strength"].default_value = 1.0
    assert reading().light is not None
    context.scene.world.cycles_visibility.diffuse = False
    assert reading() == worlds.Reading(None, for_cameras=True)
    context.scene.world = None
    assert reading() == worlds.Reading(None)


def test_a_picture_that_is_missing_says_so():
    gone = bpy.data.images.new("gone", 4, 2)
    gone.source, gone.filepath = "FILE", "//gone.hdr"
    new("TexEnvironment", background().inputs["Color"], image=gone)
    found = reading()
    assert found.light is None
    assert [failure.kind for failure in found.failures] == ["no_world_image"]


def test_what_is_keyed_is_read_at_its_frame(context):
    strength = background().inputs["Strength"]
    for frame, value in ((1, 1.0), (11, 3.0)):
        strength.default_value = value
        strength.keyframe_insert("default_value", frame=frame)
    context.scene.frame_set(1)
    first = reading().light
    context.scene.frame_set(11)
    np.testing.assert_allclose(reading().light.radiance, 3 * first.radiance, rtol=1e-5)


def test_the_key_changes_with_the_picture_and_not_with_its_turn(monkeypatch):
    of_turned_picture()
    before = reading().light
    monkeypatch.setattr(worlds, "_read", lambda _image: pytest.fail("a picture was read again"))
    nodes().nodes["Mapping"].inputs["Rotation"].default_value = (0, 0, 1)
    turned = reading().light
    assert turned.key == before.key
    assert turned.radiance is before.radiance
    assert turned.record["env_from_world"] != before.record["env_from_world"]
    background().inputs["Strength"].default_value = 1.0
    assert reading().light.key != before.key
    monkeypatch.undo()
    # a stroke of a brush: Blender tells of the picture
    painted = nodes().nodes["Environment Texture"].image
    painted.pixels.foreach_set(np.full(64 * 128 * 4, 0.5, np.float32))
    change = SimpleNamespace(id=painted, is_updated_transform=False, is_updated_geometry=False)
    worlds.notice(SimpleNamespace(updates=[change]))
    assert np.ptp(reading().light.radiance[..., 0]) < 1e-6


# ---- what is measured ------------------------------------------------------------------------------------------------


def of_a_sky() -> None:
    sky = new("TexSky", background().inputs["Color"], sun_elevation=0.6, sun_rotation=2.2)
    assert sky.sun_disc


def of_a_turned_sky_without_a_sun() -> None:
    sky = new("TexSky", background().inputs["Color"], sky_type="HOSEK_WILKIE", sun_direction=(0.5, 0.3, 0.8))
    turn = new("Mapping", sky.inputs["Vector"], Rotation=(0.3, 0.5, 0.7))
    nodes().links.new(new("TexCoord").outputs["Generated"], turn.inputs["Vector"])


def of_a_gradient() -> None:
    gradient = new("TexGradient", background().inputs["Color"], gradient_type="EASING")
    nodes().links.new(new("TexCoord").outputs["Generated"], gradient.inputs["Vector"])


@pytest.mark.parametrize(
    ("made", "rms", "worst"),
    [(of_a_sky, 0.01, 0.02), (of_a_turned_sky_without_a_sun, 0.01, 0.02), (of_a_gradient, 0.01, 0.02)],
)
def test_what_nodes_do_not_tell_is_measured(made: Callable[[], None], rms: float, worst: float):
    made()
    stale = reading()
    assert stale.stale
    assert [failure.kind for failure in stale.failures] == ["world_not_measured"]
    assert update()
    found = reading()
    assert (found.failures, found.stale) == ((), "")
    got = errors(found.light, irradiance_by_cycles())
    assert got[0] < rms
    assert got[1] < worst
    assert not update()


def test_a_picture_is_read_once_however_often_its_strength_is_changed(monkeypatch):
    reads: list[bpy.types.Image] = []
    read = worlds._read
    monkeypatch.setattr(worlds, "_read", lambda image: reads.append(image) or read(image))
    new("TexEnvironment", background().inputs["Color"], image=image(smooth()))
    for strength in range(1, 3 * worlds.KEPT):
        background().inputs["Strength"].default_value = strength
        assert reading().light is not None
    assert len(reads) == 1


def test_an_environment_that_an_object_turns_is_measured_again_when_that_turns():
    node = new("TexEnvironment", background().inputs["Color"], image=image(smooth()))
    coordinates = new("TexCoord")
    coordinates.object = bpy.data.objects.new("Empty", None)
    bpy.context.scene.collection.objects.link(coordinates.object)
    nodes().links.new(coordinates.outputs["Object"], node.inputs["Vector"])
    before = reading().stale
    assert before
    assert reading().stale == before
    coordinates.object.rotation_euler.z = 1.0
    assert reading().stale not in ("", before)


def test_each_picture_of_a_sequence_is_measured(tmp_path):
    for frame in (1, 2):
        made = image(smooth(8), is_float=False)
        made.filepath_raw, made.file_format = str(tmp_path / f"sky_{frame:04d}.png"), "PNG"
        made.save()
    node = new(
        "TexEnvironment", background().inputs["Color"], image=bpy.data.images.load(str(tmp_path / "sky_0001.png"))
    )
    node.image.source, node.image_user.frame_duration, node.image_user.use_auto_refresh = "SEQUENCE", 2, True
    names = []
    for frame in (1, 2, 1):
        bpy.context.scene.frame_set(frame)
        names.append(reading().stale)
    assert "" not in names
    assert names[0] == names[2] != names[1]


def test_a_sun_behind_nodes_that_do_not_tell_is_measured():
    """A sun of three pixels, which mirrors miss: white facets have it within a part of the sphere."""
    as_it_is = new("Gamma", background().inputs["Color"], Gamma=1.0)
    new("TexEnvironment", as_it_is.inputs["Color"], image=image(with_sun()))
    assert update()
    rms, worst = errors(reading().light, irradiance(pictures.WorldLight(with_sun()[..., :3])))
    assert rms < 0.03
    assert worst < 0.1


def test_a_sky_has_its_sun_as_a_lamp_and_turns_with_its_strength():
    of_a_sky()
    update()
    (sun,) = reading().light.suns
    towards = np.array([math.cos(0.6) * math.sin(2.2), math.cos(0.6) * math.cos(2.2), math.sin(0.6)])
    np.testing.assert_allclose(sun["place_m"], TO_JOINTS @ towards, atol=1e-6)
    assert sun["angle_rad"] == pytest.approx(nodes().nodes["Sky Texture"].sun_size)
    background().inputs["Strength"].default_value = 0.5
    # measured once, whatever its strength is
    half = reading()
    assert not half.stale
    assert half.light.suns[0]["rgb"] == pytest.approx([value / 2 for value in sun["rgb"]])


def test_until_a_world_is_measured_anew_it_lights_as_it_did():
    of_a_turned_sky_without_a_sun()
    update()
    before = reading().light
    nodes().nodes["Sky Texture"].turbidity = 7.0
    found = reading()
    assert found.stale
    assert found.light.key == before.key
    update()
    assert reading().light.key != before.key


def test_measuring_leaves_the_file_as_it_was(context):
    of_a_turned_sky_without_a_sun()
    kinds = ("scenes", "worlds", "objects", "collections", "meshes", "materials", "node_groups")
    chosen = bpy.data.objects.new("chosen", None)
    context.scene.collection.objects.link(chosen)
    context.view_layer.objects.active = chosen
    chosen.select_set(True)
    before = {kind: set(getattr(bpy.data, kind)) for kind in kinds}
    update()
    assert {kind: set(getattr(bpy.data, kind)) for kind in kinds} == before
    assert context.view_layer.objects.active == chosen
    assert context.selected_objects == [chosen]
    assert context.scene.render.engine != "CYCLES"


def test_every_value_of_a_node_counts_for_whether_it_is_measured_again():
    ramp = new("ValToRGB", background().inputs["Color"])
    noise = new("TexNoise", ramp.inputs[0])
    names = {reading().stale}
    ramp.color_ramp.elements[0].color = (0.5, 0, 0, 1)
    names.add(reading().stale)
    noise.inputs["Scale"].default_value = 7.0
    names.add(reading().stale)
    nodes().links.remove(ramp.inputs[0].links[0])
    names.add(reading().stale)
    assert len(names) == 4
    # where a node lies does not
    noise.location = (100, 100)
    ramp.select = not ramp.select
    assert reading().stale in names


# ---- what is around hands --------------------------------------------------------------------------------------------


def wall(corners: np.ndarray, rgb: tuple[float, float, float], glow: float = 0.0) -> bpy.types.Object:
    """A rectangle of four corners, meters, that throws light back or shines."""
    mesh = bpy.data.meshes.new("wall")
    mesh.from_pydata(np.array(corners, float).tolist(), [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new("wall")
    tree = versions.ensure_tree(material)
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeEmission" if glow else "ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (*rgb, 1)
    if glow:
        shader.inputs["Strength"].default_value = glow
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    mesh.materials.append(material)
    thing = bpy.data.objects.new("wall", mesh)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def room() -> None:
    """A dim world, a shining panel, a red floor and a wall; and a lamp, whose light they throw back."""
    background().inputs["Color"].default_value = (0.05, 0.07, 0.1, 1)
    wall([(0.5, -0.2, 0.2), (0.5, 0.2, 0.2), (0.5, 0.2, 0.6), (0.5, -0.2, 0.6)], (1, 0.8, 0.5), 12.0)
    wall([(-1, -1, -0.3), (1, -1, -0.3), (1, 1, -0.3), (-1, 1, -0.3)], (0.8, 0.1, 0.05))
    wall([(-0.4, -1, -1), (-0.4, 1, -1), (-0.4, 1, 1), (-0.4, -1, 1)], (0.5, 0.5, 0.5))
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "POINT"))
    lamp.data.energy, lamp.location = 20.0, (0.1, 0.5, -0.1)
    bpy.context.scene.collection.objects.link(lamp)


def test_what_is_around_hands_lights_them_as_in_cycles():
    """Walls and panels, and what they throw back of a lamp; but the lamp itself is none of it."""
    room()
    place = (0, 0, 0)
    assert reading(place).stale
    assert update(place)
    objects = len(bpy.data.objects), len(bpy.data.collections)
    rms, worst = errors(reading(place).light, irradiance_by_cycles())
    assert rms < 0.03
    assert worst < 0.1
    assert objects == (4, 0)
    # without a place there is the world alone
    assert errors(reading().light, np.tile(np.pi * np.array([0.05, 0.07, 0.1]), (60, 1)))[1] < 2e-3


def test_what_is_hidden_deleted_or_excluded_is_not_around(context):
    room()
    collection = bpy.data.collections.new("panels")
    context.scene.collection.children.link(collection)
    for thing in [*context.scene.collection.objects]:
        context.scene.collection.objects.unlink(thing)
        collection.objects.link(thing)
    names = [reading((0, 0, 0)).stale]
    bpy.data.objects["wall"].hide_render = True
    names.append(reading((0, 0, 0)).stale)
    bpy.data.objects.remove(bpy.data.objects["wall.001"])
    names.append(reading((0, 0, 0)).stale)
    collection.hide_render = True
    names.append(reading((0, 0, 0)).stale)
    assert len(set(names)) == 4
    assert update((0, 0, 0))
    assert errors(reading((0, 0, 0)).light, np.tile(np.pi * np.array([0.05, 0.07, 0.1]), (60, 1)))[1] < 0.02
    collection.hide_render = False
    assert reading((0, 0, 0)).stale == names[2]


def test_measuring_is_no_change_that_is_measured_again(context):
    room()
    bpy.context.view_layer.update()
    bpy.app.handlers.depsgraph_update_post.append(handlers.on_change)
    try:
        assert update((0, 0, 0))
        bpy.context.view_layer.update()
        assert not reading((0, 0, 0)).stale
        bpy.data.objects["wall"].location.x += 0.1
        bpy.context.view_layer.update()
        assert reading((0, 0, 0)).stale
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(handlers.on_change)


def test_what_is_around_is_measured_again_when_it_changes_and_hands_leave_their_cell(context):
    room()
    graph = context.evaluated_depsgraph_get()
    hand = bpy.data.objects.new("hand", None)
    context.scene.collection.objects.link(hand)
    graph.update()
    assert worlds.place_of(graph, [hand]) is None
    context.scene.jghand.use_surroundings = True
    names = []
    for x in (0.0, 0.01, 0.2):
        hand.location.x = x
        graph.update()
        names.append(reading(worlds.place_of(graph, [hand])).stale)
    assert names[0] == names[1] != names[2]
    before = reading((0, 0, 0)).stale
    for thing, is_around in ((bpy.data.objects["wall"], True), (hand, False), (bpy.data.materials["wall"], True)):
        change = SimpleNamespace(id=thing, is_updated_transform=True, is_updated_geometry=False)
        worlds.notice(SimpleNamespace(updates=[change]))
        now = reading((0, 0, 0)).stale
        assert (now != before) == is_around
        before = now
