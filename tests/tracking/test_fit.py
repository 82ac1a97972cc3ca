"""The motion that explains landmarks best."""

from dataclasses import replace

import numpy as np
import pytest
from tracking_samples import CAMERA, CANONICAL_M, FPS, moving_poses

from jghand_engine import limits
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.sequence import bone_directions
from jghand_engine.tracking.figures import FINGER_BONES, angles_between_deg, directions_in_palm, jitter_deg, lag_ms
from jghand_engine.tracking.fit import Landmarks, Trust, fit
from jghand_engine.tracking.skeleton import LIMITS_RAD, Skeleton

SKELETON = Skeleton.of(CANONICAL_M)


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
    return moving_poses(60).joints_m(SKELETON)


def test_exact_landmarks_give_the_motion_back(truth_m):
    found = fit(SKELETON, landmarks(truth_m), Trust(rest_rad=1e3, smoothing=0.0)).joints_m(SKELETON)
    # worst seen 2e-9 m: the fit stops when the cost hardly falls any more
    np.testing.assert_allclose(found, truth_m, atol=1e-7)


def test_smoothing_takes_noise_away(truth_m):
    noisy = landmarks(truth_m, noise_px=3.0, noise_rad=0.2)
    alone = fit(SKELETON, noisy, Trust(smoothing=0.0)).joints_m(SKELETON)
    smooth = fit(SKELETON, noisy).joints_m(SKELETON)
    assert np.median(errors_deg(smooth, truth_m)) < 0.45 * np.median(errors_deg(alone, truth_m)), "seen: 0.37"
    assert jitter_deg(smooth) < 0.1 * jitter_deg(alone), "seen: 0.065"


def test_smoothing_has_no_lag(truth_m):
    """What is played backwards is smoothed to what is smoothed, played backwards; a filter that lags cannot do that."""
    seen = landmarks(truth_m, noise_px=2.0, noise_rad=0.1)
    forwards = fit(SKELETON, seen).joints_m(SKELETON)
    backwards = fit(SKELETON, seen.part(slice(None, None, -1))).joints_m(SKELETON)[::-1]
    # worst seen 3e-13 degrees: the steps of both are the same
    assert errors_deg(backwards, forwards).max() < 1e-6
    exact = fit(SKELETON, landmarks(truth_m)).joints_m(SKELETON)
    palms = [directions_in_palm(joints, CANONICAL_M) for joints in (exact, truth_m)]
    assert abs(lag_ms(palms[0], palms[1], FPS)) <= 2, "seen: 1 ms; a frame has 33"


def test_bones_keep_their_lengths_and_joints_their_limits(truth_m):
    poses = fit(SKELETON, landmarks(truth_m, noise_px=6.0, noise_rad=0.5))
    lengths = bone_lengths(poses.joints_m(SKELETON))
    assert np.ptp(lengths, axis=0).max() < 1e-12
    assert (poses.angle_rad >= LIMITS_RAD[:, 0]).all()
    assert (poses.angle_rad <= LIMITS_RAD[:, 1]).all()


def test_a_gap_is_closed_along_what_is_around_it(truth_m):
    gone = landmarks(truth_m)
    gone.image_px[25:31] = np.nan
    found = fit(SKELETON, gone).joints_m(SKELETON)
    held = np.concatenate([truth_m[:25], np.repeat(truth_m[24:25], 6, 0), truth_m[31:]])
    assert errors_deg(found, truth_m)[25:31].max() < 0.3 * errors_deg(held, truth_m)[25:31].max(), "seen: 0.18"


def test_before_it_is_first_seen_and_after_the_hand_holds_still(truth_m):
    gone = landmarks(truth_m)
    gone.image_px[:10] = np.nan
    gone.image_px[-5:] = np.nan
    found = fit(SKELETON, gone).joints_m(SKELETON)
    np.testing.assert_array_equal(found[:10], np.broadcast_to(found[10], found[:10].shape))
    np.testing.assert_array_equal(found[-5:], np.broadcast_to(found[-6], found[-5:].shape))


def test_single_wrong_landmarks_do_not_pull_the_hand_along(truth_m):
    wrong = landmarks(truth_m)
    random = np.random.default_rng(3)
    hit = random.random(wrong.image_px.shape[:2]) < 0.03
    wrong.image_px[hit] += random.uniform(60, 120, (int(hit.sum()), 2))
    error = errors_deg(fit(SKELETON, wrong).joints_m(SKELETON), truth_m)
    assert np.percentile(error, 95) < 2, "seen: 1.0 degrees; with plain squares 28"


def test_parts_of_a_long_video_meet_without_a_seam(truth_m, monkeypatch):
    noisy = landmarks(truth_m, noise_px=2.0, noise_rad=0.1)
    whole = fit(SKELETON, noisy).joints_m(SKELETON)
    monkeypatch.setattr(limits, "FIT_WINDOW_FRAMES", 20)
    monkeypatch.setattr(limits, "FIT_MARGIN_FRAMES", 15)
    parts = fit(SKELETON, noisy).joints_m(SKELETON)
    # worst seen 0.15 degrees; what is farther away than the margin hardly matters
    assert errors_deg(parts, whole).max() < 0.3


def test_one_picture_is_enough(truth_m):
    one = landmarks(truth_m).part(slice(7, 8))
    found = fit(SKELETON, one).joints_m(SKELETON)
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
