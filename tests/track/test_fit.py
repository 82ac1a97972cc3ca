"""The motion that explains landmarks best."""

from dataclasses import replace

import numpy as np
import pytest
from tracking_samples import CAMERA, CANONICAL_M, FPS, moving_poses

from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.sequence import bone_directions
from jghand_engine.track import costs
from jghand_engine.track import fit as fit_module
from jghand_engine.track.costs import PoseCosts, Trust
from jghand_engine.track.fit import FIT_GAP_S, fit
from jghand_engine.track.poses import LIMITS_RAD, JointChain, Landmarks, Poses
from jghand_engine.track.track import FINGER_BONES, angles_between_deg, jitter_deg

CHAIN = JointChain.of(CANONICAL_M)


def landmarks(joints_m, noise_px=0.0, noise_rad=0.0, seed=0):
    random = np.random.default_rng(seed)
    directions = bone_directions(joints_m)
    directions = directions + noise_rad * random.standard_normal(directions.shape)
    directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    pixels = CAMERA.project(joints_m)
    return Landmarks(pixels + noise_px * random.standard_normal(pixels.shape), directions, CAMERA, FPS)


def errors_deg(came_m, truth_m):
    return angles_between_deg(bone_directions(came_m), bone_directions(truth_m))[:, FINGER_BONES]


@pytest.fixture(scope="module")
def truth_m():
    return moving_poses(60).joints_m(CHAIN)


def test_exact_landmarks_give_the_motion_back(truth_m):
    found = fit(CHAIN, landmarks(truth_m), Trust(rest_rad=1e3, smoothing=0.0)).joints_m(CHAIN)
    # worst seen 2e-9 m: the fit stops when the cost hardly falls any more
    np.testing.assert_allclose(found, truth_m, atol=1e-7)


def test_smoothing_takes_noise_away(truth_m):
    noisy = landmarks(truth_m, noise_px=3.0, noise_rad=0.2)
    alone = fit(CHAIN, noisy, Trust(smoothing=0.0)).joints_m(CHAIN)
    smooth = fit(CHAIN, noisy).joints_m(CHAIN)
    assert np.median(errors_deg(smooth, truth_m)) < 0.45 * np.median(errors_deg(alone, truth_m)), "seen: 0.37"
    assert jitter_deg(smooth) < 0.1 * jitter_deg(alone), "seen: 0.065"


def test_smoothing_has_no_lag(truth_m):
    """What is played backwards is smoothed to what is smoothed, played backwards; a filter that lags cannot do that."""
    seen = landmarks(truth_m, noise_px=2.0, noise_rad=0.1)
    forwards = fit(CHAIN, seen).joints_m(CHAIN)
    backwards = fit(CHAIN, seen.part(slice(None, None, -1))).joints_m(CHAIN)[::-1]
    # worst seen 3e-13 degrees: the steps of both are the same
    assert errors_deg(backwards, forwards).max() < 1e-6


def test_bones_keep_their_lengths_and_joints_their_limits(truth_m):
    poses = fit(CHAIN, landmarks(truth_m, noise_px=6.0, noise_rad=0.5))
    lengths = bone_lengths(poses.joints_m(CHAIN))
    assert np.ptp(lengths, axis=0).max() < 1e-12
    assert (poses.angle_rad >= LIMITS_RAD[:, 0]).all()
    assert (poses.angle_rad <= LIMITS_RAD[:, 1]).all()


@pytest.mark.parametrize("gap_s", [0.0, 1.0])
def test_a_gap_is_closed_along_what_is_around_it(truth_m, monkeypatch, gap_s):
    """Evenly between ends that know nothing of each other, and by the fit."""
    monkeypatch.setattr(fit_module, "FIT_GAP_S", gap_s)
    monkeypatch.setattr(fit_module, "FIT_REACH_S", gap_s)
    gone = landmarks(truth_m)
    gone.image_px[25:31] = np.nan
    found = fit(CHAIN, gone).joints_m(CHAIN)
    held = np.concatenate([truth_m[:25], np.repeat(truth_m[24:25], 6, 0), truth_m[31:]])
    assert errors_deg(found, truth_m)[25:31].max() < 0.13 * errors_deg(held, truth_m)[25:31].max(), "seen: 0.115"


def test_before_it_is_first_seen_and_after_the_hand_holds_still(truth_m):
    gone = landmarks(truth_m)
    gone.image_px[:10] = np.nan
    gone.image_px[-5:] = np.nan
    found = fit(CHAIN, gone).joints_m(CHAIN)
    np.testing.assert_array_equal(found[:10], np.broadcast_to(found[10], found[:10].shape))
    np.testing.assert_array_equal(found[-5:], np.broadcast_to(found[-6], found[-5:].shape))


def test_single_wrong_landmarks_do_not_pull_the_hand_along(truth_m):
    wrong = landmarks(truth_m)
    random = np.random.default_rng(3)
    hit = random.random(wrong.image_px.shape[:2]) < 0.03
    wrong.image_px[hit] += random.uniform(60, 120, (int(hit.sum()), 2))
    error = errors_deg(fit(CHAIN, wrong).joints_m(CHAIN), truth_m)
    assert np.percentile(error, 95) < 2, "seen: 1.0 degrees; with plain squares 28"


def test_parts_of_a_long_video_meet_without_a_seam(truth_m, monkeypatch):
    noisy = landmarks(truth_m, noise_px=2.0, noise_rad=0.1)
    whole = fit(CHAIN, noisy).joints_m(CHAIN)
    monkeypatch.setattr(fit_module, "FIT_WINDOW_FRAMES", 20)
    monkeypatch.setattr(fit_module, "FIT_MARGIN_S", 15 / FPS)
    parts = fit(CHAIN, noisy).joints_m(CHAIN)
    # worst seen 0.15 degrees; what is farther away than the margin hardly matters
    assert errors_deg(parts, whole).max() < 0.3


def test_parts_of_a_fast_film_and_of_a_smoother_motion_reach_farther_around(monkeypatch):
    noisy = replace(landmarks(moving_poses(600, 60.0).joints_m(CHAIN), noise_px=3.5, noise_rad=0.3), fps=60.0)
    trust = Trust(smoothing=4.0)
    whole = fit(CHAIN, noisy, trust)
    monkeypatch.setattr(fit_module, "FIT_WINDOW_FRAMES", 2)
    differ = np.degrees(np.abs(fit(CHAIN, noisy, trust).angle_rad - whole.angle_rad))
    assert 0 < differ.max() < 1e-4, "seen: 5.3e-6 degrees; with 60 frames around each part 0.6"


def test_errors_of_landmarks_do_not_spread_the_fingers(truth_m, monkeypatch):
    noisy = landmarks(truth_m, noise_px=8.0, noise_rad=0.3)
    held = np.median(errors_deg(fit(CHAIN, noisy).joints_m(CHAIN), truth_m))
    monkeypatch.setattr(costs, "_FIRMNESS", np.ones(20))
    assert held < 0.9 * np.median(errors_deg(fit(CHAIN, noisy).joints_m(CHAIN), truth_m))


def test_one_picture_is_enough(truth_m):
    one = landmarks(truth_m).part(slice(7, 8))
    found = fit(CHAIN, one).joints_m(CHAIN)
    assert np.median(errors_deg(found, truth_m[7:8])) < 0.5, "seen: 0.22 degrees, the pull to rest"


def test_the_wish_for_steadiness_does_not_depend_on_the_rate():
    """The same motion seen twice as often is smoothed alike: variances per frame fall with the cube of the rate."""
    slow, fast = (Trust().steadiness(fps) for fps in (30.0, 60.0))
    assert slow is not None
    assert fast is not None
    np.testing.assert_allclose(fast.second / slow.second, 8.0)
    assert Trust(smoothing=0.0).steadiness(30.0) is None
    half = replace(Trust(), smoothing=2.0).steadiness(30.0)
    assert half is not None
    np.testing.assert_allclose(half.second / slow.second, 4.0)


# ---- gaps ------------------------------------------------------------------------------------------------------------


def away(joints_m, begin, end):
    """A perfectly seen motion, but for some frames."""
    seen = landmarks(joints_m)
    seen.image_px[begin:end] = seen.directions[begin:end] = np.nan
    return seen


def still(count, way_m=0.0, bent_rad=0.05):
    """A flat hand that keeps its pose and goes evenly to the side."""
    first = moving_poses(1)
    angle = np.clip(np.full((count, 20), bent_rad), LIMITS_RAD[:, 0], LIMITS_RAD[:, 1])
    angle[:, 1::4] = 0.0
    place = np.repeat(first.place_m, count, 0)
    place[:, 0] += np.linspace(0, way_m, count)
    return Poses(np.repeat(first.turn, count, 0), place, angle)


@pytest.mark.parametrize("smoothing", [0.0, 1.0])
@pytest.mark.parametrize("gap", [1, 5, 12, 20, 60, 90])
def test_in_a_gap_a_hand_that_keeps_its_pose_keeps_its_pose(gap, smoothing):
    truth = still(60 + gap, way_m=0.05)
    joints = truth.joints_m(CHAIN)
    found = fit(CHAIN, away(joints, 30, 30 + gap), Trust(smoothing=smoothing)).joints_m(CHAIN)
    whole = fit(CHAIN, landmarks(joints), Trust(smoothing=smoothing)).joints_m(CHAIN)
    # as in a film without a gap; worst seen 0.0054 degrees and 0.0039 mm
    assert errors_deg(found, whole).max() < 0.01
    assert np.abs(found - whole).max() < 1e-5


@pytest.mark.parametrize(("gap", "smoothing"), [(1, 0.0), (20, 0.0), (90, 0.0), (13, 1.0), (90, 1.0)])
def test_over_a_gap_the_hand_goes_the_shortest_way(gap, smoothing):
    """Frames alone over any; else over one that is too long to go on from the speed at its ends."""
    joints = moving_poses(60 + gap).joints_m(CHAIN)
    poses = fit(CHAIN, away(joints, 30, 30 + gap), Trust(smoothing=smoothing))
    ends = Poses(poses.turn[[29, 30 + gap]], poses.place_m[[29, 30 + gap]], poses.angle_rad[[29, 30 + gap]])
    between = ends.spread(np.array([0, gap + 1]), gap + 2)
    np.testing.assert_allclose(poses.angle_rad[29 : 31 + gap], between.angle_rad, atol=1e-12)
    np.testing.assert_allclose(poses.joints_m(CHAIN)[29 : 31 + gap], between.joints_m(CHAIN), atol=1e-12)


def test_what_is_seen_before_and_after_a_gap_helps_each_other_although_the_gap_is_filled_evenly(monkeypatch):
    """Bursts of two frames in a noisy film, 0.43 s between them."""
    joints = moving_poses(150).joints_m(CHAIN)
    noisy = landmarks(joints, noise_px=4.0, noise_rad=0.3)
    there = np.arange(150) % 15 < 2
    noisy.image_px[~there] = np.nan
    together = fit(CHAIN, noisy)
    monkeypatch.setattr(fit_module, "FIT_REACH_S", 0.0)
    alone = errors_deg(fit(CHAIN, noisy).joints_m(CHAIN), joints)
    error = errors_deg(together.joints_m(CHAIN), joints)
    assert error[there].mean() < 0.9 * alone[there].mean(), "seen: 0.8"
    assert error[~there].mean() < 0.95 * alone[~there].mean(), "seen: 0.9"
    evenly = together.part(there).spread(np.flatnonzero(there), 150)
    np.testing.assert_allclose(together.angle_rad, evenly.angle_rad, atol=1e-12)


@pytest.mark.parametrize("gap_s", [0.1, FIT_GAP_S])
@pytest.mark.parametrize(("begin", "end"), [(85, 97), (88, 100), (95, 125), (50, 270), (89, 91), (88, 92)])
def test_where_a_gap_lies_between_parts_of_a_long_video_there_is_no_seam(monkeypatch, begin, end, gap_s):
    """Gaps about the 90th frame, at which a part ends; one of them longer than a part with all that is around it."""
    monkeypatch.setattr(fit_module, "FIT_GAP_S", gap_s)
    monkeypatch.setattr(fit_module, "FIT_WINDOW_FRAMES", 90)
    monkeypatch.setattr(fit_module, "FIT_MARGIN_S", 20 / FPS)
    truth = still(300, way_m=0.3)
    found = fit(CHAIN, away(truth.joints_m(CHAIN), begin, end))
    steps = np.linalg.norm(np.diff(found.place_m, axis=0), axis=1)
    # worst seen 1.00323 mm, the way itself; 9 mm at a seam
    assert steps.max() < 1.0034e-3
    assert np.degrees(np.abs(np.diff(found.angle_rad, axis=0)).max()) < 0.006, "seen: 0.0039"


# ---- the steps -------------------------------------------------------------------------------------------------------


def noisy_costs(count=4, seed=1, overstep_rad=0.0, **trust):
    """Poses beside noisy landmarks, some beyond their limits, as a step sees them."""
    poses = moving_poses(count)
    seen = landmarks(poses.joints_m(CHAIN), noise_px=4.0, noise_rad=0.2, seed=seed)
    seen.image_px[2, 5] += 90.0  # a wrong one, which counts less
    step = 0.1 * np.random.default_rng(seed).standard_normal((count, 26)) * ([1] * 3 + [0.1] * 3 + [1] * 20)
    step[:, 9] += overstep_rad
    poses = poses.moved(step)
    return PoseCosts.of(CHAIN, seen, Trust(**trust), poses), poses


@pytest.mark.parametrize("trust", [{}, {"landmark": 1e3}, {"direction": 1e3}, {"landmark": 1e3, "direction": 1e3}])
def test_the_gradient_is_that_of_the_costs(trust):
    """Turn, place and angles; robust losses, limits and rest; also each of them by itself."""
    weighed, poses = noisy_costs(overstep_rad=2.0, **trust)
    gradient = weighed.derivatives(poses).gradient
    for place in range(26):
        step = np.zeros((len(poses), 26))
        step[:, place] = 1e-6
        costs = [weighed.costs(poses.moved(sign * step)) for sign in (1, -1)]
        # worst seen 1.4e-9 of the largest: round-off of the differences
        np.testing.assert_allclose((costs[0] - costs[1]) / 2e-6, gradient[:, place], atol=4e-9 * np.abs(gradient).max())


def test_the_gradient_of_bone_lengths_is_that_of_the_costs():
    """The fingers' bones; with those of the palm the axes turn a little too, which a step leaves out."""
    weighed, poses = noisy_costs()
    gradient = weighed.derivatives(poses, with_lengths=True).gradient[:, 31:]

    def costs(bone, change):
        factors = np.exp(change * np.eye(15)[bone]).reshape(3, 5, 1)
        chain = replace(CHAIN, bones_m=factors * CHAIN.bones_m)
        # landmarks count in parts of the hand's length, which a step keeps
        larger = chain.bone_lengths_m[[2, 7, 12, 17]].sum() / CHAIN.bone_lengths_m[[2, 7, 12, 17]].sum()
        trust = replace(weighed.trust, landmark=weighed.trust.landmark / larger)
        return replace(weighed, chain=chain, trust=trust).costs(poses)

    for bone in range(15):
        difference = (costs(bone, 1e-6) - costs(bone, -1e-6)) / 2e-6
        np.testing.assert_allclose(difference, gradient[:, bone], atol=4e-9 * np.abs(gradient).max())


def test_a_frame_that_fits_badly_does_not_end_the_fit_of_the_others(truth_m):
    """Frames alone are fitted each for itself: what is beside them changes nothing."""
    seen = landmarks(truth_m, noise_px=5.0, noise_rad=0.3)
    seen.image_px[7] = seen.image_px[7, ::-1]
    together = fit(CHAIN, seen, Trust(smoothing=0.0)).joints_m(CHAIN)
    for frame in (3, 20, 41):
        one = fit(CHAIN, seen.part(slice(frame, frame + 1)), Trust(smoothing=0.0)).joints_m(CHAIN)
        np.testing.assert_allclose(together[frame], one[0], atol=1e-12)
