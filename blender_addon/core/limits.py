# SPDX-License-Identifier: GPL-3.0-or-later
"""Every number of the extension: value, unit, why. Source: BLENDER 3.4 and 6."""

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

# ---- the armature ---------------------------------------------------------------------------------------------------

# a finger tip ends the hand; its bone only marks the place
TIP_BONE_M = 0.005
# a rest bone shorter than this part of the mean bone has no direction, and Blender deletes bones of no length
REST_BONE_MIN = 1e-2
# sine between palm bones below which a frame has no palm plane and holds the orientation of the one before
PALM_SINE_MIN = 1e-3
# det of the normalized axes of an object: below it, its scale is (nearly) zero in some direction
SCALE_MIN = 1e-6
# det of an object's axes below which it is flat and can hide nothing that is inside of it
FLAT_DETERMINANT = 1e-12
# a camera whose normalized axes leave orthogonality by more than this is sheared by its parents
SHEAR_MAX = 1e-4
# cosine below which two directions count as opposite: the smallest rotation between them has no axis of its own
OPPOSITE_COSINE = -0.999999
# part by which fx and fy of a camera may differ and still mean square pixels
SQUARE_PIXEL_MAX = 1e-6

# ---- other people's rigs --------------------------------------------------------------------------------------------

# so many of the 16 joints other than tips must have a bone before a convention counts as recognized: a wrist and one
# finger. Fewer are chance hits (a lone "wrist" empty)
RECOGNIZED_MIN = 4

# ---- finger controls ------------------------------------------------------------------------------------------------

# flexion of the three bones at a full curl, degrees from straight: those of the engine's pose "fist"; thumb, fingers
CURL_DEG = ((16.0, 44.0, 44.0), (86.0, 107.0, 66.0))
# turn of a control that means a full curl, how far it goes the other way, and the turn that means a full spread
CURL_FULL_DEG = 90.0
CURL_BACK_DEG = 20.0
SPREAD_FULL_DEG = 25.0
# what a full splay spreads of each finger, thumb first: the engine's pose "spread", the little finger counts one
SPLAY_PARTS = (0.8, 0.75, 0.0, 0.65, 1.0)
# lowest and highest angle of a joint, degrees: flexion and spread of the first bone, flexion of the second and third;
# thumb (from its rest), fingers (from straight). The same as the engine's `hand.poses.RANGES_DEG`; a test compares
JOINT_RANGES_DEG = (
    ((-15.0, 45.0), (-15.0, 35.0), (-10.0, 55.0), (-15.0, 85.0)),
    ((-25.0, 92.0), (-22.0, 25.0), (-5.0, 112.0), (-8.0, 82.0)),
)
# the middle and last joints are hinges, with some play (METHOD 4.1); thumb, fingers. The thumb's axes here follow its
# nail and lie up to 30 degrees from the engine's, so that its hinges seem to bend sideways too and its first joint goes
# a little further: by what the engine's named poses need (28.6 and 4.1)
SIDEWAYS_RANGE_DEG = (29.0, 15.0)
THUMB_PLAY_DEG = 5.0
# turn of a bone about itself: passive play of a knuckle, and what swings about two axes have of it (assumed)
TWIST_RANGE_DEG = 30.0
# turns of the solver for a tip that is held somewhere; Blender's own number, enough for three bones
IK_ITERATIONS = 500
# how large the shapes of the controls are drawn, meters: radius of a ring around a finger, of a ball at a tip; half the
# width and depth of the bracelet around the palm, and its way from the wrist
FINGER_SHAPE_M = 0.014
TIP_SHAPE_M = 0.006
HAND_SHAPE_M = (0.062, 0.03, 0.05)
# and of the empty that stands for a hand of objects
HOLDER_SHAPE_M = 0.02

# ---- motion files ---------------------------------------------------------------------------------------------------

# an hour at 120 frames a second is 218 MB as numbers of eight bytes
MOTION_MAX_BYTES = 512 * 2**20
# frames per second that a motion may have: the engine's bounds
FPS_MIN = 0.1
FPS_MAX = 10_000.0

# ---- new cameras ----------------------------------------------------------------------------------------------------

# a hand is looked at from near
CLIP_START_M = 0.01
# how far skin reaches beyond a joint, and beyond the wrist joint, where the avatar's forearm ends, meters
SKIN_M = 0.015
WRIST_SKIN_M = 0.045
# air around the hand, as a part of the distance
MARGIN = 0.06
# focal length of new cameras, mm on a 36 mm sensor: a portrait lens, little perspective on so near a thing
LENS_MM = 85.0
# Blender's 3D views have a sensor of this width, mm; and what is kept of a view at the least for what it shows, where
# its bars leave nothing
VIEW_SENSOR_MM = 72.0
VIEW_PART_MIN = 0.2

# ---- settings of pictures -------------------------------------------------------------------------------------------

# a viewport picture at sixty frames a second
BUDGET_MS = 16.0
# below this part of its splats a hand has holes
DENSITY_MIN = 0.1
# reach of shadows, millimeters: the engine's own, and the most that it takes
SHADOW_RADIUS_MM, SHADOW_RADIUS_MAX_MM = 20.0, 200.0
# sub-frames of motion blur: enough for a finger that crosses its own width; beyond, seconds a frame for nothing
MOTION_SAMPLES = 8
MOTION_SAMPLES_MAX = 64

# ---- pictures in the viewport (BLENDER 5 and 7.1) -------------------------------------------------------------------

# how often the timer looks: nothing is open, a request is open, and at the least while its answer is due. Blender's own
# loop sleeps 5 ms between looks
IDLE_TICK_S = 0.1
OPEN_TICK_S = 0.05
SHORTEST_TICK_S = 0.005
# while playing a view waits so long for its picture, or one frame if that is shorter: Blender's main thread is then
# never blocked for 50 ms, though a busy system wakes a sleeper up to 12 ms late (`scripts/benchmark_link.py`)
PLAY_WAIT_S = 0.033
# after so many late frames in a row nobody waits any more, until an answer was fast enough again: a hung engine costs
# playback nothing
LATE_PATIENCE = 3
# a view that is orbited waits so long for the picture from the new side, where recent pictures came that fast: a view
# that turns 30 times a second with its hand is better than a faster one without
ORBIT_WAIT_S = 0.033
# after the last change: the settings of the viewport instead of the fast ones, and then the settings of renders
SETTLE_S = 0.15
SHARPEN_S = 0.6
# a picture of an earlier pose is shown for so long while no newer one comes: afterwards it would be taken for the truth
STALE_S = 2.0
# pixels of one picture: while something moves (a little more than 512 x 334), while nothing moves, and the most that is
# asked for at all (full HD): larger views are drawn from a smaller picture. Making textures of it holds the main thread
# for 15 ms; of a 4K picture it was 50, and 300 the first time
MOVING_PIXELS_MAX = 200_000
STILL_PIXELS_MAX = 1_000_000
SHARP_PIXELS_MAX = 2_100_000
# the part of a view that can show a hand ends so far from its joints, meters: skin, forearm, and the blur of splats
REACH_M = 0.06
# and is rounded outwards to so many pixels, so that a small move keeps the picture's size
CROP_STEP_PX = 32
# requests and failures that a view remembers
ASKS_KEPT = 8
FAILURES_KEPT = 32
# how often, at most, panels are drawn again for figures that change with every picture
PANEL_TICK_S = 0.5
# letters of a line of a menu that says something: the window of a picture is often small
POPUP_LETTERS = 48
# how wide the picture of a hand is left open for its bones and for the wires of its controls, pixels: no wider than
# Blender draws them; and the most wires of one control
BONE_CUT_PX = 3.0
SHAPE_CUT_PX = 1.5
SHAPE_EDGES_MAX = 512
# an orthographic view of Blender has things behind its camera: the engine's camera stands so far in front of the
# nearest joint, meters
ORTHO_ROOM_M = 0.5

# how often in a row a view tries to draw what the graphics driver refuses, and its rest between, seconds: after
# a lost context a driver needs a moment; one that cannot draw at all would fail, and say so, at every redraw
DRAW_TRIES = 3
DRAW_REST_S = 2.0

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
# how often what panels show of disks and evaluated scenes is looked up, while they are drawn
PANEL_LOOK_S = 0.5
JOB_WAIT_S = 86400.0
# bytes of one line of a job, letters of its text, and notes that are kept
JOB_LINE_MAX = 65536
JOB_TEXT_MAX = 300
JOB_NOTES = 5

# ---- work that takes a while on Blender's main thread ---------------------------------------------------------------

# one turn of it, between two of which Blender draws and hears Esc (which is to be answered within 0.2 s); the time
# between turns; and how often the status bar is drawn anew, which draws the whole window
WORK_TURN_S = 0.1
WORK_TELL_S = 0.25
WORK_REST_S = 0.005
# and how long a turn waits at a time for what a thread does
ASIDE_LOOK_S = 0.02
# part of importing a motion of another program that the engine's reading is taken for, beside the keying
CONVERSION_PART = 0.3
# the same of a video that is tracked
TRACKING_PART = 0.9

# ---- renders --------------------------------------------------------------------------------------------------------

# depth of nothing, Blender units: what Blender's own engines write, and Z combine expects
NOTHING_DEPTH = 1e10
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
# how long a file that somebody else looks at is waited for before it is replaced, on Windows, seconds
REPLACE_RESTS_S = (0.02, 0.05, 0.1, 0.2)
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
