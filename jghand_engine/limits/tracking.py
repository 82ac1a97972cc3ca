"""Limits of tracking: motions out of videos."""

from __future__ import annotations

# ---- tracking: the video ---------------------------------------------------------------------------------------------
# pictures larger than 8K are refused: a decoder takes several times their bytes before anything can be looked at
VIDEO_PIXELS_MAX = 8192 * 4320
VIDEO_EDGE_MAX_PX = 16384
# edges below this show no hand
VIDEO_EDGE_MIN_PX = 16
# pictures longer than so many times their width are refused: the second look goes along them in squares of two thirds
# of their width, at this aspect 28 of them (0.4 s)
VIDEO_ASPECT_MAX = 5.0
# larger pictures are made smaller while they are read: the detector looks at hands of 224 pixels
TRACK_EDGE_PX = 1920
# longer videos are refused, or cut off there if they do not say how long they are: some kilobytes per frame and hand
# stay in memory; nearly two hours at 30 per second
TRACK_FRAMES_MAX = 200_000
NTSC_RATE_TOLERANCE = 6e-3
# times between pictures vary where the mean rate differs from the most frequent one by more than this part; less comes
# of printing them rounded
UNEVEN_RATE_PART = 2e-3
# rates beyond this are a time base, not a rate
VIDEO_FPS_MAX = 1000.0
# seconds after which looking at a video's header is given up
VIDEO_PROBE_S = 60.0

# ---- tracking: the detector ------------------------------------------------------------------------------------------
# MediaPipe's own thresholds for finding a hand, for its presence and for following it
DETECTION_MIN = 0.5
PRESENCE_MIN = 0.5
FOLLOWING_MIN = 0.5
HANDS_MAX = 2
# seconds after which fetching its networks, 35 MB, is given up
FETCH_MODEL_S = 600.0

# ---- tracking: a second look at parts of the picture -----------------------------------------------------------------
# edge of the parts, of the shorter edge of the picture
SEARCH_PART = 2 / 3
# seconds between looks at all parts while no hand is seen, and beside one that is
SEARCH_S = 0.25
SEARCH_BESIDE_S = 1.0
# edge of what is looked at about a hand that was just lost, in parts of its size
CLOSE_LOOK_PART = 3.0

# ---- tracking: which detection is which hand -------------------------------------------------------------------------
# two detections nearer than this part of the hand's size are the same hand
SAME_HAND_PART = 0.35
# between frames a hand moves at most this part of its size per frame at 30 frames per second, else it is another one
HAND_STEP_PART = 1.2
# after so many seconds out of sight a hand's place says nothing any more
HAND_LOST_S = 0.5
# ... but up to so many seconds a hand that looks like it (difference in looks at most this, 0..1) is it again: it may
# have been behind the other one
HAND_HIDDEN_S = 2.0
HAND_UNLIKE_MAX = 0.5
# what a detection that looks surely like the other hand costs, in parts of the hand's size: more than a hand goes while
# it is behind the other one
HAND_UNLIKE_COST = 1.0
# what a second out of sight costs, in parts of the hand's size: a hand that is seen all the time goes on before one
# that was wrongly seen there long ago, unless it jumps by more
HAND_AWAY_COST = 0.3
# a hand that is seen for less than this is taken for a mistake: seconds, in short films a part of the pictures, and in
# any so many
HAND_SEEN_S = 2.0
HAND_SEEN_PART_MIN = 0.05
HAND_SEEN_FRAMES_MIN = 3
# a hand that shares more than this part of its pictures with another one of its kind is another person's
HAND_DOUBLE_PART = 0.25
# below this certainty, 0..1, of which hand it is, that is told
HAND_CERTAINTY_LOW = 0.3

# ---- tracking: the fit (standard deviations; measured with scripts/check_tracking.py, docs/TRACKING.md) --------------
# horizontal angle of view that is assumed of an unknown camera, degrees: a telephone's or webcam's
CAMERA_ANGLE_DEG = 60.0
# ... and what can be said of one
CAMERA_ANGLES_DEG = (1.0, 150.0)
# error of a landmark in the picture, part of the hand's length
LANDMARK_SIGMA = 0.015
# error of the direction of a bone in the detector's estimate in space, radians
DIRECTION_SIGMA = 0.3
# errors beyond this many standard deviations count less and less (Cauchy's loss)
ROBUST_SIGMAS = 3.0
# overstepping a joint's limit, radians
LIMIT_SIGMA_RAD = 0.02
# acceleration of joint angles and of the palm's turn, rad/s^2, and of the wrist, m/s^2, as white noise sampled at 30
# frames per second: a finger closes in 0.4 s with a peak of 57 rad/s^2
ANGLE_ACCELERATION = 25.0
TURN_ACCELERATION = 25.0
PLACE_ACCELERATION = 4.0
# speeds, rad/s and m/s: they hold a long gap back from swinging beyond its ends
ANGLE_SPEED = 8.0
TURN_SPEED = 8.0
PLACE_SPEED = 2.0
SMOOTHING_FPS = 30.0
# beyond this a motion is hardly one any more
SMOOTHING_MAX = 100.0
# pull of an angle to its rest, radians: only for what no picture shows
REST_SIGMA_RAD = 1.2
# Gauss-Newton steps; the steps end when the cost falls by less than this part, with no more damping than the first
FIT_STEPS = 30
FIT_TOLERANCE = 1e-5
# damping of its steps: the first, and between which it stays; beyond the largest no step helps any more
FIT_DAMPING = 1e-3
FIT_DAMPING_MIN = 1e-9
FIT_DAMPING_MAX = 1e6
# longest step of an angle, radians, and of the wrist, meters: as far as the linearization reaches
FIT_STEP_RAD = 0.6
FIT_STEP_M = 0.3
# no joint is taken to be nearer to the camera, meters, and no hand to be smaller in the picture, pixels
FIT_DEPTH_MIN_M = 1e-2
HAND_SPREAD_MIN_PX = 1e-3
# proportions of the hand that is seen: how far a bone's length differs from the start's, relative; frames that are
# looked at, as many of them as count as independent, and rounds of fitting poses and lengths in turn
OWN_HAND_SIGMA = 0.03
OWN_HAND_FRAMES = 200
OWN_HAND_PICTURES = 30
OWN_HAND_ROUNDS = 12
# gaps of up to so many seconds are filled by the fit, which goes on from the speed before to that after; in longer ones
# it swings farther beyond both ends and is hardly nearer (measured: docs/TRACKING.md)
FIT_GAP_S = 0.4
# what is seen on both sides of a gap of up to so many seconds is fitted together: bursts of a few frames are better
# for what is around them
FIT_REACH_S = 1.0
# frames that are fitted together at least, and how many seconds more on both sides so that the seam is not felt; at
# most so many frames there, for memory (0.1 MB per frame): with much smoothing in fast films seams may be felt
FIT_WINDOW_FRAMES = 900
FIT_MARGIN_S = 2.0
FIT_MARGIN_FRAMES_MAX = 1200

# ---- tracking: the proof ---------------------------------------------------------------------------------------------
# longer edge of each half of the side-by-side video
PROOF_EDGE_PX = 640
# how much is shown around the hands, and how far a small one is enlarged
PROOF_MARGIN = 1.3
PROOF_ENLARGED_MAX = 3.0

# ---- tracking: judging -----------------------------------------------------------------------------------------------
# how far a lag is looked for, seconds, and in which steps
LAG_MAX_S = 0.25
LAG_STEP_S = 0.001
