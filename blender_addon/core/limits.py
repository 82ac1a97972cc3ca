# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers of the renderer's process, of jobs, renders and exports: value, unit, why. Source: BLENDER 3.4."""

from __future__ import annotations

# ---- the engine's process, seconds ----------------------------------------------------------------------------------

# a cold start of the engine's Python on a slow disk
HANDSHAKE_S = 30.0
# one picture of the final preset, and the loading of an avatar (which imports torch)
REQUEST_S = 60.0
LOAD_S = 120.0
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
# lines of the engine's own output that are kept, those of them that a failure's detail shows, and letters of one
LOG_LINES = 1000
DETAIL_LINES = 20
LOG_LINE_MAX = 2000

# ---- jobs: child processes of the engine's command line --------------------------------------------------------------

# a job that was asked to stop finishes a step and writes a checkpoint, or a picture; then it is asked again, then ended
JOB_STOP_S = 30.0
# after its end: what it printed last may still be on its way
JOB_LAST_WORDS_S = 1.0
# the end of Blender waits so long for all jobs together; what needs longer ends by itself
JOB_END_S = 2.0
# how often jobs are looked after
JOB_LOOK_S = 0.25

# ---- exports, bakes, trainings ---------------------------------------------------------------------------------------

# diameter of a baked point in two standard deviations of its splat: balls of this size close the skin
POINT_WIDTH_FACTOR = 2.0
