"""The stand-ins of hands throw their shadows, and nobody sees anything else of them."""

import json
from pathlib import Path

import bpy
import hands
import numpy as np
import pytest
from test_render_engine import layers

from blender_addon.core import poses, posing
from blender_addon.core.stand_in import surface_at
from blender_addon.hand import armature, seen_hands, sources, stand_ins
from blender_addon.render import composite, preview
from blender_addon.viewport import handlers

EXACT_M = 1e-6


def add_hand(side: str = "right") -> bpy.types.Object:
    bpy.ops.jghand.add_hand(handedness=side)
    return bpy.context.object


def only(hand: bpy.types.Object) -> bpy.types.Object:
    (thing,) = hands.stand_ins_of(hand)
    return thing


# vertices of the hand; those of its forearm come after them. The last one closes the wrist where there is none
SKIN = 1610
# from the wrist to the farthest knuckle
KNUCKLE_M = 0.095


def surface_of(thing: bpy.types.Object) -> np.ndarray:
    """(V, 3) evaluated, in the world."""
    thing.hide_viewport = False
    bpy.context.view_layer.update()
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    vertices = np.empty((len(evaluated.data.vertices), 3), np.float32)
    evaluated.data.vertices.foreach_get("co", vertices.ravel())
    world = np.array(evaluated.matrix_world)
    return vertices @ world[:3, :3].T + world[:3, 3]


def engine_surface(hand: bpy.types.Object) -> np.ndarray:
    """(V, 3) the engine's template, without a forearm, posed by the joints of a hand, in the world."""
    skeleton = pytest.importorskip("jghand_engine.hand.skeleton")
    from jghand_engine.hand.orders import JointOrder, to_level
    from jghand_engine.template.builtin import load_template
    from jghand_engine.template.mesh import posed_vertices

    seen = armature.read_hand(hand, bpy.context.evaluated_depsgraph_get())
    template = load_template()
    bones = skeleton.Skeleton(template.joints_m, handedness=seen.handedness)
    return posed_vertices(template, bones, to_level(seen.joints_world_m, JointOrder.STANDARD))


@pytest.fixture
def floor(extension) -> bpy.types.Scene:
    """A hand above a plane in the sun, seen from above, and a film that the plane does not fill. Cycles."""
    hand = add_hand()
    hand.location, hand.rotation_euler = (0, -0.1, 0.1), (0, 0, 0)
    bpy.ops.mesh.primitive_plane_add(size=0.5)
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    eye.location = (0, 0, 1)
    scene = bpy.context.scene
    for thing in (sun, eye):
        scene.collection.objects.link(thing)
    scene.camera, scene.render.engine = eye, "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 4, False
    scene.render.resolution_x = scene.render.resolution_y = 48
    scene.render.resolution_percentage, scene.render.film_transparent = 100, True
    scene.view_settings.view_transform = "Standard"
    return scene


def f12(folder: Path) -> np.ndarray:
    """(H, W, 4) as it is written."""
    scene = bpy.context.scene
    scene.render.filepath = str(folder / "image.png")
    scene.render.image_settings.color_mode = "RGBA"
    bpy.ops.render.render(write_still=True)
    return hands.pixels(scene.render.filepath)


def dark(picture: np.ndarray, beside: np.ndarray) -> int:
    """Pixels that are much darker than beside."""
    return int(((beside - picture)[..., :3].mean(-1) > 0.2).sum())


def test_the_floor_shows_the_shadow_and_the_film_no_hand(floor, tmp_path):
    hand = bpy.data.objects["Right Hand"]
    with_shadow = f12(tmp_path)
    hand.jghand.cast_shadow = False
    assert not hands.stand_ins_of(hand)
    bare = f12(tmp_path)
    np.testing.assert_array_equal(with_shadow[..., 3], bare[..., 3])
    assert 0 < bare[..., 3].mean() < 1
    assert dark(with_shadow, bare) > 20


def test_its_skin_has_the_color_of_its_avatar_and_a_mesh_in_its_place_too(floor, tmp_path):
    hand, strong, painted = bpy.data.objects["Right Hand"], add_hand(), add_hand()
    strong.jghand.avatar, painted.jghand.avatar = "strong", "painted"
    stand_ins.update()
    copy = bpy.data.objects.new("mesh", only(strong).data)
    floor.view_layers[0].use_pass_diffuse_color = True
    floor.collection.objects.link(copy)
    for thing, avatar in ((only(hand), "builtin"), (copy, "strong"), (only(painted), "painted")):
        for each in floor.objects:
            each.visible_camera = each == thing
        passes = layers(floor, tmp_path)
        colors = np.stack([passes[f"Diffuse Color.{channel}"] for channel in "RGB"], -1)
        found = colors[passes["Combined.A"] == 1]
        assert len(found) > 10
        # what skin mirrors takes a part, as much of each color
        part = found.mean(0) / stand_ins.skin_rgb(seen_hands.named(avatar))
        assert 0.9 < part.min() <= part.max() < 1
        assert np.ptp(part) < 1e-3


def test_a_hand_that_is_not_rendered_throws_no_shadow_also_where_that_is_animated(floor, tmp_path):
    hand = bpy.data.objects["Right Hand"]
    for frame, hidden in ((1, True), (2, False)):
        hand.hide_render = hidden
        hand.keyframe_insert("hide_render", frame=frame)
    floor.frame_set(1)
    none = f12(tmp_path)
    floor.frame_set(2)
    assert dark(f12(tmp_path), none) > 20


def test_a_preview_movie_shows_no_stand_in(floor, tmp_path):
    """Workbench draws whatever is not hidden, in the color type Single."""
    shown = f12(tmp_path)
    floor[stand_ins.WITHOUT] = True
    assert dark(shown, f12(tmp_path)) > 20
    del floor[stand_ins.WITHOUT]
    movie = preview._begin(bpy.context)
    scene = preview._scene(movie.scene_uid)
    assert scene is not None
    assert scene.get(stand_ins.WITHOUT)
    preview._remove(movie)


def test_none_is_there_while_blender_undoes_something_and_each_hand_has_one_again(extension):
    """An undo keeps collections that it does not change, with pointers to what a timer made since: a crash in 5.2.2."""
    hand = add_hand()
    stand_ins.update()
    assert only(hand)
    stand_ins.before_undo()
    assert not [thing for thing in bpy.data.objects if stand_ins.MARK in thing]
    assert {name for name, act in handlers.HANDLERS if act == stand_ins.before_undo} == {"undo_pre", "redo_pre"}
    stand_ins.update()
    assert only(hand)


def test_it_has_the_forearm_that_the_hand_shows(extension, monkeypatch):
    """So that the shadow ends where the hand does."""
    monkeypatch.setattr(stand_ins.avatar_files, "has_forearm", lambda avatar: False)
    hand = add_hand("left")
    assert len(only(hand).data.vertices) == SKIN
    monkeypatch.setattr(stand_ins.avatar_files, "has_forearm", lambda avatar: True)
    stand_ins.update()
    assert len(only(hand).data.vertices) == 1750
    hand.jghand.forearm = False
    assert len(only(hand).data.vertices) == SKIN


def test_a_view_has_room_for_a_forearm_where_the_hand_shows_one(extension, monkeypatch):
    monkeypatch.setattr(seen_hands.avatar_files, "has_forearm", lambda avatar: False)
    hand = add_hand("left")

    def forearm() -> bool:
        ((seen,), _) = seen_hands.read([hand], bpy.context.evaluated_depsgraph_get())
        return seen.forearm

    assert not forearm()
    monkeypatch.setattr(seen_hands.avatar_files, "has_forearm", lambda avatar: True)
    assert forearm()
    hand.jghand.forearm = False
    assert not forearm()


@pytest.mark.parametrize("side", ["right", "left"])
def test_its_surface_is_the_engines_in_every_pose(extension, side):
    """Worst seen: 0.1 mm, what small weights leave out, and where the palm arches 24 % of the way of a knuckle, 2.6 mm
    of 11: shape keys follow it to the first order."""
    hand = add_hand(side)
    for pose in poses.ALL_POSES:
        bpy.ops.jghand.apply_pose(pose=pose.name)
        ways = poses.pose_on(pose.name, armature.rest_matrices_of(hand), side).knuckles.values()
        way_m = KNUCKLE_M * np.linalg.norm(list(ways), axis=-1).max()
        apart_m = np.linalg.norm(surface_of(only(hand))[: SKIN - 1] - engine_surface(hand)[:-1], axis=-1)
        assert apart_m.max() < 1.5e-4 + 0.25 * way_m


@pytest.mark.parametrize("side", ["right", "left"])
def test_shadows_are_looked_for_on_the_engines_surface(extension, side):
    """Worst seen: 0.05 mm, in a fist, too."""
    hand = add_hand(side)
    for pose in poses.ALL_POSES:
        bpy.ops.jghand.apply_pose(pose=pose.name)
        seen = armature.read_hand(hand, bpy.context.evaluated_depsgraph_get())
        surface = surface_at(1.3 * seen.joints_world_m, side).vertices / 1.3
        np.testing.assert_allclose(surface[:-1], engine_surface(hand)[:-1], atol=1e-4)


def test_it_has_the_size_of_the_hand_that_a_motion_brought(extension):
    joints_m = 1.3 * posing.rest_joints_m("right")
    hand = hands.keyed_hand(extension, "right", joints_m[None])
    stand_ins.update()
    np.testing.assert_allclose(surface_of(only(hand))[: SKIN - 1], engine_surface(hand)[:-1], atol=1e-4)


def test_a_rig_of_somebody_else_has_one_for_each_of_its_hands(extension):
    rig, joints = hands.mixamo_rig(extension)
    bpy.ops.jghand.use_armature()
    stand_ins.update()
    assert sorted(thing[stand_ins.MARK] for thing in hands.stand_ins_of(rig)) == ["left", "right"]
    for thing in hands.stand_ins_of(rig):
        wrist = joints[thing[stand_ins.MARK]][0]
        assert np.linalg.norm(surface_of(thing) - wrist, axis=-1).min() < 0.03
    sources.forget_map(rig, "left")
    stand_ins.update()
    assert only(rig)[stand_ins.MARK] == "right"


def test_it_goes_with_its_hand(extension):
    """Renamed, duplicated, moved to another collection, edited and deleted."""
    hand = add_hand()
    first = only(hand)
    hand.name = "Waving"
    other = bpy.data.collections.new("other")
    bpy.context.scene.collection.children.link(other)
    other.objects.link(hand)
    bpy.context.scene.collection.objects.unlink(hand)
    bpy.ops.object.duplicate()
    twin = bpy.context.object
    assert twin != hand
    stand_ins.update()
    assert only(hand) == first
    assert first.name == "Waving Shadow"
    assert list(first.users_collection) == [other]
    assert only(twin).data != first.data  # which follows the knuckles of its hand
    bpy.ops.jghand.apply_pose(pose="fist")
    fist = surface_of(only(twin))
    np.testing.assert_allclose(fist[: SKIN - 1], engine_surface(twin)[:-1], atol=3e-3)
    bpy.data.meshes.remove(only(twin).data)  # and the object
    copied = first.copy()
    copied.parent = copied.modifiers[0].object = twin
    other.objects.link(copied)
    stand_ins.update()
    assert only(twin) == copied
    np.testing.assert_array_equal(surface_of(copied), fist)
    bpy.ops.jghand.reset_pose()
    with armature.edit_mode(extension, twin):
        twin.data.edit_bones["index4"].tail.z += 0.001
        twin.data.edit_bones["index4"].head.z += 0.01
    stand_ins.update()
    np.testing.assert_allclose(surface_of(only(twin))[: SKIN - 1], engine_surface(twin)[:-1], atol=5e-4)
    for thing in (hand, twin):
        bpy.data.objects.remove(thing)
    stand_ins.update()
    assert not [thing for thing in bpy.data.objects if stand_ins.MARK in thing]
    assert not [mesh for mesh in bpy.data.meshes if stand_ins.MADE_FROM in mesh]


def test_of_a_hand_in_edit_mode_or_that_cannot_be_read_it_stays_with_what_the_artist_set(extension):
    hand, (rig, _) = add_hand(), hands.mixamo_rig(extension)
    bpy.ops.jghand.use_armature()
    stand_ins.update()
    things = [only(hand), *hands.stand_ins_of(rig)]
    with armature.edit_mode(extension, hand):
        stand_ins.update()
        assert only(hand) == things[0]
        hand.data.edit_bones["index4"].head = hand.data.edit_bones["index4"].tail
    rig[armature.MAP_PROPERTIES["right"]] = "?"
    stand_ins.update()
    assert [only(hand), *hands.stand_ins_of(rig)] == things
    with armature.edit_mode(extension, hand):
        hand.jghand.cast_shadow = False
        assert not hands.stand_ins_of(hand)


def test_files_without_stand_ins_get_them_and_linked_hands_too(extension, tmp_path):
    armature.build_armature(extension, "Old", posing.rest_joints_m("right"), "right")
    path = str(tmp_path / "old.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    assert not hands.stand_ins_of(bpy.data.objects["Old"])
    bpy.ops.wm.open_mainfile(filepath=path)
    assert only(bpy.data.objects["Old"]).hide_viewport
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.objects = ["Old"]
    linked = bpy.data.objects["Old"]
    bpy.context.scene.collection.objects.link(linked)
    stand_ins.update()
    assert only(linked).library is None


def test_of_a_file_of_another_making_it_is_made_anew(extension, monkeypatch):
    rig, _ = hands.mixamo_rig(extension)
    bpy.ops.jghand.use_armature()
    monkeypatch.setattr(stand_ins, "_MAKING", b"1")
    stand_ins.update()
    before = {thing.data.session_uid for thing in hands.stand_ins_of(rig)}
    monkeypatch.undo()
    stand_ins.update()
    assert before.isdisjoint(thing.data.session_uid for thing in hands.stand_ins_of(rig))


def test_with_another_avatar_it_keeps_the_materials_that_the_artist_gave_it(extension):
    hand = add_hand()
    before, glove = only(hand).data, bpy.data.materials.new("glove")
    before.materials[0] = glove
    before.materials.append(None)
    hand.jghand.avatar = "strong"
    stand_ins.update()
    assert list(only(hand).data.materials) == [glove, None]
    np.testing.assert_allclose(only(hand).data[stand_ins.ALBEDO], stand_ins.skin_rgb(seen_hands.named("strong")))


@pytest.mark.parametrize(("rgba", "is_the_artists"), [((0.50, 0.33, 0.25, 1), False), ((0.50, 0.33, 0.26, 1), True)])
def test_the_one_color_of_an_older_file_becomes_the_avatars_and_an_artists_stays(extension, rgba, is_the_artists):
    hand = add_hand()
    tree = only(hand).data.materials[0].node_tree
    tree.nodes.remove(next(node for node in tree.nodes if node.bl_idname == "ShaderNodeAttribute"))
    base = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled").inputs["Base Color"]
    base.default_value = rgba
    only(hand).data[stand_ins.MADE_FROM] = "another making"
    for _ in range(2):
        stand_ins.update()
        assert base.is_linked != is_the_artists
    assert len([node for node in tree.nodes if node.bl_idname == "ShaderNodeAttribute"]) == (not is_the_artists)


def test_linking_a_collection_brings_the_stand_in_of_its_file(extension, tmp_path):
    hand = add_hand()
    asset = bpy.data.collections.new("asset")
    for thing in (hand, only(hand)):
        asset.objects.link(thing)
        bpy.context.scene.collection.objects.unlink(thing)
    path = str(tmp_path / "asset.blend")
    bpy.data.libraries.write(path, {asset})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.collections = ["asset"]
    bpy.context.scene.collection.children.link(bpy.data.collections["asset"])
    stand_ins.update()
    bpy.context.view_layer.update()
    assert only(bpy.data.objects["Right Hand"]).library is not None
    made = bpy.context.view_layer.objects["Right Hand"].override_hierarchy_create(
        bpy.context.scene, bpy.context.view_layer
    )
    stand_ins.update()
    assert made.library is None
    assert len([thing for thing in bpy.data.objects if stand_ins.MARK in thing and thing.parent == made]) == 1


def test_views_show_it_only_where_they_trace(extension):
    hand = add_hand()
    thing = only(hand)
    assert thing.hide_viewport
    stand_ins.show(traced=True)
    assert not thing.hide_viewport
    hand.hide_set(True)
    stand_ins.show(traced=True)
    assert thing.hide_viewport
    assert thing.hide_select
    assert not thing.visible_camera


def test_the_scene_of_the_hands_has_none(floor):
    bpy.ops.jghand.combine_with_scene()
    stand_ins.update()
    assert composite.out_of_date(floor) == []


def test_blenders_usd_export_leaves_it_out(extension, tmp_path):
    if not bpy.app.build_options.usd:
        pytest.skip("this Blender has no USD")
    add_hand()
    bpy.ops.wm.usd_export(filepath=str(tmp_path / "scene.usda"))
    written = (tmp_path / "scene.usda").read_text()
    assert "Right_Hand" in written
    assert "Shadow" not in written
    assert "Stand_In" not in written


def test_blenders_gltf_export_leaves_it_out(extension, tmp_path):
    import addon_utils  # pyright: ignore[reportMissingImports] - Blender's own, which is there once bpy is

    addon_utils.enable("io_scene_gltf2", default_set=True)
    extension.preferences.addons.new().module = "blender_addon"  # as an extension is known that is enabled
    thing = only(add_hand())
    bpy.ops.mesh.primitive_cube_add()
    thing.hide_viewport = False
    bpy.ops.export_scene.gltf(filepath=str(tmp_path / "scene.gltf"), export_format="GLTF_SEPARATE")
    written = json.loads((tmp_path / "scene.gltf").read_text())
    names = {node["name"] for node in written["nodes"]}
    assert {"Right Hand", "Cube"} < names
    assert thing.name not in names
    assert len(written["meshes"]) == 1
