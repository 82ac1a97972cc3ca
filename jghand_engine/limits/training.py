"""Limits of training and its metrics."""

from __future__ import annotations

# ---- training: losses and metrics -----------------------------------------------------------------------------------
# window and constants of SSIM, which every paper shares (Wang et al. 2004); 0..1 is the range of the pictures
SSIM_WINDOW_PX = 11
SSIM_SIGMA_PX = 1.5
SSIM_K1 = 0.01
SSIM_K2 = 0.03
# weights of the five scales of MS-SSIM, the finest first (Wang, Simoncelli, Bovik 2003)
MS_SSIM_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
# thinnest box that is measured: what the networks of ST-LPIPS and LPIPS can halve four times
METRIC_BOX_MIN_PX = 32
# floor of the length of a feature vector, as both networks were trained with it
PERCEPTUAL_NORM_EPS = 1e-10
# PSNR of equal pictures is infinite, which no mean survives; 8-bit pictures that differ at all are below 84
PSNR_MAX_DB = 100.0
# figures are given apart for pictures whose fingers are bent, on the mean of their joints, below, between and above
# these angles, degrees: an open, a relaxed, a half closed hand and a fist
FLEXION_REGIONS_DEG = (15.0, 35.0, 60.0)
# sheets of pictures: side of the square over that of the hand in it; difference 0..1 that has the darkest color (a
# good avatar stays below it nearly everywhere); poses between the two ends (METHOD 6.3)
SHEET_ROOM = 1.12
SHEET_DIFFERENCE_FULL = 0.2
SHEET_STEPS_BETWEEN = 4
# a learned offset counts as quadratic below this length, meters: at 0 a plain norm has no gradient, and offsets start
# there; a hundredth of a millimeter is nothing that could be seen
OFFSET_LENGTH_EPS_M = 1e-5

# ---- training: the loop ----------------------------------------------------------------------------------------------
# second moments below this are noise: Adam's own 1e-8 would hold back planes whose texels are seldom seen
ADAM_EPS = 1e-15
# pixels kept around the hand when a picture is cut to it: as far as SSIM's window and a stray Gaussian reach
CROP_MARGIN_PX = 10
# cut pictures kept in memory, bytes; 60 kB each at 512 x 334, so that 16,000 fit
PICTURE_CACHE_BYTES = 1_000_000_000
# ... and of what a pose needs of the bones, bytes; 3.5 MB each at 40,000 Gaussians
POSE_CACHE_BYTES = 2_000_000_000
# visibility below which the shadow is black: its power with the learned gain has a finite gradient
VISIBILITY_MIN = 1e-3
# held-out views by which a training is judged while it runs: one alone can fall while their mean rises. Drawing one
# takes some 100 ms, once a minute
JUDGED_VIEWS = 8
# checkpoints that are kept, beside the one with the best fixed views: one more than the last, should that be damaged
CHECKPOINTS_KEPT = 2
# seconds between two checkpoints: what kill -9 may lose. Writing one takes some 40 ms (RENDERING 14, promise 20)
CHECKPOINT_EVERY_S = 60.0
# seconds to the first preview, which is promised within a minute, and between two later ones
FIRST_PREVIEW_S = 15.0
PREVIEW_EVERY_S = 180.0
# steps that one line of the log averages
LOG_EVERY_STEPS = 20
# steps between two copies of the state in memory, to which the guard goes back: a copy costs a few milliseconds
GUARD_KEEP_STEPS = 50
# ... and at the beginning, where the plan of a time budget has to find the speed
GUARD_KEEPS_AT_FIRST = (2, 5, 10, 20)
# values that are not finite after which a training gives up: one or two happen, more are a fault of the model
GUARD_RECOVERIES_MAX = 5
# steps that a training with a time budget is taken to have until its speed is known
PLANNED_STEPS_AT_FIRST = 10_000
# how long `jghand train` trains when it is not told, minutes; with the paper's configuration rounds of all pictures
TRAINING_MINUTES = 60.0
PAPER_ROUNDS = 30
# seconds between two lines of progress where no terminal shows a bar
PROGRESS_LINE_S = 15.0
