"""Outlines of a fit, to a fraction of a pixel."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from shaped_films import CANONICAL_M, FPS, poses_of

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.hand.sequence import bone_directions
from jghand_engine.own import fit_outlines, hand_fit
from jghand_engine.own.fit_outlines import _PLAIN, OutlineSurface, shape_of_outlines
from jghand_engine.own.hand_fit import HandFit
from jghand_engine.own.masks import wrist_side
from jghand_engine.own.shape import COARSE_COUNT, SHAPE_COUNT, in_shape
from jghand_engine.own.start import Start
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset
from jghand_engine.track.poses import JointChain, Poses

COUNT, WIDTH, HEIGHT, FOCAL_PX = 5, 240, 400, 300.0
# of the palm, thicker, and of the index finger, thinner
THICK = np.zeros(SHAPE_COUNT)
THICK[[3, 7]] = -0.5, 0.5


@pytest.fixture(scope="module")
def prior():
    hand = load_builtin(handedness=Handedness.RIGHT).prefix(1000)
    assert hand.detail is not None
    return replace(hand, detail=replace(hand.detail, texture=_PLAIN, relief=None))


@pytest.fixture(scope="module")
def camera():
    return Camera(WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, WIDTH / 2, HEIGHT / 2, np.eye(4))


@pytest.fixture(scope="module")
def joints_m():
    return poses_of(COUNT).joints_m(JointChain.of(CANONICAL_M))


@pytest.fixture(scope="module")
def masks(prior, camera, joints_m):
    """Of the hand whose palm is thick and whose index finger is thin."""
    return masks_of(prior, THICK, camera, joints_m)


def masks_of(prior, shape, camera, joints_m):
    renderer = HandRenderer(in_shape(prior, shape), preset("final"))
    shown = np.stack([renderer.render(one, camera).rgba[..., 3] > 0.5 for one in joints_m])
    return shown & wrist_side(camera.project(joints_m)[0], WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def surface(prior):
    return OutlineSurface(prior, THICK)


def skin_of(prior, shape):
    """(V, 3) of the canonical hand, meters."""
    detail = in_shape(prior, shape).detail
    assert detail is not None
    return detail.position_m


@pytest.fixture
def quick(surface, monkeypatch):
    """The basis of all these surfaces is the same."""
    monkeypatch.setattr(fit_outlines, "shape_basis", lambda *_: surface.basis)


def outlines(surface, shape, joints_m, camera, masks):
    surface.in_shape(shape)
    return [surface.outline(*each, mask) for each, mask in zip(((one, camera) for one in joints_m), masks, strict=True)]


def test_a_hand_lies_on_its_own_outline(surface, camera, joints_m, masks):
    away_m = np.concatenate([one.away_m for one in outlines(surface, THICK, joints_m, camera, masks)])
    assert len(away_m) > 150 * COUNT
    # a pixel has 1 mm
    assert np.abs(np.mean(away_m)) < 6e-5, "seen: 0.03 mm"
    assert np.sqrt(np.mean(away_m**2)) < 3e-4, "seen: 0.1 mm"


def test_what_is_told_of_an_outline_is_how_far_the_skin_moves(surface, camera, joints_m, masks):
    random = np.random.default_rng(1)
    shape = 0.15 * random.uniform(-1, 1, SHAPE_COUNT)
    moved_m = joints_m + np.array([0.0006, -0.0004, 0.004])
    before = outlines(surface, THICK, joints_m, camera, masks)
    after = outlines(surface, THICK + shape, moved_m, camera, masks)
    for one, other, change_m in zip(before, after, moved_m - joints_m, strict=True):
        said = one.by_joints @ change_m.ravel() + one.by_shape @ shape
        got = one.away_m.mean() - other.away_m.mean()
        np.testing.assert_allclose(said.mean(), got, atol=6e-5)
        assert np.std(said) > 2e-4


@pytest.mark.usefixtures("quick")
def test_outlines_of_known_joints_give_the_thickness(prior, camera, joints_m, masks):
    found = shape_of_outlines(prior, np.zeros(SHAPE_COUNT), joints_m, camera, masks)
    place_m = [skin_of(prior, shape) for shape in (np.zeros(SHAPE_COUNT), found, THICK)]
    hand = place_m[0][:, 1] > 0.02
    before, after = (np.linalg.norm((one - place_m[2])[hand], axis=1).mean() for one in place_m[:2])
    assert after < 0.5 * before, "seen: 0.4"


@pytest.mark.usefixtures("quick")
def test_outlines_find_bumps_that_are_finer_than_a_finger_is_wide(prior, camera, joints_m):
    bumpy = np.zeros(SHAPE_COUNT)
    bumpy[COARSE_COUNT + 20] = 2.0
    found = shape_of_outlines(prior, np.zeros(SHAPE_COUNT), joints_m, camera, masks_of(prior, bumpy, camera, joints_m))
    alike = found[COARSE_COUNT:] @ bumpy[COARSE_COUNT:] / np.linalg.norm(found) / np.linalg.norm(bumpy)
    assert alike > 0.5, "seen: 0.64"


def fit_of(prior, camera, joints_m, poses, **more):
    pixels, directions = camera.project(joints_m)[0], bone_directions(joints_m)
    start = Start(camera, Handedness.RIGHT, pixels, directions, poses, CANONICAL_M)
    return HandFit(prior, start, np.arange(COUNT) / FPS, count=100, **more)


@pytest.mark.usefixtures("quick")
def test_a_finger_that_is_aside_in_one_picture_goes_back_and_is_no_thicker(prior, camera, joints_m, masks):
    poses = poses_of(COUNT)
    turned = poses.turn @ vector_rotation(0.02 * np.random.default_rng(2).standard_normal((COUNT, 3)))
    angle = poses.angle_rad.copy()
    angle[0, 5] += 0.03
    fit = fit_of(prior, camera, joints_m, Poses(turned, poses.place_m + np.array([0.002, -0.001, 0.0]), angle))
    with torch.no_grad():
        fit.unknowns.shape += torch.from_numpy(THICK[:COARSE_COUNT])
    before = fit.result()
    fit.fit_outlines(masks)
    after = fit.result()
    off_px = [
        np.linalg.norm(camera.project(one.joints_m)[0] - camera.project(joints_m)[0], axis=-1)
        for one in (before, after)
    ]
    assert np.median(off_px[1][:, 6:]) < 0.4 * np.median(off_px[0][:, 6:]), "seen: 0.05"
    assert off_px[1][0, 17] < 0.4 * off_px[0][0, 17], "the index finger's tip, seen: 0.03"
    change_m = skin_of(prior, after.shape) - skin_of(prior, THICK)
    index = prior.detail.bone_weights[:, [7, 12, 17]].sum(1) > 0.9
    assert np.linalg.norm(change_m[index], axis=1).mean() < 1e-4, "seen: 0.03 mm"


@pytest.mark.usefixtures("quick")
def test_of_a_known_hand_only_poses_change(prior, camera, joints_m, masks):
    hand = fit_of(prior, camera, joints_m, poses_of(COUNT)).result()
    poses = poses_of(COUNT)
    fit = fit_of(prior, camera, joints_m, replace(poses, place_m=poses.place_m + np.array([0.003, 0, 0])), hand=hand)
    fit.fit_outlines(masks)
    after = fit.result()
    np.testing.assert_array_equal(after.shape, hand.shape)
    np.testing.assert_allclose(after.own_joints_m, hand.own_joints_m, atol=1e-7)
    assert np.abs(after.poses.place_m[:, 0] - poses.place_m[:, 0]).max() < 0.0015


@pytest.mark.usefixtures("quick")
def test_in_every_picture_of_a_film_outlines_move_a_known_hand_smoothly(prior, camera, joints_m, masks, monkeypatch):
    def step(_surface, joints, *_):
        """One that stays, and one that trembles from picture to picture."""
        moved = np.zeros((COUNT, 26))
        moved[:, 0], moved[:, 25] = 0.02, 0.01 * (-1.0) ** np.arange(COUNT)
        return moved, np.zeros(0)

    monkeypatch.setattr(hand_fit, "outline_step", step)
    monkeypatch.setattr(hand_fit, "STEPS", 1)
    hand = fit_of(prior, camera, joints_m, poses_of(COUNT)).result()
    fit = fit_of(prior, camera, joints_m, poses_of(COUNT), hand=hand)
    before = fit.result().poses
    fit.fit_outlines(masks)
    after = fit.result().poses
    np.testing.assert_allclose(after.angle_rad[:, 0] - before.angle_rad[:, 0], 0.02, rtol=1e-4)
    assert np.abs(after.place_m - before.place_m).max() < 0.005, "as far as it trembled: 0.01"
