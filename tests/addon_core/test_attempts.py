"""What fails is tried again a few times, with a rest between, and then left alone."""

from __future__ import annotations

import itertools

from blender_addon.core import pacing
from blender_addon.core.pacing import Attempts


def test_it_is_tried_again_after_a_rest_and_not_for_ever():
    attempts, now_s, tried = Attempts(), 100.0, []
    for _ in range(400):
        if attempts.allowed(now_s):
            tried.append(now_s)
            attempts = attempts.after_failure(now_s)
        now_s += 0.05
    assert len(tried) == pacing.DRAW_TRIES
    assert all(later - earlier >= pacing.DRAW_REST_S for earlier, later in itertools.pairwise(tried))
    assert attempts.due_s() is None


def test_what_never_failed_has_nothing_due():
    assert Attempts().due_s() is None
    assert Attempts().allowed(0.0)
    assert Attempts().after_failure(3.0).due_s() == 3.0 + pacing.DRAW_REST_S
