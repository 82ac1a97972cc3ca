"""Limits of hands, their joints and motions."""

from __future__ import annotations

# ---- hand: safe rotations and frames (thresholds are relative to the hand size unless a unit is given) --------------
# relative length, sine or distance to a pole below which the gradient (never the value) is damped; larger values
# bend gradients of ordinary hands, smaller ones let 1/|b| through
GRADIENT_DAMPING = 0.05
# multiple of machine epsilon below which a bone has no direction
ZERO_BONE_EPS = 32.0
# sine between neighboring palm bones below which the palm plane is clamped towards the canonical one (C1)
PALM_CLAMP = 0.02
# distance (radians, nearly) to a pole of the swing inside which the fallback acts and a flag is raised
SWING_POLE = 1e-3
# |z x n| below which a metacarpal takes its flexion axis from the canonical hand
FLEXION_AXIS_MIN = 1e-3
# part of the palm's area vector perpendicular to the palm axis below which there is no palm normal
PALM_NORMAL_MIN = 1e-4
# palm plane length, relative to PALM_CLAMP, below which the canonical plane is used outright
PALM_PLANE_MIN = 1e-3
# floor of s_i / s_g inside the power of the blended scale: its gradient is infinite at a zero bone
SCALE_RATIO_MIN = 1e-2
# a canonical hand is refused when a bone is shorter than this part of the mean bone
CANONICAL_BONE_MIN = 1e-3
# ... or when neighboring palm bones enclose a smaller sine
CANONICAL_PALM_SINE_MIN = 0.04
# ... or when a joint is nearer than this to the abduction pole, as 1 - |u_y|
CANONICAL_POLE_MIN = 0.02

# ---- hand: plausibility of joints ---------------------------------------------------------------------------------
# index..pinky: metacarpal at least this times the proximal phalanx (anatomy; a wrong joint order breaks it)
METACARPAL_RATIO_MIN = 1.3
# index..pinky: first phalanx at least this times the second; below 1 because video estimates shorten the pinky's
PHALANX_RATIO_MIN = 0.85
# wrist to middle tip, meters: outside this range the unit is most likely not meters
HAND_LENGTH_MIN_M = 0.06
HAND_LENGTH_MAX_M = 0.40
# path index-middle-ring-pinky knuckle over the direct way: a hand's arch gives 1.05, two swapped fingers 1.6 and more
KNUCKLE_DETOUR_MAX = 1.35
# place of a metacarpal's base on the line wrist to knuckle, which OpenXR lists (0.33 to 0.37 in the rig that the
# template comes from)
OPENXR_METACARPAL_PART = 0.34
# frames per second of a motion: outside this range it is most likely a frame count or milliseconds
FPS_MIN = 0.1
FPS_MAX = 10_000.0

# ---- hand: named poses ----------------------------------------------------------------------------------------------
# tips touch: air of this part of the finger chain's length (about 3 mm) weighs as much as turning one joint by the
# pull; a weaker pull bends fingers oddly to close the last tenth of a millimeter
TOUCH_PART = 0.02
TOUCH_PULL_DEG = 40.0
# half a finger's thickness and half the thumb's, as part of that length: the tip's joint stays so far from the bone
TOUCH_THICKNESS_PART = 0.07
# Gauss-Newton steps and the step of its differences; four steps reach the end on the built-in hand
TOUCH_STEPS = 8
TOUCH_DIFFERENCE_DEG = 1e-3

# ---- hand: motions of others --------------------------------------------------------------------------------------
# bones that vary by less than this (standard deviation, meters) are constant: text with few digits
BONE_WOBBLE_MIN_M = 1e-4
# part of a frame by which a time may miss it and still be that frame: round-off of clocks in text
FRAME_EPS = 1e-6
# more frames than this are a mistake of a file or of its clock: two hours at 120 per second
MOTION_FRAMES_MAX = 1_000_000
# poses that are taken between frames at once: 4096 with all that is on the way have 60 MB
POSES_AT_ONCE = 4096
