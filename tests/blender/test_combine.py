"""Hands in pictures of Cycles: in front of things, behind them, and away again without a trace."""

import bpy
import hands
import numpy as np
import pytest

from blender_addon import versions
from blender_addon.core import posing
from blender_addon.core.view import Moment, over, picture_request, scene_linear
from blender_addon.hand import armature
from blender_addon.render import camera, composite, lamps
from blender_addon.renderer import runtime
from blender_addon.renderer.link import EngineLink
from blender_addon.renderer.process import engine_command

SIZE = (216, 144)  # the stand-in's discs are several pixels wide


pytestmark = pytest.mark.usefixtures("linked_extension")


@pytest.fixture
def scene(context, tmp_path) -> bpy.types.Scene:
    """A hand above a wall that glows gray and fills the picture; the camera looks down on both. Cycles, one sample."""
    armature.build_armature(context, "right", posing.rest_joints_m("right"), "right")
    bpy.ops.mesh.primitive_plane_add(size=4.0, location=(0, 0, -0.1))
    wall = context.object
    wall.name = "wall"
    material = bpy.data.materials.new("glow")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    glow, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    glow.inputs["Color"].default_value = (0.2, 0.2, 0.2, 1.0)
    tree.links.new(glow.outputs[0], output.inputs[0])
    wall.data.materials.append(material)
    eye = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    eye.location = (0, 0.08, 0.5)
    scene = context.scene
    scene.collection.objects.link(eye)
    scene.camera = eye
    camera.set_picture_size(scene.render, *SIZE)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 1, False
    scene.view_settings.view_transform, scene.render.dither_intensity = "Standard", 0.0
    scene.render.filepath = str(tmp_path / "picture.png")
    return scene


def f12() -> np.ndarray:
    """(H, W, 3) of the current frame, top row first."""
    scene = bpy.context.scene
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"
    bpy.ops.render.render(write_still=True)
    return hands.pixels(scene.render.filepath)[..., :3]


def covered(picture: np.ndarray) -> int:
    """Pixels that the stand-in's white discs cover."""
    return int((picture > 0.99).all(-1).sum())


GRAY = 0.4845  # 0.2 in linear light


def test_the_nearer_of_hand_and_wall_is_seen(scene):
    assert bpy.ops.jghand.combine_with_scene() == {"FINISHED"}
    in_front = f12()
    assert covered(in_front) > 20
    rest = in_front[~(in_front > 0.99).all(-1)]
    np.testing.assert_allclose(rest, GRAY, atol=0.01)
    bpy.data.objects["wall"].location.z = 0.1  # now between hand and camera
    behind = f12()
    assert covered(behind) == 0
    np.testing.assert_allclose(behind, GRAY, atol=0.01)


def test_the_hands_follow_frame_and_pose_of_the_scene(scene):
    hand = bpy.data.objects["right"]
    for frame, x in ((1, 0.0), (2, 0.05)):
        hand.location.x = x
        hand.keyframe_insert("location", frame=frame)
    bpy.ops.jghand.combine_with_scene()
    places = []
    for frame in (1, 2):
        scene.frame_set(frame)
        places.append(hands.centroid((f12() > 0.99).all(-1)))
    # 0.05 m at half a meter, of a picture 0.36 m wide there; the hand itself is nearer
    assert 0.9 < (places[1][0] - places[0][0]) / (0.05 / 0.36 * SIZE[0]) < 1.2
    assert places[1][1] == pytest.approx(places[0][1], abs=0.5)


def test_soft_edges_are_mixed_with_what_is_behind_them(scene, engine_python):
    """A real hand's edges over a gray wall: the engine's own picture laid on it in linear light."""
    before = runtime.link()
    runtime._link = EngineLink(lambda: engine_command(engine_python))
    try:
        scene.jghand.render_preset = "viewport"
        bpy.ops.jghand.combine_with_scene()
        came = f12()
        depsgraph = bpy.context.evaluated_depsgraph_get()
        view = camera.pinhole(scene.camera, depsgraph)
        hand = armature.read_hand(bpy.data.objects["right"], depsgraph)
        reply = runtime.link().request(
            *picture_request([Moment(view, [hand])], preset="viewport", outputs=["rgba_f32", "depth"])
        )
    finally:
        runtime._link.close()
        runtime._link = before
    rgba, depth = (np.asarray(reply.arrays[name].view()) for name in ("rgba_f32", "depth"))
    linear = over(scene_linear(rgba), (0.2, 0.2, 0.2))[..., :3]
    wanted = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)
    seen = depth > 0  # what covers a pixel less than that has no depth to be combined by
    soft = seen & (rgba[..., 3] > 0.1) & (rgba[..., 3] < 0.9)
    assert soft.sum() > 100
    # one 8-bit step of rounding
    assert np.abs(came[seen] - np.minimum(wanted[seen], 1.0)).max() < 1.5 / 255  # a file has no highlight above white


def test_size_and_region_are_those_of_the_scene(scene):
    bpy.ops.jghand.combine_with_scene()
    whole = f12()
    camera.set_picture_size(scene.render, 2 * SIZE[0], 2 * SIZE[1])
    assert covered(f12()) == pytest.approx(4 * covered(whole), rel=0.1)
    camera.set_picture_size(scene.render, *SIZE)
    render = scene.render
    render.use_border, render.use_crop_to_border = True, True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.75, 0.25, 0.75
    bpy.ops.jghand.combine_with_scene()
    part = camera.region(render)
    np.testing.assert_allclose(f12(), whole[part.top : part.bottom, part.left : part.right], atol=0.01)


def is_magenta(picture: np.ndarray) -> bool:
    return bool((picture == (1.0, 0.0, 1.0)).all())


def test_a_picture_whose_hand_failed_is_magenta_and_says_why(scene, capfd):
    bpy.ops.jghand.combine_with_scene()
    hand = bpy.data.objects["right"]
    hand.scale.x = 0
    assert is_magenta(f12())
    assert runtime.render_note.failure.kind == "zero_scale"
    told = capfd.readouterr()
    assert "JGHand: The hands of frame 1 failed and are magenta: A scale of zero is not supported" in told.err
    assert "ERROR A scale of zero is not supported" in told.out
    hand.scale.x = 1
    assert covered(f12()) > 20
    assert runtime.render_note.failure is None


def fails_from(hand: bpy.types.Object, frame: int) -> None:
    """Its scale is zero from a frame on."""
    for at, x in ((1, 1.0), (frame, 0.0)):
        hand.scale.x = x
        hand.keyframe_insert("scale", frame=at)
    for curve in versions.fcurves(hand):
        for key in curve.keyframe_points:
            key.interpolation = "CONSTANT"


def test_an_animation_goes_on_with_magenta_frames_and_says_so_once(scene, tmp_path, capfd):
    bpy.ops.jghand.combine_with_scene()
    fails_from(bpy.data.objects["right"], 2)
    scene.render.filepath, scene.frame_end = str(tmp_path / "frame_"), 3
    bpy.ops.render.render(animation=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"frame_{frame:04d}.png" for frame in (1, 2, 3)]
    assert [is_magenta(hands.pixels(tmp_path / f"frame_{k:04d}.png")[..., :3]) for k in (1, 2, 3)] == [
        False,
        True,
        True,
    ]
    assert capfd.readouterr().err.count("failed and are magenta") == 1
    assert runtime.render_note.failure.kind == "zero_scale"


def test_a_second_time_brings_it_up_to_date_and_makes_nothing_twice(scene):
    bpy.ops.jghand.combine_with_scene()
    ours = composite.hands_scene_of(scene)
    nodes = len(versions.compositor_tree(scene).nodes)
    armature.build_armature(bpy.context, "left", posing.rest_joints_m("left"), "left")
    bpy.data.objects.remove(bpy.data.objects["right"])
    scene.frame_end = 77
    bpy.ops.jghand.combine_with_scene()
    assert composite.hands_scene_of(scene) == ours
    assert {thing.name for thing in ours.collection.objects} == {"left", "Camera"}
    assert ours.frame_end == 77
    assert len(versions.compositor_tree(scene).nodes) == nodes
    assert len(bpy.data.scenes) == 2


def test_removing_leaves_nothing(scene):
    wanted = f12()
    before = {name: len(getattr(bpy.data, name)) for name in ("scenes", "node_groups", "objects", "cameras")}
    bpy.ops.jghand.combine_with_scene()
    assert scene.render.use_lock_interface
    assert bpy.ops.jghand.remove_combination() == {"FINISHED"}
    assert not scene.render.use_lock_interface
    assert {name: len(getattr(bpy.data, name)) for name in before} == before
    assert versions.compositor_tree(scene) is None
    assert not scene.view_layers[0].use_pass_z
    assert composite.HAD_DEPTH not in scene.view_layers[0]
    assert not [name for name in scene.keys() if name.startswith("jghand_")]  # noqa: SIM118 - no dictionary
    np.testing.assert_array_equal(f12(), wanted)


@pytest.mark.parametrize("changed", [False, True])
def test_removing_gives_jghand_back_where_the_scene_still_has_what_it_was_given(scene, changed):
    bpy.ops.jghand.use_engine()
    bpy.ops.jghand.combine_with_scene()
    assert "EEVEE" in scene.render.engine
    if changed:
        scene.render.engine = "CYCLES"
    bpy.ops.jghand.remove_combination()
    assert scene.render.engine == ("CYCLES" if changed else "JGHAND")
    assert not [name for name in scene.keys() if name.startswith("jghand_")]  # noqa: SIM118 - no dictionary


def own_nodes(scene: bpy.types.Scene) -> bpy.types.Node:
    """A compositor of the user's, which makes the picture half as bright; returns its node."""
    tree = versions.ensure_compositor_tree(scene)
    output = versions.compositor_output(tree)
    picture = tree.nodes.new("CompositorNodeRLayers")
    dim = tree.nodes.new("CompositorNodeExposure")
    dim.inputs[1].default_value = -1.0
    tree.links.new(picture.outputs["Image"], dim.inputs[0])
    tree.links.new(dim.outputs[0], output.inputs[0])
    return dim


def test_a_scene_that_did_not_composite_does_not_afterwards(scene):
    """Its nodes were switched off: they have no part in the combined picture, and are there again after it."""
    dim = own_nodes(scene)
    scene.render.use_compositing = False
    wanted = f12()
    trees = len(bpy.data.node_groups)
    for _ in range(2):  # bringing it up to date forgets nothing
        bpy.ops.jghand.combine_with_scene()
    assert scene.render.use_compositing
    picture = f12()
    assert (picture != wanted).any()  # the hand
    if versions.compositor_tree(scene) != dim.id_data:  # in 4.5 a scene has one tree
        wall = (picture[..., :3] != picture[0, 0, :3]).all(-1) == 0
        np.testing.assert_allclose(picture[wall], wanted[wall], atol=0.6 / 255)
    bpy.ops.jghand.remove_combination()
    assert not scene.render.use_compositing
    if hasattr(scene, "compositing_node_group"):
        assert scene.compositing_node_group == dim.id_data
    assert len(bpy.data.node_groups) == trees
    assert not [name for name in scene.keys() if name.startswith("jghand_")]  # noqa: SIM118 - no dictionary
    np.testing.assert_array_equal(f12(), wanted)


def test_nodes_of_the_user_stay_and_work_before_ours(scene):
    dim = own_nodes(scene)
    tree = versions.compositor_tree(scene)
    alone = f12()
    before = {(link.from_socket, link.to_socket) for link in tree.links}
    count = len(tree.nodes)
    bpy.ops.jghand.combine_with_scene()
    combined = f12()
    assert covered(combined) > 20  # the hand is not dimmed
    rest = ~(combined > 0.99).all(-1)
    np.testing.assert_allclose(combined[rest], alone[rest], atol=0.01)
    bpy.ops.jghand.remove_combination()
    assert versions.compositor_tree(scene) == tree
    assert len(tree.nodes) == count
    assert {(link.from_socket, link.to_socket) for link in tree.links} == before
    assert dim.name in tree.nodes
    np.testing.assert_array_equal(f12(), alone)


def test_nodes_that_the_user_adds_to_our_compositor_stay_when_it_is_removed(scene):
    bpy.ops.jghand.combine_with_scene()
    tree = versions.compositor_tree(scene)
    dim = tree.nodes.new("CompositorNodeExposure")
    bpy.ops.jghand.remove_combination()
    assert versions.compositor_tree(scene) == tree
    assert dim.name in tree.nodes
    assert not composite._nodes(tree)


def test_a_copy_of_the_scene_does_not_touch_the_combination_of_the_first(scene):
    bpy.ops.jghand.combine_with_scene()
    ours = composite.hands_scene_of(scene)
    for way in ("LINK_COPY", "FULL_COPY"):
        for combined in (False, True):
            bpy.context.window.scene = scene
            bpy.ops.scene.new(type=way)
            copy = bpy.context.window.scene
            assert copy != scene
            call = bpy.ops.jghand.combine_with_scene if combined else bpy.ops.jghand.remove_combination
            assert call() == {"FINISHED"}
            assert composite.hands_scene_of(scene) == ours
            tree = versions.compositor_tree(scene)
            assert {node.scene for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers"} == {scene, ours}
            made = composite.hands_scene_of(copy)
            assert (made is not None) == combined
            if combined:
                assert made != ours
                nodes = versions.compositor_tree(copy).nodes
                shown = {node.scene for node in nodes if node.bl_idname == "CompositorNodeRLayers"}
                assert shown == {copy, made}
                assert bpy.ops.jghand.remove_combination() == {"FINISHED"}
            assert not copy.view_layers[0].use_pass_z
            assert not composite.has_combination(copy)
            bpy.data.scenes.remove(copy)
    bpy.context.window.scene = scene
    assert covered(f12()) > 20


def test_another_view_layer_takes_the_place_of_the_first_which_is_as_it_was(scene):
    bpy.ops.jghand.combine_with_scene()
    first = scene.view_layers[0]
    second = scene.view_layers.new("Second")
    second.use_pass_z = False
    count = len(versions.compositor_tree(scene).nodes)
    bpy.context.window.view_layer = second
    bpy.ops.jghand.combine_with_scene()
    assert (first.use_pass_z, second.use_pass_z) == (False, True)
    tree = versions.compositor_tree(scene)
    # 4.5 makes a node for the first layer itself, which was used and stays; the second one has none
    assert len(tree.nodes) - count in ((0,) if hasattr(scene, "compositing_node_group") else (1,))
    assert "Second" in {node.layer for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers"}
    bpy.context.window.view_layer = first
    bpy.ops.jghand.remove_combination()
    assert (first.use_pass_z, second.use_pass_z) == (False, False)


def test_a_picture_says_in_what_its_hands_are_not_up_to_date(scene, capfd):
    bpy.ops.jghand.combine_with_scene()
    camera.set_picture_size(scene.render, SIZE[0] // 2, SIZE[1] // 2)  # follows by itself
    scene.frame_end += 10
    f12()
    assert composite.out_of_date(scene) == []
    assert "not up to date" not in capfd.readouterr().err
    armature.build_armature(bpy.context, "late", posing.rest_joints_m("left"), "left")
    scene.render.fps = 50
    f12()
    said = capfd.readouterr().err
    assert "late is missing, FPS differs" in said
    f12()
    assert "not up to date" not in capfd.readouterr().err  # once
    bpy.data.objects["right"].hide_render = True
    assert "1 objects are no longer needed" in composite.out_of_date(scene)
    bpy.ops.jghand.combine_with_scene()
    assert composite.out_of_date(scene) == []


def test_the_lamps_and_the_world_of_the_scene_light_its_hands_as_its_engine_takes_them(scene):
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.diffuse_factor = 0.5
    inside, placed = bpy.data.collections.new("inside"), bpy.data.objects.new("placed", None)
    inside.objects.link(bpy.data.objects.new("point", bpy.data.lights.new("point", "POINT")))
    placed.instance_type, placed.instance_collection = "COLLECTION", inside
    for thing in (sun, placed):
        scene.collection.objects.link(thing)
    scene.world = bpy.data.worlds.new("world")
    bpy.ops.jghand.combine_with_scene()
    ours = composite.hands_scene_of(scene)
    assert ours.world == scene.world
    found = {}
    for engine in ("CYCLES", "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"):
        scene.render.engine = engine
        for each in (scene, ours):
            each.view_layers[0].update()
            found[engine, each.name] = sorted(map(str, lamps.lamps_of(each.view_layers[0].depsgraph, []).lamps))
        assert found[engine, scene.name] == found[engine, ours.name]
    assert [len(each) for each in found.values()] == [2, 2, 3, 3]
    placed.hide_render = True
    assert composite.out_of_date(scene) == ["1 objects are no longer needed"]


def test_a_linked_hand_of_the_same_name_is_combined_too(scene, tmp_path):
    path = str(tmp_path / "hand.blend")
    right = bpy.data.objects["right"]
    bpy.data.libraries.write(path, {right})
    with bpy.data.libraries.load(path, link=True) as (_there, taken):
        taken.objects = ["right"]
    scene.collection.objects.link(taken.objects[0])
    assert taken.objects[0].name == right.name
    bpy.ops.jghand.combine_with_scene()
    ours = composite.hands_scene_of(scene)
    assert set(ours.collection.objects) == {right, taken.objects[0], scene.camera}
    assert composite.out_of_date(scene) == []


def test_undo_takes_it_back(scene):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.jghand.combine_with_scene()
    bpy.ops.ed.undo_push(message="combined")
    assert len(bpy.data.scenes) == 2
    bpy.ops.ed.undo()
    assert len(bpy.data.scenes) == 1
    assert composite.hands_scene_of(bpy.context.scene) is None
    assert versions.compositor_tree(bpy.context.scene) is None


def test_a_scene_of_jghands_is_given_back_to_eevee(scene):
    scene.render.engine = "JGHAND"
    bpy.ops.jghand.combine_with_scene()
    assert scene.render.engine.startswith("BLENDER_EEVEE")
    ours = composite.hands_scene_of(scene)
    assert ours is not None
    assert ours.render.engine == "JGHAND"


def test_what_is_missing_is_said(scene):
    with pytest.raises(RuntimeError, match="not combined"):
        bpy.ops.jghand.remove_combination()
    scene.camera = None
    with pytest.raises(RuntimeError, match="no camera"):
        bpy.ops.jghand.combine_with_scene()
    bpy.data.objects.remove(bpy.data.objects["right"])
    scene.camera = bpy.data.objects["Camera"]
    with pytest.raises(RuntimeError, match="no hand"):
        bpy.ops.jghand.combine_with_scene()


def test_timeline_markers_choose_the_camera_of_the_hands_too(scene):
    other = bpy.data.objects.new("Other", bpy.data.cameras.new("Other"))
    other.location = (0.08, 0.08, 0.5)
    scene.collection.objects.link(other)
    for frame, eye in ((1, bpy.data.objects["Camera"]), (2, other)):
        scene.timeline_markers.new(eye.name, frame=frame).camera = eye
    bpy.ops.jghand.combine_with_scene()
    places = []
    for frame in (1, 2):
        scene.frame_set(frame)
        places.append(hands.centroid((f12() > 0.99).all(-1)))
    assert places[1][0] < places[0][0] - 5


def test_hands_are_blurred_with_the_shutter_of_the_scene(scene):
    hand = bpy.data.objects["right"]
    for frame, x in ((0, -0.1), (2, 0.1)):
        hand.location.x = x
        hand.keyframe_insert("location", frame=frame)
    for curve in versions.fcurves(hand):
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.5
    points = scene.render.motion_blur_shutter_curve.curves[0].points
    points.new(0.4, 0.7)
    points[0].location = (0.0, 0.2)
    scene.render.motion_blur_shutter_curve.update()
    bpy.ops.jghand.combine_with_scene()
    shutter = composite.hands_scene_of(scene).render.motion_blur_shutter_curve
    assert [tuple(point.location) for point in shutter.curves[0].points] == [tuple(point.location) for point in points]
    scene.frame_set(1)
    blurred = f12()
    scene.render.use_motion_blur = False
    bpy.ops.jghand.combine_with_scene()
    sharp = f12()
    changed = [(picture - GRAY > 0.02).all(-1).sum() for picture in (blurred, sharp)]
    assert changed[0] > 2 * changed[1]
    assert covered(blurred) < 0.5 * covered(sharp)
    assert blurred.min() > GRAY - 0.01  # no dark rims
