# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers of the renderer's process, of jobs, renders and exports: value, unit, why. Source: BLENDER 3.4."""

from __future__ import annotations

# ---- the engine's process, seconds ----------------------------------------------------------------------------------

# a cold start of the engine's Python on a slow disk
HANDSHAKE_S = 30.0
# the answer to the token
WELCOME_S = 5.0
# one picture of the final preset, and the loading of an avatar (which imports torch)
REQUEST_S = 60.0
LOAD_S = 120.0
# the longest time that may be asked for one picture: a day; beyond some weeks the system's own waits overflow
REQUEST_MAX_S = 86400.0
# no sign of life for so long: the engine is slow, then it hangs (it gives one every second)
SLOW_S = 5.0
SILENCE_S = 30.0
# how often a wait looks whether the process still lives; the link's thread, while the engine is ready, is woken by
# whatever comes and looks this often besides
POLL_S = 0.05
LOOK_S = 1.0
# between two starts after a failure, and how many of them there are unless the user asks for one
RESTART_S = 5.0
RESTARTS_MAX = 3
# pictures that failed and are not asked for again, the newest
REFUSED_MAX = 64
# after stdin was closed the engine may finish; then it is ended. At the end of Blender, or of the extension, somebody
# waits for that, and the engine has nothing that it must finish
STOP_S = 3.0
CLOSE_S = 0.3
# what was ended is gone within moments; what is not hangs in the system
KILL_S = 1.0
# after a connection broke, its process may be about to end
TERMINATE_S = 2.0
# after the end of the process, what it printed last may still be on its way
LAST_WORDS_S = 0.2
# lines of the engine's own output that are kept, those of them that a failure's detail shows, and letters of one
LOG_LINES = 1000
DETAIL_LINES = 20
LOG_LINE_MAX = 2000

# a camera whose normalized axes leave orthogonality by more than this is sheared by its parents
SHEAR_MAX = 1e-4
# part by which fx and fy of a camera may differ and still mean square pixels
SQUARE_PIXEL_MAX = 1e-6

# ---- jobs: child processes of the engine's command line --------------------------------------------------------------

# a job that was asked to stop finishes a step and writes a checkpoint, or a picture; then it is asked again, then ended
JOB_STOP_S = 30.0
# after its end: what it printed last may still be on its way
JOB_LAST_WORDS_S = 1.0
# the end of Blender waits so long for all jobs together; what needs longer ends by itself
JOB_END_S = 2.0
# how often jobs are looked after, and how often the folder of a training is read; without a window, or for a script, a
# job is waited for a day
JOB_LOOK_S = 0.25
TRAINING_LOOK_S = 3.0
JOB_WAIT_S = 86400.0
# bytes of one line of a job, letters of its text, and notes that are kept
JOB_LINE_MAX = 65536
JOB_TEXT_MAX = 300
JOB_NOTES = 5

# how much a part of the picture a region has to be: Blender draws none of fewer pixels
REGION_MIN_PX = 1

# ---- exports, bakes, trainings ---------------------------------------------------------------------------------------

# what a USD stage holds beside its samples: skeleton and mesh, and of every Gaussian what does not move (measured)
USD_STATIC_BYTES = 300_000
USD_STATIC_GAUSSIAN_BYTES = 98
# diameter of a baked point in two standard deviations of its splat: balls of this size close the skin
POINT_WIDTH_FACTOR = 2.0
# bytes of a bake's stamp, and those of a training's log that are read at a time
STAMP_MAX_BYTES = 2**20
LOG_READ_BYTES = 2**20
# a joint that is further from where it was baked has moved: above Blender's rounding, below what is seen
BAKE_MOVED_M = 2e-5
# the picture of a loss: size, air around it, thickness of the line in pixels; sRGB and alpha of ground and line
CURVE_PX = (256, 160)
CURVE_MARGIN_PX = 4
CURVE_LINE_PX = 2
CURVE_GROUND = (0.12, 0.12, 0.12, 1.0)
CURVE_LINE = (0.85, 0.62, 0.35, 1.0)
# what Solid mode shows of baked points, linear: skin
POINTS_SOLID_RGBA = (0.55, 0.30, 0.20, 1.0)
