"""Work in a thread gives its result, or its failure, to whoever goes on in turns."""

from __future__ import annotations

import threading

import pytest

from blender_addon.core.aside import aside, at_once


def test_the_result_is_returned_after_turns_that_say_nothing_yet():
    go_on = threading.Event()
    steps = aside(lambda: go_on.wait(10.0) and "done")
    assert [next(steps), next(steps)] == [0.0, 0.0]
    go_on.set()
    assert at_once(steps) == "done"


def test_what_it_raises_is_raised_by_the_turns():
    with pytest.raises(ZeroDivisionError):
        at_once(aside(lambda: 1 / 0))


def test_given_up_it_ends_unseen():
    go_on = threading.Event()
    steps = aside(go_on.wait)
    next(steps)
    steps.close()
    go_on.set()
    with pytest.raises(StopIteration):
        next(steps)
