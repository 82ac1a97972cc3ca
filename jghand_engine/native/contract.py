"""The numbers that every form of the drawing agrees on: kernels, float64 reference, formats that others draw.

Those that the kernels compile in are repeated in constants.h, and a test compares the two; the others are handed to
them. Changing one of the first group changes what trained avatars look like: they were learned with it.
"""

from __future__ import annotations

# ---- rasterization (RENDERING 3 and 8) ------------------------------------------------------------------------------

# pixel footprint added to the projected variance, px^2; weights are trained with it
BLUR_PX2 = 0.3
# contribution below which a Gaussian does not touch a pixel: one 8-bit step
ALPHA_MIN = 1.0 / 255.0
# cap of one contribution; bounds 1/(1 - alpha) in the backward pass by 1e3
ALPHA_MAX = 0.999
# transmittance below which a pixel may stop; error at most T_STOP * max(rgb)
T_STOP = 1e-4
# near plane, meters
Z_NEAR_M = 0.01
# alpha above which a pixel has a depth
DEPTH_ALPHA_MIN = 0.05
# largest projected variance, px^2: keeps float-to-int conversion and det^2 inside their ranges
VAR_MAX_PX2 = 1e9
# colors beyond this overflow float32 in the gradients; counted as invalid
RGB_MAX = 1e6
# part of a pixel's alpha, at least, that is taken for seen from outside: from below on its color goes to black. Less
# (0.005) would leave rims of surfaces, up to a millimeter beyond the Gaussians, their color, but show the
# cut of the blend by its inverse
FRONT_MIN = 0.04
# coverage from which such a picture shows anything: Gaussians are round, and wider at an outline than skin ends
COVER_FROM = 0.15
# transmittance below which a Gaussian gives such a picture none of its color, and above which all: between those of one
# layer an eighth of what is right beneath is seen, which in back light is brighter by ten times and more
BENEATH_FROM, BENEATH_WHOLE = 0.1, 0.5
# coverage from which on all of a pixel is covered: nothing beneath would add to its color
COVER_WHOLE = 1 - BENEATH_FROM
# where the skin at a pixel is known Gaussians from so far before to so far behind it are its own, meters of a hand of
# scale 1, more where it is steep, up to so many times: they lie a millimeter below it, and are as wide. Others have
# this part of their alpha, so that skin without Gaussians of its own has a color, too
OWN_BEFORE_M, OWN_BEHIND_M, OWN_STEEPEST, OTHERS_PART = 1.5e-3, 3e-3, 4.0, 0.1
# skin so much deeper than that of the next pixel is behind its edge, meters of a hand of scale 1, and widths of a
# pixel, as in small pictures round skin has such steps all over
EDGE_STEP_M, EDGE_STEEPNESS = 2e-3, 4.0
# how near nothing is, 1/m
NOT_NEAR = -3e38
# coordinates beyond this are counted as invalid, meters: depth is blended like a color, and has the same limit
POSITION_MAX_M = 1e6
# a covariance is positive semi-definite when it is with this part of its trace added to the diagonal: what float32
# leaves of a flat Gaussian has eigenvalues down to -6.3e-8 of the trace
COVARIANCE_SLACK = 1e-6
# smallest cut-off of the kernel: its exponential is good down to 2^-32
NATIVE_ALPHA_MIN = 1e-9
# longest side of an image, px: tile coordinates are int16
IMAGE_MAX_PX = 65_536
# edge of a tile and of a block, px; Gaussians per chunk. Speed only, must not show in the image
TILE_PX = 16
BLOCK_PX = 4
CHUNK = 128
# entries of the tile lists are int32
MAX_PAIRS = 2**31 - 1
# gradient buffers, added in this fixed order so that threads do not change bits
GRADIENT_STRIPES = 4

# ---- self-shadow (METHOD 5.2) ---------------------------------------------------------------------------------------

# reach, meters; one longer than a hand finds nothing more
SHADOW_RADIUS_M = 0.020
# occlusion curve, and darkness before an avatar has learned its own
SHADOW_BIAS = 0.15
SHADOW_SOFTNESS = 0.05
SHADOW_GAIN = 8.0
# strength per channel, 0..1: skin shadows are reddish (chosen by eye on the built-in avatar)
SHADOW_TINT = (0.60, 0.75, 0.80)
# (1 + |bias|) / softness: above it the exponent of the occlusion curve leaves what the kernel's 2^x covers
SHADOW_STEEPNESS_MAX = 80.0
# screen radius of the sample disc, px
SHADOW_RADIUS_MIN_PX = 1.0
SHADOW_RADIUS_MAX_PX = 96.0
# taps per pixel; more cost time and change nothing visible
SHADOW_SAMPLES_MAX = 256
# their angle from one to the next, a sunflower
GOLDEN_ANGLE_RAD = 2.399963229728653
# |v| is smoothed by this part of the radius: never sqrt(0)
SHADOW_LENGTH_EPS = 1e-3
# depth that the kernel gives a pixel without any, meters: farther than the shadow's reach from everything
SHADOW_FAR_M = 1e6
# normals come from depth differences over this length, meters: the depth of splats is bumpy by tenths of a millimeter
# over the size of a Gaussian, and one-pixel normals of it speckle. Against ray-traced occlusion of smooth surfaces it
# is as good or better (correlation 0.81 / 0.78 / 0.58 / 0.81 instead of 0.79 / 0.76 / 0.57 / 0.80)
SHADOW_NORMAL_REACH_M = 0.003
# what stands out of the tangent plane by less than this does not occlude, meters: the pits between Gaussians would show
# as specks (no loss against ray-traced occlusion up to 0.6 mm)
SHADOW_HEIGHT_MIN_M = 4e-4
# the two one-sided differences are averaged when they agree within this part of the smaller one, or by less than so
# many meters: bumps. Otherwise the smaller is taken, so that a normal never spans a silhouette
SHADOW_AGREE = 0.5
SHADOW_AGREE_FLOOR_M = 5e-4
# floor of |t_x x t_y|^2, m^4: a degenerate normal becomes the zero vector instead of NaN
SHADOW_NORMAL_MIN2 = 1e-36
# gradient buffers of the shadow, one per stripe of rows, added in this fixed order: threads do not change bits
SHADOW_STRIPES = 4
