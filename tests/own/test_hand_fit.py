"""The hand and its motion that explain a film."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from motion_errors import motion_errors
from shaped_films import CANONICAL_M, PRIOR, film

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.hand.sequence import bone_directions
from jghand_engine.native.library import load as load_native
from jghand_engine.own import fit_surface
from jghand_engine.own.fit_surface import FitSurface, outline_factor
from jghand_engine.own.fit_terms import guides
from jghand_engine.own.fit_views import sights, view_of
from jghand_engine.own.hand_fit import RATES, Effort, FitPictures, FittedHand, HandFit
from jghand_engine.own.masks import wrist_side
from jghand_engine.own.shape import COARSE_COUNT
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import DetailedHand, SurfaceHits
from jghand_engine.render.settings import RenderSettings
from jghand_engine.template.builtin import load_template
from jghand_engine.track.poses import Poses


def disturbed(poses: Poses, seed: int = 0) -> Poses:
    """Joints 4 mm off, wrist upon wrist."""
    random = np.random.default_rng(seed)
    turned = vector_rotation(0.03 * random.standard_normal(poses.place_m.shape))
    place = poses.place_m + 0.002 * random.standard_normal(poses.place_m.shape)
    return Poses(poses.turn @ turned, place, poses.angle_rad + 0.05 * random.standard_normal(poses.angle_rad.shape))


def outline(fit: HandFit, shown: FitPictures) -> float:
    with torch.no_grad():
        joints = fit.joints(fit.everything)
        return float(shown.errors(fit.everything, joints, fit.shape)[:, 0].mean())


def test_pictures_bring_joints_bones_and_outline_back():
    truth = film()
    best = HandFit(PRIOR, truth.start(), truth.time_s, count=700)
    with torch.no_grad():
        best.unknowns.shape[:] = torch.from_numpy(truth.shape[:COARSE_COUNT])
    fit = HandFit(PRIOR, truth.start(disturbed(truth.poses), 1.0, CANONICAL_M), truth.time_s, count=700)
    factor = fit._outline_factor(truth.rgb_u8, truth.masks)
    least, first = (outline(one, one._shown(truth.rgb_u8, truth.masks, factor)) for one in (best, fit))
    before = motion_errors(fit.result().joints_m, 1.0, truth.joints_m, 1.0)
    fit.fit_landmarks(8)
    fit.fit_pictures(truth.rgb_u8, truth.masks, Effort(times=1, rounds=12))
    found = fit.result()
    after = motion_errors(found.joints_m, 1.0, truth.joints_m, 1.0)
    # a drawn outline is softer than a mask: what is left of the truth itself is no error
    part = (found.outline_residual.mean() - least) / (first - least)
    length = bone_lengths(found.own_joints_m)[5:] / bone_lengths(truth.canonical_joints_m)[5:]
    assert part < 0.2, "seen: 0.01"
    assert not fit.unknowns.fine_shape.any(), (
        "they are for outlines, which a hand without a surface of its skin has not"
    )
    assert before.wrist_mm > 4
    assert after.aligned_mm < 0.6 * before.aligned_mm
    # of fingers, whose bones the pictures show
    assert np.abs(length / np.median(length) - 1).mean() < 0.02


@pytest.fixture(scope="module")
def exact():
    """A fit in float64 beside the truth, before few small pictures."""
    truth = film(3)
    fit = HandFit(PRIOR.prefix(250), truth.start(disturbed(truth.poses)), truth.time_s, count=0, dtype=torch.float64)
    with torch.no_grad():
        fit.unknowns.shape += 0.3 * torch.randn(
            COARSE_COUNT, generator=torch.Generator().manual_seed(1), dtype=torch.float64
        )
    joints = fit.joints(fit.everything).detach()
    camera = truth.camera.scaled(1 / 4)
    seen = sights(truth.rgb_u8[:, 2::4, 2::4], truth.masks[:, 2::4, 2::4], joints.numpy(), camera)
    shown = FitPictures(fit.surface, seen, fit.surface.keep(joints), 1.0)
    return fit, shown, shown.colors(joints, fit.shape.detach())


@pytest.mark.parametrize("name", RATES)
def test_every_group_has_the_gradient_of_its_costs(exact, name, monkeypatch):
    # where a Gaussian ends is a step, which differences see and gradients do not
    monkeypatch.setattr(fit_surface, "_SETTINGS", RenderSettings(alpha_min=1e-7))
    fit, shown, colors = exact
    group = getattr(fit.unknowns, name)
    way = torch.randn(group.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64) * RATES[name]

    def cost() -> torch.Tensor:
        joints = fit.joints(fit.everything)
        errors = shown.errors(fit.everything, joints, fit.shape, colors).mean(0)
        return fit.detector_cost(fit.everything, joints, (0.05, 0.05)) + 4 * errors.sum()

    (gradient,) = torch.autograd.grad(cost(), group)
    ends = []
    for sign in (1e-5, -1e-5):
        with torch.no_grad():
            group += sign * way
            ends.append(float(cost()))
            group -= sign * way
    assert float((gradient * way).sum()) == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3)


@pytest.mark.parametrize("factor", [1, 2, 4])
def test_outlines_of_few_gaussians_in_small_pictures_have_the_size_of_the_skins_surface(factor):
    """At three sizes of the fit's pictures."""
    truth, prior = film(), load_builtin(handedness=Handedness.RIGHT).prefix(2000)
    camera = Camera(384, 640, 472.0, 472.0, 192.0, 320.0, np.eye(4))
    joints = torch.from_numpy(truth.joints_m[[0, 3]]).float()
    views = [view_of(camera, np.zeros(2), np.array([384.0, 640.0]), 2 * factor)] * 2
    surface = FitSurface(prior, 1000)

    def sides(view_camera: Camera) -> np.ndarray:
        pixels = view_camera.project(truth.joints_m[[0, 3]])[0]
        return wrist_side(pixels, view_camera.width, view_camera.height)

    def area(size: float) -> float:
        posed = surface.posed(joints, None, surface.keep(joints))
        pictures = [surface.draw(posed, row, views[0].camera, surface.hand.rgb, size).alpha.numpy() for row in range(2)]
        return float((np.stack(pictures) * sides(views[0].camera)).sum()) * (2 * factor) ** 2

    hits, fine = SurfaceHits(load_native("auto"), DetailedHand.of(prior, 0.0)), camera.scaled(4)
    met = [np.isfinite(hits(prior.skeleton().bones(one), fine)[1]) for one in truth.joints_m[[0, 3]]]
    whole = float((np.stack(met) & sides(fine)).sum()) / 4**2
    assert area(outline_factor(prior, surface, joints, views)) == pytest.approx(whole, rel=5e-3)
    assert area(1.0) > 1.02 * whole


def test_what_lies_beyond_the_wrist_changes_no_number():
    truth = film(4)
    beyond = ~wrist_side(truth.camera.project(truth.joints_m)[0], truth.camera.width, truth.camera.height)
    # the wrist's line goes with the fit: the arm begins where no fit of this film comes to
    away = np.roll(beyond, 12, axis=1) & beyond
    results = []
    for color in (0, 255):
        rgb, masks = truth.rgb_u8.copy(), truth.masks.copy()
        rgb[away], masks[away] = color, color > 0
        fit = HandFit(PRIOR, truth.start(disturbed(truth.poses)), truth.time_s, count=500)
        fit.fit_pictures(rgb, masks, Effort(times=1, rounds=2))
        results.append(fit.result())
    assert away.any()
    for one in fields(FittedHand):
        if one.name not in ("camera", "poses"):
            np.testing.assert_array_equal(getattr(results[0], one.name), getattr(results[1], one.name))


def test_a_fit_that_goes_on_from_its_file_finds_the_very_hand_of_one_that_was_not_stopped(tmp_path):
    truth, path, twice = film(4), tmp_path / "rounds.npz", Effort(times=2, rounds=1)
    whole, stopped, again = (
        HandFit(PRIOR, truth.start(disturbed(truth.poses)), truth.time_s, count=500) for _ in range(3)
    )
    whole.fit_pictures(truth.rgb_u8, truth.masks, twice)
    stopped.fit_pictures(truth.rgb_u8, truth.masks, replace(twice, times=1), ended=lambda: stopped.save(path))
    again.load(path)
    assert (again.done, again.spent_s) == (1, stopped.spent_s)
    again.fit_pictures(truth.rgb_u8, truth.masks, twice)
    assert again.done == 2
    for name, tensor in vars(whole.unknowns).items():
        assert torch.equal(getattr(again.unknowns, name), tensor)
    # time that was spent before counts
    again.fit_pictures(truth.rgb_u8, truth.masks, replace(twice, least_s=again.spent_s))
    assert again.done == 2


def test_a_found_hand_comes_back_from_its_file_and_shapes_an_avatar(tmp_path):
    truth = film(3)
    fit = HandFit(PRIOR, truth.start(), truth.time_s, count=300)
    with torch.no_grad():
        fit.unknowns.shape[0] = 0.8
    found = fit.result()
    found.save(tmp_path / "fit.npz")
    again = FittedHand.load(tmp_path / "fit.npz")
    np.testing.assert_array_equal(again.joints_m, found.joints_m)
    np.testing.assert_array_equal(again.poses.turn, found.poses.turn)
    assert again.camera.fx == found.camera.fx
    thicker = again.avatar_shape(PRIOR)
    assert 1e-4 < np.linalg.norm(thicker.position_m - PRIOR.position_m, axis=1).mean() < 3e-3
    np.testing.assert_array_equal(thicker.canonical_joints_m, PRIOR.canonical_joints_m)
    np.testing.assert_array_equal(thicker.own_joints_m, found.own_joints_m)
    # the bones of the hand in the film, in the pose of the prior's canonical hand
    np.testing.assert_allclose(bone_lengths(found.own_joints_m), bone_lengths(truth.canonical_joints_m), rtol=1e-5)
    np.testing.assert_allclose(bone_directions(found.own_joints_m[None]), bone_directions(CANONICAL_M[None]), atol=1e-5)


def test_the_flat_hands_of_both_sides_are_the_ruler():
    flat = load_template().joints_m - load_template().joints_m[:1]
    back = flat * (-1.0, 1.0, -1.0)
    slanted = flat @ vector_rotation(np.array([0.0, 0.9, 0.0])).T
    bent = film(3).joints_m[1:2]
    joints = np.concatenate([np.stack([flat] * 8), back[None], slanted[None], bent])
    chosen = guides(bone_directions(joints))
    assert chosen[:8].sum() == 6
    assert chosen[8:].tolist() == [True, False, False]
