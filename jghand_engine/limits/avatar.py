"""Limits of avatars, drawn and learned."""

from __future__ import annotations

# ---- avatar ---------------------------------------------------------------------------------------------------------
# radius of a Gaussian, meters
SIGMA_MIN_M = 1e-4
SIGMA_MAX_M = 4e-3
# posed radius relative to the whole hand's scale: blending rotations shrinks the determinant at flexed knuckles
SIGMA_STRETCH_MIN = 0.7
SIGMA_STRETCH_MAX = 1.4
# length of a quaternion at or below which it is no rotation, and counts as none
QUATERNION_MIN = 1e-6
# |det L| / s_g^3 below which the blended rotation is replaced by the palm's
BLEND_DET_MIN = 1e-3
# Gaussians deeper than this, meters, grow in a coarser level of detail only until they are this many of their own
# radii below the skin: further grown they would show as a halo around the hand
DEEP_M = 1e-3
DEEP_RADII = 1.8
# weights per Gaussian in a compact file: on the built-in hand the rest holds at most 0.8 % of a row, 0.004 % on average
STORED_WEIGHTS = 7
# a file with more Gaussians or a longer header is refused before anything is allocated
AVATAR_MAX_GAUSSIANS = 1_000_000
AVATAR_HEADER_MAX_BYTES = 65_536
# placed points that the user's cache keeps, the newest: 5 MB each at 40,000 Gaussians
POINTS_CACHE_FILES = 8
# characters of one text in an avatar's description (name, template, license, an angle's name): they are shown in a line
AVATAR_TEXT_MAX = 500
# canonical Gaussians further than this from the wrist along an axis, meters, belong to no hand
AVATAR_REACH_M = 0.5

# ---- avatar: the learned hand (METHOD 4) -----------------------------------------------------------------------------
# logarithm of the strongest light and shade: exp(3) is 20 times, farther than any display reaches
LIGHT_EXPONENT_MAX = 3.0
# strongest shade that a pose may add or take, as a logarithm: what the shadow and the light do not explain
SHADE_MAX = 0.5
# squared length below which a normal counts as none
NORMAL_LENGTH2_MIN = 1e-12
# standard deviation of feature planes at the start (METHOD 4.2)
PLANE_START_STD = 0.1
# logarithm of the longest and shortest axis of a Gaussian over its radius: 20 times, a needle
LOG_STRETCH_MAX = 3.0
# how far a learned normal may leave the template's, per unit of the decoder's output
NORMAL_BEND = 0.3
# logarithm of the greatest and least shine over their middle: skin is equally glossy nearly everywhere, and cameras
# that were not learned from show what was taken for gloss
SHINE_SPREAD = 0.5
# lobes of the gloss at the start: wide, lambda of exp(lambda (cos - 1)), and nearly dark, before the softplus;
# a sharper lobe than the last is narrower than what a Gaussian of half a millimeter can show
LOBE_SHARPNESS_START = 5.0
LOBE_SHARPNESS_MAX = 60.0
LOBE_RAW_START = -4.5
# learnable range of the shadow's darkness g (METHOD 5.2: 4 to 12; wider, because a shadow may be better off)
SHADOW_GAIN_RANGE = (1.0, 12.0)
# what a file may hold of what was learned; beyond it nothing was learned from pictures, and memory or floats run out:
# lobes of the gloss; color, rim and shine that they may have; gain of the shadow; octaves of an encoding, widths and
# texels of the pose's network, and its weights
LIGHT_LOBES_MAX = 64
LIGHT_VALUE_MAX = 1e3
SHADOW_GAIN_MAX = 100.0
POSE_NET_OCTAVES_MAX = 12
POSE_NET_WIDTH_MAX = 1024
POSE_NET_TEXELS_MAX = 256
POSE_NET_WEIGHT_MAX = 1e4
# Gaussians times the width of the pose's network: drawing without compiled code holds about three layers of so many
# float32, 0.8 GB together; a trained hand has 60,000 x 128, an eighth of it
POSE_NET_UNITS_MAX = 64_000_000
# by how much the length of a stored normal may be off 1
NORMAL_LENGTH_TOLERANCE = 1e-3
# largest basis of the linear tier of the correctives
BASIS_MAX = 64
# how far a joint may leave the range of angles that was trained, degrees, before it is told: the skin of a good avatar
# carries on so far (assumed)
POSE_RANGE_TOLERANCE_DEG = 8.0
# distilling: poses that are made up; wobble of flexion, abduction and palm angles, degrees; how far beyond the known
# range, degrees: as far as the angles of a hand between two learned poses go
DISTIL_POSES = 400
DISTIL_WOBBLE_DEG = (8.0, 3.0)
DISTIL_WOBBLE_PALM_DEG = 2.0
DISTIL_BEYOND_DEG = 5.0
# penalty on directions, per pose, for numbers of variance 1; variance of a component over the largest below which it is
# noise; Gaussians at once: bounds the memory to some 400 MB
DISTIL_RIDGE = 1e-4
DISTIL_VARIANCE_MIN = 1e-6
DISTIL_GAUSSIANS_AT_ONCE = 2048
# ranges of the angles between neighboring palm bones (theta^p) and palm planes (theta^n), degrees (METHOD 4.1)
PALM_NEIGHBOR_RANGES_DEG = ((0.0, 60.0), (0.0, 30.0), (0.0, 30.0), (0.0, 30.0))
PALM_PLANE_RANGES_DEG = ((-30.0, 60.0), (-20.0, 40.0), (-20.0, 40.0))

# ---- avatar: cast shadows -------------------------------------------------------------------------------------------
# lamps around the hand, and points of the skin at which they are counted: one per 20 mm^2
LAMPS = 64
# logarithm of a lamp's brightness per unit of its parameter: lamps differ much more than other parameters do
LAMP_RATE = 10.0
ANCHORS = 2048
# distances of a Gaussian to its anchors count as longer by this, meters: no anchor takes all
ANCHOR_SOFTENING_M = 1e-4
# flesh is a point's own up to this many radii from its bone, and wholly foreign from this many on
OWN_FLESH_RADII = (1.15, 1.6)
# edges of shadows: softness of the capsule's surface, as a part of its radius, and half width of a lamp per distance
# (64 lamps on a sphere are 0.25 in radius; sharper edges learned poses a little better, with less than half of it)
FLESH_SOFTNESS = 0.2
LAMP_HALF_WIDTH = 0.15
# floors against division by zero: squared length of a capsule's axis (m^2), squared sine between ray and axis, width of
# an edge (m)
CAPSULE_LENGTH2_MIN = 1e-12
CAPSULE_SINE2_MIN = 1e-3
CAPSULE_WIDTH_MIN_M = 1e-6
# light that reaches skin which sees no lamp, from other skin, over that of all lamps together, at the start; and its
# floor, against division by zero
BOUNCED_START = 0.03
BOUNCED_MIN = 1e-12
# display-referred colors go with light to this power
LIGHT_TO_DISPLAY = 1 / 2.2
# what a file may hold: lamps; by how much shares and weights of an anchor, of 16 bits, may sum to something else than 1
CAST_LAMPS_MAX = 256
# ... and anchors times lamps: the torch form holds some ten float32 for each; ours has 131,072 pairs
CAST_PAIRS_MAX = 4_000_000
CAST_SUM_TOLERANCE = 5e-3
# a row of bone weights, of a template or an avatar, that is further from 1 than this was not meant as weights: float32
# rounding of 21 summands leaves less than 1e-6
WEIGHT_SUM_TOLERANCE = 1e-5
# signed distance that d = 0..1 of the UVD coordinates spans, meters (a fixed range: features must not shift)
UVD_RANGE_M = 0.010
