"""A motion out of a video: frames to landmarks, landmarks to one hand, that hand to a smooth motion.

video            frames of a video file, one at a time
detection        what a detector of hands says about an image, and a second look for what it missed
mediapipe_hands  the detector: MediaPipe, an optional package, and its networks
hands_over_time  detections of single images to at most one right and one left hand over time
poses            a hand of constant bones, its landmarks over time and its poses
costs            how well poses explain landmarks, and how that changes with them
fit              the motion that explains the landmarks best
own_hand         the proportions of the hand that was seen
track            all of it
proof            what was seen and what came of it, side by side
"""

# angle of view across the longer edge that is assumed of an unknown camera, degrees: the main cameras of telephones
# have 63 to 70 in films
CAMERA_ANGLE_DEG = 66.0
