"""Timers of the extension go on after a mistake: Blender drops one that raises, and nobody would look any more."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import pytest

from blender_addon import clock, ui
from blender_addon.hand import poses as pose_library
from blender_addon.renderer import jobs as renderer_jobs
from blender_addon.renderer import runtime


@pytest.fixture(autouse=True)
def told(monkeypatch):
    """What was printed."""
    errors = []
    monkeypatch.setattr(clock, "_told", set())
    monkeypatch.setattr(clock.traceback, "print_exception", errors.append)
    return errors


def test_the_watch_of_jobs_goes_on_after_a_mistake_which_is_told_once(context, monkeypatch, told):
    def mistaken():
        raise RuntimeError("a mistake")

    monkeypatch.setattr(runtime, "_jobs", SimpleNamespace(tick=mistaken))
    assert [runtime._tick() for _ in range(3)] == [renderer_jobs.JOB_LOOK_S] * 3
    assert [str(error) for error in told] == ["a mistake"]


def test_what_cannot_be_looked_at_does_not_hide_the_rest(context, monkeypatch, told):
    def bad(_context):
        raise RuntimeError("no such disk")

    registry = SimpleNamespace(is_registered=lambda _: False, register=lambda *_, **__: None)
    context = bpy.context
    app = SimpleNamespace(background=False, timers=registry)
    monkeypatch.setattr(ui, "bpy", SimpleNamespace(app=app, context=bpy.context))
    for look in (bad, lambda _: 7, bad):
        ui.kept(context, look)
    good = next(key[0] for key in ui._wanted if key[0] is not bad)
    ui._look_up()
    assert ui.kept(context, good) == 7
    assert ui.kept(context, bad) is None
    assert [str(error) for error in told] == ["no such disk"]
    ui._kept.clear()


def test_a_shelf_that_cannot_be_shown_is_left(context, monkeypatch, told):
    monkeypatch.setattr(pose_library, "bpy", SimpleNamespace(context=None))
    assert pose_library._try_to_show() is None
    assert len(told) == 1
    assert not bpy.app.timers.is_registered(pose_library._try_to_show)
