"""The panel says what pictures of Cycles and EEVEE with hands cannot show: panes before them, volumes, soft edges."""

from collections.abc import Iterator

import bpy
import hands
import pytest
from mathutils import Matrix
from recording_layout import draw

from blender_addon import versions
from blender_addon.render.panel import RenderPanel
from blender_addon.viewport import handlers


@pytest.fixture
def scene(extension) -> Iterator[bpy.types.Scene]:
    """A hand that a camera of a Cycles scene looks at; edits are told of, as in a window."""
    bpy.app.handlers.depsgraph_update_post.append(handlers.on_change)
    bpy.ops.jghand.add_hand()
    scene = extension.scene
    scene.camera, scene.render.engine = hands.camera_on(extension, (0, 0, 0.09), 0.5), "CYCLES"
    yield scene
    bpy.app.handlers.depsgraph_update_post.remove(handlers.on_change)


def told() -> str:
    bpy.context.view_layer.update()
    return " ".join(draw(RenderPanel, bpy.context).texts)


def material(shader: str, socket: str = "Surface", **values: object) -> bpy.types.Material:
    made = bpy.data.materials.new(shader)
    tree = versions.ensure_tree(made)
    tree.nodes.clear()
    node, output = tree.nodes.new(shader), tree.nodes.new("ShaderNodeOutputMaterial")
    for name, value in values.items():
        node.inputs[name.replace("_", " ")].default_value = value
    tree.links.new(node.outputs[0], output.inputs[socket])
    return made


def card(scene: bpy.types.Scene, of: bpy.types.Material, part: float = 0.5) -> bpy.types.Object:
    """A card across the way from the camera to the hand; at part 0.5, in the middle."""
    bpy.ops.mesh.primitive_plane_add(size=0.3)
    thing = bpy.context.object
    thing.data.materials.append(of)
    eye = scene.camera.matrix_world
    thing.matrix_world = eye @ Matrix.Translation((0, 0, -0.5 * part))
    return thing


def cloud_in(scene: bpy.types.Scene) -> bpy.types.Object:
    """A volume around the origin; one without content has no extent."""
    cloud = bpy.data.objects.new("cloud", bpy.data.volumes.new("cloud"))
    scene.collection.objects.link(cloud)
    bpy.ops.mesh.primitive_cube_add(size=1)
    bpy.context.object.parent = cloud
    cloud.modifiers.new("filled", "MESH_TO_VOLUME").object = bpy.context.object
    return cloud


@pytest.mark.parametrize(
    ("shader", "values", "is_pane"),
    [
        ("ShaderNodeBsdfGlass", {}, True),
        ("ShaderNodeBsdfPrincipled", {"Transmission_Weight": 1.0}, True),
        ("ShaderNodeBsdfPrincipled", {"Alpha": 0.5}, True),
        ("ShaderNodeBsdfPrincipled", {}, False),
    ],
)
def test_a_pane_between_camera_and_hand_is_named(scene, shader, values, is_pane):
    pane = card(scene, material(shader, **values))
    assert ("Plane: no hand is seen through it" in told()) == is_pane
    pane.location.z += 1.0
    assert "seen through" not in told()
    pane.location.z -= 1.0
    scene.render.engine = "JGHAND"  # whose pictures have nothing but hands
    assert "seen through" not in told()


def test_a_pane_in_a_group_of_nodes_and_in_an_instance_of_a_collection_is_found(scene):
    glass = material("ShaderNodeBsdfGlass")
    pane = card(scene, glass)
    tree = glass.node_tree
    group = bpy.data.node_groups.new("Window", "ShaderNodeTree")
    group.nodes.new("ShaderNodeBsdfTransparent")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    tree.nodes.remove(tree.nodes["Glass BSDF"])
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    tree.links.new(node.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    inner, placed = bpy.data.collections.new("inner"), bpy.data.objects.new("placed", None)
    pane.users_collection[0].objects.unlink(pane)
    inner.objects.link(pane)
    placed.instance_type, placed.instance_collection = "COLLECTION", inner
    assert "seen through" not in told()
    scene.collection.objects.link(placed)
    assert "no hand is seen through it" in told()


def test_a_pane_between_lamp_and_hand_is_named_where_it_shades_as_a_whole(scene):
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "POINT"))
    lamp.matrix_world = scene.camera.matrix_world
    scene.collection.objects.link(lamp)
    pane = card(scene, material("ShaderNodeBsdfGlass"))
    scene.jghand.light = "CAPTURE"
    assert "shades hands" not in told()
    scene.jghand.light = "SCENE"
    assert "Plane: seen through, but shades hands as a whole; turn off Shadow" in told()
    pane.data.materials.append(material("ShaderNodeBsdfDiffuse"))  # a frame
    assert "Plane: its panes shade hands; separate them" in told()
    pane.visible_shadow = False
    assert "shades hands" not in told()


def test_volumes_are_named_before_and_around_hands_and_as_worlds(scene):
    fog = material("ShaderNodeVolumePrincipled", "Volume")
    bpy.ops.mesh.primitive_cube_add(size=2)
    bpy.context.object.data.materials.append(fog)
    assert "Cube: a volume does not dim hands" in told()
    bpy.context.object.location.x = 5
    assert "volume" not in told()
    cloud_in(scene)
    assert "cloud: a volume" in told()
    scene.world = bpy.data.worlds.new("World")
    tree = versions.ensure_tree(scene.world)
    output = next(node for node in tree.nodes if node.type == "OUTPUT_WORLD")
    tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], output.inputs["Volume"])
    assert "The volume of the world does not dim hands" in told()


def test_depth_of_field_is_told_where_hands_are_among_other_things(scene):
    scene.camera.data.dof.use_dof = True
    assert "Depth of field" in told()
    scene.render.engine = "JGHAND"
    assert "Depth of field" not in told()


def test_a_room_with_windows_is_named_only_where_one_may_be_between(scene):
    bpy.ops.mesh.primitive_cube_add(size=4)  # around camera and hand
    room = bpy.context.object
    for shader in ("ShaderNodeBsdfDiffuse", "ShaderNodeBsdfGlass"):
        room.data.materials.append(material(shader))
    scene.jghand.light = "SCENE"
    assert "Cube" not in told()
    scene.collection.objects.link(bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN")))  # from outside
    assert "Cube: its panes shade hands" in told()
    assert "no hand is seen through it" not in told()
    scene.jghand.use_exact_light = True  # has what comes through them
    assert "Cube" not in told()
    room.dimensions = (0.4, 0.4, 0.4)  # the camera looks in
    assert "Cube: no hand is seen through it" in told()


def test_a_text_of_glass_is_named(scene):
    thing = bpy.data.objects.new("text", bpy.data.curves.new("text", "FONT"))
    thing.data.materials.append(material("ShaderNodeBsdfGlass"))
    thing.data.size, thing.data.align_x, thing.data.align_y = 0.2, "CENTER", "CENTER"
    thing.data.body = "■"
    scene.collection.objects.link(thing)
    thing.matrix_world = scene.camera.matrix_world @ Matrix.Translation((0, 0, -0.25))
    assert "text: no hand is seen through it" in told()
    thing.location.z += 1.0  # beside the ways
    assert "text" not in told()


def test_a_volume_that_is_moved_is_looked_at_anew(scene):
    cloud = cloud_in(scene)
    assert "cloud: a volume" in told()
    cloud.location.x = 5
    assert "cloud" not in told()


def test_what_jghand_alone_leaves_out_of_images_is_named_with_the_way_to_have_both(scene, capfd):
    for count in range(5):
        bpy.ops.mesh.primitive_cube_add(location=(count, 5, 0))
    bpy.context.object.hide_render = True
    assert "alone" not in told()
    bpy.ops.jghand.use_engine()
    assert "hands alone, without Cube, Cube.001, Cube.002, …" in capfd.readouterr().out
    assert 'hands alone, without Cube, Cube.001, Cube.002, …. "Set Up Compositing" renders both' in told()
    assert "jghand.combine_with_scene" in draw(RenderPanel, bpy.context).operators
    inner, placed = bpy.data.collections.new("inner"), bpy.data.objects.new("A tree", None)
    inner.objects.link(bpy.data.objects["Cube"])
    scene.collection.objects.link(placed)
    placed.instance_type, placed.instance_collection = "COLLECTION", inner
    assert "hands alone, without A tree, Cube, Cube.001, …" in told()
    bpy.data.objects.remove(placed)
    for thing in scene.objects:
        thing.hide_render = thing.type == "MESH"
    assert "alone" not in told()
