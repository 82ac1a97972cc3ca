"""From what a detector sees to a motion."""

import numpy as np
import pytest
from tracking_samples import CANONICAL_M, FPS, HEIGHT, WIDTH, right_joints_m, seen, sight

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import bone_lengths, hand_length
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.hand.sequence import bone_directions, rebuilt
from jghand_engine.track.track import (
    FINGER_BONES,
    MOTION_FROM_CAMERA,
    Sightings,
    TrackOptions,
    angles_between_deg,
    jitter_deg,
    track,
)

RIGHT, LEFT = Handedness.RIGHT, Handedness.LEFT


def errors_deg(came_m, truth_m):
    return angles_between_deg(bone_directions(came_m), bone_directions(truth_m))[:, FINGER_BONES]


@pytest.fixture(scope="module")
def truth_m():
    return right_joints_m(40)


@pytest.fixture(scope="module")
def tracked(truth_m):
    return track(sight(truth_m).sightings, CANONICAL_M)[RIGHT]


def test_a_perfectly_seen_motion_is_found(tracked, truth_m):
    assert np.median(errors_deg(tracked.in_view, truth_m)) < 0.6, (
        "seen: 0.3 degrees, the smoothing and the pull to rest"
    )
    assert np.abs(tracked.in_view - truth_m).max() < 0.003, "seen: 1.6 mm"


def test_the_motion_has_y_up_and_looks_at_the_viewer(tracked):
    np.testing.assert_array_equal(tracked.sequence.joints_m, tracked.in_view * MOTION_FROM_CAMERA)
    up = tracked.sequence.joints_m[:, 3] - tracked.sequence.joints_m[:, 0]
    assert (up[:, 1] > 0.05).all(), "fingers are up in the pictures"
    assert (tracked.sequence.joints_m[..., 2] < 0).all(), "before the camera"


def test_the_motion_has_the_avatars_bones(tracked):
    lengths = bone_lengths(tracked.sequence.joints_m)
    np.testing.assert_allclose(lengths, np.broadcast_to(bone_lengths(CANONICAL_M), lengths.shape), atol=1e-12)


def test_a_left_hand_is_the_mirror_image_of_the_right_one(tracked, truth_m):
    left = track(sight(truth_m * (-1, 1, 1), LEFT).sightings, CANONICAL_M)[LEFT]
    assert left.sequence.handedness is LEFT
    np.testing.assert_allclose(left.sequence.joints_m * (-1, 1, 1), tracked.sequence.joints_m, atol=1e-9)


def test_frames_without_the_hand_are_filled_and_marked(truth_m):
    sightings = sight(truth_m).sightings
    for frame in (0, 12, 13, 14, 39):
        sightings.frames[frame] = []
    hand = track(sightings, CANONICAL_M)[RIGHT]
    assert np.flatnonzero(hand.sequence.filled).tolist() == [0, 12, 13, 14, 39]
    assert hand.sequence.valid.all()
    assert errors_deg(hand.in_view, truth_m)[12:15].max() < 4, "seen: 1.8 degrees"


@pytest.mark.parametrize("smoothing", [0.0, 1.0])
@pytest.mark.parametrize("gap", [10, 45, 100])
def test_a_hand_that_keeps_its_pose_is_filled_in_with_that_pose_however_long_it_was_away(gap, smoothing):
    pose = right_joints_m(1)[0]
    joints = pose + np.linspace(0, 0.05, 40 + gap)[:, None, None] * (1, 0, 0)
    sightings = sight(joints).sightings
    for frame in range(20, 20 + gap):
        sightings.frames[frame] = []
    hand = track(sightings, CANONICAL_M, TrackOptions(smoothing=smoothing))[RIGHT]
    assert hand.sequence.filled.sum() == gap
    # worst seen 0.45 degrees: as the film goes on the hand is seen from another side, and fingers are drawn to rest
    assert errors_deg(hand.in_view, np.broadcast_to(hand.in_view[19], joints.shape)).max() < 0.5
    steps = np.linalg.norm(np.diff(hand.in_view[:, 0], axis=0), axis=-1)
    assert steps.max() < 1.003 * 0.05 / (39 + gap), "seen: 1.0016 of the way in a frame"


def test_hands_that_cross_are_two_motions():
    joints, x = right_joints_m(90), np.linspace(-0.15, 0.15, 90)
    across = x[:, None, None] * np.array([1.0, 0.0, 0.0])
    truth = {RIGHT: joints + across, LEFT: joints * (-1, 1, 1) - across}
    frames = [
        [seen(truth[side][k], side) for side in (RIGHT, LEFT) if abs(x[k]) > 0.03 or (side is RIGHT) == (x[k] < 0)]
        for k in range(90)
    ]
    found = track(Sightings(FPS, (HEIGHT, WIDTH), frames), CANONICAL_M)
    assert set(found) == {RIGHT, LEFT}
    for side, hand in found.items():
        assert np.median(errors_deg(hand.in_view, truth[side])[hand.seen]) < 0.5, "seen: 0.47 degrees, the pull to rest"
        assert np.abs(hand.in_view - truth[side])[hand.seen].max() < 0.004, "seen: 3.8 mm"


@pytest.mark.parametrize("off_m", [(-0.24, 0.0, 0.0), (0.24, -0.05, 0.0)])
def test_a_hand_at_the_border_is_found_as_one_in_the_middle(truth_m, off_m):
    truth = truth_m + off_m
    hand = track(sight(truth).sightings, CANONICAL_M)[RIGHT]
    assert np.median(errors_deg(hand.in_view, truth)) < 0.6, "seen: 0.51 degrees, the pull to rest"
    assert np.abs(hand.in_view - truth).max() < 0.004, "seen: 3.4 mm"


def test_or_their_joints_are_left_missing(truth_m):
    sightings = sight(truth_m).sightings
    sightings.frames[12] = []
    sequence = track(sightings, CANONICAL_M, TrackOptions(fill=False))[RIGHT].sequence
    assert sequence.gaps.frames == (12,)
    assert not sequence.filled.any()


def test_a_known_length_sets_the_size_of_hand_and_way(tracked, truth_m):
    length = 1.25 * hand_length(CANONICAL_M)
    larger = track(sight(truth_m).sightings, CANONICAL_M, TrackOptions(hand_length_m=length))[RIGHT].sequence
    assert abs(hand_length(larger.joints_m) - length) < 1e-12
    ratio = larger.joints_m[:, 0] / tracked.sequence.joints_m[:, 0]
    assert np.abs(np.median(ratio) - 1.25) < 1e-4, "a larger hand that looks the same is farther away"


def test_own_bones_keep_their_lengths_too(truth_m):
    sequence = track(sight(truth_m).sightings, CANONICAL_M, TrackOptions(own_bones=True))[RIGHT].sequence
    assert np.ptp(bone_lengths(sequence.joints_m), axis=0).max() < 1e-12


def test_without_a_hand_there_is_no_motion():
    assert track(sight(np.zeros((0, 21, 3))).sightings, CANONICAL_M) == {}


@pytest.mark.parametrize(
    "options",
    [
        {"hand_length_m": 18.0},
        {"hand_length_m": float("nan")},
        {"smoothing": -1.0},
        {"smoothing": float("nan")},
        {"camera_angle_deg": 0.0},
        {"camera_angle_deg": 180.0},
    ],
)
def test_what_cannot_be_is_refused(options):
    with pytest.raises(InputError):
        TrackOptions(**options).check()


def test_a_bone_that_swings_to_and_fro_has_that_jitter():
    """Three degrees to either side in turn: six from the middle of where it was and will be."""
    canonical = np.broadcast_to(bone_directions(CANONICAL_M[None]), (9, 20, 3))
    side = np.radians(3.0) * (-1.0) ** np.arange(9)
    across = np.cross(canonical[0], (0.3, 0.5, 0.8))
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    turn = vector_rotation(side[:, None, None] * across)
    swinging = np.einsum("fbij,fbj->fbi", turn, canonical)
    joints = rebuilt(np.zeros((9, 3)), swinging, np.full(20, 0.03))
    assert abs(jitter_deg(joints) - 6.0) < 1e-9
    assert jitter_deg(np.broadcast_to(CANONICAL_M, (9, 21, 3))) == 0.0
    assert np.isnan(jitter_deg(joints[:2]))
