# SPDX-License-Identifier: GPL-3.0-or-later
"""What is tried in a real Blender window; `scripts/test_in_blender.py` runs it.

    driver.py    runs inside Blender: installs the zip, walks through the steps, writes down how they went
    window.py    what a step does with the window: mouse, keys, pictures of the screen
    pictures.py  what a step asks of a picture
    NAME.py      a story: functions `step_...(window)`, which run in their order in one session of Blender

A step is a plain function. Where Blender has to go on working meanwhile it is a generator: `yield 0.5` goes on half a
second later, `yield condition` once `condition()` is true (TimeoutError after a while). What it finds wrong it asserts.
"""
