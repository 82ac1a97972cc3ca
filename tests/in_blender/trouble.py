# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine dies, and Blender goes on: a sentence, a button, a picture, and never a lost scene."""

from __future__ import annotations

import os
import signal

import bpy

from in_blender.animator import close_other_windows
from in_blender.pictures import skin


def kill_engine(window):
    os.kill(window.runtime().link().status.handshake["pid"], signal.SIGKILL)
    yield lambda: window.runtime().link().status.state == "failed"
    yield 0.7


def step_a_hand_is_there(window):
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    yield from window.open_sidebar()
    window.add_hand("left")
    yield from window.settle()
    assert skin(window.crop(window.picture("left_hand"))).mean() > 0.03


def step_a_killed_engine_is_a_sentence_with_a_remedy(window):
    yield from kill_engine(window)
    failure = window.runtime().link().status.failure
    assert failure.kind == "killed"
    assert failure.advice.sentence
    assert failure.advice.remedy
    window.picture("killed")


def step_its_button_brings_the_picture_back(window):
    assert window.call("jghand.restart_engine") == {"FINISHED"}
    yield from window.settle()
    assert skin(window.crop(window.picture("started_again"))).mean() > 0.03


def step_a_view_at_rest_brings_a_killed_engine_back(window):
    yield from kill_engine(window)
    yield lambda: window.runtime().link().status.state == "ready"
    yield from window.settle()
    assert skin(window.crop(window.picture("back_by_itself"))).mean() > 0.03


def step_f12_starts_a_dead_engine_itself(window):
    window.call("jghand.use_engine")
    window.call("jghand.add_camera")
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 320, 240
    scene.render.filepath = str(window.out / "after_death.png")
    yield from window.settle()
    yield from kill_engine(window)
    yield window.module("renderer.state").RESTART_S  # no earlier does it start again by itself
    with window.override():
        bpy.ops.render.render("INVOKE_DEFAULT", write_still=True)
    yield lambda: not bpy.app.is_job_running("RENDER")
    yield 1.0
    window.picture("rendered_after_death")
    assert (window.out / "after_death.png").exists()
    assert window.runtime().link().status.state == "ready"


def step_a_failed_f12_says_why_where_its_image_would_be(window):
    close_other_windows(window)
    camera = bpy.context.scene.camera.data
    camera.type, camera.dof.use_dof = "ORTHO", True
    yield 0.5
    yield from window.point_at_view()
    yield from window.key("F12")
    yield lambda: window.runtime().last_render() is not None and window.runtime().last_render().failure is not None
    yield 2.0
    window.picture("f12_failed")  # the sentence above the image, in a pop-up that is whole, and in the status bar
    assert window.runtime().last_render().failure.kind == "orthographic_lens"
    camera.type, camera.dof.use_dof = "PERSP", False
    close_other_windows(window)


def step_an_avatar_that_is_damaged_or_gone_is_told_in_the_panel(window):
    views, hand = window.module("viewport.views"), bpy.context.object
    file = window.out / "mine.jghand"
    file.write_bytes(b"no avatar")
    for path, kind in ((file, "bad_avatar"), (window.out / "gone.jghand", "no_avatar")):
        hand.jghand.avatar = str(path)
        yield lambda kind=kind: [failure.kind for _, failure in views.problems()] == [kind]
        yield 1.0
        window.picture(kind)
    hand.jghand.avatar = ""
    yield from window.settle()
    assert not views.problems()


def step_no_engine_at_all_is_a_sentence_too(window):
    """The preference wins over everything else; an interpreter that is not there is named."""
    preferences = bpy.context.preferences.addons[window.addon.__name__].preferences
    preferences.engine_python = "/nowhere/python"
    window.runtime().link().restart()
    yield lambda: window.runtime().link().status.state == "failed"
    yield 0.7
    window.picture("no_engine")
    failure = window.runtime().link().status.failure
    assert failure.kind == "no_python"
    assert "/nowhere/python" in failure.detail
    preferences.engine_python = ""
    window.runtime().link().restart()
    yield from window.settle()
