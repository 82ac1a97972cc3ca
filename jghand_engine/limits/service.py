"""Limits of the engine as a process."""

from __future__ import annotations

# ---- service: the engine as a process (BLENDER 3, RENDERING 13); what both sides share stands in service/protocol.py
# seconds between two signs of life; Blender calls the engine slow after 5 s without one
HEARTBEAT_S = 1.0
# a stranger's time to say the token
GREETING_S = 2.0
# connections that may be greeting at the same time; one more, and the oldest is closed
GREETINGS_MAX = 8
# after the end of stdin a running request may finish for so long before the process ends regardless
STOP_GRACE_S = 3.0
# requests of a client that wait; one more is read when one is taken
REQUESTS_WAITING_MAX = 16
# hands in one picture; each costs as much as the first
PICTURE_HANDS_MAX = 16
# renderers that are kept: one per set of hands and settings, each with its hands' arrays in memory
RENDERERS_MAX = 8
# avatars that are kept though no renderer shows them: those that were just loaded, before their first picture
IDLE_AVATARS_MAX = 4
# moments of one picture with motion blur: as many as the extension may ask for
EXPOSURES_MAX = 64
# renderers of other settings are asked for one frame in so many milliseconds; a minute is no frame any more
BUDGET_MAX_MS = 60_000.0
# sizes that are measured for budgets: widths, px, each with about twice the pixels of the one before; width over height
BUDGET_WIDTHS_PX = (256, 384, 512, 640, 768, 1024, 1280, 1536, 1920, 2560, 3840)
BUDGET_ASPECT = 1.5
# letters of a text among the settings of a picture
SETTING_TEXT_MAX = 200
# meters of places in a request: beyond any scene, and far from where float64 overflows
REQUEST_NUMBER_MAX = 1e9
# focal length and principal point, px: a view a million times narrower than any lens is a mistake
PINHOLE_MAX_PX = 1e9
# by how much a rotation on the wire may fail to be one: twice the rounding of Blender's float32 matrices, and no scale
RIGID_MAX = 1e-4
# letters of an error's detail on the wire: with the sentence it must fit the 64 kB header
DETAIL_MAX = 8000
