# SPDX-License-Identifier: GPL-3.0-or-later
"""What an animator does in the first minutes: from the side bar's one button to a rendered animation."""

import itertools
import time

import bpy
import numpy as np

from in_blender.pictures import changed, skin

# the button of the empty side bar, and the first item of the menu below it: pixels from the bar's left, window's top
ADD_BUTTON, FIRST_ITEM = (110, 284), (62, 312)
SIZE = (480, 320)
kept: dict[str, np.ndarray] = {}


def hand() -> bpy.types.Object:
    return next(thing for thing in bpy.data.objects if thing.type == "ARMATURE")


def view_picture(window, name: str) -> np.ndarray:
    return window.crop(window.picture(name))


def step_one_button_adds_a_hand(window):
    yield from window.open_sidebar()
    window.picture("empty_scene")
    bar = window.region("UI")
    for x, from_top in (ADD_BUTTON, FIRST_ITEM):
        yield from window.click(bar.x + x, window.window.height - from_top)
    assert hand() == bpy.context.view_layer.objects.active
    assert bpy.context.scene.camera is not None


def step_the_hand_is_seen_in_solid(window):
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    yield from window.look_at((0.02, 0.075, 0.01), 0.36, (0.75, 0.0, 0.75))
    window.redraw()
    yield 0.5
    before = window.crop(window.screen())
    yield from window.settle()
    after = view_picture(window, "solid")
    assert skin(after).mean() > 0.05, "there is no hand in Solid"
    assert skin(after).mean() > skin(before).mean()


def step_material_preview_shows_the_same_hand(window):
    yield from window.shading("MATERIAL")
    yield from window.settle()
    assert skin(view_picture(window, "material_preview")).mean() > 0.05


def step_a_picture_without_hands_says_so(window):
    """F12 with an engine that draws no hands: a menu names it and offers the two ways to get them."""
    scene = bpy.context.scene
    scene.render.engine = "BLENDER_WORKBENCH"
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    yield from window.point_at_view()
    yield from window.key("F12")
    rendering, ui = window.module("render.rendering"), window.module("ui")
    yield lambda: any(uid == scene.session_uid for uid, _ in rendering._said) and ui.later is None
    yield 1.0
    window.picture("without_hands")
    yield from window.key("Escape")
    close_other_windows(window)
    scene.render.engine = "BLENDER_EEVEE"
    yield 0.5


def step_rendered_mode_shows_it_with_our_engine(window):
    # that of the default scene stands behind the palm
    bpy.data.objects["Light"].location = (2, -4, 3)
    yield from window.shading("RENDERED")
    window.picture("rendered_with_eevee")
    assert window.call("jghand.use_engine") == {"FINISHED"}
    yield from window.settle()
    assert skin(view_picture(window, "rendered_agx")).mean() > 0.05


def step_one_button_gives_it_the_colors_of_its_capture(window):
    before = window.crop(window.screen())
    assert window.call("jghand.use_standard") == {"FINISHED"}
    window.redraw()
    yield 1.0
    after = view_picture(window, "rendered_standard")
    assert after[skin(after)].mean() > before[skin(before)].mean()


def step_a_pose_is_applied_and_keyed(window):
    yield from window.shading("SOLID")
    yield from window.settle()
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 24
    for frame, pose in ((1, "open"), (12, "fist"), (24, "point")):
        scene.frame_set(frame)
        window.call("jghand.apply_pose", pose=pose, use_keys=True)
        yield 0.3
    scene.frame_set(1)
    yield from window.settle()
    kept["open"] = view_picture(window, "keyed_open")
    scene.frame_set(12)
    yield from window.settle()
    kept["fist"] = view_picture(window, "keyed_fist")
    assert changed(kept["open"], kept["fist"]).mean() > 0.03


def step_the_timeline_has_the_keys_of_the_poses(window):
    """Blender jumps from key to key that its timeline shows: those of selected bones."""
    bpy.context.scene.frame_set(1)
    frames = []
    for _ in range(2):
        with window.override():
            bpy.ops.screen.keyframe_jump(next=True)
        yield 0.3
        frames.append(bpy.context.scene.frame_current)
    assert frames == [12, 24], f"the timeline shows no keys: {frames}"


def step_scrubbing_follows_the_pointer(window):
    area = window.area("DOPESHEET_EDITOR")
    region = window.region("WINDOW", area)
    y = region.y + region.height - 12
    places = [region.x + region.view2d.view_to_region(frame, 0, clip=False)[0] for frame in range(1, 25, 2)]
    yield from window.move(places[0], y)
    yield from window.press()
    frames = set()
    for x in places:
        yield from window.drag(x, y)
        frames.add(bpy.context.scene.frame_current)
    scrubbed = view_picture(window, "scrubbing")
    yield from window.release()
    assert len(frames) > 4, f"the timeline did not follow: {frames}"
    assert skin(scrubbed).mean() > 0.03
    yield from window.settle()


def step_playing_counts_late_frames(window):
    bpy.context.scene.frame_set(1)
    frames = []
    yield from window.point_at_view()
    yield from window.key("space")
    began = time.monotonic()
    for _ in range(30):
        yield 0.1
        frames.append(bpy.context.scene.frame_current)
    assert window.window.screen.is_animation_playing
    window.picture("playing")
    late = window.module("viewport.views").late_frames()
    print(f"JGHAND playing: {len(set(frames))} different frames in 3 s, {late} late", flush=True)
    # each frame that was played is counted once at the most, however slow this machine is
    assert 0 <= late <= (time.monotonic() - began) * bpy.context.scene.render.fps + 2
    yield from window.key("space")
    assert not window.window.screen.is_animation_playing
    assert len(set(frames)) > 5
    yield from window.settle()
    window.picture("played")


def step_undo_takes_a_pose_back(window):
    scene = bpy.context.scene
    scene.frame_set(12)
    yield from window.settle()
    before = window.crop(window.screen())
    with window.override():
        bpy.ops.ed.undo_push(message="what this story did by hand")
    window.call("jghand.reset_pose")
    yield from window.settle()
    reset = view_picture(window, "reset")
    assert changed(before, reset).mean() > 0.02
    yield from window.point_at_view()
    yield from window.key("ctrl+z")
    yield from window.settle()
    undone = view_picture(window, "undone")
    assert changed(before, undone, 24).mean() < 0.01, "undo did not bring the pose back"


def step_the_camera_button_frames_the_hand(window):
    scene = bpy.context.scene
    scene.frame_set(1)
    assert window.call("jghand.add_camera") == {"FINISHED"}
    window.space().region_3d.view_perspective = "CAMERA"
    window.redraw()
    yield from window.settle()
    assert skin(view_picture(window, "through_camera")).mean() > 0.02


def step_f12_renders_the_hand(window):
    yield from window.f12()
    path = window.out / "f12.png"
    bpy.context.scene.render.image_settings.color_mode = "RGB"
    bpy.data.images["Render Result"].save_render(str(path))
    rendered = read(path)
    assert rendered.shape[:2] == SIZE[::-1]
    assert skin(rendered).mean() > 0.1, "F12 is empty"
    yield from window.key("Escape")
    close_other_windows(window)
    yield 0.5


def close_other_windows(window) -> None:
    for other in list(bpy.context.window_manager.windows)[1:]:
        with bpy.context.temp_override(window=other):
            bpy.ops.wm.window_close()


def read(path) -> np.ndarray:
    """(H, W, 3) uint8 of a picture file, top row first."""
    image = bpy.data.images.load(str(path))
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return np.rint(pixels.reshape(height, width, 4)[::-1, :, :3] * 255).astype(np.uint8)


def step_an_animation_is_rendered_and_its_frames_differ(window):
    scene = bpy.context.scene
    scene.frame_step = 11
    scene.render.filepath = str(window.out / "frame_")
    done = []
    bpy.app.handlers.render_complete.append(lambda *_: done.append(True))
    yield from window.point_at_view()
    yield from window.key("ctrl+F12")
    yield lambda: len(list(window.out.glob("frame_*.png"))) == 3 and done
    yield 1.0
    close_other_windows(window)
    scene.frame_step = 1
    pictures = [read(path) for path in sorted(window.out.glob("frame_*.png"))]
    assert all(skin(picture).mean() > 0.05 for picture in pictures)
    for one, other in itertools.pairwise(pictures):
        assert changed(one, other).mean() > 0.02, "two frames of the animation are the same"


def step_a_saved_file_shows_its_hand_again(window):
    scene = bpy.context.scene
    scene.frame_set(12)
    window.space().region_3d.view_perspective = "CAMERA"
    yield from window.settle()
    before = view_picture(window, "before_saving")
    path = str(window.out / "hand.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(app_template="")
    yield 1.0
    with window.override():
        bpy.ops.wm.open_mainfile(filepath=path)
    yield 1.0
    yield from window.settle()
    after = view_picture(window, "opened_again")
    assert skin(after).mean() > 0.02
    assert changed(before, after, 24).mean() < 0.01, "the opened file looks different"


def step_an_imported_motion_stands_upright_on_the_hand(window):
    """The hand that Add Hand made stands by its object's rotation; a motion has z up."""
    motion_m = upright_m(window) + 0.03 * np.sin(np.arange(FILM_FRAMES) / 3)[:, None, None] * (1, 0, 0)
    np.savez(window.out / "wave.npz", joints_m=motion_m, order="standard", unit="m", fps=24.0, handedness="right")
    yield from window.choose_file("jghand.import_motion", window.out / "wave.npz")
    yield lambda: hand().animation_data.action.name.startswith("wave")
    check_joints(3, motion_m[2] - motion_m[0, 0] + np.array(hand().location))
    yield from window.look_at((0.02, 0.0, 0.075), 0.36, (1.35, 0.0, 0.3))
    yield from window.settle()
    assert skin(view_picture(window, "imported")).mean() > 0.05


def step_a_selected_ring_poses_its_finger_alone(window):
    bones = hand().pose.bones
    with window.override():
        bpy.ops.object.mode_set(mode="POSE")
        bpy.ops.pose.select_all(action="DESELECT")
    bones["control_index"].select = True
    before = {bone.name: bone.matrix_basis.copy() for bone in bones}
    window.call("jghand.apply_pose", pose="fist")
    yield from window.settle()
    window.picture("one_finger")
    changed_bones = {name for name, matrix in before.items() if bones[name].matrix_basis != matrix}
    assert changed_bones == {"index1", "index2", "index3"}
    with window.override():
        bpy.ops.object.mode_set(mode="OBJECT")


FILM_FRAMES = 12


def upright_m(window) -> np.ndarray:
    """(F, 21, 3) a resting hand with its fingers up, z up, meters."""
    x, y, z = np.moveaxis(window.module("core.posing").rest_joints_m("right"), -1, 0)
    return np.tile(np.stack([x, -z, y], -1), (FILM_FRAMES, 1, 1))


def check_joints(frame: float, wanted_m: np.ndarray) -> None:
    """wanted_m: (21, 3) where the joints are in the world at a frame."""
    whole = int(frame)
    bpy.context.scene.frame_set(whole, subframe=frame - whole)
    thing = hand().evaluated_get(bpy.context.evaluated_depsgraph_get())
    for name, place in (("wrist", 0), ("index1", 5), ("middle4", 12), ("pinky4", 20)):
        np.testing.assert_allclose(thing.matrix_world @ thing.pose.bones[name].head, wanted_m[place], atol=1e-5)
