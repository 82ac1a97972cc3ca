"""Limits of drawing."""

from __future__ import annotations

# ---- splat: the rasterization contract (RENDERING 3 and 8) ----------------------------------------------------------
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
# largest projected variance, px^2: keeps float-to-int conversion and det^2 inside their ranges
VAR_MAX_PX2 = 1e9
# colors beyond this overflow float32 in the gradients; counted as invalid
RGB_MAX = 1e6
# meters at which parallel rays are taken to meet: their directions differ by 1e-7 over a hand then, float32's rounding
PARALLEL_EYE_M = 1e6
# coordinates beyond this are counted as invalid, meters: depth is blended like a color, and has the same limit
POSITION_MAX_M = 1e6
# a covariance is positive semi-definite when it is with this part of its trace added to the diagonal: what float32
# leaves of a flat Gaussian has eigenvalues down to -6.3e-8 of the trace
COVARIANCE_SLACK = 1e-6
# smallest cut-off of the native kernel: its exponential is good down to 2^-32
NATIVE_ALPHA_MIN = 1e-9
# largest picture side: tile coordinates are int16
PICTURE_MAX_PX = 65_536
# pixels of a tile edge, of a block edge; Gaussians per chunk. Speed only, must not show in the picture
TILE_PX = 16
BLOCK_PX = 4
CHUNK = 128
# entries of the tile lists are int32
MAX_PAIRS = 2**31 - 1
# gradient buffers, added in this fixed order so that threads do not change bits
GRADIENT_STRIPES = 4
# pairs of pixel and Gaussian that the torch reference holds at once: some 30 MB per intermediate in float64
REFERENCE_PAIRS_AT_ONCE = 4_000_000
# alpha above which a pixel has a depth
DEPTH_ALPHA_MIN = 0.05

# ---- splat: shadow (METHOD 5.2) -------------------------------------------------------------------------------------
SHADOW_RADIUS_M = 0.020
# a longer reach than a hand is long finds nothing more
SHADOW_RADIUS_MAX_M = 0.2
SHADOW_BIAS = 0.15
SHADOW_SOFTNESS = 0.05
SHADOW_GAIN = 8.0
# screen radius of the sample disc, px
SHADOW_RADIUS_MIN_PX = 1.0
SHADOW_RADIUS_MAX_PX = 96.0
# (1 + |bias|) / softness: above it the exponent of the occlusion curve leaves what the kernel's 2^x covers
SHADOW_STEEPNESS_MAX = 80.0
# |v| is smoothed by this part of the radius: never sqrt(0)
SHADOW_LENGTH_EPS = 1e-3
# depth that the kernel gives a pixel without any, meters: farther than the shadow's reach from everything
SHADOW_FAR_M = 1e6
# taps per pixel; more cost time and change nothing visible
SHADOW_SAMPLES_MAX = 256
# normals come from depth differences over this length, meters: the depth of splats is bumpy by tenths of a millimeter
# over the size of a Gaussian, and one-pixel normals of it speckle. Against ray-traced occlusion of smooth surfaces it
# is as good or better (correlation 0.81 / 0.78 / 0.58 / 0.81 instead of 0.79 / 0.76 / 0.57 / 0.80, METHOD 5.2)
SHADOW_NORMAL_REACH_M = 0.003
# what stands out of the tangent plane by less than this does not occlude, meters: the pits between Gaussians would show
# as specks (no loss against ray-traced occlusion up to 0.6 mm)
SHADOW_HEIGHT_MIN_M = 4e-4
# the two one-sided differences are averaged when they agree within this part of the smaller one; otherwise the smaller
# is taken, so that a normal never spans a silhouette
SHADOW_AGREE = 0.5
# ... and always when they differ by less than this, meters: bumps
SHADOW_AGREE_FLOOR_M = 5e-4
# floor of |t_x x t_y|^2, m^4: a degenerate normal becomes the zero vector instead of NaN
SHADOW_NORMAL_MIN2 = 1e-36
# gradient buffers of the shadow, one per stripe of rows, added in this fixed order: threads do not change bits
SHADOW_STRIPES = 4
# strength per channel, 0..1: skin shadows are reddish (chosen by eye on the built-in avatar)
SHADOW_TINT = (0.60, 0.75, 0.80)
GOLDEN_ANGLE_RAD = 2.399963229728653
# gate from the joints alone: radius of influence, meters, and the score over which the pass fades in
GATE_RADIUS_M = 0.060
GATE_LOW = 0.5
GATE_HIGH = 1.0
# capsule radii of bones 1..20, millimeters at scale 1 (METHOD 5.4)
GATE_CAPSULE_RADII_MM = (
    *(16.0,) * 5, 10.0, 9.0, 9.0, 8.5, 7.5, 9.0, 8.0, 8.0, 7.8, 7.0, 8.0, 7.2, 7.2, 7.0, 6.2,
)  # fmt: skip
# occlusion that is seen: the part of the hand's pixels beyond it is what the gate is judged by (METHOD 5.4)
GATE_NEED = 0.2
# samples along each capsule's axis: 5 x 5 distances per pair of bones; penetration is capped (a deep overlap of two
# bones must not hide the others)
GATE_SAMPLES = 5
GATE_PENETRATION_MAX = 1.5
# a shadow that never changes a pixel by more, as it was measured, is not drawn: two 8-bit steps, on the darkest pixel
SHADOW_UNSEEN = 2 / 255
# hands smaller than this on the picture get no shadow pass, px; it fades in up to the second size
SHADOW_HAND_MIN_PX = 64.0
SHADOW_HAND_FULL_PX = 96.0

# ---- splat: half resolution ------------------------------------------------------------------------------------------
# depths that differ by less are of one surface, meters: less than a finger's thickness, more than a pixel's slope
SAME_SURFACE_M = 0.005

# ---- splat: so many milliseconds a frame -----------------------------------------------------------------------------
# part of a budget that 95 % of the measured frames may take: the rest is for whoever shows the picture
BUDGET_PART = 0.9
# how long a machine that knows nothing of itself measures, seconds
BUDGET_SECONDS = 2.0
# pictures smaller than this lose more by half the size than by fewer Gaussians (built-in hand), pixels
HALF_PIXELS_MIN = 600_000
# accuracy of a whole picture over black from which on an artist sees no difference, has to look for it, sees it at once
LOOKS_SAME_DB = 45.0
LOOKS_ALIKE_DB = 38.0
LOOKS_CLOSE_DB = 30.0

# ---- splat: reuse between frames ------------------------------------------------------------------------------------
# matrices are reused when no joint moved more than this, meters
REUSE_JOINTS_M = 5e-5
# ... and the skin then lacks at most this, meters. Joints that move against each other turn bones: the skin of the
# trained hand moves by up to 5 times their movement in usual poses (0.25 mm), and by up to 11 times where bones are
# half and one and a half times as long in turn
REUSE_SKIN_M = 6e-4
# ... but where a finger is bent further than any hand can, radians, by up to 14 times: such hands are reused only when
# nothing moved at all
REUSE_BENT_MAX = 2.4
# ... and the correctives when no angle changed more than this, radians: a hand that moves as a whole keeps them
REUSE_ANGLE_RAD = 2e-4
# ... and the skin then lacks at most this, meters (the built-in hand's named poses: 0.06 mm, every angle at its limit)
REUSE_CORRECTION_M = 1e-4

# ---- splat: only the effects a scene calls for (RENDERING 11) -------------------------------------------------------
# a hand whose median Gaussian is smaller than this on the picture is drawn larger and averaged, px: the low pass of
# 0.55 px would swell it. It fades in down to the second size, and is never switched
FILTER_SIGMA_PX = 0.5
FILTER_SIGMA_FULL_PX = 0.35
# times larger at most, and pixels of such a drawing at most
FILTER_FACTOR_MAX = 8
FILTER_PIXELS_MAX = 4_000_000
# when the hand's box is smaller than this part of the picture, only the box is drawn
CROP_PART_MAX = 0.5
# ... and the shadow of single pixels then differs by at most this, where a sample falls on another pixel (worst seen:
# 0.014)
CROP_SHADOW = 0.015
# ... and offsets of the correctives are stretched by at most this: where two bones at 112 degrees share the skin, their
# mean map keeps its volume by stretching along the axis by cos(56 degrees)^(-2/3) = 1.47
OFFSET_STRETCH = 1.5
# its edges stand at multiples of this, px: tiles stay where they were, and buffers are seldom made anew
CROP_STEP_PX = 64
# the faint tail: contributions between 1/255 and this, and what the picture keeps without them, dB (the shipped hands:
# 51 to 57; RENDERING 9.1 has 59 for a shell of fewer layers)
TAIL_ALPHA_MIN = 1.0 / 1024.0
TAIL_PSNR_DB = 50.0
# estimated cost on one core of the machine of RENDERING, milliseconds per Gaussian, per pixel, per pixel and sample
SKIN_MS = 5e-6
NETWORK_MS = 2.7e-4
LINEAR_MS = 2e-5
CAST_MS = 2e-5
RASTER_MS = 1.3e-4
TAIL_MS = 1.3e-5
MAP_MS = 1e-6
SHADOW_MS = 3e-7
