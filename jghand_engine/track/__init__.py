"""A motion out of a video: pictures to landmarks, landmarks to one hand, that hand to a smooth motion.

video.py         pictures of a video file, one at a time
detection.py     what a detector of hands says about a picture, and the interface it has
model_file.py    where the detector's networks are, and how they come there
mediapipe_hands.py  the detector: MediaPipe, an optional package
second_look.py   at parts of the picture, for hands that were overlooked
hands_over_time.py  detections of single pictures to at most one right and one left hand over time
skeleton.py      a hand of constant bones: angles to joints, with derivatives
poses.py         landmarks of a hand over time, and the poses of that skeleton
look.py          how well poses explain landmarks, frame by frame, and how that changes with them
own_hand.py      the proportions of the hand that was seen
smoother.py      the linear algebra of smoothing forwards and backwards at once
fit.py           the motion of that skeleton that explains the landmarks best
track.py         all of it
proof.py         what was seen and what came of it, side by side
figures.py       how far off, how jittery, how late a motion is
"""

# horizontal angle of view that is assumed of an unknown camera, degrees: a telephone's or webcam's
CAMERA_ANGLE_DEG = 60.0
