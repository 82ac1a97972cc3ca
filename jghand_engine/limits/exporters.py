"""Limits of exported files."""

from __future__ import annotations

# ---- exporters: pictures and video ----------------------------------------------------------------------------------
# zlib level of PNG files, 0..9: on a hand, level 6 saves 3 % and takes 1.6 times as long, level 1 costs 16 % of size
PNG_COMPRESSION = 4
# constant rate factor of H.264: 18 is visually without loss
VIDEO_CRF = 18

# ---- exporters: splat files -----------------------------------------------------------------------------------------
# opacity is written to PLY as a logit, which 0 and 1 have none of; the step of 8 bits is 4000 times larger
PLY_OPACITY_MARGIN = 1e-6
# bits of a position in SPZ behind the point: steps of 0.004 mm, and 32 m on each side of the origin
SPZ_FRACTIONAL_BITS = 18
# what SPZ multiplies the harmonics of band 0 by before it cuts them to 0..1, and where its sizes begin
SPZ_COLOR_SCALE = 0.15
SPZ_LN_SIGMA_MIN = -10.0
# gzip's level, 0..9, as the format's own library has it
SPZ_GZIP_LEVEL = 6

# ---- exporters: splat files that are read ---------------------------------------------------------------------------
# bytes of a PLY header; those of splats with all harmonics have 1.5 kB
PLY_HEADER_BYTES_MAX = 65_536
# bytes of the description in a GLB: JSON takes up to thirty times its size in memory; ours has 1.5 kB
GLB_JSON_BYTES_MAX = 65_536
# times that an SPZ file may grow when it is unpacked, higher harmonics left out; hands grow to 1.8 times their size, a
# bomb of zeros to 1000
SPZ_RATIO_MAX = 4
# bytes that are unpacked at once
SPZ_CHUNK_BYTES = 65_536
# Gaussians that are decoded at once: half a megabyte
SPLAT_PART_ROWS = 4096
# a median size, and a distance between Gaussians, above which nobody meant meters
SPLAT_SIGMA_SANE_M = 1.0
SPLAT_SIZE_SANE_M = 1000.0

# ---- exporters: passes ----------------------------------------------------------------------------------------------
# the skin around a joint is what lies in a slab of this half thickness across its bone: thin beside the shortest bone
JOINT_SLAB_M = 0.004
# which of the distances of that skin counts, percent: the largest are strays of the neighboring finger
JOINT_REACH_PERCENTILE = 95.0
# a joint is visible when what is before it begins at most so many times that far from it: rays come in at an angle and
# bent joints bulge, seen 1.3; what hides a joint begins from 1.6 on, and the thickness of a finger away as a rule
JOINT_REACH_ROOM = 1.45

# ---- exporters: USD -------------------------------------------------------------------------------------------------
# spherical harmonics of band 0: color = 0.5 + SH_C0 * coefficient
SH_C0 = 0.28209479177387814
# share of every skin weight that goes to the twin joint which carries what half precision lost of a scale; a power of
# two is exact in float32, and 2^-8 keeps the twin's scale within 12.5 % of the true one (2^-11 / 2^-8)
USD_FINE_SHARE = 2.0**-8
# part by which constant radii may be off those of a frame before the export says so: less is not seen
USD_SIGMA_ERROR_TOLD = 0.05
# frames between two saves: a take's Gaussians then never stand in memory together, and no slower (EXPORT 5). Its bones
# do: 20 kB a frame, 42 kB while the skeleton is made
USD_SAVE_EVERY = 24
# half width of a splat's bound in standard deviations: 99.7 % of the kernel
USD_SPLAT_EXTENT_SIGMA = 3.0
# horizontal aperture that cameras are written with: 36 mm in tenths of the stage's unit, the meter. Ratios alone make
# the field of view, but depth of field and the lens that a reader shows follow from the size
USD_APERTURE = 0.36
# the clipping of an exported camera leaves this factor before and behind the hand, for what else the scene holds
USD_CLIPPING_ROOM = 2.0
# part of the free disk that must be left over when an export is expected to fit: other programs write too
DISK_RESERVE = 0.02
# bytes of an export beside the samples of positions: layers, static arrays, skin, tables (per Gaussian and fixed,
# generous)
USD_STATIC_BYTES_PER_GAUSSIAN = 180
USD_STATIC_BYTES = 2_000_000
# ... and in every frame: bones, bounds and times (seen 3,400)
USD_FRAME_BYTES = 3_500
# age in seconds of the folder of an export that was killed, after which the next one removes it
USD_LEFT_OVER_S = 60.0
# bytes of a .usdz at most: its zip counts in 32 bits, and its directory takes some hundred
USDZ_BYTES_MAX = 2**32 - 2**16
# bytes that are copied into it at once
USDZ_CHUNK_BYTES = 2**20
# every so many-th Gaussian is in the stand-in that is shown where splats are not: a hand is still closed with a tenth
USD_PROXY_STEP = 10
# bones that a Gaussian of the skinned variants follows at most: the hands that ship have 7. With 4, as many real-time
# clients have it, Gaussians of the palm are up to 3.8 mm off
USD_SKIN_BONES = 8
# a longer take's Gaussians are cut into files that are read one at a time (value clips); shorter ones stay in one
# file, because parsers other than Pixar's know no clips
USD_CLIPS_ABOVE_FRAMES = 2000
# frames in one of these files: 170 MB for 60,000 Gaussians
USD_CLIP_FRAMES = 240
# what Omniverse, usdview and Blender draw points as is a ball without a soft edge: two standard deviations close the
# skin (as the extension has it)
USD_BALL_WIDTH_FACTOR = 2.0
# Gaussians around a vertex whose mean color the exported mesh gets
USD_MESH_COLOR_NEIGHBORS = 8

# ---- exporters: USD files that are checked --------------------------------------------------------------------------
# what `check-usd` lets pass: how far a Gaussian may stick out of its bound (meters, round-off of float32 at 100 m),
# and how far the length of a quaternion may be from 1 (that of NVIDIA's rule VG.035)
USD_EXTENT_TOLERANCE_M = 1e-5
USD_QUATERNION_TOLERANCE = 1e-3
# ... how far the weights of a point may be from 1: at 1 m from the origin it then moves by 1 mm
USD_WEIGHT_SUM_TOLERANCE = 1e-3
# ... and how far an opacity may be out of 0..1: some steps of float32 at 1
USD_OPACITY_TOLERANCE = 1e-6
# share of the values that must be impossible before we guess that they are logarithms or logits: a few are a slip
USD_GUESS_SHARE = 0.5
# variants of a stage that are looked at: each opens the stage anew
USD_CHECK_VARIANTS_MAX = 32

# ---- exporters: web page --------------------------------------------------------------------------------------------
# gzip's level of the hand's data, 0..9: 9 takes twice as long and saves 0.2 %
WEB_GZIP_LEVEL = 6
# frames of a motion: ten minutes at 60 a second take 12 MB of the page
WEB_FRAMES_MAX = 36_000
# letters of the page's title: one line
WEB_TITLE_MAX = 120
# bytes at the start of a file by which it is known as one of ours: the marks stand in the first 200
WEB_MARK_BYTES = 1000
