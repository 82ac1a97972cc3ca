"""The motion of all pictures of a film, by a hand that is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from motion_errors import motion_errors
from shaped_films import FPS, PRIOR, Film, film

from jghand_engine.errors import InputError
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.hand.sequence import bone_directions, rebuilt
from jghand_engine.own import exact
from jghand_engine.own.chain import chain_of
from jghand_engine.own.exact import begun, check_length, exact_poses
from jghand_engine.own.film import Source
from jghand_engine.own.hand_fit import Effort, FittedHand, HandFit
from jghand_engine.own.start import Start
from jghand_engine.track.poses import JointChain, Poses

BEST = np.arange(0, 12, 3)


@pytest.fixture(scope="module")
def truth() -> Film:
    return film(12)


@pytest.fixture(scope="module")
def fitted(truth) -> FittedHand:
    """The hand itself, as a fit of some pictures gives it."""
    own = rebuilt(
        np.zeros((1, 3)), bone_directions(PRIOR.canonical_joints_m[None]), bone_lengths(truth.canonical_joints_m)
    )
    some = truth.poses.part(BEST)
    return FittedHand(truth.camera, some, truth.joints_m[BEST], own[0], truth.shape, np.zeros(len(BEST)))


def tracked(truth: Film) -> Start:
    """As a tracker has it: everywhere off by about as much, and by a little more in each picture; one is not seen."""
    random = np.random.default_rng(2)
    count = len(truth.poses)
    turn = truth.poses.turn @ vector_rotation(np.array([0.08, -0.05, 0.04]) + 0.02 * random.standard_normal((count, 3)))
    place = truth.poses.place_m + (0.004, -0.003, 0.012) + 0.002 * random.standard_normal((count, 3))
    angle = truth.poses.angle_rad + 0.1 + 0.08 * random.standard_normal((count, 20))
    start = truth.start(Poses(turn, place, angle), 1.0)
    start.landmarks_px[7] = np.nan
    return start


def test_a_known_hand_comes_nearer_in_every_picture_and_stays_as_it_is(truth, fitted):
    start = tracked(truth)
    height, width = truth.rgb_u8.shape[1:3]
    source = Source("film", (height, width), FPS, 12, True, None, None, tuple(truth.rgb_u8))
    stages: list[str] = []
    poses = exact_poses(source, start, BEST, fitted, PRIOR, lambda stage, done, total: stages.append(stage))
    chain = chain_of(PRIOR.canonical_joints_m, fitted.own_joints_m)
    others = np.delete(np.arange(12), [*BEST.tolist(), 7])

    def error_mm(of: Poses, which: np.ndarray) -> float:
        return motion_errors(of.part(which).joints_m(chain), 1.0, truth.joints_m[which], 1.0).wrist_mm

    moved = begun(start.poses, BEST, fitted.poses)
    assert error_mm(moved, others) < 0.8 * error_mm(start.poses, others), "what the best pictures say of the others"
    assert error_mm(poses, others) < 0.7 * error_mm(moved, others), "what their own pictures say"
    assert len(poses) == 12
    between = np.linalg.norm(np.diff(poses.place_m[[6, 7, 8]], axis=0), axis=1)
    assert between[0] == pytest.approx(between[1]), "where it was not seen it goes the shortest way"
    assert list(dict.fromkeys(stages))[-1] == "Fitting all pictures"


def test_a_fit_with_a_known_hand_begins_where_the_other_ended_and_changes_no_hand(truth):
    start = truth.start().part(BEST)
    first = HandFit(PRIOR, start, truth.time_s[BEST], count=300)
    with torch.no_grad():
        generator = torch.Generator().manual_seed(3)
        first.unknowns.log_length += 0.05 * torch.randn(20, generator=generator)
        first.unknowns.palm_shift_m += 0.003 * torch.randn(5, 3, generator=generator)
        first.unknowns.shape += 0.3
    found = first.result()
    fit = HandFit(PRIOR, replace(start, poses=found.poses), truth.time_s[BEST], found, count=300)
    # single precision; worst seen 1e-7
    np.testing.assert_allclose(fit.result().joints_m, found.joints_m, atol=1e-6)
    chain = chain_of(PRIOR.canonical_joints_m, found.own_joints_m)
    np.testing.assert_allclose(found.poses.joints_m(chain), found.joints_m, atol=1e-6)
    fit.fit_pictures(truth.rgb_u8[BEST], truth.masks[BEST], Effort(times=1, rounds=2))
    after = fit.result()
    assert np.abs(after.joints_m - found.joints_m).max() > 1e-4
    np.testing.assert_allclose(after.own_joints_m, found.own_joints_m, atol=1e-6)
    np.testing.assert_allclose(after.shape, found.shape, atol=1e-7)


def test_a_fit_goes_on_for_as_long_as_it_is_told(truth, fitted, monkeypatch):
    now = iter(range(0, 1000, 10))
    monkeypatch.setattr("jghand_engine.own.hand_fit.time.monotonic", lambda: next(now))
    fit = HandFit(PRIOR, truth.start().part(BEST), truth.time_s[BEST], fitted, count=300)
    ticks: list[tuple[int, int]] = []
    effort = Effort(times=1, least_s=35.0, rounds=1)
    fit.fit_pictures(truth.rgb_u8[BEST], truth.masks[BEST], effort, tick=lambda *now: ticks.append(now))
    assert ticks == [(0, 1), (1, 2), (2, 3), (3, 4), (4, 4)]


def test_what_was_fitted_moves_what_lies_between(truth):
    start = tracked(truth).poses
    moved = begun(start, np.array([3, 9]), truth.poses.part(np.array([3, 9])))
    for known in (3, 9):
        np.testing.assert_allclose(moved.joints_m(chain(truth))[known], truth.joints_m[known], atol=1e-6)
    step = moved.place_m - start.place_m
    np.testing.assert_allclose(step[6], (step[3] + step[9]) / 2)
    np.testing.assert_allclose(step[[0, 11]], step[[3, 9]])


def chain(truth: Film) -> JointChain:
    return JointChain.of(truth.canonical_joints_m)


def test_a_film_that_is_too_long_is_refused_in_words():
    check_length(exact.PICTURES_MAX)
    with pytest.raises(InputError, match=r"at most 900 pictures of the hand, got 901.*--most"):
        check_length(901)
