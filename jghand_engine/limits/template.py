"""Limits of the template and files of other people."""

from __future__ import annotations

# ---- template -------------------------------------------------------------------------------------------------------
# spread of the split of the wrist's weight over the metacarpals, meters (assumed; METHOD 2.7)
PALM_SPLIT_SIGMA_M = 0.012
# distance from the wrist over which the palm blends to the wrist matrix, meters (assumed)
WRIST_BLEND_M = 0.015
# weight field: voxel edge, margin around the surface, sweeps per level, levels (METHOD 3.4)
FIELD_VOXEL_M = 0.003
FIELD_MARGIN_M = 0.012
FIELD_SWEEPS = 30
FIELD_LEVELS = 4
# a row of bone weights, of a template or an avatar, that is further from 1 than this was not meant as weights: float32
# rounding of 21 summands leaves less than 1e-6
WEIGHT_SUM_TOLERANCE = 1e-5
# weights below this are dropped and the rest renormalized: far joints would drag skin by fractions of a millimeter
WEIGHT_MIN = 1e-3
# closest points: faces are searched in pieces of at most this radius (meters), so many at first, and so many in all.
# Speed only: the search asks for more pieces until it is certain (32 are enough for 9 in 10 points near the skin)
CLOSEST_PIECE_RADIUS_M = 0.002
CLOSEST_FIRST_CANDIDATES = 32
# pieces are passed over when they are farther than the nearest found by more than this part of it: rounding of float64,
# amply, so that of two equally near faces the same is chosen however many were asked for
CLOSEST_ROUNDING = 1e-9
# a triangle whose corner has a squared sine below this is taken for its edges, from which it then differs by a
# millionth of its length at most: rounding leaves 4e-16 where the area is none
CLOSEST_FLAT = 1e-12
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
# depth of the shell of Gaussians under the skin, meters; deeper ones are hidden
SHELL_DEPTH_M = 0.003
GAUSSIANS_PER_BONE = 3000
# farthest-point order takes (points per bone)^2 steps
SHELL_PER_BONE_MAX = 20_000
# edge of the cells from which the shell is drawn, meters: speed only
SHELL_CELL_M = 0.003
# draws per wanted point after which a bone is taken to have no skin (built-in hand: at most 11)
SHELL_DRAWS_MAX = 1000
# signed distance that d = 0..1 of the UVD coordinates spans, meters (a fixed range: features must not shift)
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
