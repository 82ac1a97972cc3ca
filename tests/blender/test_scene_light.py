"""Hands in the light of their scene: what F12 makes of lamps and worlds, and what a view asks for."""

import subprocess
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import bpy
import hands
import numpy as np
import pytest
from mathutils import Vector
from test_avatar_cards import write_avatar
from test_combine import f12
from test_limits import material
from test_render_blend import script
from test_render_engine import layers, linked_to

from blender_addon import clock
from blender_addon.core import posing
from blender_addon.core.view import LIGHT_FROM_WORLD, SceneLight
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, avatar_files
from blender_addon.render import camera, composite, exact_light, handover, lamps, probe, scene_light
from blender_addon.renderer.link import EngineLink
from blender_addon.viewport import handlers

pytestmark = pytest.mark.usefixtures("linked_extension")


@pytest.fixture(scope="module")
def real_engine(real_engine) -> Iterator[EngineLink]:
    with linked_to(real_engine):
        yield real_engine


@pytest.fixture
def told_of_edits() -> Iterator[None]:
    """As where Blender has a window."""
    edits = bpy.app.handlers.depsgraph_update_post
    edits.append(handlers.on_change)
    yield
    edits.remove(handlers.on_change)


@pytest.fixture
def scene(context) -> bpy.types.Scene:
    """A hand, a camera, and a lamp in a black world; nothing is known of light."""
    scene_light.forget()
    armature.build_armature(context, "right", posing.rest_joints_m("right"), "right")
    scene = context.scene
    scene.camera = hands.camera_on(context, (0, 0.09, 0), 0.5)
    camera.set_picture_size(scene.render, 96, 64)
    scene.render.engine, scene.render.film_transparent = "JGHAND", True
    scene.jghand.render_preset, scene.jghand.light = "draft", "SCENE"
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.data.energy, lamp.location = 2.0, (0.2, 0.2, 0.5)
    scene.collection.objects.link(lamp)
    return scene


def colors(scene: bpy.types.Scene, folder: Path) -> np.ndarray:
    """(H, W, 3) of F12, scene-linear."""
    passes = layers(scene, folder)
    return np.stack([passes[f"Combined.{name}"] for name in "RGB"], -1)


def even_world(rgb: tuple[float, float, float]) -> bpy.types.World:
    world = bpy.data.worlds.new("Even")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (*rgb, 1)
    return world


def test_twice_the_watts_are_twice_the_light(scene, real_engine, tmp_path):
    once = colors(scene, tmp_path)
    scene.objects["Lamp"].data.energy *= 2
    twice = colors(scene, tmp_path)
    assert once.max() > 0.05
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-4, atol=1e-6)


def test_lamp_and_world_light_the_hand_together(scene, real_engine, tmp_path):
    lamp = colors(scene, tmp_path)
    scene.world = even_world((0.1, 0.3, 0.2))
    both = colors(scene, tmp_path)
    scene.objects["Lamp"].hide_render = True
    world = colors(scene, tmp_path)
    assert world[..., 1].max() > 1.5 * world[..., 0].max()
    np.testing.assert_allclose(both, lamp + world, rtol=0.02, atol=1e-3)


def test_a_plane_through_the_wrist_leaves_the_skin_before_it_as_bright(scene, real_engine, tmp_path):
    camera.set_picture_size(scene.render, 240, 240)
    scene.view_layers[0].use_pass_z = True
    eye, at = scene.camera, Vector((0, 0.012, 0))
    eye.location = (0.2, 0.3, 0.35)
    eye.rotation_euler = (eye.location - at).to_track_quat("Z", "Y").to_euler()
    scene.objects["Lamp"].location = (0.4, 0.5, 0.7)
    bare = layers(scene, tmp_path)
    bpy.ops.mesh.primitive_plane_add(size=2.0, location=at, rotation=(-np.pi / 2, 0, 0))
    cut = layers(scene, tmp_path)
    projection = eye.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=240, y=240)
    across, depth = (2 * np.arange(240) + 1) / 240 - 1, bare["Depth.Z"]
    ahead = np.stack([depth * across / projection[0][0], -depth * across[:, None] / projection[1][1], -depth], -1)
    before_m = (ahead @ np.array(eye.matrix_world)[:3, :3].T)[..., 1] + eye.location.y - at.y
    red, red_cut = bare["Combined.R"], cut["Combined.R"]
    for nearest_m, farthest_m, least, most in (
        (0, 0.004, 0.95, 1.0),
        (0.004, 0.1, 0.995, 1.0),
        (-0.1, -0.01, 0.0, 0.05),
    ):
        there = (bare["Combined.A"] > 0.99) & (before_m > nearest_m) & (before_m < farthest_m)
        assert there.sum() > 30
        assert least <= red_cut[there].sum() / red[there].sum() <= most


def test_the_light_of_the_capture_knows_no_lamp(scene, real_engine, tmp_path):
    scene.jghand.light = "CAPTURE"
    before = colors(scene, tmp_path)
    scene.objects["Lamp"].data.energy = 5000.0
    np.testing.assert_array_equal(before, colors(scene, tmp_path))


def test_the_scene_of_the_hands_has_the_lamps_and_the_world(scene):
    scene.world = even_world((1, 1, 1))
    ours = composite.combine(scene, scene.view_layers[0])
    assert ours.world == scene.world
    assert ours.jghand.light == "SCENE"
    assert scene.objects["Lamp"].name in ours.collection.objects
    assert composite.out_of_date(scene) == []


def test_a_run_without_a_window_has_the_pixels_of_f12(scene, real_engine, engine_python, tmp_path):
    """Every bit of them, in the light of a lamp and a world."""
    scene.world, scene.camera.name = even_world((0.1, 0.3, 0.2)), "Eye"
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"
    scene.render.image_settings.color_depth, scene.render.filepath = "16", str(tmp_path / "f12.png")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "lit.blend"))
    bpy.ops.render.render(write_still=True)
    words = ("--out", tmp_path / "out", "--frames", "1", "--engine-python", engine_python)
    done = script("render_blend.py", tmp_path / "lit.blend", *words)
    assert done.returncode == 0, done.stderr
    f12, headless = (hands.pixels(tmp_path / name) for name in ("f12.png", "out/Eye/0001.png"))
    np.testing.assert_array_equal(headless, f12)
    assert f12[..., :3].max() > 0.1


@pytest.fixture
def avatars(tmp_path) -> dict[str, str]:
    """Files of one that learned in known light, of a film's, of one that learned in unknown light, of a painted one."""
    kinds = {"known": "known", "film": "estimated", "unknown": "learnt"}
    learnt = {name: {"light": {"kind": kind}} for name, kind in kinds.items()} | {"painted": None}
    return {
        kind: str(write_avatar(tmp_path / f"{kind}.jghand", name=kind, gaussians=3, learnt=about))
        for kind, about in learnt.items()
    }


def test_the_first_hand_is_lit_by_the_scene_if_it_learned_in_known_light(context, monkeypatch):
    for known in (True, False):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        card = replace(avatar_files.SHIPPED_CARDS["builtin"], light="known" if known else "learnt")
        monkeypatch.setitem(avatar_files.SHIPPED_CARDS, "builtin", card)
        bpy.ops.jghand.add_hand()
        assert scene_light.is_chosen(bpy.context.scene) == known


def test_a_loaded_avatar_decides_on_the_light_until_an_artist_has(context, avatars):
    bpy.ops.jghand.add_hand()
    settings = context.scene.jghand
    lights = ("known", "SCENE"), ("unknown", "CAPTURE"), ("film", "SCENE"), ("painted", "CAPTURE")
    for kind, light in lights:
        bpy.ops.jghand.load_avatar(filepath=avatars[kind])
        assert settings.light == light
    settings.light = "CAPTURE"
    bpy.ops.jghand.load_avatar(filepath=avatars["known"])
    assert settings.light == "CAPTURE"
    settings.light = "SCENE"
    bpy.ops.jghand.load_avatar(filepath=avatars["unknown"])
    assert settings.light == "SCENE"


def test_a_scene_with_hands_keeps_its_light_when_another_is_added_or_its_file_is_opened(context, avatars, tmp_path):
    armature.build_armature(context, "old", posing.rest_joints_m("right"), "right")
    bpy.context.scene.objects[0].jghand.avatar = avatars["known"]
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "old.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "old.blend"))
    assert not scene_light.is_chosen(bpy.context.scene)
    bpy.ops.jghand.add_hand()
    bpy.ops.jghand.load_avatar(filepath=avatars["known"])
    assert not scene_light.is_chosen(bpy.context.scene)


@pytest.mark.parametrize("is_linked", [False, True], ids=["appended", "linked"])
def test_a_hand_of_another_file_decides_as_one_that_is_added(context, avatars, tmp_path, is_linked):
    for kind in ("known", "unknown"):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        hand = armature.build_armature(bpy.context, kind, posing.rest_joints_m("right"), "right")
        hand.jghand.avatar = avatars[kind]
        inside = bpy.data.collections.new("inside")
        inside.objects.link(hand)
        bpy.data.libraries.write(str(tmp_path / f"{kind}.blend"), {inside})
    bring = bpy.ops.wm.link if is_linked else bpy.ops.wm.append

    def light_after(*kinds: str) -> str:
        for kind in kinds:
            bring(directory=f"{tmp_path / kind}.blend/Collection/", filename="inside")
        return bpy.context.scene.jghand.light

    for kinds, light in ((["known"], "SCENE"), (["unknown"], "CAPTURE"), (["known", "unknown"], "SCENE")):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        assert light_after(*kinds) == light
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.jghand.light = "CAPTURE"
    assert light_after("known") == "CAPTURE"


def view(shading: str, **more: bool) -> SimpleNamespace:
    chosen = {"use_scene_lights": True, "use_scene_lights_render": True, "use_scene_world": True, **more}
    return SimpleNamespace(
        shading=SimpleNamespace(type=shading, **chosen),
        local_view=None,
        as_pointer=lambda: 1,
        show_object_viewport_light=True,
        use_local_collections=False,
    )


def test_a_view_keeps_its_light_until_something_changes_it(scene, told_of_edits, monkeypatch):
    hand, lamp = scene.objects[0], scene.objects["Lamp"]
    reads, read = [], lamps.lamps_of
    # without the view, which only a window has
    monkeypatch.setattr(lamps, "lamps_of", lambda *args: (reads.append(args), read(*args[:2]))[1])

    def light(shading: str = "RENDERED") -> SceneLight | None:
        return scene_light.in_view(bpy.context.evaluated_depsgraph_get(), view(shading), [hand])

    lamps.forget()
    assert light("SOLID") is None
    assert reads == []
    first = light()
    assert first is not None
    assert light() is first
    hand.location.x = 0.1
    assert light() is first
    assert len(reads) == 1
    lamp.location.x += 0.1
    moved = light()
    assert moved is not None
    assert moved.lamps[0]["place_m"][0] == pytest.approx(first.lamps[0]["place_m"][0] + 0.1)
    assert light() is moved
    assert len(reads) == 2
    scene.world = even_world((0.1, 0.3, 0.2))
    around = light()
    assert around is not None
    assert around.world is not None
    assert light() is around


def test_material_preview_without_the_world_of_the_scene_lights_by_its_hdri(scene):
    """How it lies as seen in a window: a quarter turn brings what comes from +x to -y."""
    hdri = next(light for light in bpy.context.preferences.studio_lights if light.type == "WORLD")
    space = view("MATERIAL", use_scene_world=False, use_scene_lights=False, use_studiolight_view_rotation=True)
    space.shading.selected_studio_light = hdri
    space.shading.studiolight_rotate_z, space.shading.studiolight_intensity = 0.0, 1.0
    before = len(bpy.data.images)

    def light() -> SceneLight | None:
        return scene_light.in_view(bpy.context.evaluated_depsgraph_get(), space, [scene.objects[0]])

    def towards(blender: tuple[float, float, float]) -> np.ndarray:
        found = light()
        assert found is not None
        assert found.world is not None
        return np.array(found.world["env_from_world"]) @ LIGHT_FROM_WORLD[:3, :3] @ blender

    assert light() is None  # that of the capture, until the picture is read
    assert scene_light.tend()
    plain = light()
    assert plain is not None
    assert plain.picture is not None
    assert not plain.lamps
    np.testing.assert_allclose(towards((1, 0, 0)), (1, 0, 0), atol=1e-6)
    space.shading.studiolight_rotate_z, space.shading.studiolight_intensity = np.pi / 2, 2.0
    np.testing.assert_allclose(towards((0, -1, 0)), (1, 0, 0), atol=1e-6)
    twice = light()
    assert twice is not None
    np.testing.assert_allclose(twice.picture, 2 * plain.picture)
    space.shading.studiolight_rotate_z, space.shading.use_studiolight_view_rotation = 0.0, False
    space.region_3d = SimpleNamespace(view_matrix=np.eye(4))  # from above
    np.testing.assert_allclose(towards((0, 0, -1)), (0, 1, 0), atol=1e-6)
    np.testing.assert_allclose(towards((0, 1, 0)), (0, 0, 1), atol=1e-6)
    space.shading.selected_studio_light = SimpleNamespace(path="/no/such.exr")
    assert light() is None
    assert scene_light.tend()
    assert light() is None
    assert not scene_light.tend()
    assert len(bpy.data.images) == before


def untold(scene: bpy.types.Scene) -> bpy.types.NodeSocketColor:
    """A world whose nodes do not tell its light, which is the color of the socket that is returned."""
    scene.world = even_world((1, 1, 1))
    tree = scene.world.node_tree
    gamma = tree.nodes.new("ShaderNodeGamma")
    gamma.inputs["Color"].default_value = (0.5, 0.5, 0.5, 1)
    tree.links.new(gamma.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    return gamma.inputs["Color"]


def of_render(scene: bpy.types.Scene) -> SceneLight:
    light = scene_light.of_render(bpy.context.evaluated_depsgraph_get(), [scene.objects[0]])
    assert light is not None
    return light


@pytest.fixture
def measured(monkeypatch) -> list[str]:
    """The scenes whose worlds are measured, by name."""
    names: list[str] = []
    measure = probe.measure
    monkeypatch.setattr(probe, "measure", lambda scene, *more: names.append(scene.name) or measure(scene, *more))
    return names


def test_nodes_that_do_not_tell_their_light_are_measured_once_before_they_light_a_render(scene, measured):
    untold(scene)
    for _ in range(2):
        scene_light.measure(bpy.context.evaluated_depsgraph_get())
        assert of_render(scene).picture == pytest.approx(0.5, abs=0.02)
    assert measured == [scene.name]
    assert scene_light.warnings == ()


def test_a_keyed_world_that_is_measured_lights_each_frame_as_it_is_there(scene, real_engine, tmp_path, measured):
    color = untold(scene)
    scene.objects["Lamp"].hide_render = True
    for frame, gray in ((1, 0.2), (2, 0.4)):
        color.default_value = (gray, gray, gray, 1)
        color.keyframe_insert("default_value", frame=frame)
    scene.frame_set(1)
    scene.frame_start, scene.frame_end = 1, 2
    scene.render.image_settings.file_format, scene.render.filepath = "PNG", str(tmp_path / "picture")
    scene.view_settings.view_transform = "Raw"
    bpy.ops.render.render(animation=True)
    means = []
    for frame in (1, 2):
        image = bpy.data.images.load(str(tmp_path / f"picture{frame:04d}.png"))
        image.colorspace_settings.name = "Non-Color"
        means.append(np.reshape(image.pixels[:], (-1, 4))[:, :3].mean())
    assert means[1] == pytest.approx(2 * means[0], rel=0.05)
    assert len(measured) == 2


def test_a_render_in_a_window_has_its_world_measured_on_the_main_thread(scene, monkeypatch):
    """Its own thread waits meanwhile; what was made for that goes when no render goes on."""
    untold(scene)
    graph, found, is_rendering = bpy.context.evaluated_depsgraph_get(), [], True
    monkeypatch.setattr(clock, "runs", lambda: True)
    monkeypatch.setattr(handover, "is_blender_busy", lambda: is_rendering)
    before = len(bpy.data.scenes), len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.materials)
    waits = threading.Thread(target=lambda: found.append(scene_light.of_render(graph, [scene.objects[0]])))
    waits.start()
    while waits.is_alive():
        exact_light.tend()
        waits.join(0.01)
    assert found[0].picture == pytest.approx(0.5, abs=0.02)
    assert len(bpy.data.scenes) == 2
    is_rendering = False
    exact_light.tend()
    assert before == (len(bpy.data.scenes), len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.materials))


def test_a_window_renders_no_world_that_is_not_measured(scene, monkeypatch, tmp_path):
    untold(scene)
    scene.render.filepath = str(tmp_path / "picture.png")
    monkeypatch.setattr(scene_light, "measure", lambda _: None)
    with pytest.raises(RuntimeError, match="not measured at this frame"):
        bpy.ops.render.render(write_still=True)
    assert not (tmp_path / "picture.png").exists()
    assert "not measured" in " ".join(scene_light.warnings)


def test_a_world_that_shows_to_the_camera_alone_says_that_it_lights_no_hands(scene):
    def told() -> str:
        scene_light.of_render(bpy.context.evaluated_depsgraph_get(), [scene.objects[0]])
        return " ".join(scene_light.warnings)

    scene.world = even_world((1, 1, 1))
    tree = scene.world.node_tree
    shown, background = tree.nodes.new("ShaderNodeMixShader"), tree.nodes["Background"]
    tree.links.new(tree.nodes.new("ShaderNodeLightPath").outputs["Is Camera Ray"], shown.inputs[0])
    tree.links.new(background.outputs[0], shown.inputs[2])
    tree.links.new(shown.outputs[0], tree.nodes["World Output"].inputs["Surface"])
    assert "The world shows to the camera alone" in told()
    tree.links.new(background.outputs[0], shown.inputs[1])
    assert told() == ""
    scene.world.cycles_visibility.diffuse = False
    assert "The world shows to the camera alone" in told()
    scene.world.cycles_visibility.camera = False  # nobody sees it
    assert told() == ""


def test_a_world_without_its_image_fails_the_render(scene, tmp_path):
    scene.world = even_world((1, 1, 1))
    tree = scene.world.node_tree
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = bpy.data.images.new("gone", 4, 2)
    node.image.source, node.image.filepath = "FILE", str(tmp_path / "gone.hdr")
    tree.links.new(node.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    with pytest.raises(JGHandFailure, match="image of the world is missing"):
        of_render(scene)


def test_a_bake_that_fails_is_no_black_world_and_is_tried_again(scene, monkeypatch):
    untold(scene)
    with monkeypatch.context() as broken:
        broken.setattr(probe, "bpy", SimpleNamespace(**{**vars(bpy), "ops": SimpleNamespace(
            object=SimpleNamespace(bake=lambda **_: {"CANCELLED"}))}))  # fmt: skip
        scene_light.measure(bpy.context.evaluated_depsgraph_get())
        with pytest.raises(JGHandFailure) as failed:
            of_render(scene)
        assert failed.value.kind == "world_bake"

        def refuse(**_: str) -> None:
            raise RuntimeError("No valid selected objects")

        probe.bpy.ops.object.bake = refuse
        scene_light.measure(bpy.context.evaluated_depsgraph_get())
        with pytest.raises(JGHandFailure, match="No valid selected objects"):
            of_render(scene)
    scene_light.measure(bpy.context.evaluated_depsgraph_get())
    assert of_render(scene).picture == pytest.approx(0.5, abs=0.02)


def test_a_view_has_its_world_measured_once_cycles_is_there(scene, monkeypatch):
    import addon_utils  # Blender's own, which is there once bpy is

    untold(scene)
    monkeypatch.setattr(scene_light, "_REST_S", 0.0)
    scene.objects["Lamp"].hide_viewport = True  # a view of a test has no eyes for it
    light = partial(scene_light.in_view, space=view("RENDERED"), hands=[scene.objects[0]])
    addon_utils.disable("cycles")
    try:
        light(bpy.context.evaluated_depsgraph_get())
        assert scene_light.tend()
        light(bpy.context.evaluated_depsgraph_get())
        assert "Cycles, which is disabled" in " ".join(scene_light.warnings)
        assert not scene_light.tend()
    finally:
        addon_utils.enable("cycles")
    light(bpy.context.evaluated_depsgraph_get())
    assert scene_light.tend()
    assert light(bpy.context.evaluated_depsgraph_get()).picture == pytest.approx(0.5, abs=0.02)


def test_the_world_of_the_view_that_wants_it_is_measured_whatever_window_is_active(scene, monkeypatch, measured):
    monkeypatch.setattr(scene_light, "_REST_S", 0.0)
    other = bpy.data.scenes.new("Other")
    other.collection.objects.link(scene.objects[0])
    other.jghand.light = "SCENE"
    untold(other)
    layer = other.view_layers[0]
    layer.update()
    things, space = [scene.objects[0]], view("RENDERED")
    scene.objects["Lamp"].hide_viewport = True  # a view of a test has no eyes for it
    scene_light.in_view(layer.depsgraph, space, things)
    scene_light.in_view(bpy.context.evaluated_depsgraph_get(), space, things)
    assert scene_light.tend()
    assert measured == ["Other"]
    assert scene_light.in_view(layer.depsgraph, space, things).picture == pytest.approx(0.5, abs=0.02)
    assert not scene_light.tend()
    other.world.node_tree.nodes["Gamma"].inputs["Color"].default_value = (0.7, 0.7, 0.7, 1)
    layer.update()
    scene_light.in_view(layer.depsgraph, space, things)
    bpy.data.scenes.remove(other)
    assert not scene_light.tend()


def test_a_light_that_is_saved_renders_outside_blender(scene, engine_python, tmp_path):
    scene.world = even_world((0.1, 0.3, 0.2))
    assert bpy.ops.jghand.save_light(filepath=str(tmp_path / "light.json")) == {"FINISHED"}
    script = (
        "import sys; from pathlib import Path; from jghand_engine.export.light_file import read_light; "
        "light = read_light(Path(sys.argv[1])); print(len(light.lamps), light.world.terms.mean_irradiance.round(3))"
    )
    words = [engine_python, "-c", script, str(tmp_path / "light.json")]
    told = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert told == f"1 {np.round(np.pi * np.array([0.1, 0.3, 0.2]), 3)}\n"


# ---- view transforms -------------------------------------------------------------------------------------------------

# of two balls, one the engine's and one of Cycles: albedo, meters, and how far each is beside the middle
ALBEDO, RADIUS_M, BESIDE_M = 0.5, 0.04, 0.05
# a pixel for each millimeter; the engine's has the normals of a ball in the middles of its facets
BALLS_PX, PX_M, FACET_PX = (200, 100), 1e-3, 5
# seen from the camera's side; at a grazing angle the engine's rounded cosine is no Lambertian's
SUN = np.array([0.5, 0.3, 0.81])
LIT_COSINE, INNER = 0.1, 0.85


def ball_of_cycles(place: tuple[float, float, float]) -> bpy.types.Object:
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=6, radius=RADIUS_M, location=place)
    ball = bpy.context.object
    ball.data.shade_smooth()
    ball.data.materials.append(material("ShaderNodeBsdfDiffuse", Color=(ALBEDO, ALBEDO, ALBEDO, 1.0)))
    return ball


@pytest.fixture
def two_balls(context, engine_python, tmp_path) -> bpy.types.Scene:
    """A hand that is a gray ball, and a gray ball of Cycles beside it, combined and seen from straight above, in a warm
    sun without shadows that makes them brighter than white."""
    scene_light.forget()
    ball = tmp_path / "ball.jghand"
    words = map(str, (ball, ALBEDO, RADIUS_M, 0, BESIDE_M, 0))
    subprocess.run([engine_python, "-I", Path(__file__).with_name("write_ball_avatar.py"), *words], check=True)
    hand = armature.build_armature(context, "right", posing.rest_joints_m("right"), "right")
    hand.jghand.avatar, hand.jghand.cast_shadow = str(ball), False
    hand.location.x = -BESIDE_M
    ball_of_cycles((BESIDE_M, BESIDE_M, 0))
    scene = context.scene
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    eye.data.type, eye.data.ortho_scale, eye.location = "ORTHO", BALLS_PX[0] * PX_M, (0, BESIDE_M, 0.5)
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.color, sun.data.angle, sun.data.use_shadow = 8.0, (1.0, 0.7, 0.4), 0.0, False
    sun.matrix_world = Vector(SUN).to_track_quat("Z", "Y").to_matrix().to_4x4()
    for thing in (eye, sun):
        scene.collection.objects.link(thing)
    scene.camera, scene.render.engine = eye, "CYCLES"
    camera.set_picture_size(scene.render, *BALLS_PX)
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = 16, False, 0
    scene.render.dither_intensity = 0.0
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = str(tmp_path / "picture.png")
    scene.jghand.light = "SCENE"
    composite.combine(scene, scene.view_layers[0])
    return scene


def test_a_hand_beside_a_ball_of_cycles_has_its_color_under_each_view_transform(two_balls, real_engine):
    right, up, *_ = (side * (np.arange(FACET_PX // 2, 100, FACET_PX) + 0.5 - 50) * PX_M / RADIUS_M for side in (1, -1))
    x, y = np.meshgrid(right, up)
    height = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    seen = (x * x + y * y < INNER**2) & (np.stack([x, y, height], -1) @ SUN > LIT_COSINE * np.linalg.norm(SUN))
    assert seen.sum() > 100
    brightest = []
    for name in ("Standard", "Filmic", "AgX"):
        two_balls.view_settings.view_transform = name
        shown = 255 * f12()[FACET_PX // 2 :: FACET_PX, FACET_PX // 2 :: FACET_PX]
        hand, ball = shown[:, :20][seen], shown[:, 20:][seen]
        assert np.ptp(ball[:, 0]) > 80
        assert np.abs(hand - ball).max() <= 3
        brightest.append(ball.max(0))
    assert np.ptp(brightest, axis=0).max() > 20  # three different pictures
