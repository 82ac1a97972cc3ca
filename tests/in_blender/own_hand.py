# SPDX-License-Identifier: GPL-3.0-or-later
"""My Hand from a Film, by its buttons: without the training tools, of a film without a hand, canceled, to its end.

The program is the real one, the films are small: its own hand that opens and closes, and a wall. It takes some minutes,
and is not tried where scripts/test_in_blender.py finds no Python that has what the training tools have.
"""

import os
import subprocess
from pathlib import Path
from unittest import SkipTest

import bpy

from in_blender.pictures import changed

# pixels from the bar's left, window's top, in the empty scene: the panel's header, its button, and Cancel at its bar
HEADER, CHOOSE, CANCEL = (110, 320), (110, 352), (236, 351)
PYTHON = os.environ.get("JGHAND_LEARNING_PYTHON", "")
WALL = """
import sys, numpy as np
from jghand_engine.export.video import write_video
write_video(sys.argv[1], [np.full((240, 320, 3), 90 + frame, np.uint8) for frame in range(30)], 15.0)
"""


def step_without_the_training_tools_the_panel_says_what_is_missing(window):
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    yield from window.open_sidebar()
    closed = window.crop(window.screen(), window.region("UI"))
    yield from click(window, HEADER)
    opened = window.crop(window.picture("no_tools"), window.region("UI"))
    assert changed(closed, opened).mean() > 0.05, "the panel did not open"


def step_films_are_made(window):
    need_python()
    films(window).mkdir()
    render = ("-m", "jghand_engine", "render", "--poses", "open,fist,open", "--size", "240x320", "--out", "pictures")
    for words in (("-c", WALL, "wall.mp4"), (*render, "--video", "hand.mp4")):
        made = subprocess.Popen([PYTHON, "-I", *words], cwd=films(window), stdin=subprocess.DEVNULL)
        yield lambda made=made: made.poll() is not None
        assert made.returncode == 0
    bpy.context.preferences.addons[window.addon.__name__].preferences.engine_python = PYTHON
    bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
    window.redraw()
    yield 1.0
    window.picture("how_to_film")


def step_what_is_wrong_with_a_film_stands_where_it_was_chosen(window):
    need_python()
    yield from choose(window, "wall.mp4")
    yield from until(window, "failed")
    assert "wall.mp4: wanted a hand" in job(window).state.failure.detail
    window.picture("refused")


def step_its_bar_says_the_stage_and_its_button_cancels(window):
    need_python()
    with window.override():  # the failure has pushed the button down
        bpy.ops.jghand.hand_from_film("INVOKE_DEFAULT")
    yield from in_browser(window, "hand.mp4")
    yield from until(window, "Looking for the hand")
    window.picture("looking")
    yield from until(window, "Fitting the hand by pictures")
    window.picture("fitting")
    yield from click(window, CANCEL)
    yield from until(window, "canceled")
    window.picture("canceled")
    assert not list(hands(window).glob("*.jghand"))


def step_the_film_becomes_a_hand_that_can_be_added(window):
    need_python()
    yield from choose(window, "hand.mp4")
    for stage in ("Fitting the hand by pictures", "Cutting the hand out", "Finding skin and light", "done"):
        yield from until(window, stage)
        print(f"JGHAND {job(window).state.sentence()}", flush=True)
    window.picture("done")
    assert (hands(window) / "my_hand.jghand").is_file()
    assert window.call("jghand.add_hand", avatar="my_hand") == {"FINISHED"}
    window.call("view3d.view_selected")
    yield from window.settle()
    window.picture("my_hand")


# ---- parts -----------------------------------------------------------------------------------------------------------


def need_python():
    if not PYTHON:
        raise SkipTest("no Python has the engine with PyTorch: --learning-python")


def job(window):
    return window.runtime().jobs.get("own")


def films(window) -> Path:
    return window.out / "films"


def hands(window) -> Path:
    return window.module("folders").user_folder("hands")


def click(window, place):
    x, from_top = place
    yield from window.click(window.region("UI").x + x, window.window.height - from_top)
    yield 1.0


def choose(window, film: str):
    yield from click(window, CHOOSE)
    yield from in_browser(window, film)


def in_browser(window, film: str):
    before = job(window)
    yield from window.in_browser(films(window) / film)
    yield lambda: job(window) not in (None, before)
    yield 1.0


def until(window, stage: str):
    """Waits for a stage of the job, or an end of it, as long as the story may take."""
    while not (state := job(window).state).text.startswith(stage) and state.phase.value != stage:
        assert not job(window).is_over, state
        yield 0.5
    yield 1.0
