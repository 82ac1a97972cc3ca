"""What a scene leaves of lamps at points of the skin: nothing behind a card, all beside it, a penumbra of its width."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from blender_addon.core import posing, stand_in
from blender_addon.core.view import LIGHT_FROM_WORLD, Moment, Pinhole, picture_request
from blender_addon.hand import sources
from blender_addon.render import composite, lamps, scene_light, scene_shadows

SUN = {"kind": "sun", "rgb": [1, 1, 1], "place_m": [0, 1, 0]}
POINT = {"kind": "point", "rgb": [1, 1, 1], "place_m": [0, 1, 0]}
AREA = {
    "kind": "area", "rgb": [1, 1, 1], "place_m": [0, 1, 0], "axis": [0, -1, 0], "side": [1, 0, 0], "size_m": [0.2, 0.2],
}  # fmt: skip


@pytest.fixture(autouse=True)
def fresh(context):
    """Nothing is known yet, and edits are told as by the handler of the extension."""

    def on_change(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        scene_shadows.notice(depsgraph)

    scene_shadows.forget()
    bpy.app.handlers.depsgraph_update_post.append(on_change)
    yield
    bpy.app.handlers.depsgraph_update_post.remove(on_change)


def card(size: float, *, up: float, aside: float = 0.0) -> bpy.types.Object:
    """A level square; Blender's z is up, and y in the axes of lamps."""
    bpy.ops.mesh.primitive_plane_add(size=size, location=(aside, 0, up))
    return bpy.context.object


def line(count: int = 800, length: float = 0.4) -> tuple[np.ndarray, np.ndarray]:
    """Points along x on the ground and the normals there, up."""
    points = np.zeros((count, 3))
    points[:, 0] = np.linspace(-length / 2, length / 2, count)
    return points, np.tile([0.0, 1.0, 0.0], (count, 1))


def left(points: np.ndarray, normals: np.ndarray, *records: dict) -> np.ndarray:
    """0..1."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return scene_shadows.left_of_lamps(points, normals, scene_shadows.beside(points), records, depsgraph) / 255


@pytest.mark.parametrize("lamp", [SUN, POINT, AREA], ids=["sun", "point", "area"])
def test_a_card_between_leaves_nothing_and_one_beside_all(context, lamp):
    points, normals = line(length=0.1)
    plane = card(0.6, up=0.5)
    assert left(points, normals, lamp).max() == 0
    plane.location.x = 0.8
    assert left(points, normals, lamp).min() == 1
    plane.location = (0, 0, -0.2)
    assert left(points, normals, lamp).min() == 1
    plane.location.z = 1.2
    assert left(points, normals, lamp).min() == (0 if lamp is SUN else 1)


def test_a_card_that_lies_on_the_skin_shades_it_and_the_skins_own_surface_does_not(context):
    points, normals = line(length=0.1)
    card(0.6, up=0.0)
    assert left(points, normals, SUN).min() == 1
    card(0.6, up=0.01)
    assert left(points, normals, SUN).max() == 0


def test_skin_that_faces_away_is_looked_at_as_well_and_lamps_without_shadow_cost_no_ray(context):
    """Skin that has no points of its own, as a forearm's, may read those of the other side, or of the wrist's cut."""
    points, normals = line(length=0.1)
    card(0.6, up=0.5)
    assert left(points, -normals, POINT).max() == 0
    assert left(points, normals, {**POINT, "has_shadow": False}).min() == 1


def _width(seen: np.ndarray, step: float) -> float:
    """Of the ramp from none to all: six times the integral of v (1 - v), v as mean over 20 neighbors."""
    mean = seen[: len(seen) // 20 * 20].reshape(-1, 20).mean(-1)
    return float(6 * (mean * (1 - mean)).sum() * 20 * step)


@pytest.mark.parametrize("up", [0.2, 0.5])
def test_the_penumbra_of_an_area_lamp_is_as_wide_as_it_should_be(context, up):
    """Of a straight edge: size of the lamp x edge to ground / lamp to edge."""
    card(2.0, up=up, aside=1.0)
    points, normals = line(length=0.8)
    points[:, 1] -= scene_shadows.LIFT_M  # rays begin above the skin
    wanted = AREA["size_m"][0] * up / (1 - up)
    assert _width(left(points, normals, AREA)[0], 0.001) == pytest.approx(wanted, rel=0.3)


@pytest.mark.parametrize("kind", ["sun", "point"])
def test_the_penumbra_of_a_round_lamp_is_as_wide_as_it_should_be(context, kind):
    """The visible part of a disk behind a straight edge; 6 x the integral of v (1 - v) is 0.865 of its width."""
    card(2.0, up=0.5, aside=1.0)
    points, normals = line(length=0.8)
    lamp = {**SUN, "angle_rad": 0.4} if kind == "sun" else {**POINT, "radius_m": 0.1}
    whole = 2 * 0.5 * np.tan(0.2) if kind == "sun" else 0.2
    x = np.linspace(-1, 1, 20_001)
    part = 0.5 + (x * np.sqrt(1 - x * x) + np.arcsin(x)) / np.pi
    wanted = 6 * (part * (1 - part)).mean() * whole
    assert _width(left(points, normals, lamp)[0], 0.001) == pytest.approx(wanted, rel=0.3)


def test_a_soft_shadow_has_no_blotches(context):
    """Skin 3.5 mm apart, wholly in the penumbra of a straight edge: each point is near what it should be."""
    card(2.0, up=0.5, aside=1.0)
    across, along = np.meshgrid(np.arange(-0.07, 0.07, 0.0035), np.arange(-0.07, 0.07, 0.0035))
    points = np.stack([across, np.full_like(across, -scene_shadows.LIFT_M), along], -1).reshape(-1, 3)
    seen = left(points, np.tile([0.0, 1.0, 0.0], (len(points), 1)), {**POINT, "radius_m": 0.1})[0]
    x = across.ravel() / 0.1
    wanted = 0.5 - (x * np.sqrt(1 - x * x) + np.arcsin(x)) / np.pi
    assert np.sqrt(((seen - wanted) ** 2).mean()) < 0.05


def upright_skin() -> tuple[np.ndarray, np.ndarray]:
    """Points of a wall along z, 3.5 mm apart, and their normals, towards +x."""
    up, along = np.meshgrid(np.arange(-0.07, 0.07, 0.0035), np.arange(-0.07, 0.07, 0.0035))
    points = np.stack([np.zeros_like(up), up, along], -1).reshape(-1, 3) + 1e-4
    return points, np.tile([1.0, 0.0, 0.0], (points.shape[0], 1))


SLANTED = {**SUN, "place_m": [1, 1, 0]}


@pytest.mark.parametrize("lamp", [SLANTED, {**SLANTED, "angle_rad": 0.05}, {**AREA, "place_m": [1, 1, 0]}])
def test_skin_that_comes_through_a_thing_is_lit_up_to_it(context, lamp):
    """The engine's skin is a mean of points around: those that the thing hides are as seen ones beside them."""
    points, normals = upright_skin()
    plane = card(0.6, up=0.0)
    for turned in (False, True):
        seen = left(points, normals, lamp)[0]
        assert seen[points[:, 1] > 0].min() == 1
        # a plane says by its normal from where it is looked at
        assert (seen[(points[:, 1] < 0) & (points[:, 1] > -0.0036)].min() == 1) == (not turned)
        assert seen[points[:, 1] < -0.012].max() == 0
        plane.rotation_euler.x = np.pi


def test_what_stands_on_skin_keeps_its_shadow_beside_it(context):
    """A ring's is as dark at the ring as elsewhere, though skin beyond it is lit."""
    across, along = np.meshgrid(np.arange(-0.03, 0.03, 0.0035), np.arange(-0.03, 0.03, 0.0035))
    points = np.stack([across, np.zeros_like(across), along], -1).reshape(-1, 3) + 1e-4
    bpy.ops.mesh.primitive_cube_add(size=0.008, scale=(0.5, 20, 2))  # 4 mm wide, across the skin, and 8 mm high
    seen = left(points, np.tile([0.0, 1.0, 0.0], (len(points), 1)), SLANTED)[0]
    x = points[:, 0]
    assert seen[(x < -0.0021) & (x > -0.007)].max() == 0
    assert seen[np.abs(x) < 0.0019].min() > 0
    assert seen[(x > 0.0021) | (x < -0.0085)].min() == 1


def test_instances_units_and_turned_things_throw_shadows_and_stand_ins_none(extension):
    points, normals = line(length=0.1)
    plane = card(0.6, up=0.0)
    plane.name = "card"
    collection = bpy.data.collections.new("cards")
    collection.objects.link(plane)
    bpy.context.scene.collection.objects.unlink(plane)
    instance = bpy.data.objects.new("instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", collection
    instance.matrix_world = Matrix.Translation((0, 0, 50)) @ Matrix.Rotation(3.0, 4, "Z") @ Matrix.Scale(100, 4)
    bpy.context.scene.collection.objects.link(instance)
    bpy.context.scene.unit_settings.scale_length = 0.01
    assert left(points, normals, POINT).max() == 0
    instance.location.z = 150
    assert left(points, normals, POINT).min() == 1
    bpy.data.objects.remove(instance)
    bpy.context.scene.unit_settings.scale_length = 1.0
    bpy.ops.jghand.add_hand()
    for thing in bpy.data.objects:
        thing.hide_viewport = False
    joints_m = posing.rest_joints_m("right") @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]] @ LIGHT_FROM_WORLD[:3, :3].T
    surface = stand_in.surface_at(joints_m, "right")
    assert left(surface.vertices, surface.normals, SUN).min() == 1


def test_a_thing_that_changes_is_looked_at_again(context):
    points, normals = line(length=0.1)
    plane = card(0.6, up=0.5)
    assert left(points, normals, POINT).max() == 0
    for vertex in plane.data.vertices:
        vertex.co.x += 2
    plane.data.update()
    assert left(points, normals, POINT).min() == 1
    plane.data.vertices.foreach_set("co", np.array([-1, -1, 0, 1, -1, 0, -1, 1, 0, 1, 1, 0], np.float32))
    plane.data.update()
    plane.visible_shadow = False
    assert left(points, normals, POINT).min() == 1


def counted(monkeypatch: pytest.MonkeyPatch, name: str) -> list[object]:
    """What a function of the module was called with, from now on."""
    calls, real = [], getattr(scene_shadows, name)
    monkeypatch.setattr(scene_shadows, name, lambda *args: (calls.append(args), real(*args))[1])
    return calls


def test_a_hand_that_moves_reads_no_thing_again_however_many_there_are(context, monkeypatch):
    points, normals = line(length=0.1)
    for number in range(70):
        card(0.01 + 0.001 * number, up=0.5)
    read, scenes = counted(monkeypatch, "_shape_of"), counted(monkeypatch, "_solids")
    for step in range(3):
        left(points + np.array([0.001 * step, 0, 0]), normals, POINT)
    assert (len(read), len(scenes)) == (70, 2)  # where they stand, and what they are
    bpy.context.object.location.x = 0.01
    left(points, normals, POINT)
    assert (len(read), len(scenes)) == (70, 3)
    bpy.context.object.data.vertices[0].co.x -= 0.01
    bpy.context.object.data.update()
    left(points, normals, POINT)
    assert len(read) == 71


def test_blenders_lamps_are_read_into_what_it_takes(context):
    """The shadow of a cube on points that a spot of Blender's lights."""
    spot = bpy.data.objects.new("spot", bpy.data.lights.new("spot", "SPOT"))
    spot.location = (0, 0, 1)
    bpy.context.scene.collection.objects.link(spot)
    bpy.ops.mesh.primitive_cube_add(size=0.1, location=(0, 0, 0.5))
    points, normals = line(length=0.8)
    found = lamps.lamps_of(bpy.context.evaluated_depsgraph_get(), [])
    seen = left(points, normals, *found.lamps)[0]
    assert seen[len(seen) // 2] == 0
    assert seen[0] == seen[-1] == 1


def lit_hand(context: bpy.types.Context) -> bpy.types.Object:
    """In the light of a scene with a sun above, level, with its palm up."""
    bpy.ops.jghand.add_hand()
    hand = context.object
    hand.rotation_euler.zero()
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    context.scene.collection.objects.link(sun)
    context.scene.jghand.light = "SCENE"
    return hand


def shaded(context: bpy.types.Context, hand: bpy.types.Object, view: str) -> tuple:
    """The light on a hand as a view has it, and its joints."""
    depsgraph = context.evaluated_depsgraph_get()
    seen = sources.read_hands(hand, depsgraph)
    return scene_light.shaded_in_view(scene_light.of_render(depsgraph, [hand]), seen, depsgraph, view), seen


def test_the_engine_is_told_where_a_card_shades_a_hand(extension):
    """Behind it all is dark that faces the sun; where nothing is, nothing is said."""
    hand = lit_hand(extension)
    light, _ = shaded(extension, hand, "before")
    assert light.left is None
    plane = card(0.2, up=0.2)  # above the half of the hand that is nearer than 0.1 m
    light, seen = shaded(extension, hand, "with a card")
    points, normals = stand_in.points_on(stand_in.surface_at(seen[0].joints_world_m, "right"))
    towards, left_of_it = normals[:, 2] > 0.3, light.left[0, 0]
    assert light.left.shape == (1, 1, stand_in.POINTS)
    assert left_of_it[towards & (points[:, 1] < 0.095)].max() == 0
    assert left_of_it[points[:, 1] > 0.105].min() == 255
    moment = Moment(Pinhole(16, 16, 20, 20, 8, 8, np.eye(4)), seen)
    header, arrays = picture_request([moment], preset="draft", outputs=["rgba_f32"], light=light)
    assert arrays["left"].shape == light.left.shape
    assert arrays["left_at"].shape == (stand_in.POINTS, 3)
    before = light.key
    plane.location.z = -0.2
    light, _ = shaded(extension, hand, "with a card below")
    assert light.left is None
    assert light.key != before
    assert header["light"] == light.record()


def test_things_shade_a_hand_as_the_shadow_linking_of_a_light_has_it(extension):
    """Without a word of it to the engine, which knows no things."""
    hand, plane = lit_hand(extension), card(0.2, up=0.2)
    lamp = next(thing for thing in extension.scene.objects if thing.type == "LIGHT")
    blockers = lamp.light_linking.blocker_collection = bpy.data.collections.new("blockers")

    def is_shaded() -> bool:
        scene_light.forget()  # a view keeps its shadows until it rests
        light, _ = shaded(extension, hand, "linked")
        assert "blockers" not in light.record()["lamps"][0]
        return light.left is not None

    assert is_shaded()
    blockers.objects.link(plane)
    how = blockers.collection_objects[0].light_linking
    how.link_state = "EXCLUDE"
    assert not is_shaded()
    blockers.objects.link(hand)  # without it nothing shades hands
    how.link_state = "INCLUDE"
    assert is_shaded()
    blockers.objects.unlink(plane)
    assert not is_shaded()


def test_a_hand_that_is_posed_keeps_its_shadows_until_it_rests(extension, monkeypatch):
    hand, looks = lit_hand(extension), counted(monkeypatch, "left_of_lamps")
    card(0.2, up=0.2)
    now_s = 100.0
    monkeypatch.setattr(scene_light, "time", SimpleNamespace(monotonic=lambda: now_s))
    first, _ = shaded(extension, hand, "view")
    assert len(looks) == 1
    for _ in range(4):
        hand.location.x += 0.01
        now_s += 0.1
        assert not scene_light.tend()
        light, _ = shaded(extension, hand, "view")
        np.testing.assert_array_equal(light.left, first.left)
    assert len(looks) == 1
    now_s += 0.2
    assert scene_light.tend()
    assert not scene_light.tend()  # a view that is gone is not drawn again and again
    light, _ = shaded(extension, hand, "view")
    assert len(looks) == 2
    assert (light.left != first.left).any()
    assert shaded(extension, hand, "view")[0] is light
    sun = bpy.data.objects["sun"]
    extension.scene.collection.objects.link(bpy.data.objects.new("second sun", sun.data))
    assert len(shaded(extension, hand, "view")[0].left[0]) == 2  # at once: those of one lamp do not fit two


def test_points_on_a_hand_are_even_and_those_of_the_template(extension):
    surface = stand_in.surface_at(posing.rest_joints_m("right"), "right")
    points, normals = stand_in.points_on(surface)
    np.testing.assert_allclose(points, stand_in.points_m(), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-9)
    apart = np.sort(np.linalg.norm(points[::10, None] - points[None], axis=-1), axis=-1)
    assert 0.0015 < np.median(apart[:, 1]) < 0.004
    assert apart[:, 6].max() < 0.012


def test_what_may_shade_hands_is_in_the_scene_that_draws_them(extension):
    lit_hand(extension)
    wall = card(0.5, up=1.0)
    scene = extension.scene
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(eye)
    scene.camera, scene.render.engine = eye, "CYCLES"
    bpy.ops.jghand.combine_with_scene()
    there = composite.hands_scene_of(scene).collection.objects
    assert wall.name in there
    assert not [thing for thing in there if "jghand_stand_in" in thing]
    assert composite.out_of_date(scene) == []
    for _ in range(2):
        card(0.5, up=2.0)
    assert composite.out_of_date(scene) == ["2 things that may light or shade hands are missing"]
    bpy.ops.jghand.combine_with_scene()
    wall.visible_shadow = False
    bpy.ops.jghand.combine_with_scene()
    assert wall.name not in there
    scene.jghand.use_exact_light = True
    bpy.ops.jghand.combine_with_scene()
    assert wall.name in there  # it throws light back
    scene.jghand.light = "CAPTURE"
    bpy.ops.jghand.combine_with_scene()
    assert wall.name not in there
