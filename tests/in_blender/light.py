# SPDX-License-Identifier: GPL-3.0-or-later
"""The hand in the light of the scene: lamps that are dragged, the world, and the shadow that falls on things."""

import importlib

import bpy
import numpy as np

from in_blender.pictures import skin

# a screen's step that nobody takes for noise
STEP = 8


def step_a_hand_in_the_default_scene_is_lit_by_it(window):
    for thing in list(bpy.context.scene.objects):
        if thing.type == "MESH":
            bpy.data.objects.remove(thing)
    bpy.ops.jghand.add_hand()
    scene = bpy.context.scene
    scene.jghand.light, scene.render.engine = "SCENE", "JGHAND"
    assert scene.view_settings.view_transform == "AgX"
    lamp = _lamp()
    lamp.location, lamp.data.energy, lamp.data.shadow_soft_size = (0.6, -0.5, 0.3), 6.0, 0.05
    window.space().overlay.show_overlays = False
    window.space().region_3d.view_perspective = "PERSP"
    yield from window.look_at((0.0, 0.0, 0.09), 0.5, (1.5, 0.0, 0.0))
    yield from window.shading("RENDERED")
    yield lambda: _is_sharp(window)
    window.picture("lamp_before_it")


def step_the_light_follows_a_lamp_that_is_dragged(window):
    before = _colors(window).mean()
    yield from _drag_lamp(window, 0.5)
    behind = _colors(window).mean()
    window.picture("lamp_behind_it")
    assert behind < before - 2 * STEP
    yield from _drag_lamp(window, -0.5)
    assert abs(_colors(window).mean() - before) < 2


def step_a_red_lamp_makes_it_red(window):
    before = _colors(window).mean(0)
    _lamp().data.color = (1.0, 0.02, 0.02)
    window.redraw()
    yield lambda: _is_sharp(window)
    after = _colors(window).mean(0)
    window.picture("red_lamp")
    assert after[0] / after[1] > 1.3 * before[0] / before[1]
    _lamp().data.color = (1.0, 1.0, 1.0)
    window.redraw()
    yield 0.5
    yield lambda: _is_sharp(window)


def step_undo_and_redo_take_the_light_along(window):
    with window.override():
        bpy.ops.ed.undo_push(message="before")
    before = _colors(window).mean()
    _lamp().data.energy = 24.0
    with window.override():
        bpy.ops.ed.undo_push(message="a brighter lamp")
    window.redraw()
    yield lambda: _is_sharp(window)
    after = _colors(window).mean()
    assert after > before + 2 * STEP
    for key, wanted in (("ctrl+z", before), ("ctrl+shift+z", after), ("ctrl+z", before)):
        yield from window.point_at_view()
        yield from window.key(key)
        yield 0.5
        yield lambda: _is_sharp(window)
        assert abs(_colors(window).mean() - wanted) < 2, key


def step_a_cube_between_lamp_and_hand_shades_it(window):
    before = _colors(window).mean()
    bpy.ops.mesh.primitive_cube_add(size=0.15, location=tuple(np.array((0.0, 0.0, 0.09)) / 2 + _lamp().location / 2))
    cube = bpy.context.object
    yield 0.5  # shadows are looked for after a rest
    yield lambda: _is_sharp(window)
    window.picture("cube_before_lamp")
    assert _colors(window).mean() < before - 2 * STEP
    bpy.data.objects.remove(cube)
    yield 0.5
    yield lambda: _is_sharp(window)
    assert abs(_colors(window).mean() - before) < 2


def step_the_world_lights_it(window):
    world = bpy.context.scene.world
    _lamp().hide_set(True)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 4.0
    window.redraw()
    yield lambda: _is_sharp(window)
    bright = _colors(window).mean()
    window.picture("bright_world")
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5
    window.redraw()
    yield lambda: _is_sharp(window)
    assert _colors(window).mean() < bright - STEP
    _lamp().hide_set(False)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1.0
    yield 0.5


def step_in_material_preview_it_stands_in_the_scenes_light_and_throws_its_shadow(window):
    bpy.context.scene.render.engine = "BLENDER_EEVEE"
    # below the forearm
    bpy.ops.mesh.primitive_plane_add(size=2.0, location=(0.0, 0.0, -0.15))
    _lamp().location = (-0.4, -0.4, 0.5)
    shading = window.space().shading
    yield from window.look_at((0.1, 0.1, 0.0), 0.8, (1.0, 0.0, 0.2))
    empty = window.crop(window.screen())[-40:].astype(int)
    yield from window.shading("MATERIAL")
    shading.use_scene_lights = shading.use_scene_world = True
    window.redraw()
    yield lambda: _is_sharp(window)
    yield lambda: np.abs(window.crop(window.screen())[-40:] - empty).mean() > STEP  # EEVEE has its shaders
    yield 3.0  # and gathers its samples
    with_shadow = window.picture("material_preview").astype(int)
    red, _, blue = np.moveaxis(window.crop(with_shadow), -1, 0)
    assert (red > 1.25 * blue).sum() > 5000  # the hand, without overlays: EEVEE leaves no depth then
    hand = next(thing for thing in bpy.context.scene.objects if "jghand_handedness" in thing)
    hand.jghand.cast_shadow = False
    window.redraw()
    yield lambda: _is_sharp(window)
    yield 3.0
    without = window.crop(window.picture("without_shadow").astype(int))
    darker = without.mean(-1) - window.crop(with_shadow).mean(-1)
    assert (darker > STEP).sum() > 2000


def step_rendered_by_eevee_a_view_has_its_shadow_and_not_the_hand(window):
    hand = next(thing for thing in bpy.context.scene.objects if "jghand_handedness" in thing)
    yield from window.shading("RENDERED")
    yield 3.0
    without = window.crop(window.picture("eevee_without_shadow").astype(int))
    hand.jghand.cast_shadow = True
    window.redraw()
    yield 4.0
    shown = window.crop(window.picture("eevee_rendered").astype(int))
    assert (without.mean(-1) - shown.mean(-1) > STEP).sum() > 2000
    assert skin(shown).sum() < 500  # of the widgets


def step_under_agx_a_mesh_hand_beside_it_has_the_same_light_and_shadow(window):
    scene = bpy.context.scene
    assert scene.view_settings.view_transform == "AgX"
    for thing in [thing for thing in scene.objects if thing.type == "MESH" and "jghand_stand_in" not in thing]:
        bpy.data.objects.remove(thing)
    hand = next(thing for thing in scene.objects if "jghand_handedness" in thing)
    hand.jghand.cast_shadow = True
    (stand_in,) = (thing for thing in bpy.data.objects if "jghand_stand_in" in thing)
    mesh = bpy.data.objects.new("Mesh Hand", stand_in.data)
    mesh.matrix_world = hand.matrix_world
    mesh.location.x += 0.16
    scene.collection.objects.link(mesh)
    bpy.ops.mesh.primitive_plane_add(size=1.0, location=(0.0, 0.0, 0.0))
    ground, lamp, eye = bpy.context.object, _lamp(), scene.camera
    lamp.data.type, lamp.data.energy, lamp.rotation_euler = "SUN", 4.0, (0.9, 0.0, -0.5)
    eye.location, eye.rotation_euler = (0.08, -0.75, 0.25), (1.35, 0.0, 0.0)
    eye.data.type, eye.data.ortho_scale = "ORTHO", 0.48  # a pixel for each millimeter
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 64, False
    scene.render.resolution_x, scene.render.resolution_y = 480, 320
    bpy.context.preferences.view.render_display_type = "NONE"
    window.call("jghand.combine_with_scene")
    path = window.out / "mesh_hand_beside_it.png"
    scene.render.filepath = str(path)
    with window.override():
        bpy.ops.render.render("INVOKE_DEFAULT", write_still=True)
    yield lambda: path.exists() and not bpy.app.is_job_running("RENDER")
    image = bpy.data.images.load(str(path))
    shown = (255 * np.reshape(image.pixels[:], (320, 480, -1))[::-1, :, :3]).astype(np.uint8)
    of_hand, of_mesh = (half[skin(half)] for half in np.array_split(shown, 2, axis=1))
    assert 0.8 < len(of_hand) / len(of_mesh) < 1.25
    assert np.abs(of_hand.mean(0) - of_mesh.mean(0)).max() < 2 * STEP
    assert abs(np.ptp(of_hand.mean(0)) - np.ptp(of_mesh.mean(0))) < STEP / 2  # one color, and as red
    of_hand, of_mesh, clear = (shown[205:245, left : left + 40].mean() for left in (222, 222 + 160, 20))
    assert max(of_hand, of_mesh) < clear - 2 * STEP
    assert abs(of_hand - of_mesh) < STEP
    window.call("jghand.remove_combination")
    for thing in (mesh, ground):
        bpy.data.objects.remove(thing)
    lamp.data.type, scene.render.engine = "POINT", "JGHAND"


def step_solid_keeps_the_light_of_the_capture(window):
    yield from window.shading("SOLID")
    yield lambda: _is_sharp(window)
    before = _colors(window).mean(0)
    _lamp().data.energy = 5000.0
    window.redraw()
    yield 1.0
    yield lambda: _is_sharp(window)
    assert np.abs(_colors(window).mean(0) - before).max() < 1
    window.picture("solid")


def _drag_lamp(window, y: float):
    """Moves it through the scene, and waits."""
    for place in np.linspace(_lamp().location.y, y, 12):
        _lamp().location.y = place
        window.redraw()
        yield 0.05
    yield lambda: _is_sharp(window)


def _lamp() -> bpy.types.Object:
    return next(thing for thing in bpy.context.scene.objects if thing.type == "LIGHT")


def _colors(window) -> np.ndarray:
    """(N, 3) pixels of the palm, below the middle of the view."""
    shown = window.crop(window.screen()).astype(float)
    height, width = shown.shape[:2]
    return shown[height * 50 // 100 : height * 60 // 100, width * 48 // 100 : width * 52 // 100].reshape(-1, 3)


def _is_sharp(window) -> bool:
    """Whether every view has the best picture of what it wants."""
    views = importlib.import_module(window.addon.__name__ + ".viewport.views")
    paces = [view.pace for view in views.all_views()]
    return bool(paces) and all(
        p.grade == 2 and p.shown and p.shown.want == p.want and p.shown.grade == 2 for p in paces
    )
