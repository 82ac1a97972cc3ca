"""Limits of captures."""

from __future__ import annotations

# ---- capture: the rig ------------------------------------------------------------------------------------------------
# largest turn of the metacarpals of index, middle, ring and pinky, degrees: the first two hardly move, the others make
# the hollow of the palm (6 and 12: DATA 4)
CAPTURE_CUP_DEG = (0.5, 1.0, 6.0, 12.0)
# part of it for a finger that is fully bent at its knuckle, for a thumb wholly across the palm, and for a hand at rest
CAPTURE_CUP_FLEXION = 0.65
CAPTURE_CUP_OPPOSITION = 0.30
CAPTURE_CUP_REST = 0.05
# how far below flat a stretched finger may press its metacarpal, as a part of the largest turn
CAPTURE_CUP_FLATTEN = 0.25

# ---- capture: poses --------------------------------------------------------------------------------------------------
# poses of one capture: beyond it the choice of varied ones takes minutes
CAPTURE_POSES_MAX = 5000
# transitions and random poses to choose from: so many for every pose, and at least
CAPTURE_CANDIDATES = 4
CAPTURE_CANDIDATES_LEAST = 200
# part of a range that an extreme pose uses: people reach the ends of a table of ranges one joint at a time
CAPTURE_EXTREME_PART = 0.95
# largest delay of a finger in a transition, as a part of it
CAPTURE_FINGER_DELAY = 0.25
# standard deviation of what is added to angles so that no shape is made twice alike, degrees
CAPTURE_VARIATION_DEG = 4.0
# how far a finger of a random pose may leave the others, as a part of the range
CAPTURE_FINGER_FREEDOM = 0.45
# DIP flexion that a PIP flexion brings along, and what is left to the finger, degrees (one standard deviation)
CAPTURE_DIP_OF_PIP = 0.62
CAPTURE_DIP_LOOSE_DEG = 7.0
# bones of random poses stay this part of the hand's length (wrist to middle tip) apart: about 11 mm, a little less than
# a finger is thick, because skin gives way
CAPTURE_GAP_PART = 0.062
# the last two bones of a bent finger stay this part of the hand's length away from the metacarpals: finger tips then
# lie on the palm; judged by eye on pictures of fists
CAPTURE_PALM_GAP_PART = 0.075
# flexions are scaled down to this for it, at most, in so many steps
CAPTURE_EASE_MOST = 0.7
CAPTURE_EASE_STEPS = 31
# rounds of alternating projection for the gap between two bones
CAPTURE_GAP_ROUNDS = 8

# ---- capture: cameras ------------------------------------------------------------------------------------------------
CAPTURE_CAMERAS_MAX = 500
# edges of a picture, pixels: below nothing is seen of a hand, above Cycles takes minutes a picture
CAPTURE_SIZE_PX = (16, 4096)
# distance from the middle of the hands, meters: like the stages of the data sets
CAPTURE_DISTANCE_M = (0.8, 1.1)
# largest roll about the viewing direction, degrees
CAPTURE_ROLL_DEG = 12.0
# part of the picture left free on each side of all poses
CAPTURE_MARGIN = 0.03
# height of the viewing direction beyond which it is steep, and the picture's upper edge is no longer the fingers' way
CAPTURE_STEEP = 0.85
# close-ups: distance, and what the shorter edge of the picture shows there, meters: about two fingers' lengths
CAPTURE_CLOSE_M = 0.45
CAPTURE_CLOSE_FIELD_M = 0.11

# ---- capture: skin ---------------------------------------------------------------------------------------------------
# edge of the baked texture: 0.4 mm of skin per texel, finer than a pixel of a whole hand at 334 x 512 (0.5 mm)
CAPTURE_SKIN_PX = 1024
# edges that a skin picture may have, pixels
CAPTURE_TEXTURE_PX = (64, 8192)
# skin this far above the lower edge gives the wrist's cut its color, meters
CAPTURE_WRIST_BAND_M = 0.012
# mottling that a coarse picture cannot hold: (cell in meters, amount), and how strongly it darkens red, green, blue
CAPTURE_MOTTLING = ((0.0026, 0.022), (0.0011, 0.022))
CAPTURE_MOTTLING_RGB = (0.55, 1.0, 1.0)
# depth of a furrow that a picture shows as a dark line, meters, and the shade (sRGB) at which it is nearly reached
CAPTURE_RELIEF_M = 0.00022
CAPTURE_RELIEF_SHADE = 0.035
# grain of skin that no picture holds: its height and its cells, meters; finer ones are lost between texels
CAPTURE_GRAIN_M = 0.000012
CAPTURE_GRAIN_CELL_M = 0.0009

# ---- capture: plan and worker ----------------------------------------------------------------------------------------
# rays per pixel: 1 is a test, beyond the most the denoiser has nothing left to do
CAPTURE_SAMPLES = (1, 4096)
# every so manieth pose, and one of so many cameras, is kept for the test
CAPTURE_EVERY_POSE = 5
CAPTURE_EVERY_CAMERA = 6
# waiting for another process that is just taking its shard or writing the plan, seconds: it needs milliseconds, or a
# few seconds on a slow disk
CAPTURE_LOCK_WAIT_S = 30.0
# how long Blender may take to end, seconds, and how many lines of its last words are told
CAPTURE_END_S = 20.0
CAPTURE_LAST_WORDS = 4
