"""Limits of studies."""

from __future__ import annotations

# ---- studies --------------------------------------------------------------------------------------------------------
# accuracy of the paper's avatars (RENDERING 9.1): what an error beside it costs is said of a model as good as this, dB
MODEL_PSNR_DB = 33.4
# points on the skin of the transformation table: 1.4 mm apart, well below the distances that it tells apart
TRANSFORM_STUDY_POINTS = 20_000

# ---- studies: numerical stability -----------------------------------------------------------------------------------
# distances, as parts of the hand's size, at which hands beside a singularity are tried as well
STABILITY_JITTERS = (1e-12, 1e-9, 1e-7, 1e-5, 1e-3)
# hands at each of those distances
STABILITY_BESIDE = 20
# error of the joints whose effect on the skin is measured, meters: that of a good motion capture
STABILITY_NUDGE_M = 5e-4
# nudges tried for every hand, in random directions
STABILITY_NUDGES = 64
# hands and nudges where a network has to be asked for each of them
STABILITY_FEW = 15
# points of the skin that are watched, of the template's 1610
STABILITY_SKIN_POINTS = 400
# what a nudge may move any of them by, meters (METHOD 2.11)
STABILITY_SKIN_MAX_M = 2e-3
# gradient times hand size (METHOD 2.11)
STABILITY_GRADIENT_MAX = 1e5
# float32 against float64, meters on a hand of ordinary size (METHOD 2.11, of the joints)
STABILITY_PRECISION_MAX_M = 5e-7
# promise 3 of RENDERING 14: a pixel differs by less from the reference, unless a contribution falls on the other side
# of the cut, which is worth one 8-bit step
STABILITY_PIXEL_MAX = 1.1e-4
STABILITY_FLIP_MAX = 1 / 255
# pixels of a small picture in which that may happen
STABILITY_FLIPPED_MAX = 2
# how far everything in a picture is moved to see whether a pixel jumps, meters
STABILITY_PICTURE_NUDGE_M = 1e-6
# Gaussians and side of the picture in which a hand is compared with the reference
STABILITY_GAUSSIANS = 1500
# anchors of its cast shadow: at all 2,048 the gradients of one row's hands took 6 GB
STABILITY_ANCHORS = 128
STABILITY_PICTURE_PX = 64
# ... and what a pixel may change by then, in 8-bit steps: one contribution at the cut, and the movement itself
STABILITY_STEPS_MAX = 1.1
# the usual guards of the formulas that ours are set against: "length + eps", clipped arc cosine
USUAL_EPS = 1e-8
USUAL_CLIP = 1e-6
# side of the hands drawn both ways, pixels
STABILITY_VIEW_PX = 300

# ---- studies: their pictures -----------------------------------------------------------------------------------------
# resolution and colors of a picture's file: below 300 kB together
PLOT_DPI = 110
PLOT_COLORS = 128

# ---- studies: accuracy against time ----------------------------------------------------------------------------------
# contribution below which a Gaussian does not touch a pixel of the picture that all others are measured against
ACCURACY_ALPHA_MIN = 1e-6
# poses of such pictures, which take seconds each, and how many pixels they have all together at most
ACCURACY_POSES = 6
ACCURACY_PIXELS = 1_200_000
# prefixes of an avatar's Gaussians, and sizes of the linear form of its correctives, that are compared
ACCURACY_COUNTS = (10_000, 20_000, 30_000, 40_000, 60_000, 120_000)
ACCURACY_BASES = (4, 8, 16, 32)
# made-up poses that the linear forms are fitted to: fewer than `jghand bake` takes, for time
ACCURACY_DISTIL_POSES = 60
# frames of each setting, and those before them that are not counted (RENDERING 9.3)
ACCURACY_ROUNDS = 150
ACCURACY_WARM_UP = 10
# pictures of each kind of a capture that every setting is compared with, where nobody says another number
ACCURACY_PICTURES = 3
# part by which medians of one run differ without a reason: a preset is on the front unless something is faster by more
FRONT_NOISE = 0.05
# side of the part of the picture that is shown of a setting, pixels
ACCURACY_CROP_PX = 150
# curves of growing time: Gaussians, sizes up to 4K, hands, poses in a batch; frames of each point
GROWTH_GAUSSIANS = (10_000, 30_000, 100_000, 300_000, 1_000_000)
GROWTH_SIZES_PX = ((256, 167), (512, 334), (1024, 668), (1920, 1080), (3840, 2160))
GROWTH_HANDS = (1, 2, 4)
GROWTH_POSES = (1, 10, 100, 1000)
GROWTH_ROUNDS = 12
