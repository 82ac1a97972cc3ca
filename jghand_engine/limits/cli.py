"""Limits of the command line."""

from __future__ import annotations

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
# variants of a stage that are looked at: each opens the stage anew
USD_CHECK_VARIANTS_MAX = 32
# bytes at the start of a binary USD file that say where its table of contents is
USD_CRATE_HEADER_BYTES = 24

# ---- cli: the demo --------------------------------------------------------------------------------------------------
# rate, seconds of a move and of a stop: quick enough for a video of a few seconds, slow enough to see
DEMO_FPS = 30.0
DEMO_MOVE_S = 0.6
DEMO_HOLD_S = 0.2
# how far the whole hand turns to either side, degrees: shows more than one side and stays recognisable
DEMO_SWAY_DEG = 35.0
# moments of the motion on the contact sheet
SHEET_COLUMNS = 8
# the widest lens that `jghand render` takes, millimetres: one that sees around the hand
APERTURE_MAX_MM = 200.0

# ---- cli: commands that another program started ----------------------------------------------------------------------
# seconds between two lines of progress: a panel is not read faster, and a pipe is not flooded
PROGRESS_JSON_S = 0.25
# seconds after the end of standard input until such a command ends regardless: a step of a training and its checkpoint
# take a few, a picture of a capture up to a minute
STOP_WITHOUT_INPUT_S = 90.0

# ---- cli: pictures that several processes make at once ---------------------------------------------------------------
# seconds between two looks whether a picture that another process is at is there: a picture takes some hundredths
CLAIM_POLL_S = 0.1
# seconds between two lines about the same training of a list
PROGRESS_MANY_S = 60.0
