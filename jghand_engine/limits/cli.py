"""Limits of the command line."""

from __future__ import annotations

# ---- cli: framing of a motion ---------------------------------------------------------------------------------------
# focal length over the longer edge of the picture: a long lens, which does not make near fingers look swollen
FRAMING_FOCAL = 2.2
# part of the picture that the hand may fill
FRAMING_FILL = 0.94
# how far the skin reaches beyond a joint and, with the cut, beyond the wrist, meters, for a palm (wrist to middle
# knuckle) of the length FRAMING_PALM_M; measured on the built-in template
FRAMING_SKIN_M = 0.012
FRAMING_WRIST_M = 0.034
FRAMING_PALM_M = 0.0885
# length of a mean of unit vectors below which it is no direction
FRAMING_DIRECTION_MIN = 0.2

# ---- cli: the demo --------------------------------------------------------------------------------------------------
# rate, seconds of a move and of a stop: quick enough for a video of a few seconds, slow enough to see
DEMO_FPS = 30.0
DEMO_MOVE_S = 0.6
DEMO_HOLD_S = 0.2
# how far the whole hand turns to either side, degrees: shows more than one side and stays recognizable
DEMO_SWAY_DEG = 35.0
# moments of the motion on the contact sheet
SHEET_COLUMNS = 8
# the widest lens that `jghand render` takes, millimeters: one that sees around the hand
APERTURE_MAX_MM = 200.0

# ---- cli: commands that another program started ----------------------------------------------------------------------
# seconds between two lines of progress: a panel is not read faster, and a pipe is not flooded
PROGRESS_JSON_S = 0.25
# seconds after the end of standard input until such a command ends regardless: a step of a training and its checkpoint
# take a few, a picture of a capture up to a minute
STOP_WITHOUT_INPUT_S = 90.0

# ---- cli: JSON that a user gives -------------------------------------------------------------------------------------
# bytes of a camera (1 kB) or a map of bones (10 kB): JSON takes up to thirty times its size in memory
JSON_GIVEN_BYTES_MAX = 100_000
# the largest number of a camera, pixels or meters: beyond it no picture is meant
CAMERA_NUMBER_MAX = 1e6
