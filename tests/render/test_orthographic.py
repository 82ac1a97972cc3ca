"""Parallel rays: what is drawn is what a camera sees that stands far away, with the same kernels."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from depth_scenes import fingers, planes_of
from small_avatars import ellipsoid_avatar, trained_avatar
from splat_scenes import (
    DRAWING,
    ELLIPSOID_NAMES,
    NAMES,
    NATIVE,
    GradientBounds,
    assert_same_gradients,
    assert_same_picture,
    camera_for,
    draw,
    exact,
    gradients_of,
    hand_gaussians,
    stretched,
)

from jghand_engine.hand.poses import named_pose
from jghand_engine.learn.shadow import normalized_depth, visibility
from jghand_engine.native import library as native_library
from jghand_engine.render.camera import Camera
from jghand_engine.render.effect_plan import Choice, Effect
from jghand_engine.render.renderer import HandRenderer, SceneRenderer
from jghand_engine.render.settings import RenderSettings, preset
from jghand_engine.render.shadow import NativeShade, ShadowStyle

PX_PER_METER = 600.0


def parallel(camera: Camera, px_per_meter: float = PX_PER_METER) -> Camera:
    """The same view with parallel rays."""
    return replace(camera, fx=px_per_meter, fy=1.1 * px_per_meter, orthographic=True)


def from_afar(camera: Camera, away_m: float) -> Camera:
    """A pinhole so far behind an orthographic camera that its rays are nearly parallel."""
    matrix = camera.camera_from_world.copy()
    matrix[2, 3] += away_m
    depth_m = float(matrix[2, 3])
    return replace(camera, fx=camera.fx * depth_m, fy=camera.fy * depth_m, camera_from_world=matrix, orthographic=False)


@pytest.mark.parametrize("shape", [lambda g: g, stretched], ids=["spheres", "ellipsoids"])
def test_the_reference_draws_what_a_pinhole_sees_from_far_away(shape):
    gaussians, camera = shape(hand_gaussians(400)), parallel(camera_for(64, 48))
    near = exact(gaussians, camera)
    errors = []
    for away_m in (20.0, 200.0):
        far = exact(gaussians, from_afar(camera, away_m))
        errors.append(float((near.alpha - far.alpha).abs().mean()))
        assert float((near.rgb - far.rgb).abs().mean()) < 0.05 / away_m
    # sizes differ in proportion to the nearness
    assert errors[1] < 0.15 * errors[0]


@pytest.mark.parametrize("backend", DRAWING)
@pytest.mark.parametrize("shape", [lambda g: g, stretched], ids=["spheres", "ellipsoids"])
def test_the_kernels_draw_what_the_reference_draws(backend, shape):
    gaussians, camera = shape(hand_gaussians(3000)), parallel(camera_for(120, 84))
    assert_same_picture(draw(gaussians, camera, backend), exact(gaussians, camera), flips=2)


@pytest.mark.parametrize("backend", NATIVE)
@pytest.mark.parametrize(("shape", "names"), [(lambda g: g, NAMES), (stretched, ELLIPSOID_NAMES)], ids=["s", "e"])
def test_gradients_are_those_of_the_reference(backend, shape, names):
    gaussians, camera = shape(hand_gaussians(300, opacity=(0.3, 0.9))), parallel(camera_for(48, 40))
    got = gradients_of(gaussians, camera, backend=backend, alpha_min=1e-6, t_stop=0.0)
    want = gradients_of(gaussians, camera, dtype=torch.float64, alpha_min=1e-6)
    assert_same_gradients(got, want, GradientBounds(2e-4, 2e-4, 1e-7, 2e-4), names)


@pytest.mark.parametrize("variant", NATIVE)
def test_the_shadow_is_the_same_compiled_and_as_specified(variant):
    camera = parallel(replace(camera_for(96, 96), camera_from_world=np.eye(4)), 700.0)
    pinhole = replace(camera, fx=700.0 * 0.6, fy=700.0 * 0.6, orthographic=False)
    camera = replace(camera, fy=700.0)
    planes, style = planes_of(fingers(pinhole)), ShadowStyle(samples=64)
    native = NativeShade(native_library.load(variant), 96, 96)
    came = np.empty((96, 96), np.float32)
    native.prepare(planes.numpy(), camera, style, near_m=0.6, visibility=came)
    native.run()
    depth_m, valid = normalized_depth(planes[4].double(), planes[3].double())
    wanted = visibility(depth_m, valid, camera, style).numpy()
    assert wanted.min() < 0.8
    difference = np.abs(came - wanted)
    # as for pinholes: 5e-5 but where the rounding of a sample's place falls the other way
    assert (difference > 1e-3).mean() < 0.01
    assert np.median(difference) < 5e-5


def hand_before(camera_size=(120, 100), *, backend: str, avatar=None, **settings) -> tuple[HandRenderer, np.ndarray]:
    avatar = avatar or trained_avatar(3000)
    joints_m = named_pose("fist", avatar.canonical_joints_m, handedness=avatar.handedness)
    return HandRenderer(avatar, replace(preset("viewport"), backend=backend, **settings)), joints_m


def view(size=(120, 100), px_per_meter: float = PX_PER_METER) -> Camera:
    eye, target = (0.15, 0.15, 0.5), (0, 0.05, 0)
    return parallel(Camera.looking_at(eye, target, (0, 1, 0), width=size[0], height=size[1], focal_px=1), px_per_meter)


@pytest.mark.parametrize("backend", DRAWING)
@pytest.mark.parametrize("make", [trained_avatar, ellipsoid_avatar])
def test_a_trained_hand_shines_as_it_does_from_far_away(backend, make):
    renderer, joints_m = hand_before(backend=backend, avatar=make(3000))
    near, far = (renderer.render(joints_m, one).rgba for one in (view(), from_afar(view(), 200.0)))
    assert near[..., 3].max() > 0.9
    # worst observed 2.3e-4: from 200 m the sizes of the hand's parts differ by 0.1 % still
    assert np.abs(near - far).mean() < 4e-4


@pytest.mark.parametrize("backend", DRAWING)
def test_moving_the_camera_along_its_rays_changes_nothing_but_depth(backend):
    renderer, joints_m = hand_before(backend=backend)
    moved = view().camera_from_world.copy()
    moved[2, 3] += 3.0
    one = renderer.render(joints_m, view())
    other = renderer.render(joints_m, replace(view(), camera_from_world=moved))
    seen = one.depth_m > 0
    np.testing.assert_array_equal(seen, other.depth_m > 0)
    # worst observed 4.5e-6 and 1.4e-3: depths of three meters are rounded more coarsely, two Gaussians change places
    np.testing.assert_allclose(other.depth_m[seen], one.depth_m[seen] + 3.0, atol=1e-5)
    np.testing.assert_allclose(other.rgba, one.rgba, atol=3e-3)


@pytest.mark.parametrize("backend", DRAWING)
def test_the_hands_box_holds_all_that_is_seen(backend):
    camera = view((600, 400), 500.0)
    pictures = []
    for effects in ("auto", "all"):
        renderer, joints_m = hand_before(backend=backend, effects=Choice.parse(effects), antialias=False)
        frame = renderer.render(joints_m, camera)
        pictures.append(frame)
    assert pictures[0].report.plan is not None
    assert not pictures[0].report.plan.runs(Effect.WHOLE)
    assert np.abs(pictures[0].rgba[..., 3] - pictures[1].rgba[..., 3]).max() < 0.02


def test_bones_and_normals_are_seen_along_parallel_rays_too():
    avatar = trained_avatar(3000)
    joints_m = named_pose("open", avatar.canonical_joints_m, handedness=avatar.handedness)
    scene = SceneRenderer([avatar], RenderSettings(normals=True))
    frame = scene.render([joints_m], view())
    ids = scene.bone_ids(view())
    assert set(np.unique(ids)) <= set(range(21))
    assert len(np.unique(ids)) > 10
    assert frame.normal is not None
    solid = frame.depth_m > 0
    assert (frame.normal[solid][:, 2] <= 0).all()
