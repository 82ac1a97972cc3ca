"""Every numerical constant of the engine: value, unit, why, and what breaks when it changes.

Grouped by room. The kernels receive these values as arguments or repeat them in `native/constants.h`, which a test
compares with this file.
"""

from __future__ import annotations

# ---- colour (IEC 61966-2-1) -----------------------------------------------------------------------------------------
# below this sRGB value the curve is a straight line of this slope
SRGB_TOE = 0.04045
SRGB_SLOPE = 12.92
SRGB_OFFSET = 0.055
SRGB_EXPONENT = 2.4

# ---- hand: safe rotations and frames (thresholds are relative to the hand size unless a unit is given) --------------
# relative length, sine or distance to a pole below which the gradient (never the value) is damped; larger values
# bend gradients of ordinary hands, smaller ones let 1/|b| through
GRADIENT_DAMPING = 0.05
# multiple of machine epsilon below which a bone has no direction
ZERO_BONE_EPS = 32.0
# sine between neighbouring palm bones below which the palm plane is clamped towards the canonical one (C1)
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
# ... or when neighbouring palm bones enclose a smaller sine
CANONICAL_PALM_SINE_MIN = 0.04
# ... or when a joint is nearer than this to the abduction pole, as 1 - |u_y|
CANONICAL_POLE_MIN = 0.02

# ---- hand: plausibility of joints ---------------------------------------------------------------------------------
# index..pinky: metacarpal at least this times the proximal phalanx (anatomy; a wrong joint order breaks it)
METACARPAL_RATIO_MIN = 1.3
# index..pinky: first phalanx at least this times the second; below 1 because video estimates shorten the pinky's
PHALANX_RATIO_MIN = 0.85
# wrist to middle tip, metres: outside this range the unit is most likely not metres
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
# rate of a motion file that declares none and is told none: that of most cameras
DEFAULT_FPS = 30.0
# a motion file larger than this, packed or unpacked, is refused: an hour at 120 frames per second has 220 MB
MOTION_MAX_BYTES = 1 << 30
# the same for .json and .csv, whose numbers take ten times their text while they are read: an hour at 30
MOTION_TEXT_MAX_BYTES = 1 << 27

# ---- hand: named poses ----------------------------------------------------------------------------------------------
# tips touch: air of this part of the finger chain's length (about 3 mm) weighs as much as turning one joint by the
# pull; a weaker pull bends fingers oddly to close the last tenth of a millimetre
TOUCH_PART = 0.02
TOUCH_PULL_DEG = 40.0
# half a finger's thickness and half the thumb's, as part of that length: the tip's joint stays so far from the bone
TOUCH_THICKNESS_PART = 0.07
# Gauss-Newton steps and the step of its differences; four steps reach the end on the built-in hand
TOUCH_STEPS = 8
TOUCH_DIFFERENCE_DEG = 1e-3

# ---- template -------------------------------------------------------------------------------------------------------
# spread of the split of the wrist's weight over the metacarpals, metres (assumed; METHOD 2.7)
PALM_SPLIT_SIGMA_M = 0.012
# distance from the wrist over which the palm blends to the wrist matrix, metres (assumed)
WRIST_BLEND_M = 0.015
# weight field: voxel edge, margin around the surface, sweeps per level, levels (METHOD 3.4)
FIELD_VOXEL_M = 0.003
FIELD_MARGIN_M = 0.012
FIELD_SWEEPS = 30
FIELD_LEVELS = 4
# a row of bone weights, of a template or an avatar, that is further from 1 than this was not meant as weights: float32
# rounding of 21 summands leaves less than 1e-6
WEIGHT_SUM_TOLERANCE = 1e-5
# weights below this are dropped and the rest renormalised: far joints would drag skin by fractions of a millimetre
WEIGHT_MIN = 1e-3
# closest points: faces are searched in pieces of at most this radius (metres), so many at first, and so many in all.
# Speed only: the search asks for more pieces until it is certain
CLOSEST_PIECE_RADIUS_M = 0.002
CLOSEST_FIRST_CANDIDATES = 8
CLOSEST_PIECES_MAX = 2_000_000
# (points x candidates) worked on at once: bounds the memory to about 100 MB
CLOSEST_BATCH = 300_000
# laying out textures: triangles are widened by this part of themselves, so that shared edges leave no gap; twice the
# smallest area that is drawn, texels^2
UV_EDGE_SLACK = 0.02
UV_DOUBLE_AREA_MIN_PX2 = 1e-12
# empty border of a layout made by us and the gap between its parts; texels in which room for the cap is looked for
UV_MARGIN = 0.02
UV_ROOM_PX = 256
# depth of the shell of Gaussians under the skin, metres; deeper ones are hidden
SHELL_DEPTH_M = 0.003
GAUSSIANS_PER_BONE = 3000
# farthest-point order takes (points per bone)^2 steps
SHELL_PER_BONE_MAX = 20_000
# edge of the cells from which the shell is drawn, metres: speed only
SHELL_CELL_M = 0.003
# draws per wanted point after which a bone is taken to have no skin (built-in hand: at most 11)
SHELL_DRAWS_MAX = 1000
# signed distance that d = 0..1 of the UVD coordinates spans, metres (a fixed range: features must not shift)
UVD_RANGE_M = 0.010

# ---- template: files of other people -------------------------------------------------------------------------------
# MANO's files have 4 MB and a few thousand operations and 30 MB of numbers; larger ones are not MANO. The bytes bound
# the file, and once more all that its calls produce; an operation takes half a kilobyte at most
PICKLE_BYTES_MAX = 64 * 2**20
PICKLE_OPERATIONS_MAX = 200_000
PICKLE_ELEMENTS_MAX = 20_000_000
# rows of MANO's skin weights sum to 1 within rounding; further off they are no such weights
MANO_WEIGHT_SUM_TOLERANCE = 1e-3
OBJ_BYTES_MAX = 64 * 2**20
# all arrays of a template file together, unpacked
NPZ_BYTES_MAX = 64 * 2**20
# records inside records: MANO's deepest is a Select of a Ch of an array
PICKLE_NESTING_MAX = 5
# radius of the disk that the wrist cap gets in a UV square, at most; and its part of the free circle there
CAP_UV_RADIUS_MAX = 0.06
CAP_UV_FILL = 0.8

# ---- avatar ---------------------------------------------------------------------------------------------------------
# radius of a Gaussian, metres
SIGMA_MIN_M = 1e-4
SIGMA_MAX_M = 4e-3
# posed radius relative to the whole hand's scale: blending rotations shrinks the determinant at flexed knuckles
SIGMA_STRETCH_MIN = 0.7
SIGMA_STRETCH_MAX = 1.4
# length of a quaternion at or below which it is no rotation, and counts as none
QUATERNION_MIN = 1e-6
# |det L| / s_g^3 below which the blended rotation is replaced by the palm's
BLEND_DET_MIN = 1e-3
# Gaussians deeper than this, metres, grow in a coarser level of detail only until they are this many of their own
# radii below the skin: further grown they would show as a halo around the hand
DEEP_M = 1e-3
DEEP_RADII = 1.8
# weights per Gaussian in a compact file: on the built-in hand the rest holds at most 0.8 % of a row, 0.004 % on average
STORED_WEIGHTS = 7
# a file with more Gaussians or a longer header is refused before anything is allocated
AVATAR_MAX_GAUSSIANS = 1_000_000
AVATAR_HEADER_MAX_BYTES = 65_536
# characters of one text in an avatar's description (name, template, licence, an angle's name): they are shown in a line
AVATAR_TEXT_MAX = 500
# canonical Gaussians further than this from the wrist along an axis, metres, belong to no hand
AVATAR_REACH_M = 0.5

# ---- datasets -------------------------------------------------------------------------------------------------------
# grey value of a mask file from which a pixel is hand: JPEG smears the edge over some pixels around the middle
MASK_THRESHOLD = 128
# samples per pixel edge when a template is projected: steps of 1/16 in the coverage of a pixel
MASK_SUPERSAMPLING = 4
# grey values between which the avatar papers take a pixel of a projected mask for skin (METHOD 6.1)
PAPER_MASK_GREY = (10, 200)
# the same papers leave a picture out when the hand's box is nearer to the border than this or smaller, pixels; when it
# is as dark as this; when two colour channels differ nowhere by more than this; when the mask has fewer pixels
PAPER_BORDER_PX = 10
PAPER_BOX_MIN_PX = 80
PAPER_DARK = 20
PAPER_CHANNEL_DIFFERENCE = 1
PAPER_MASK_MIN_PX = 3000
# width and height of HanCo's pictures
HANCO_SIZE_PX = (224, 224)
HANCO_CAMERAS = 8
# last bytes of a picture file in which its end mark must stand; some cameras pad the file behind it
PICTURE_TAIL_BYTES = 64
# by how much a stored camera rotation may fail to be one: text with six digits
CAMERA_ROTATION_TOLERANCE = 1e-4
# ... and the skew of a camera that is taken for none, px: none of the data sets has any
CAMERA_SKEW_MAX_PX = 1e-3
# the rule by which a set without a split of its own is split: every n-th pose and every n-th camera is for the test
SPLIT_EVERY_POSE = 5
SPLIT_EVERY_CAMERA = 6
# check-data looks at so many pictures of a larger set, and names so many examples of what is wrong
CHECK_PICTURES = 400
CHECK_EXAMPLES = 8
# pictures on which it tries out which mistake would explain joints beside the hand
CHECK_MISTAKE_PICTURES = 24
# a joint so near to the mask counts as on it, px: joints lie inside the finger, its silhouette may be cut close
CHECK_REACH_PX = 3
# part of the joints on the mask below which a picture is named, and, as the median over all, the set refused; masks
# that leave out what an object hides have less than 1
CHECK_ON_MASK_PICTURE_MIN = 0.7
CHECK_ON_MASK_MIN = 0.85
# a mask with fewer pixels is empty, one that covers more of its picture is most likely inverted or of something else
CHECK_MASK_MIN_PX = 50
CHECK_MASK_MAX = 0.9
# variation of a bone's length, standard deviation over mean, above which joints are told to be noisy (triangulated
# ones of real sets vary by a few per cent)
CHECK_BONE_WOBBLE = 0.08
# mean bend of the fingers' middle joints away from the palm, as a sine, from which it must be the other hand
CHECK_CURL = 0.1
# overlay pictures: enlargement, and how far outside of the picture lines are still drawn, px
OVERLAY_ZOOM = 2
OVERLAY_REACH_PX = 20_000
# folders between the one that the user names and the one that holds the set, upwards and downwards
FOLDER_LEVELS_UP = 6
FOLDER_LEVELS_DOWN = 2

# ---- avatar: the learnt hand (METHOD 4) -----------------------------------------------------------------------------
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
# how far a learnt normal may leave the template's, per unit of the decoder's output
NORMAL_BEND = 0.3
# lobes of the gloss at the start: wide, lambda of exp(lambda (cos - 1)), and nearly dark, before the softplus;
# a sharper lobe than the last is narrower than what a Gaussian of half a millimetre can show
LOBE_SHARPNESS_START = 5.0
LOBE_SHARPNESS_MAX = 60.0
LOBE_RAW_START = -4.5
# learnable range of the shadow's darkness g (METHOD 5.2: 4 to 12; wider, because a shadow may be better off)
SHADOW_GAIN_RANGE = (1.0, 12.0)
# what a file may hold of what was learnt; beyond it nothing was learnt from pictures, and memory or floats run out:
# lobes of the gloss; colour, rim and shine that they may have; gain of the shadow; octaves of an encoding, widths and
# texels of the pose's network, and its weights
LIGHT_LOBES_MAX = 64
LIGHT_VALUE_MAX = 1e3
SHADOW_GAIN_MAX = 100.0
POSE_NET_OCTAVES_MAX = 12
POSE_NET_WIDTH_MAX = 1024
POSE_NET_TEXELS_MAX = 256
POSE_NET_WEIGHT_MAX = 1e4
# by how much the length of a stored normal may be off 1
NORMAL_LENGTH_TOLERANCE = 1e-3
# cheaper tiers of the correctives: what one may lose to be taken unasked, dB (RENDERING 5); largest basis
TIER_LOST_MAX_DB = 0.1
BASIS_MAX = 64
# how far a joint may leave the range of angles that was trained, degrees, before it is told: the skin of a good avatar
# carries on so far (assumed)
POSE_RANGE_TOLERANCE_DEG = 8.0
# distilling: poses that are made up; wobble of flexion, abduction and palm angles, degrees; how far beyond the known
# range, degrees: as far as the angles of a hand between two learnt poses go
DISTIL_POSES = 400
DISTIL_WOBBLE_DEG = (8.0, 3.0)
DISTIL_WOBBLE_PALM_DEG = 2.0
DISTIL_BEYOND_DEG = 5.0
# penalty on directions, per pose, for numbers of variance 1; variance of a component over the largest below which it is
# noise; Gaussians at once: bounds the memory to some 400 MB
DISTIL_RIDGE = 1e-4
DISTIL_VARIANCE_MIN = 1e-6
DISTIL_GAUSSIANS_AT_ONCE = 2048
# ranges of the angles between neighbouring palm bones (theta^p) and palm planes (theta^n), degrees (METHOD 4.1)
PALM_NEIGHBOUR_RANGES_DEG = ((0.0, 60.0), (0.0, 30.0), (0.0, 30.0), (0.0, 30.0))
PALM_PLANE_RANGES_DEG = ((-30.0, 60.0), (-20.0, 40.0), (-20.0, 40.0))

# ---- native: threads ------------------------------------------------------------------------------------------------
# threads taken without being asked, at most; beyond this many nothing was measured
AUTOMATIC_THREADS = 8

# ---- splat: the rasterisation contract (RENDERING 3 and 8) ----------------------------------------------------------
# pixel footprint added to the projected variance, px^2; weights are trained with it
BLUR_PX2 = 0.3
# contribution below which a Gaussian does not touch a pixel: one 8-bit step
ALPHA_MIN = 1.0 / 255.0
# cap of one contribution; bounds 1/(1 - alpha) in the backward pass by 1e3
ALPHA_MAX = 0.999
# transmittance below which a pixel may stop; error at most T_STOP * max(rgb)
T_STOP = 1e-4
# near plane, metres
Z_NEAR_M = 0.01
# largest projected variance, px^2: keeps float-to-int conversion and det^2 inside their ranges
VAR_MAX_PX2 = 1e9
# colours beyond this overflow float32 in the gradients; counted as invalid
RGB_MAX = 1e6
# coordinates beyond this are counted as invalid, metres: depth is blended like a colour, and has the same limit
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
# depth that the kernel gives a pixel without any, metres: farther than the shadow's reach from everything
SHADOW_FAR_M = 1e6
# taps per pixel; more cost time and change nothing visible
SHADOW_SAMPLES_MAX = 256
# normals come from depth differences over this length, metres: the depth of splats is bumpy by tenths of a millimetre
# over the size of a Gaussian, and one-pixel normals of it speckle. Against ray-traced occlusion of smooth surfaces it
# is as good or better (correlation 0.81 / 0.78 / 0.58 / 0.81 instead of 0.79 / 0.76 / 0.57 / 0.80, METHOD 5.2)
SHADOW_NORMAL_REACH_M = 0.003
# what stands out of the tangent plane by less than this does not occlude, metres: the pits between Gaussians would show
# as specks (no loss against ray-traced occlusion up to 0.6 mm)
SHADOW_HEIGHT_MIN_M = 4e-4
# the two one-sided differences are averaged when they agree within this part of the smaller one; otherwise the smaller
# is taken, so that a normal never spans a silhouette
SHADOW_AGREE = 0.5
# ... and always when they differ by less than this, metres: bumps
SHADOW_AGREE_FLOOR_M = 5e-4
# floor of |t_x x t_y|^2, m^4: a degenerate normal becomes the zero vector instead of NaN
SHADOW_NORMAL_MIN2 = 1e-36
# gradient buffers of the shadow, one per stripe of rows, added in this fixed order: threads do not change bits
SHADOW_STRIPES = 4
# strength per channel, 0..1: skin shadows are reddish (chosen by eye on the built-in avatar)
SHADOW_TINT = (0.60, 0.75, 0.80)
GOLDEN_ANGLE_RAD = 2.399963229728653
# gate from the joints alone: radius of influence, metres, and the score over which the pass fades in
GATE_RADIUS_M = 0.060
GATE_LOW = 0.5
GATE_HIGH = 1.0
# capsule radii of bones 1..20, millimetres at scale 1 (METHOD 5.4)
GATE_CAPSULE_RADII_MM = (
    *(16.0,) * 5, 10.0, 9.0, 9.0, 8.5, 7.5, 9.0, 8.0, 8.0, 7.8, 7.0, 8.0, 7.2, 7.2, 7.0, 6.2,
)  # fmt: skip
# samples along each capsule's axis: 5 x 5 distances per pair of bones; penetration is capped (a deep overlap of two
# bones must not hide the others)
GATE_SAMPLES = 5
GATE_PENETRATION_MAX = 1.5
# hands smaller than this on the picture get no shadow pass, px
SHADOW_HAND_MIN_PX = 64.0

# ---- splat: reuse between frames ------------------------------------------------------------------------------------
# matrices are reused when no joint moved more than this, metres
REUSE_JOINTS_M = 5e-5
# ... and the skin then lacks at most this, metres. Joints that move against each other turn bones: the skin of a hand
# without flags moves by up to 2.9 times their movement in the named poses, 3.4 times in random ones (built-in hand)
REUSE_SKIN_M = 2e-4

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
# sheets of pictures: side of the square over that of the hand in it; difference 0..1 that has the darkest colour (a
# good avatar stays below it nearly everywhere); poses between the two ends (METHOD 6.3)
SHEET_ROOM = 1.12
SHEET_DIFFERENCE_FULL = 0.2
SHEET_STEPS_BETWEEN = 4
# a learnt offset counts as quadratic below this length, metres: at 0 a plain norm has no gradient, and offsets start
# there; a hundredth of a millimetre is nothing that could be seen
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
# visibility below which the shadow is black: its power with the learnt gain has a finite gradient
VISIBILITY_MIN = 1e-3
# checkpoints that are kept, beside the one with the best fixed view: one more than the last, should that be damaged
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

# ---- studies --------------------------------------------------------------------------------------------------------
# accuracy of the paper's avatars (RENDERING 9.1): what an error beside it costs is said of a model as good as this, dB
MODEL_PSNR_DB = 33.4
# points on the skin of the transformation table: 1.4 mm apart, well below the distances that it tells apart
TRANSFORM_STUDY_POINTS = 20_000

# ---- service: the engine as a process (BLENDER 3, RENDERING 14); what both sides share stands in service/protocol.py

# seconds between two signs of life; Blender calls the engine slow after 5 s without one
HEARTBEAT_S = 1.0
# a stranger's time to say the token
GREETING_S = 2.0
# connections that may be greeting at the same time; one more, and the oldest is closed
GREETINGS_MAX = 8
# after the end of stdin a running request may finish for so long before the process ends regardless
STOP_GRACE_S = 3.0
# hands in one picture; each costs as much as the first
PICTURE_HANDS_MAX = 16
# renderers that are kept: one per set of hands and settings, each with its hands' arrays in memory
RENDERERS_MAX = 8
# focal length and principal point, px: a view a million times narrower than any lens is a mistake
PINHOLE_MAX_PX = 1e9
# by how much a rotation on the wire may fail to be one: twice the rounding of Blender's float32 matrices, and no scale
RIGID_MAX = 1e-4
# letters of an error's detail on the wire: with the sentence it must fit the 64 kB header
DETAIL_MAX = 8000

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
# distance from the middle of the hands, metres: like the stages of the data sets
CAPTURE_DISTANCE_M = (0.8, 1.1)
# largest roll about the viewing direction, degrees
CAPTURE_ROLL_DEG = 12.0
# part of the picture left free on each side of all poses
CAPTURE_MARGIN = 0.03
# height of the viewing direction beyond which it is steep, and the picture's upper edge is no longer the fingers' way
CAPTURE_STEEP = 0.85
# close-ups: distance, and what the shorter edge of the picture shows there, metres: about two fingers' lengths
CAPTURE_CLOSE_M = 0.45
CAPTURE_CLOSE_FIELD_M = 0.11

# ---- capture: skin ---------------------------------------------------------------------------------------------------
# edge of the baked texture: 0.4 mm of skin per texel, finer than a pixel of a whole hand at 334 x 512 (0.5 mm)
CAPTURE_SKIN_PX = 1024
# edges that a skin picture may have, pixels
CAPTURE_TEXTURE_PX = (64, 8192)
# skin this far above the lower edge gives the wrist's cut its colour, metres
CAPTURE_WRIST_BAND_M = 0.012
# mottling that a coarse picture cannot hold: (cell in metres, amount), and how strongly it darkens red, green, blue
CAPTURE_MOTTLING = ((0.0026, 0.022), (0.0011, 0.022))
CAPTURE_MOTTLING_RGB = (0.55, 1.0, 1.0)
# depth of a furrow that a picture shows as a dark line, metres, and the shade (sRGB) at which it is nearly reached
CAPTURE_RELIEF_M = 0.00022
CAPTURE_RELIEF_SHADE = 0.035
# grain of skin that no picture holds: its height and its cells, metres; finer ones are lost between texels
CAPTURE_GRAIN_M = 0.000012
CAPTURE_GRAIN_CELL_M = 0.0009

# ---- capture: plan and worker ----------------------------------------------------------------------------------------
# rays per pixel: 1 is a test, beyond the most the denoiser has nothing left to do
CAPTURE_SAMPLES = (1, 4096)
# every so manieth pose, and one of so many cameras, is kept for the test
CAPTURE_EVERY_POSE = 5
CAPTURE_EVERY_CAMERA = 6
# how long Blender may take to end, seconds, and how many lines of its last words are told
CAPTURE_END_S = 20.0
CAPTURE_LAST_WORDS = 4

# ---- exporters: pictures and video ----------------------------------------------------------------------------------
# zlib level of PNG files, 0..9: on a hand, level 6 saves 3 % and takes 1.6 times as long, level 1 costs 16 % of size
PNG_COMPRESSION = 4
# constant rate factor of H.264: 18 is visually without loss
VIDEO_CRF = 18

# ---- exporters: USD -------------------------------------------------------------------------------------------------
# spherical harmonics of band 0: colour = 0.5 + SH_C0 * coefficient
SH_C0 = 0.28209479177387814
# share of every skin weight that goes to the twin joint which carries what half precision lost of a scale; a power of
# two is exact in float32, and 2^-8 keeps the twin's scale within 12.5 % of the true one (2^-11 / 2^-8)
USD_FINE_SHARE = 2.0**-8
# frames between two saves: a take's Gaussians then never stand in memory together, and no slower (EXPORT 5). Its bones
# do: 20 kB a frame, 42 kB while the skeleton is made
USD_SAVE_EVERY = 24
# half width of a splat's bound in standard deviations: 99.7 % of the kernel
USD_SPLAT_EXTENT_SIGMA = 3.0
# horizontal aperture that cameras are written with; only ratios to the focal length matter
USD_APERTURE = 36.0
# the clipping of an exported camera leaves this factor before and behind the hand, for what else the scene holds
USD_CLIPPING_ROOM = 2.0
# part of the free disk that must be left over when an export is expected to fit: other programs write too
USD_DISK_RESERVE = 0.02
# bytes of an export beside the samples of positions: layers, static arrays, tables (per Gaussian and fixed, generous)
USD_STATIC_BYTES_PER_GAUSSIAN = 80
USD_STATIC_BYTES = 2_000_000
# Gaussians around a vertex whose mean colour the exported mesh gets
USD_MESH_COLOUR_NEIGHBOURS = 8

# ---- cli: framing of a motion ---------------------------------------------------------------------------------------
# focal length over the longer edge of the picture: a long lens, which does not make near fingers look swollen
FRAMING_FOCAL = 2.2
# part of the picture that the hand may fill
FRAMING_FILL = 0.94
# how far the skin reaches beyond a joint and, with the cut, beyond the wrist, metres, for a palm (wrist to middle
# knuckle) of the length FRAMING_PALM_M; measured on the built-in template
FRAMING_SKIN_M = 0.012
FRAMING_WRIST_M = 0.034
FRAMING_PALM_M = 0.0885
# length of a mean of unit vectors below which it is no direction
FRAMING_DIRECTION_MIN = 0.2
# what `check-usd` lets pass: how far a Gaussian may stick out of its bound (metres, round-off of float32 at 100 m),
# and how far the length of a quaternion may be from 1 (that of NVIDIA's rule VG.035)
USD_EXTENT_TOLERANCE_M = 1e-5
USD_QUATERNION_TOLERANCE = 1e-3
# ... and how far the weights of a point may be from 1: at 1 m from the origin it then moves by 1 mm
USD_WEIGHT_SUM_TOLERANCE = 1e-3

# ---- cli: the demo --------------------------------------------------------------------------------------------------
# rate, seconds of a move and of a stop: quick enough for a video of a few seconds, slow enough to see
DEMO_FPS = 30.0
DEMO_MOVE_S = 0.6
DEMO_HOLD_S = 0.2
# how far the whole hand turns to either side, degrees: shows more than one side and stays recognisable
DEMO_SWAY_DEG = 35.0
# moments of the motion on the contact sheet
SHEET_COLUMNS = 8
