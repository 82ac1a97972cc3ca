"""The engine's pinhole sees every joint where Blender itself projects it."""

import bpy
import hands
import numpy as np
import pytest

from blender_addon.core import posing
from blender_addon.core.joints import HANDEDNESSES, LEFT
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature
from blender_addon.render import camera

# worst observed 1.1e-4 px (float32 of Blender's own matrices); the promise is 0.01
AGREES_PX = 1e-3

VIEWS = {
    "perspective": ((512, 334), {}),
    "long lens": ((512, 334), {"lens": 135}),
    "shifted": ((512, 334), {"shift_x": 0.13, "shift_y": -0.21}),
    "portrait": ((334, 512), {}),
    "portrait and shifted": ((334, 512), {"shift_x": -0.2, "shift_y": 0.1}),
    "fitted vertically": ((512, 334), {"sensor_fit": "VERTICAL", "shift_x": 0.05}),
    "fitted horizontally, portrait": ((334, 512), {"sensor_fit": "HORIZONTAL", "shift_y": 0.05}),
    "odd size": ((333, 201), {"sensor_width": 23.6, "shift_x": 0.01}),
}


def set_size(scene: bpy.types.Scene, size: tuple[int, int]) -> None:
    camera.set_picture_size(scene.render, *size)


def disagreement_px(context: bpy.types.Context, hand: bpy.types.Object, eye: bpy.types.Object) -> float:
    """Largest distance in pixels between our projection of the joints and Blender's."""
    depsgraph = context.evaluated_depsgraph_get()
    view = camera.pinhole(eye, depsgraph)
    seen = armature.read_hand(hand, depsgraph)
    unit_m = context.scene.unit_settings.scale_length
    points = seen.joints_world_m / unit_m
    blenders = hands.blenders_pixels(context.scene, eye, points, (view.width, view.height))
    ours = view.project(seen.joints_world_m)
    assert (ours[:, 2] > 0).all()
    return np.linalg.norm(ours[:, :2] - blenders, axis=-1).max()


@pytest.mark.parametrize(("size", "lens"), VIEWS.values(), ids=VIEWS.keys())
@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_joints_are_seen_where_blender_projects_them(context, size, lens, handedness):
    hand = hands.keyed_hand(context, handedness, hands.moving_hand_m(handedness))
    set_size(context.scene, size)
    eye = hands.camera_on(context, (0, 0.1, 0), 0.6, **lens)
    armature.at_frame(context.scene, 2)
    assert disagreement_px(context, hand, eye) < AGREES_PX


@pytest.mark.parametrize("place", hands.PLACES.values(), ids=hands.PLACES.keys())
@pytest.mark.parametrize("unit_m", [1.0, 0.01, 0.3048])
def test_the_place_of_the_hand_and_the_unit_of_the_scene_do_not_matter(context, place, unit_m):
    context.scene.unit_settings.scale_length = unit_m
    hand = hands.keyed_hand(context, "right", hands.moving_hand_m("right"))
    hands.put(hand, place)
    set_size(context.scene, (512, 334))
    depsgraph = armature.at_frame(context.scene, 3)
    middle = armature.read_hand(hand, depsgraph).joints_world_m.mean(0) / unit_m
    eye = hands.camera_on(context, middle, 1.2 / unit_m, shift_x=0.03)
    context.view_layer.update()
    assert disagreement_px(context, hand, eye) < AGREES_PX


def test_percentage_is_honored_and_rounded_as_blender_does(context):
    render = context.scene.render
    for size, percentage, expected in (((512, 334), 50, (256, 167)), ((333, 201), 33, (109, 66)), ((3, 1), 10, (1, 1))):
        render.resolution_x, render.resolution_y, render.resolution_percentage = *size, percentage
        assert camera.picture_size(render) == expected


# sizes that come out whole: world_to_camera_view takes the size before rounding, the renderer the one after it
@pytest.mark.parametrize("percentage", [100, 50, 250])
@pytest.mark.parametrize("aspect", [(1, 1), (2, 1), (1, 1.5)])
def test_percentage_and_pixel_aspect_are_honored(context, percentage, aspect):
    hand = hands.keyed_hand(context, "right", hands.moving_hand_m("right"))
    eye = hands.camera_on(context, (0, 0.1, 0), 0.6, shift_y=0.05)
    render = context.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 512, 334, percentage
    render.pixel_aspect_x, render.pixel_aspect_y = aspect
    armature.at_frame(context.scene, 2)
    assert disagreement_px(context, hand, eye) < AGREES_PX * max(1, percentage / 100)
    view = camera.pinhole(eye, context.evaluated_depsgraph_get())
    assert view.fx / view.fy == pytest.approx(aspect[1] / aspect[0], rel=1e-6)


def test_scale_of_a_camera_is_left_out_as_blender_leaves_it_out(context):
    hand = hands.keyed_hand(context, "right", hands.moving_hand_m("right"))
    set_size(context.scene, (512, 334))
    eye = hands.camera_on(context, (0, 0.1, 0), 0.6)
    eye.scale = (2, 3, 0.5)
    armature.at_frame(context.scene, 2)
    assert disagreement_px(context, hand, eye) < AGREES_PX


@pytest.mark.parametrize("unit_m", [1.0, 0.01])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.13, -0.21)])
def test_an_orthographic_camera_projects_as_blender_does(context, unit_m, shift):
    context.scene.unit_settings.scale_length = unit_m
    context.scene.render.pixel_aspect_x = 1.5
    hand = hands.keyed_hand(context, "right", hands.moving_hand_m("right"))
    set_size(context.scene, (512, 334))
    eye = hands.camera_on(context, (0, 0.1 / unit_m, 0), 0.6 / unit_m, type="ORTHO", ortho_scale=0.4 / unit_m)
    eye.data.shift_x, eye.data.shift_y = shift
    armature.at_frame(context.scene, 2)
    assert disagreement_px(context, hand, eye) < AGREES_PX
    view = camera.pinhole(eye, context.evaluated_depsgraph_get())
    assert view.orthographic
    assert view.fx == pytest.approx(512 / 0.4, rel=1e-5)


def test_depth_of_field_is_that_of_the_camera(context):
    context.scene.unit_settings.scale_length = 0.1
    eye = hands.camera_on(context, (0, 0, 0), 5, lens=80)
    depth_of_field = eye.data.dof
    depth_of_field.use_dof, depth_of_field.aperture_fstop, depth_of_field.focus_distance = True, 4.0, 3.0
    view = camera.pinhole(eye, context.evaluated_depsgraph_get())
    assert view.aperture_m == pytest.approx(0.1 * 0.080 / 4, rel=1e-5)
    assert view.focus_m == pytest.approx(0.3, rel=1e-6)
    depth_of_field.focus_object = bpy.data.objects.new("Focus", None)
    context.scene.collection.objects.link(depth_of_field.focus_object)
    depth_of_field.focus_object.location = (0.2, 0, 0)
    context.view_layer.update()
    axis = np.array(eye.matrix_world.col[2])[:3]
    view = camera.pinhole(eye, context.evaluated_depsgraph_get())
    # the depth along the view axis, not the distance
    assert view.focus_m == pytest.approx(0.1 * (5 - 0.2 * axis[0]), rel=1e-5)
    hand = hands.keyed_hand(context, "right", hands.moving_hand_m("right"))
    depth_of_field.focus_object, depth_of_field.focus_subtarget = hand, "index4"
    context.view_layer.update()
    depsgraph = context.evaluated_depsgraph_get()
    view = camera.pinhole(eye, depsgraph)
    tip = armature.read_hand(hand, depsgraph).joints_world_m[8]
    assert view.focus_m == pytest.approx(view.project(tip)[2], rel=1e-5)


@pytest.mark.parametrize(
    ("kind", "lens", "parent_scale"),
    [
        ("panoramic", {"type": "PANO"}, (1, 1, 1)),
        ("orthographic_lens", {"type": "ORTHO"}, (1, 1, 1)),
        ("sheared_camera", {}, (1, 1, -1)),
        ("sheared_camera", {}, (1, 3, 1)),
    ],
)
def test_a_camera_that_no_pinhole_is_like_is_refused(context, kind, lens, parent_scale):
    eye = hands.camera_on(context, (0, 0, 0), 1, **lens)
    eye.data.dof.use_dof = True
    eye.parent = bpy.data.objects.new("Parent", None)
    context.scene.collection.objects.link(eye.parent)
    eye.parent.scale = parent_scale
    context.view_layer.update()
    with pytest.raises(JGHandFailure) as caught:
        camera.pinhole(eye, context.evaluated_depsgraph_get())
    assert caught.value.kind == kind


@pytest.mark.parametrize("handedness", HANDEDNESSES)
@pytest.mark.parametrize("side", camera.SIDES)
@pytest.mark.parametrize("size", [(512, 334), (334, 512)])
def test_a_framing_camera_shows_the_whole_hand_and_not_much_else(context, handedness, side, size):
    joints = hands.moving_hand_m(handedness, frames=8)
    set_size(context.scene, size)
    eye = camera.add_framing_camera(context, side, joints, handedness)
    view = camera.pinhole(eye, context.evaluated_depsgraph_get())
    pixels = view.project(joints)
    margin = camera.SKIN_M * view.fx / pixels[..., 2]
    for axis, edge in enumerate(size):
        assert (pixels[..., axis] - margin > 0).all()
        assert (pixels[..., axis] + margin < edge).all()
    filled = np.ptp(pixels[..., :2].reshape(-1, 2), axis=0) / size
    assert filled.max() > 0.55


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_the_palm_camera_sees_the_palm_with_the_fingers_up(context, handedness):
    joints = posing.rest_joints_m(handedness)
    set_size(context.scene, (512, 334))
    eye = camera.add_framing_camera(context, "CamPalm", joints[None], handedness)
    view = camera.pinhole(eye, context.evaluated_depsgraph_get())
    pixels = view.project(joints)
    wrist, middle_tip, thumb_tip = pixels[0], pixels[12], pixels[4]
    assert middle_tip[1] < wrist[1] - 100
    # looking at the palm of a right hand with the fingers up, the thumb is on the right
    assert (thumb_tip[0] > wrist[0]) == (handedness != LEFT)
